"""Coefficient equations: the network's own polynomials, and all their real solutions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from strategies import networks_with_elements, repeatable

from bayes_impedance.classical.coefficients import CoefficientEquations, exact_solutions, log_sensitivity
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.rational import TransferFunction

PAPER = parse(PAPER_NETWORK)
EQUATIONS = CoefficientEquations.of(PAPER)
TYPICAL = {"n3": 6.7e-7, "r3": 60.0, "m2": 7.6e-4, "r1": 1.5, "n1": 1.2e-3, "m1": 0.05, "n2": 4.9e-3, "r2": 3.7}
CENTRE = np.log([TYPICAL[e] for e in EQUATIONS.elements])


def rational(values):
    return PAPER.transfer_function(values).normalised()


def by_elimination(transfer):
    """Eq. 4 taken apart by hand: one candidate for every real zero of Z, with the two conditions that are left over.

    1/Z = (1/r3) s/(s + a) + 1/Zt with a = 1/(n3 r3): the skin's pole is a zero of Z, and 1/Zt vanishes at infinity.
    Then Zt = s m2 + 1/(s n1) + r1 + limb, whose last two are a biquadratic with limb(0) = 0 and limb(inf) = r2.
    """
    b, a = np.asarray(transfer.numerator, dtype=float), np.asarray(transfer.denominator, dtype=float)
    scale = 300.0
    b, a = b * scale ** np.arange(5, -1, -1.0), a * scale ** np.arange(5, -1, -1.0)
    found = []
    for zero in np.roots(b):
        if abs(zero.imag) > 1e-9 * abs(zero):
            continue
        corner = -zero.real
        at_infinity = a[0] / b[0]
        residue = np.polyval(a, zero.real) / np.polyval(np.polyder(b), zero.real)
        first = residue / (-corner * at_infinity)
        rest, _ = np.polydiv(b, [1.0, corner])  # the other zeros
        top, _ = np.polydiv(np.polysub(a, at_infinity * np.polymul([1.0, 0.0], rest)), [1.0, corner])
        # Without the skin the mobility is top / rest, and top has lost its highest power.
        top = top[-4:]
        mass, inverse = rest[0] / top[0], rest[-1] / top[-2]
        left = np.polysub(rest, np.polymul(top, [mass, 0.0]))
        left = np.polysub(left, inverse * top[:-1])
        biquadratic = left[-4:-1] / top[-2]
        below = top[:-1] / top[-2]
        r1, r2 = biquadratic[-1], biquadratic[0] / below[0] - biquadratic[-1]
        n2, slope = below[1] / r2, biquadratic[1] - biquadratic[-1] * below[1]
        m1 = below[0] / n2
        values = {
            "n3": at_infinity / corner / scale,
            "r3": 1 / at_infinity,
            "m2": mass / scale,
            "r1": r1,
            "n1": 1 / inverse / scale,
            "m1": m1 / scale,
            "n2": n2 / scale,
            "r2": r2,
        }
        found.append((values, first - 1, slope / m1 - 1))
    return found


@repeatable
@given(networks_with_elements(max_leaves=7))
def test_equations_are_the_networks_own_coefficients(network_and_elements):
    network, log_elements = network_and_elements
    equations = CoefficientEquations.of(network)
    transfer = network.transfer_function(dict(zip(network.elements, np.exp(log_elements).tolist(), strict=True)))
    wanted, surplus = equations.wanted(transfer)
    value, _ = equations.evaluate(log_elements[None], np.ones((1, log_elements.size)))
    assert not surplus
    np.testing.assert_allclose(value[0], wanted, rtol=1e-12)


def test_slopes_are_the_derivatives():
    sign = np.where(np.arange(8) % 3 == 1, -1.0, 1.0)[None]
    _, slope = EQUATIONS.evaluate(CENTRE[None], sign)
    for p in range(8):
        step = 1e-6 * np.eye(8)[p]
        ahead, behind = (EQUATIONS.evaluate((CENTRE + d)[None], sign)[0] for d in (step, -step))
        np.testing.assert_allclose(
            (ahead - behind)[0] / 2e-6, slope[0, :, p], rtol=1e-6, atol=1e-9 * np.abs(slope).max()
        )


def test_eq4_has_ten_coefficients_for_eight_elements():
    assert EQUATIONS.names == ("b5", "b4", "b3", "b2", "b1", "b0", "a5", "a4", "a3", "a2", "a1")
    text = dict(line.split(" = ") for line in EQUATIONS.text())
    assert text["b5"] == "n3 r3 m2 n1 m1 n2"
    assert text["a1"] == "n3 + n1"
    assert text["b0"] == "1"  # the common factor is spoken for: ten are left
    value, slope = EQUATIONS.evaluate(CENTRE[None], np.ones((1, 8)))
    singular = np.linalg.svd(log_sensitivity(value[0], slope[0]), compute_uv=False)
    assert singular.size == 8
    assert singular[-1] > 1e-3 * singular[0]  # full rank: over-determined, and not under-determined


@pytest.mark.parametrize("seed", range(4))
def test_finds_the_elements_of_eq4_again(seed):
    theta = CENTRE + np.random.default_rng(seed).normal(0, 0.7, 8)
    values = dict(zip(EQUATIONS.elements, np.exp(theta).tolist(), strict=True))
    solutions = exact_solutions(EQUATIONS, rational(values), CENTRE, seed)
    exact = [v for v, first, second in by_elimination(rational(values)) if abs(first) < 1e-5 and abs(second) < 1e-5]
    assert len(solutions) == len(exact) == 1
    assert solutions[0].positive
    assert solutions[0].isolated
    for element, value in values.items():
        assert solutions[0].values[element] == pytest.approx(value, rel=1e-8)
        assert exact[0][element] == pytest.approx(value, rel=1e-4)


@pytest.mark.parametrize("wrong", ["m2", "r1", "n2"])
def test_finds_negative_elements_and_says_so(wrong):
    values = {**TYPICAL, wrong: -TYPICAL[wrong]}
    solutions = exact_solutions(EQUATIONS, rational(values), CENTRE)
    assert len(solutions) == 1
    assert not solutions[0].positive
    assert {e for e, v in solutions[0].values.items() if v < 0} == {wrong}
    assert solutions[0].values[wrong] == pytest.approx(values[wrong], rel=1e-8)


def test_a_coefficient_that_is_off_leaves_no_solution():
    transfer = rational(TYPICAL)
    numerator = transfer.numerator.copy()
    numerator[2] *= 1.001
    off = TransferFunction.from_coefficients(numerator.tolist(), transfer.denominator.tolist())
    assert exact_solutions(EQUATIONS, off, CENTRE) == ()
    assert all(max(abs(first), abs(second)) > 1e-4 for _, first, second in by_elimination(off))


def test_a_constant_in_the_denominator_is_an_obstacle():
    transfer = rational(TYPICAL)
    denominator = transfer.denominator.copy()
    denominator[-1] = 1.0
    wanted, surplus = EQUATIONS.wanted(
        TransferFunction.from_coefficients(transfer.numerator.tolist(), denominator.tolist())
    )
    assert surplus == ("a0 = 1",)
    assert np.all(wanted > 0)
    assert exact_solutions(EQUATIONS, TransferFunction.from_coefficients([1.0], denominator.tolist()), CENTRE) == ()


def test_parts_that_can_change_places_give_two_solutions():
    network = parse("(m1-r1)|(m2-r2)|n1")
    values = {"m1": 1.0, "r1": 2.0, "m2": 3.0, "r2": 0.5, "n1": 0.2}
    solutions = exact_solutions(CoefficientEquations.of(network), network.transfer_function(values), np.zeros(5))
    assert len(solutions) == 2
    assert {round(s.values["m1"], 6) for s in solutions} == {1.0, 3.0}
    assert all(s.positive and s.isolated for s in solutions)


def test_a_continuum_is_one_solution_and_not_isolated():
    network = parse("(m1-r1)|m2|m3|n1")
    values = {"m1": 1.0, "r1": 2.0, "m2": 3.0, "m3": 0.5, "n1": 0.2}
    solutions = exact_solutions(CoefficientEquations.of(network), network.transfer_function(values), np.zeros(5))
    positive = [s for s in solutions if s.positive]
    assert len(positive) == 1
    assert not positive[0].isolated
    assert positive[0].values["m2"] + positive[0].values["m3"] == pytest.approx(3.5, rel=1e-6)


def test_same_seed_same_solutions():
    first, second = (exact_solutions(EQUATIONS, rational(TYPICAL), CENTRE, 3) for _ in range(2))
    assert first == second
