"""Operations against their formulas, central differences, networks of more elements, and passivity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import network_impedance, networks_with_elements, repeatable

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, Element, Network, parse
from bayes_impedance.network.operations import LOGARITHMIC, N_PARAMETERS, NAMES, Operation, transform, transform_many

NETWORK = parse(PAPER_NETWORK)
FREQUENCY = np.geomspace(5, 5000, 23)
OMEGA = 2 * np.pi * FREQUENCY
S = 1j * OMEGA
THETA = np.log([6.76e-7, 61.4, 7.9e-4, 1.52, 1.15e-3, 0.0517, 4.73e-3, 3.82])
ELEMENTS = dict(zip(NETWORK.elements, np.exp(THETA), strict=True))
W0 = 600.0

PATHS = ((), (0,), (0, 1), (1, 2), (1, 3), (1, 3, 1, 0))
"""The port, the skin, a damper in it, a spring, the limb, and a spring at its end."""


class Case(NamedTuple):
    """An operation with constants and parameters at which it changes the fingertip by a part of itself."""

    name: str
    constants: tuple[float, ...]
    u: tuple[float, ...]

    @property
    def x(self) -> float:
        return float(np.exp(self.u[0])) if self.constants[2:] == (LOGARITHMIC,) else self.constants[0] * self.u[0]


CASES = (
    Case("add", (1e-5, 1.0), (0.7,)),
    Case("add", (0.1, 0.0), (-0.7,)),
    Case("add", (10.0, -1.0), (0.7,)),
    Case("add", (10.0, -1.0, LOGARITHMIC), (0.7,)),
    Case("delay", (1e-5,), (-0.5,)),
    Case("highpass", (3.0,), (0.4,)),
    Case("highpass", (3.0,), (-0.4,)),
    Case("lowpass", (1e-5,), (0.4,)),
    Case("lowpass", (1e-5,), (-0.4,)),
    Case("power", (1.0, W0), (0.1,)),
    Case("hysteresis", (1.0,), (0.2,)),
    Case("line", (1e-4,), (0.3,)),
    Case("line", (1e-4,), (-0.3,)),
    Case("line", (1e-12,), (0.3,)),  # the power series
    Case("beside_power", (2.0, W0), (0.3, 0.2)),
    Case("beside_power", (2.0, W0, LOGARITHMIC), (0.3, 0.2)),
    Case("relaxation", (3.0,), (0.5, -6.0)),
    Case("resonator", (1e-3,), (0.4, 6.0, -2.0)),
    Case("reflex", (100.0,), (0.4, -3.5, 3.0)),
    Case("bypass", (3.0, 200.0), (0.4, 0.6)),
    Case("series_compliance", (1e-6,), (0.7,)),
    Case("series_layer", (1e-6,), (0.7, -8.0)),
    Case("sweep", (1.0, OMEGA[0], 1000.0), (0.3, 0.0)),
    Case("sweep", (1.0, OMEGA[0], 1000.0), (-0.3, -3.0)),
)
CASE = pytest.mark.parametrize("case", CASES, ids=lambda c: f"{c.name}{c.u[0]:+}")


def root_coth(w: np.ndarray) -> np.ndarray:
    """sqrt(w) coth sqrt(w): either root gives the same."""
    root = np.sqrt(w)
    return root / np.tanh(root)


def formula(case: Case, s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """T(z) of the table in the module's docstring."""
    x, c1 = case.x, (*case.constants, 0.0)[1]
    u1, u2 = (*case.u, 0.0, 0.0)[1:3]
    match case.name:
        case "add":
            return z + x * s**c1
        case "delay":
            return z * np.exp(-s * x)
        case "highpass":
            return z * (s / (s + abs(x))) ** np.sign(x)
        case "lowpass":
            return z * (1 / (1 + s * abs(x))) ** np.sign(x)
        case "power":
            return z * (s / c1) ** x
        case "hysteresis":
            return z * (1 + 1j * x)
        case "line":
            return z * root_coth(s * x / z)
        case "beside_power":
            return z + x * (s / c1) ** (1 / (1 + np.exp(-u1)) - 1)
        case "relaxation":
            return z + x / (1 + s * np.exp(u1))
        case "resonator":
            p, d = np.exp(u1), np.exp(u2)
            return z + s * x * (2 * d * p * s + p**2) / (s**2 + 2 * d * p * s + p**2)
        case "reflex":
            return z + x * np.exp(-s * np.exp(u1)) / (s * (1 + s / np.exp(u2)))
        case "bypass":
            return z + x + c1 * u1 / s
        case "series_compliance":
            return 1 / (1 / z + s * x)
        case "series_layer":
            return 1 / (1 / z + s * x / (1 + s * np.exp(u1)))
        case "sweep":
            p = np.exp(u1)
            return z * np.exp(x * (1 - (s.imag / c1) ** -p) / (1 - case.constants[2] ** -p))
    raise AssertionError(case.name)


