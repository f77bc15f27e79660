"""Elements that no recording can tell apart: what is put together, and the exact rank against numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from strategies import networks, repeatable

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, Network, parse
from bayes_impedance.network.redundancy import inseparable, merged


@pytest.mark.parametrize(
    ("written", "fitted", "expressions"),
    [
        ("(n1-n2)|r1|m1", "n1_n2|r1|m1", ["n1 + n2"]),
        ("n1|n2|r1", "n1_n2|r1", ["1/(1/n1 + 1/n2)"]),
        ("r1|r2", "r1_r2", ["r1 + r2"]),
        ("r1-r2-n1", "r1_r2-n1", ["1/(1/r1 + 1/r2)"]),
        ("m1|m2|n1", "m1_m2|n1", ["m1 + m2"]),
        ("m1-m2", "m1_m2", ["1/(1/m1 + 1/m2)"]),
        ("n1-(r1|r2)-n3", "n1_n3-r1_r2", ["r1 + r2", "n1 + n3"]),
        ("(m1-(m2|(m3-m4)))|r1", "m1_m2_m3_m4|r1", ["1/(1/m1 + 1/(m2 + 1/(1/m3 + 1/m4)))"]),
        ("skin:(n1-n2)-r1", "skin:n1_n2-r1", ["n1 + n2"]),
        (PAPER_NETWORK, PAPER_NETWORK, []),
        ("(n1-r1)|(n2-r2)", "(n1-r1)|(n2-r2)", []),
    ],
)
def test_like_elements_side_by_side_become_one(written: str, fitted: str, expressions: list[str]) -> None:
    network, combinations = merged(parse(written))
    assert str(network) == str(parse(fitted))
    assert [c.expression for c in combinations] == expressions


@repeatable
@given(networks())
def test_the_merged_network_has_the_impedance_of_the_written_one(network: Network) -> None:
    smaller, combinations = merged(network)
    values = dict(
        zip(network.elements, np.exp(np.random.default_rng(1).normal(size=len(network.elements))), strict=True)
    )
    combined = values | {c.name: eval(c.expression, {}, dict(values)) for c in combinations}
    s = 1j * np.geomspace(0.1, 10, 7)
    np.testing.assert_allclose(smaller.impedance(s, combined), network.impedance(s, values), rtol=1e-9)
    assert merged(smaller) == (smaller, ())


@pytest.mark.parametrize(
    ("written", "lost"),
    [
        ("n1|r1|m1", ()),
        (PAPER_NETWORK, ()),
        ("(n1-r1)|(n2-r2)", ()),  # equal parts may change places, but each is determined
        ("(n1-n2)|r1", ("n1", "n2")),
        ("(r1-(r2|n1))|r3", ("r1", "r2", "n1", "r3")),  # four elements, three coefficients
        ("skin:(n1-r1)-n2", ("n1", "n2")),
        ("m1|((r1-(r2|n1))|r3)", ("r1", "r2", "n1", "r3")),
    ],
)
def test_what_others_can_take_over_is_inseparable(written: str, lost: tuple[str, ...]) -> None:
    assert inseparable(parse(written)) == lost


def test_a_long_ladder_is_separable() -> None:
    """Thirty elements: the numerical rank of the derivatives would be a matter of the tolerance."""
    text = "r0|n0"
    for k in range(1, 15):
        text = f"n{k}|(r{k}-({text}))"
    assert inseparable(parse(text)) == ()


@repeatable
@given(networks())
def test_the_exact_rank_is_that_of_numerical_derivatives(network: Network) -> None:
    if len(network.elements) > 6:
        return  # the numerical rank is no oracle for more
    kernel = Kernel(network)
    theta = np.random.default_rng(2).normal(scale=0.5, size=(1, len(kernel.elements)))
    frequency = np.geomspace(0.01, 10, 60)
    z, slope = kernel.derivative(theta, frequency)
    relative = (slope / z[:, None])[0]
    columns = np.hstack([relative.real, relative.imag])
    sizes = np.linalg.svd(columns, compute_uv=False)
    smallest = sizes[-1] / sizes[0]
    assert smallest < 1e-13 if inseparable(network) else smallest > 1e-14
