"""Elements that no recording can tell apart: what is put together, and the exact rank against numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from strategies import language_with_u, networks, repeatable

from bayes_impedance.errors import InputError
from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, Network, parse
from bayes_impedance.network.parameters import SIGNED
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
        # of the same for all and of people's own, each with its like; what is held stays
        ("m1*|m2*|n1", "m1_m2*|n1", ["m1 + m2"]),
        ("m1*|m2|n1", "m1*|m2|n1", []),
        ("m1*|m2|m3*|m4", "m1_m3*|m2_m4", ["m1 + m3", "m2 + m4"]),
        ("r1=2|r2|r3|r4=1", "r1=2|r2_r3|r4=1", ["r2 + r3"]),
        ("m1=2|m2", "m1=2|m2", []),
        ("m1|m2|m1_m2=3", "m1_m2_|m1_m2=3", ["m1 + m2"]),
        # inside of wrappers; never across one, and no power laws
        ("delay[d1*](n1-n2)|r1|r2", "delay[d1*](n1_n2)|r1_r2", ["n1 + n2", "r1 + r2"]),
        ("m1-x:gain[g1=2]((r1|r2)-r3)", "m1-x:gain[g1=2](r1_r2_r3)", ["1/(1/(r1 + r2) + 1/r3)"]),
        ("offset[m1*](m2|m3)", "offset[m1*](m2_m3)", ["m2 + m3"]),
        ("gain[g1](m1)|m2|p1^0.5|p2^0.5", "gain[g1](m1)|m2|p1^0.5|p2^0.5", []),
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


@pytest.mark.parametrize(
    ("written", "lost"),
    [
        # what nothing in one person's curve tells apart
        ("m1*|m2|r1", ("m1", "m2")),
        ("n1*-n2-r1", ("n1", "n2")),
        ("m1=3|m2|r1", ()),
        ("offset[m1*](m2|r1)", ("m1", "m2")),
        ("offset[m1*](m2-r1)", ()),
        ("offset[k1*](n1|r1)-m1", ("k1", "n1")),
        ("offset[k1=3](n1|r1)-m1", ()),
        # values that are held stand in relations to one another
        ("highpass[f1=-1](m1)|highpass[f2=-1](m2)", ("m1", "m2")),
        ("lowpass[t1=1](m1)|lowpass[t2=2](m2)", ()),
        ("lowpass[t1=0.25](m1)-lowpass[t2=0.25](m2)", ("m1", "m2")),
        ("(m1=1-(r1=2|(r2=4-n1)))|(m2-r3)", ()),
        ("offset[m1=-0.5](m2=0.5|r1)|offset[r2=-1](m3=1|r3=1)-r4", ()),
        # a gain absorbs every size inside
        ("gain[g1](n1|r1)", ("g1", "n1", "r1")),
        ("gain[g1](n1=3|r1)", ()),
        ("gain[g1=2](n1|r1)", ()),
        ("gain[g1*](p1^a1)", ("g1", "p1")),
        ("m1|gain[g1](line_free[m2](r1|delay[d1](n2)))", ("g1", "m2", "r1", "n2")),
        # lines
        ("line_matched[r1](n1)", ("r1", "n1")),
        ("line_matched[m1](n1|r1)", ("m1", "n1", "r1")),
        ("line_matched[m1](n1|r1=2)", ()),
        ("line_free[r1](n1)", ()),
        ("line_fixed[m1](n1|r1)-m2", ()),
        ("line_free[m1](m2)", ("m1", "m2")),  # a layer of mass all through
        ("line_fixed[r1](gain[g1=2](r2))|line_free[r3](n3)", ("r1", "r2")),
        # power laws
        ("p1^a1|p2^a2", ()),
        ("p1^0.5|p2^0.5", ("p1", "p2")),
        ("p1^0.5@3|p2^0.5@80|r1", ("p1", "p2")),
        ("p1^0.5|p2^0.25", ()),
        ("line_matched[r1](n1)|p1^0.5", ("r1", "n1", "p1")),
        ("line_matched[r1](n1)|p1^0.51", ("r1", "n1")),
        ("line_matched[r1](n1)|line_matched[r2=3](n2)", ("r1", "n1", "n2")),
        ("line_matched[r1=1](line_matched[r2=1](n1))|p1^0.75", ("n1", "p1")),
        ("line_matched[r1=1](line_matched[r2=1](n1))|p1^0.5", ()),
        # delays and filters
        ("delay[d1*](delay[d2](r1))", ("d1", "d2")),
        ("delay[d1*](delay[d2=0.3](r1))", ()),
        ("delay[d1=0.3](m1)|delay[d2=0.3](m2)", ("m1", "m2")),
        ("delay[d1=0](m1)|m2", ("m1", "m2")),
        ("lowpass[t1](r1-n1)", ()),
        ("lowpass[t1=0](m1)|m2", ("m1", "m2")),
        ("lowpass[t1=-0.2](r1)|m1|r2", ("r1", "m1", "r2")),
        ("lowpass[t1=0.2](r1)|m1|r2", ()),
        ("highpass[f1=-0.2](r1)|n1|r2", ("r1", "n1", "r2")),
        ("highpass[f1*](r1)|n1|r2", ()),
        ("lowpass[t1](r1)|(n1-r2)", ()),
        # a spring with a loss is no damper at any frequency but one; its real and imaginary part are two numbers
        ("hysteretic[e1](n1)", ()),
        ("hysteretic[e1](n1)|n2|r1", ("e1", "n1", "n2")),
        ("hysteretic[e1](n1)|hysteretic[e2](n2)", ("e1", "n1", "e2", "n2")),
        ("reflex[k1,d1,f1](r1)|n1", ()),
        ("reflex[k1,d1=0.1,f1](n1|r1)", ()),
        ("reflex[k1,d1,f1](reflex[k2,d2,f2=3](m1))", ()),
    ],
)
def test_parameters_that_others_can_take_over(written: str, lost: tuple[str, ...]) -> None:
    assert inseparable(parse(written)) == lost


def test_every_wrapper_has_its_derivatives_in_residues() -> None:
    for construct in CONSTRUCTS.values():
        for first in construct.letters[0]:
            own = ", ".join(f"{letters[0] if i else first}1" for i, letters in enumerate(construct.letters))
            assert set(inseparable(parse(f"{construct.word}[{own}](r7-(m8|n9))"))) <= {f"{first}1", "r7", "m8", "n9"}


def test_deeply_nested_roots_are_found_or_given_up_in_words() -> None:
    text = "n0|r0"
    for k in range(1, 6):
        text = f"line_matched[r{k}]({text})|m{k}"
    assert len(inseparable(parse(text))) == 12 - 1  # the outermost mass is free of the roots
    for k in range(6, 22):
        text = f"line_matched[r{k}]({text})|m{k}"
    with pytest.raises(InputError, match="too many nested infinite lines"):
        inseparable(parse(text))


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


@repeatable
@given(language_with_u(max_leaves=5))
def test_the_exact_rank_is_that_of_numerical_derivatives_in_the_whole_language(network_and_u) -> None:
    network, u = network_and_u
    if not 0 < u.size <= 5:
        return
    u = u + np.random.default_rng(3).normal(scale=0.2, size=u.size)  # no round numbers, of which some are special
    signed = [p.link == SIGNED for p in network.parameters if not p.held]
    u = np.where(signed, np.abs(u), u)  # below zero a filter is another function
    frequency = np.geomspace(0.003, 30, 120)
    z, slope = Kernel(network).derivative(u, frequency)
    relative = slope / z
    columns = np.hstack([relative.real, relative.imag])
    sizes = np.linalg.svd(columns / np.linalg.norm(columns, axis=1, keepdims=True), compute_uv=False)
    assert sizes[-1] < 1e-13 if inseparable(network) else sizes[-1] > 1e-9