def five(case: Case, u: Sequence[float], z: np.ndarray) -> np.ndarray:
    """T and its derivatives at the impedances z, one for each of OMEGA, shape (5, F)."""
    own, constants = np.zeros((1, N_PARAMETERS)), np.zeros(N_PARAMETERS)
    own[0, : len(u)], constants[: len(case.constants)] = u, case.constants
    code = NAMES.index(case.name) + 1
    return transform_many(code, own, constants, OMEGA, np.ascontiguousarray(z[None]))[:, 0]


def difference(function: Callable[[float], np.ndarray], h: float = 1e-5) -> np.ndarray:
    """Derivative at zero by central differences of steps h and 2 h, the error of order h^2 taken out."""
    near, far = ((function(step) - function(-step)) / (2 * step) for step in (h, 2 * h))
    return (4 * near - far) / 3


def assert_close(analytic: np.ndarray, numeric: np.ndarray, z: np.ndarray) -> None:
    """To 1e-6 of itself; differences of z say nothing about a derivative below 1e-3 of z."""
    error = np.abs(analytic - numeric) / (np.abs(analytic) + 1e-3 * np.abs(z))
    assert error.max() < 1e-6


def operation(case: Case, path: tuple[int, ...], number: int = 0) -> Operation:
    return Operation(case.name, path, tuple(f"{letter}{number}" for letter in "xyw"[: len(case.u)]), case.constants)


def some_impedances(seed: int) -> np.ndarray:
    """Passive ones of the fingertip's size, of any phase."""
    rng = np.random.default_rng(seed)
    return np.exp(rng.uniform(-1, 4, OMEGA.size)) * np.exp(1j * rng.uniform(-1.5, 1.5, OMEGA.size))


# One operation


def test_every_operation_is_tried() -> None:
    assert {case.name for case in CASES} == set(NAMES)
    assert [Operation(name, (), (), ()).code for name in NAMES] == list(range(1, len(NAMES) + 1))


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
    for code in range(len(NAMES) + 1):
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


# In a network


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


# The same physics with more elements

ALL_PLACES = pytest.mark.parametrize("place", [p.name for p in NETWORK.places()])


def assert_same(place: str, added: Operation, u: Sequence[float], grown: Network, values: dict[str, float]) -> None:
    here = NETWORK.place(place).path
    kernel = Kernel(NETWORK, [Operation(added.name, here, added.parameters, added.constants)])
    theta = [np.log({**ELEMENTS, **values}[name]) for name in grown.elements]
    expected = Kernel(grown).impedance(theta, FREQUENCY)
    np.testing.assert_allclose(kernel.impedance([*THETA, *u], FREQUENCY), expected, rtol=1e-10)


@ALL_PLACES
@pytest.mark.parametrize(("element", "power", "value"), [("m9", 1.0, 2e-4), ("r9", 0.0, 0.3), ("n9", -1.0, 1e-3)])
def test_add_is_an_element_beside(place: str, element: str, power: float, value: float) -> None:
    grown = NETWORK.beside(place, Element(element))
    x = 1 / value if element[0] == "n" else value
    assert_same(place, Operation("add", (), ("x",), (x / 0.7, power)), [0.7], grown, {element: value})
    positive = Operation("add", (), ("x",), (1.0, power, LOGARITHMIC))
    assert_same(place, positive, [np.log(x)], grown, {element: value})


@ALL_PLACES
def test_relaxation_is_a_damper_and_spring_in_series(place: str) -> None:
    grown, r, n = NETWORK.beside(place, parse("r9-n9")), 2.0, 1e-3
    assert_same(place, Operation("relaxation", (), ("r", "t"), (r,)), [1, np.log(r * n)], grown, {"r9": r, "n9": n})


@ALL_PLACES
def test_resonator_is_a_mass_on_a_spring_and_damper(place: str) -> None:
    m, p, d = 1e-3, 900.0, 0.2
    grown = NETWORK.beside(place, parse("m9-(r9|n9)"))
    values = {"m9": m, "n9": 1 / (m * p**2), "r9": 2 * d * p * m}
    added = Operation("resonator", (), ("m", "p", "d"), (m,))
    assert_same(place, added, [1, np.log(p), np.log(d)], grown, values)


