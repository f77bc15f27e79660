"""Operations by themselves: their formulas, and derivatives against central differences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from operation_cases import (
    CASE,
    CASES,
    FREQUENCY,
    NETWORK,
    OF_THE_PLACE,
    OMEGA,
    THETA,
    W0,
    Case,
    S,
    assert_close,
    difference,
    five,
    formula,
    operation,
    some_impedances,
)

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.operations import LOGARITHMIC, N_PARAMETERS, NAMES, OWN_CODES, Operation, code_of
from bayes_impedance.network.rows import slopes_row, transform_row
from bayes_impedance.network.transform import transform, transform_many


def test_every_operation_is_tried() -> None:
    assert {case.name for case in CASES} == set(OF_THE_PLACE)
    codes = [*(Operation(name, (), (), ()).code for name in NAMES), *OWN_CODES.values()]
    assert sorted(codes) == list(range(1, len(codes) + 1))


@CASE
def test_an_operation_is_its_formula(case: Case) -> None:
    z = some_impedances(1)
    np.testing.assert_allclose(five(case, case.u, z)[0], formula(case, S, z), rtol=1e-11)


@CASE
def test_five_outputs_against_central_differences(case: Case) -> None:
    z = some_impedances(2)
    _, slope, *by_parameter = five(case, case.u, z)
    for turn in (1.0, 1j):  # T is holomorphic in z: every direction gives the same slope
        numeric = difference(lambda h, step=turn * z: five(case, case.u, z + h * step)[0]) / (turn * z)
        assert_close(slope, numeric, np.ones_like(z))
    for k in range(N_PARAMETERS):
        if k >= len(case.u):
            assert not by_parameter[k].any()
            continue
        one = np.eye(len(case.u))[k]
        assert_close(by_parameter[k], difference(lambda h, one=one: five(case, case.u + h * one, z)[0]), z)


@CASE
def test_all_frequencies_at_once_are_one_by_one(case: Case) -> None:
    """The loops that a network uses, against the formula for one frequency: to a few units of the last digit."""
    assert_rows_are_formulas(code_of(case.name), case.constants, case.u)


@pytest.mark.parametrize("name", OWN_CODES)
def test_all_frequencies_at_once_for_a_networks_own_nodes(name: str) -> None:
    for constants in ((1.0, 1.0, LOGARITHMIC), (0.0, W0, LOGARITHMIC), (0.0, -1.0, LOGARITHMIC)):
        if name != "power_law" or constants[1] > 0:
            assert_rows_are_formulas(OWN_CODES[name], constants, (-0.7, 0.4, 0.2))


def assert_rows_are_formulas(code: int, constants: Sequence[float], u: Sequence[float]) -> None:
    z, c = some_impedances(5), np.zeros(N_PARAMETERS)
    c[: len(constants)] = constants
    own = (*u, 0.0, 0.0)[:N_PARAMETERS]
    sums, adjoints = (np.array([[x.real, x.imag]]) for x in (z, np.full_like(z, 0.3 - 0.8j)))
    output, slopes = np.empty_like(sums), np.empty((N_PARAMETERS, 2, z.size))
    transform_row(code, own, c, OMEGA, sums, output, 0)
    slopes_row(code, own, c, OMEGA, sums, adjoints, 0, slopes)
    value, inner, *by_u = transform_many(code, np.array([own]), c, OMEGA, z[None])[:, 0]
    np.testing.assert_allclose(output[0, 0] + 1j * output[0, 1], value, rtol=1e-14)
    turned = adjoints[0, 0] + 1j * adjoints[0, 1] - (0.3 - 0.8j) * inner
    # A thin line's T hardly depends on z: its dT/dz is a small difference of two terms of the size of T/z.
    assert np.all(np.abs(turned) <= 2e-14 * np.maximum(np.abs(inner), np.abs(value / z)))
    for slope, expected in zip(slopes, by_u, strict=True):
        np.testing.assert_allclose(slope[0] + 1j * slope[1], (0.3 - 0.8j) * expected, rtol=2e-14)


@CASE
def test_zero_coefficient_changes_nothing(case: Case) -> None:
    z = some_impedances(3)
    positive = case.constants[2:] == (LOGARITHMIC,)  # by construction: as small as one likes, but never zero
    u = (0.0, 0.0) if case.name == "bypass" else (-60.0 if positive else 0.0, *case.u[1:])
    np.testing.assert_allclose(five(case, u, z)[0], z, rtol=1e-14)
    assert np.abs(five(case, case.u, z)[0] / z - 1).max() > 1e-10


def test_many_are_one_by_one() -> None:
    rng = np.random.default_rng(4)
    u, z = rng.normal(size=(4, 3)), rng.normal(size=(4, 5)) + 2 + 1j * rng.normal(size=(4, 5))
    c = np.array([0.3, 1.0, 0.0])
    for code in (0, *map(code_of, OF_THE_PLACE)):
        many = transform_many(code, u, c, OMEGA[:5], z)
        for m in range(4):
            for f in range(5):
                np.testing.assert_array_equal(many[:, m, f], transform(code, *u[m], *c, OMEGA[f], z[m, f]))


@pytest.mark.parametrize("name", ["delay", "highpass", "lowpass"])
def test_negative_coefficient_is_the_inverse(name: str) -> None:
    case = next(c for c in CASES if c.name == name)
    there = operation(case, ())
    back = Operation(name, (), ("back",), case.constants)
    kernel = Kernel(NETWORK, [there, back])
    z = kernel.impedance([*THETA, 0.8, -0.8], FREQUENCY)
    np.testing.assert_allclose(z, Kernel(NETWORK).impedance(THETA, FREQUENCY), rtol=1e-13)
    once = Kernel(NETWORK, [there]).impedance([*THETA, 0.8], FREQUENCY)
    assert np.abs(once / z - 1).max() > 0.01
