"""A network is another one with an addition if that one is left when what is new is taken out."""

from __future__ import annotations

import pytest

from bayes_impedance.network.additions import extends
from bayes_impedance.network.notation import parse

PLAIN = "(n3|r3)-(m2|r1|n1)"


@pytest.mark.parametrize(
    "network",
    [
        "delay[d1*]((n3|r3)-(m2|r1|n1))",
        "(m2|n1|delay[d1](r1))-skin:(r3|n3)",
        "offset[m9*](highpass[f1=0.1]((n3|r3)-(m2|r1|n1)))",
        "(n3|r3|p9^a9@100)-(m2|r1|n1)",
        "(n3|r3|p9^0.5)-(m2|r1|n1)",
        "m9*|((n3|r3)-(m2|r1|n1))",
        "(n3|r3)-(m2|r1|(n1-(n4|r4)))",
        "(n3|(r3-n9))-tissue:(m2|(r1-r8)|n1)",
        "(n3|r3)-(rest:(m2|r1)|n1)-n9",
        "(n3|r3)-(m2*|r1|line_free[m8](n1))",
    ],
)
def test_an_addition_is_recognised(network: str) -> None:
    assert extends(parse(network), parse(PLAIN))
    assert not extends(parse(PLAIN), parse(network))


@pytest.mark.parametrize(
    "network",
    [PLAIN, "(n1|r1)-(m2|r3|n3|r9)", "(n3-r3)|(m2-r1-n1)|r9", "(n3|r3)-(m2|r1|p9^a9)", "r9", "n3|r3|m2|r1|n1|r9"],
)
def test_another_network_is_none(network: str) -> None:
    assert not extends(parse(network), parse(PLAIN))


def test_wrappers_of_the_network_before_stay() -> None:
    plain = parse("hysteretic[e1](n1)|r1")
    assert extends(parse("delay[d1](hysteretic[e1](n1-n2)|r1)"), plain)
    assert not extends(parse("delay[d1](n1|r1|hysteretic[e1](n2))"), plain)