@ALL_PLACES
def test_bypass_is_a_spring_and_damper_beside(place: str) -> None:
    grown, r, k = NETWORK.beside(place, parse("n9|r9")), 0.5, 300.0
    assert_same(place, Operation("bypass", (), ("r", "k"), (1.0, 1.0)), [r, k], grown, {"r9": r, "n9": 1 / k})


@ALL_PLACES
def test_series_compliance_is_a_spring_in_series(place: str) -> None:
    grown, n = NETWORK.in_series(place, Element("n9")), 3e-7
    assert_same(place, Operation("series_compliance", (), ("n",), (1e-7,)), [3], grown, {"n9": n})


@ALL_PLACES
def test_series_layer_is_a_spring_and_damper_in_series(place: str) -> None:
    grown, r, n = NETWORK.in_series(place, parse("n9|r9")), 40.0, 1e-5
    added = Operation("series_layer", (), ("n", "t"), (n,))
    assert_same(place, added, [1, np.log(r * n)], grown, {"n9": n, "r9": r})


@ALL_PLACES
@pytest.mark.parametrize(("logit", "element"), [(-40.0, "n9"), (40.0, "r9")])
def test_power_law_beside_has_a_spring_and_a_damper_as_its_ends(place: str, logit: float, element: str) -> None:
    c = 2.0
    value = 1 / (c * W0) if element == "n9" else c  # c (s/w0)^-1 = c w0/s
    added = Operation("beside_power", (), ("c", "a"), (c, W0))
    assert_same(place, added, [1, logit], NETWORK.beside(place, Element(element)), {element: value})


@ALL_PLACES
def test_reflex_without_delay_and_lag_is_a_spring(place: str) -> None:
    k = 300.0
    grown = NETWORK.beside(place, Element("n9"))
    assert_same(place, Operation("reflex", (), ("k", "t", "w"), (k,)), [1, -40, 40], grown, {"n9": 1 / k})


@pytest.mark.parametrize("place", ["n3", "n1", "n2"])
def test_full_power_turns_a_spring_into_a_damper(place: str) -> None:
    """1/(s n) (s/w0)^1 = 1/(w0 n)."""
    damper = 1 / (W0 * ELEMENTS[place])
    grown = NETWORK.replaced(place, Element("r9"))
    assert_same(place, Operation("power", (), ("x",), (1.0, W0)), [1], grown, {"r9": damper})


@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_line_is_a_long_ladder(loss: float) -> None:
    """200 segments, each a compliance with half of its mass at either end; the last one stands on the ground."""
    n, mass, segments = 1e-3, 0.2, 200
    w = np.linspace(0.05, 0.98, 40) * 3.5 * np.pi / np.sqrt(n * mass)  # beyond the third standing wave
    whole = (1 + 1j * loss) / (1j * w * n)  # what stands at the place: a spring, with loss
    step, half = whole * segments, 1j * w * mass / segments / 2
    ladder = step + half
    for _ in range(segments - 1):
        ladder = half + 1 / (1 / step + 1 / (ladder + half))
    kernel = Kernel(
        parse("n1"), [Operation("hysteresis", (), ("eta",), (1.0,)), Operation("line", (), ("m",), (mass,))]
    )
    line = kernel.impedance([np.log(n), loss, 1.0], w / (2 * np.pi))
    # A T section of the ladder has cosh g = 1 + w/(2 N^2) and the characteristic impedance Z (1 + w/(4 N^2))^(1/2), so
    # that the ladder is Z coth(N g) with N g = x (1 - x^2/(24 N^2)) to first order: that is how wrong it may be.
    x = np.sqrt(1j * w * mass / whole)
    slope = np.abs(whole * x / np.sinh(x) ** 2)
    due = slope * np.abs(x) ** 3 / (24 * segments**2) + np.abs(line * x**2) / (8 * segments**2)
    error = np.abs(line - ladder)
    assert np.all(error <= 1.1 * due)
    assert np.median(error / np.abs(line)) < 1e-3
    assert np.abs(line / (whole + 1j * w * mass / 3) - 1).max() > 1  # not the lumped third


def test_line_carries_a_third_of_its_mass_at_first() -> None:
    kernel = Kernel(parse("n1"), [Operation("line", (), ("m",), (1e-6,))])
    z = kernel.impedance([np.log(1e-3), 1.0], FREQUENCY[:8])
    low = S[:8]
    np.testing.assert_allclose(z - 1 / (low * 1e-3), low * 1e-6 / 3, rtol=1e-4)


