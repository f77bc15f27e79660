"""Parts that can be exchanged: the impedance stays as it is, and where it would not there is no exchange."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.network.symmetry import branch_exchanges, exchanges

FREQUENCY = np.geomspace(1, 1000, 7)


@pytest.mark.parametrize(
    ("notation", "pairs"),
    [
        ("(n1-r1)|(r2-n2)", 1),
        ("(n1-r1)|(n2-r2)|m1|(n3-r3)", 3),
        ("a:(n1|r1)-b:(r2|n2)-m1", 1),
        ("(n1-(r1|m1))|((m2|r2)-n2)", 1),
        ("((n1-r1)|(n2-r2)|m1)-((n3-r3)|m2|(n4-r4))", 3),
        ("(n1-delay[d1](r1))|(delay[d2](r2)-n2)", 1),
        ("(n1-p1^a1)|(p2^a2-n2)", 1),
        ("(n1*-r1)|(n2*-r2)", 1),
        ("(n1-r1=2.0)|(n2-r2=2.0)", 1),
    ],
)
def test_the_impedance_stays_as_it_is(notation: str, pairs: int) -> None:
    kernel = Kernel(parse(notation))
    found = exchanges(kernel.network)
    assert len(found) == pairs
    u = np.random.default_rng(1).normal(size=len(kernel.elements))
    before = kernel.impedance(u[None], FREQUENCY)
    for exchange in found:
        rows = [kernel.elements.index(exchange.get(name, name)) for name in kernel.elements]
        assert rows != sorted(rows)
        np.testing.assert_allclose(kernel.impedance(u[rows][None], FREQUENCY), before, rtol=1e-12)


@pytest.mark.parametrize(
    "notation",
    [
        "m1|r1|n1",
        "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))",
        "(n1-r1)|(n2-m2)",
        "(n1*-r1)|(n2-r2)",
        "(n1-r1=2.0)|(n2-r2=3.0)",
        "(n1-p1^a1@10)|(n2-p2^a2@20)",
        "(n1-lowpass[t1](r1))|(n2-hysteretic[e1](r2))",
    ],
)
def test_what_differs_in_more_than_names_is_not_exchanged(notation: str) -> None:
    assert exchanges(parse(notation)) == ()


def test_branches_at_different_places_are_exchanged_whole() -> None:
    (exchange,) = branch_exchanges(parse("(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))"))
    assert exchange == {"n3": "n2", "r3": "r2", "n2": "n3", "r2": "r3"}


@pytest.mark.parametrize(
    "notation",
    [
        "(n1-r1)|(r2-n2)",  # of one group: that is no other network
        "m1|(n1-r1)|(n2-m2)",  # of other kinds
        "(n1-r1)|(m1-(n2-(r2|m2)))",
        "(n1-r1*)|(m1-((n2-r2)|m2))",  # one of them the same for all
        "m1|r1|n1",
    ],
)
def test_others_are_not(notation: str) -> None:
    assert branch_exchanges(parse(notation)) == ()
