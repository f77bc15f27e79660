"""Operations at places of networks: values, derivatives, chains."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from operation_cases import (
    CASE,
    CASES,
    ELEMENTS,
    FREQUENCY,
    NETWORK,
    PATHS,
    THETA,
    Case,
    S,
    assert_close,
    difference,
    formula,
    operation,
)
from strategies import network_impedance, networks_with_elements, repeatable

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.operations import Operation


def by_hand(case: Case, path: tuple[int, ...]) -> np.ndarray:
    return network_impedance(NETWORK, S, ELEMENTS, path, lambda z: formula(case, S, z))


@CASE
@pytest.mark.parametrize("path", PATHS, ids=str)
def test_an_operation_acts_on_its_place_alone(case: Case, path: tuple[int, ...]) -> None:
    z = Kernel(NETWORK, [operation(case, path)]).impedance([*THETA, *case.u], FREQUENCY)
    np.testing.assert_allclose(z, by_hand(case, path), rtol=1e-10)


def assert_derivative(kernel: Kernel, theta: np.ndarray) -> None:
    z, dz = kernel.derivative(theta, FREQUENCY)
    np.testing.assert_array_equal(z, kernel.impedance(theta, FREQUENCY))
    for p in range(theta.size):
        one = np.eye(theta.size)[p]
        assert_close(dz[p], difference(lambda h, one=one: kernel.impedance(theta + h * one, FREQUENCY)), z)


@CASE
@pytest.mark.parametrize("path", PATHS, ids=str)
def test_derivative_of_the_kernel(case: Case, path: tuple[int, ...]) -> None:
    """By every element and parameter, with a second operation on the tissue around or beside the place."""
    around = Operation("hysteresis", (1,), ("eta",), (1.0,))
    assert_derivative(Kernel(NETWORK, [operation(case, path), around]), np.array([*THETA, *case.u, 0.05]))


@pytest.mark.parametrize("seed", range(6))
def test_derivative_of_chains(seed: int) -> None:
    """Four operations at places and in an order drawn at random, at least two of them at one place."""
    rng = np.random.default_rng(seed)
    cases = [CASES[i] for i in rng.choice(len(CASES), 4, replace=False)]
    places = [PATHS[i] for i in rng.integers(len(PATHS), size=3)]
    places.append(places[0])
    kernel = Kernel(NETWORK, [operation(c, path, i) for i, (c, path) in enumerate(zip(cases, places, strict=True))])
    assert len(kernel.elements) == 8 + sum(len(c.u) for c in cases)
    assert_derivative(kernel, np.concatenate([THETA, *(c.u for c in cases)]))


def test_chained_operations_are_applied_in_their_order() -> None:
    late, mass = Operation("delay", (1,), ("tau",), (1e-4,)), Operation("add", (1,), ("m",), (1e-3, 1.0))

    def expected(form: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
        return network_impedance(NETWORK, S, ELEMENTS, (1,), form)

    first = Kernel(NETWORK, [late, mass]).impedance([*THETA, 0.5, 0.3], FREQUENCY)
    then = Kernel(NETWORK, [mass, late]).impedance([*THETA, 0.3, 0.5], FREQUENCY)
    np.testing.assert_allclose(first, expected(lambda z: z * np.exp(-S * 5e-5) + S * 3e-4), rtol=1e-12)
    np.testing.assert_allclose(then, expected(lambda z: (z + S * 3e-4) * np.exp(-S * 5e-5)), rtol=1e-12)
    assert np.abs(first / then - 1).max() > 1e-3


def test_parameters_come_after_the_elements() -> None:
    kernel = Kernel(NETWORK, [operation(CASES[0], (1,)), operation(Case("bypass", (3.0, 200.0), (0.4, 0.6)), (), 1)])
    assert kernel.elements == (*NETWORK.elements, "x0", "x1", "y1")


@repeatable
@given(networks_with_elements(), st.integers(0, 100), st.sampled_from(CASES))
def test_any_place_of_any_network(network_and_elements: tuple[Network, np.ndarray], k: int, case: Case) -> None:
    network, theta = network_and_elements
    path = network.places()[k % len(network.places())].path
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    z = Kernel(network, [operation(case, path)]).impedance([*theta, *case.u], FREQUENCY)
    expected = network_impedance(network, S, values, path, lambda inside: formula(case, S, inside))
    np.testing.assert_allclose(z, expected, rtol=1e-9)


def test_groups_with_operations_keep_their_kind() -> None:
    """A group that is operated on is no longer flattened into its parent: parallel in parallel, series in series."""
    for notation in ("a:(m1|n1)|r1|n2", "m1-a:(n1-r1)-n2"):
        network = parse(notation)
        place = network.place("a")
        theta = np.array([0.3, -0.2, 0.1, 0.4])
        s = 2j * np.pi * np.array([0.05, 0.2, 1.0])
        values = dict(zip(network.elements, np.exp(theta), strict=True))
        kernel = Kernel(network, [Operation("power", place.path, ("x",), (1.0, 1.0))])
        z = kernel.impedance([*theta, 0.3], s.imag / (2 * np.pi))
        expected = network_impedance(network, s, values, place.path, lambda inside, s=s: inside * s**0.3)
        np.testing.assert_allclose(z, expected, rtol=1e-12)