def test_line_does_not_notice_where_its_series_ends() -> None:
    """On either side of |w| = 0.01 the power series and the exponential form are the same to their last digits."""
    for turn in np.exp(1j * np.linspace(-3.1, 3.1, 9)):
        near = np.array([0.009999999, 0.010000001]) * turn
        values = [five(Case("line", (1.0,), (1.0,)), (1.0,), np.full(OMEGA.size, S[0] / w))[:3, 0] for w in near]
        # w changes by 2e-7 of itself: so may the numbers, and the derivative of the series is good to 3e-9
        np.testing.assert_allclose(values[0], values[1], rtol=1e-6)


@pytest.mark.parametrize("path", [(), (1,)], ids=str)
def test_delay_keeps_the_magnitude_and_turns_the_phase(path: tuple[int, ...]) -> None:
    tau = 3e-5
    kernel = Kernel(NETWORK, [Operation("delay", path, ("tau",), (tau,))])
    turned = kernel.impedance([*THETA, 1.0], FREQUENCY)
    plain = Kernel(NETWORK).impedance(THETA, FREQUENCY)
    if path:
        expected = network_impedance(NETWORK, S, ELEMENTS, path, lambda z: z * np.exp(-S * tau))
        np.testing.assert_allclose(turned, expected, rtol=1e-12)
        assert np.abs(np.abs(turned / plain) - 1).max() > 1e-3
    else:
        np.testing.assert_allclose(np.abs(turned), np.abs(plain), rtol=1e-13)
        np.testing.assert_allclose(np.angle(turned / plain), -OMEGA * tau, rtol=1e-9)


# Passive bodies have passive impedances

POSITIVE = st.floats(-3.0, 3.0)  # logarithms
PHYSICAL = tuple(name for name in NAMES if name not in ("delay", "highpass", "lowpass", "reflex"))
"""Bodies: what happens in a channel, or in nerves, need not be passive."""


def draw_body(draw: st.DrawFn, network: Network) -> tuple[Operation, list[float]]:
    """A physical body at a place where it may be, near the frequencies of 1 rad/s where the random networks live."""
    name = draw(st.sampled_from(PHYSICAL))
    nodes = {place: network.at(place) for place in network.places()}
    springs = [p for p, node in nodes.items() if isinstance(node, Element) and node.name[0] == "n"]
    if name in ("power", "hysteresis") and not springs:
        name = "relaxation"
    place = draw(st.sampled_from(springs if name in ("power", "hysteresis") else network.places()))
    scale = float(np.exp(draw(POSITIVE)))
    count = {"relaxation": 2, "resonator": 3, "bypass": 2, "beside_power": 2, "series_layer": 2}.get(name, 1)
    shapes = [draw(POSITIVE) for _ in range(count - 1)]
    constants = (scale, 1.0)
    if name == "add":
        constants = (scale, draw(st.sampled_from([1.0, 0.0, -1.0])))
    if name == "power":
        constants = (draw(st.floats(0.0, 1.0)), 1.0)
    if name == "bypass":
        shapes = [float(np.exp(shapes[0]))]
    return Operation(name, place.path, tuple("xyw"[:count]), constants), [1.0, *shapes]


@st.composite
def bodies(draw: st.DrawFn) -> tuple[Network, Operation, np.ndarray]:
    network, theta = draw(networks_with_elements())
    added, u = draw_body(draw, network)
    return network, added, np.array([*theta, *u])


@repeatable
@given(bodies())
def test_physical_bodies_are_passive(body: tuple[Network, Operation, np.ndarray]) -> None:
    network, added, theta = body
    z = Kernel(network, [added]).impedance(theta, np.geomspace(1e-3, 1e3, 97))
    assert np.all(np.isfinite(z))
    # Losses far below the magnitude drown in its rounding.
    assert np.all(z.real >= -1e-12 * np.abs(z))


@pytest.mark.parametrize(("name", "u"), [("hysteresis", -0.2), ("power", -0.2), ("power", 2.5)])
def test_what_is_not_physical_is_not_passive(name: str, u: float) -> None:
    """The other side of the coin: signs and exponents that no body has show as a negative real part."""
    added = Operation(name, (), ("x",), (1.0, W0))
    z = Kernel(parse("n1"), [added]).impedance([0.0, u], FREQUENCY)
    assert np.all(z.real < 0)


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
