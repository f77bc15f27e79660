"""What is said to be passive is, at any values; what is doubted can be active."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from strategies import language_impedance, language_with_u, repeatable, values_of_u

from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.notation import parse
from bayes_impedance.network.passivity import doubts_of_passivity, known_passive

S = 2j * np.pi * np.geomspace(1e-3, 1e3, 97)
RIGHT = np.concatenate([S, *(abs(S) * np.exp(1j * angle) for angle in np.linspace(0, 1.5, 5))])
"""Also growing motions: a mass below zero has no real part at any frequency, but drives whatever it is attached to."""


def where(text: str) -> np.ndarray:
    """A loss factor is defined for steady vibrations only."""
    return S if "hysteretic" in text else RIGHT


def rounding(z: np.ndarray) -> np.ndarray:
    return 1e-9 * np.abs(z)


@repeatable
@given(language_with_u(max_leaves=7))
def test_what_is_known_to_be_passive_is(network_and_u) -> None:
    network, u = network_and_u
    if known_passive(network):
        z = language_impedance(network, where(str(network)), values_of_u(network, u))
        assert np.all(z.real >= -rounding(z))


@repeatable
@given(language_with_u(passive=True))
def test_networks_of_passive_parts_are_known_to_be(network_and_u) -> None:
    network, _ = network_and_u
    shared_offset = any(p.link == "signed" and not (p.held and p.symbol.value > 0) for p in network.parameters)
    assert known_passive(network) == (not shared_offset)


ACTIVE = {
    "delay[d1](n1)": {"d1": 0.1, "n1": 1.0},
    "m1|delay[d1=-0.1](r1)": {"m1": 1.0, "r1": 1.0},
    "highpass[f1](m1)": {"f1": 1.0, "m1": 1.0},
    "highpass[f1*](n1)": {"f1": -1.0, "n1": 1.0},
    "lowpass[t1](n1)": {"t1": 1.0, "n1": 1.0},
    "lowpass[t1*](m1)": {"t1": -1.0, "m1": 1.0},
    "offset[m1*](r1-n1)": {"m1": -1.0, "r1": 1.0, "n1": 1.0},
    "offset[r1*](n1)": {"r1": -1.0, "n1": 1.0},
    "offset[r1=-1](n1)": {"n1": 1.0},
    "hysteretic[e1](m1)": {"e1": 1.0, "m1": 1.0},
    "hysteretic[e1](p1^b1)": {"e1": 5.0, "p1": 1.0, "b1": 1.9},
    "hysteretic[e1](n1|line_free[m1](n2))": {"e1": 5.0, "n1": 1.0, "m1": 1.0, "n2": 1.0},
    "hysteretic[e1](hysteretic[e2](n1|r1))": {"e1": 9.0, "e2": 9.0, "n1": 1.0, "r1": 1.0},
    "reflex[r1,d1,f1](n1)": {"r1": 1.0, "d1": 0.3, "f1": 1.0, "n1": 1.0},
    "reflex[k1,d1,f1](n1)": {"k1": 1.0, "d1": 0.3, "f1": 1.0, "n1": 1.0},
}
"""Networks that may be active, and values at which they are."""


@pytest.mark.parametrize("text", ACTIVE)
def test_what_is_doubted_can_be_active(text: str) -> None:
    network = parse(text)
    assert not known_passive(network)
    z = network.impedance(where(text), ACTIVE[text])
    assert np.any(z.real < -rounding(z))


def test_every_active_wrapper_is_tried() -> None:
    assert {word for word, c in CONSTRUCTS.items() if not c.passive or c.signed} <= {
        t for t in CONSTRUCTS if any(t in text for text in ACTIVE)
    }


@pytest.mark.parametrize(
    "text",
    [
        "m1|r1-n1",
        "p1^a1|p2^b1",
        "gain[g1*](m1|n1)",
        "line_matched[m1](line_free[r1](n1)|r2)-p1^b1",
        "offset[m1](n1)",
        "offset[m1=0.5](n1)",
        "offset[m1=0](n1)",
        "delay[d1=0](lowpass[t1=0](m1))",
        "hysteretic[e1](n1)",
        "hysteretic[e1](n1-(r1|p1^a1)|p2^0.5)",
        "hysteretic[e1](line_free[r1](n1|r2)-offset[k1](n2))",
        "hysteretic[e1](line_fixed[r1](n1)|gain[g1](line_matched[r3](p1^a1)))",
        "hysteretic[e1](hysteretic[e2](n1-n2))",
        "squeeze_film[r1,t1](m1)",
        "hysteretic[e1](squeeze_film[r1,t1](n1))",
    ],
)
def test_what_is_certified(text: str) -> None:
    network = parse(text)
    assert known_passive(network)
    rng = np.random.default_rng(1)
    for _ in range(50):
        values = {
            p.name: float({"a": 0, "b": 1}[p.letter] + rng.random() if p.letter in "ab" else np.exp(rng.normal(0, 2)))
            for p in network.parameters
        }
        z = network.impedance(where(text), values)
        assert np.all(z.real >= -rounding(z))


@pytest.mark.parametrize(
    ("text", "doubts"),
    [
        ("m1|n1", ()),
        ("m1|delay[d1](n1)", ("delay[d1](...) shifts the phase without bound",)),
        (
            "lowpass[t1*](highpass[f1=2](m1))",
            (
                "lowpass[t1*](...) shifts the phase by up to 90 degrees",
                "highpass[f1=2](...) shifts the phase by up to 90 degrees",
            ),
        ),
        ("offset[m1*](n1)", ("offset[m1*](...) may subtract from the impedance",)),
        ("offset[m1=-2](n1)", ("offset[m1=-2](...) subtracts from the impedance",)),
        (
            "hysteretic[e1](n1|m1)",
            ("hysteretic[e1](...) is applied to a part with inertia, whose phase it shifts beyond 90 degrees",),
        ),
        ("reflex[k1,d1,f1*](n1)", ("reflex[k1, d1, f1*](...) responds with a delay, so that it can add energy",)),
    ],
)
def test_the_reason_is_told(text: str, doubts: tuple[str, ...]) -> None:
    assert doubts_of_passivity(parse(text)) == doubts
