"""When a network is shown as a circuit, and how."""

from __future__ import annotations

import pytest

from bayes_impedance.network.electrical import read_circuit
from bayes_impedance.network.notation import parse
from bayes_impedance.network.spellings import circuit_of, in_both


@pytest.mark.parametrize("circuit", ["R0-p(R1,CPE1)-Wo1", "p(R1,C1)-L2", "R0-La1-W1-Ws2"])
def test_what_was_given_as_a_circuit_is_shown_as_that_circuit(circuit: str) -> None:
    notation = str(read_circuit(circuit))
    assert circuit_of(notation, "ohm") == circuit
    assert in_both(notation, "ohm") == f"{notation} = {circuit}"


@pytest.mark.parametrize(
    ("notation", "circuit"),
    [
        ("m9*|r0|(r1-n1)", "L9-R0-p(R1,C1)"),
        ("m9=1e-05|r0", "L9-R0"),
        ("m9=0.0115|r0", "L9-R0"),
        ("cell:(r1-p1^a1@12.5)|p2^a2@1e-3", "p(R1,CPE1)-CPE2"),
        ("r0|p1^0.5@30", "R0-W1"),
    ],
)
def test_marks_are_no_part_of_a_circuit(notation: str, circuit: str) -> None:
    assert circuit_of(notation, "ohm") == circuit
    plain = parse(circuit)
    assert len(plain.elements) == sum(not p.held or bool(p.name) for p in parse(notation).parameters)


@pytest.mark.parametrize(
    ("notation", "unit"),
    [
        ("r0|n1", "N s/m"),
        ("r0|n1", "Pa s/m3"),
        ("delay[d1*](r0|n1)", "ohm"),
        ("r0|p1^0.7", "ohm"),
        ("no network", "ohm"),
    ],
)
def test_what_is_not_shown_as_a_circuit(notation: str, unit: str) -> None:
    assert circuit_of(notation, unit) == ""
    assert in_both(notation, unit) == notation


def test_without_a_network_there_is_no_circuit() -> None:
    assert circuit_of(None, "ohm") == ""
