"""Operations against networks of more elements, and the passivity of what they describe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from operation_cases import (
    ELEMENTS,
    FREQUENCY,
    NETWORK,
    OMEGA,
    THETA,
    W0,
    Case,
    S,
    five,
)
from strategies import network_impedance, networks_with_elements, repeatable

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, parse
from bayes_impedance.network.operations import LOGARITHMIC, NAMES, TRAITS, Operation

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
    assert_same(place, Operation("reflex", (), ("k", "t", "w"), (k, -1.0)), [1, -40, 40], grown, {"n9": 1 / k})


@ALL_PLACES
def test_a_reflex_to_velocity_without_delay_and_lag_is_a_damper(place: str) -> None:
    grown = NETWORK.beside(place, Element("r9"))
    assert_same(place, Operation("reflex", (), ("r", "t", "w"), (3.0, 0.0)), [1, -40, 40], grown, {"r9": 3.0})


@pytest.mark.parametrize("place", ["m1", "m2", "r1", "r3"])
def test_a_free_line_is_the_wrapper_around_a_compliance(place: str) -> None:
    """No force acts on the far side of a layer of which the element is the sum along the way."""
    grown, n = NETWORK.replaced(NETWORK.place(place), parse(f"line_fixed[{place}](n9)")), 3e-6
    assert_same(place, Operation("free_line", (), ("n",), (n,)), [1], grown, {"n9": n})


def test_a_free_line_is_a_long_ladder() -> None:
    """400 masses with a spring after each; the last spring leads nowhere."""
    m, n, segments = 0.02, 4e-5, 400
    w = np.linspace(0.05, 0.98, 40) * 2.4 * np.pi / np.sqrt(n * m)
    step, along = 1 / (1j * w * n) * segments * (1 + 0.3j), 1j * w * m / segments  # springs with a loss
    ladder = 0 * along
    for _ in range(segments):
        ladder = 1 / (1 / step + 1 / (ladder + along))  # a spring in series with a mass and what follows
    kernel = Kernel(parse("line_fixed[m1](hysteretic[e1](n1))"))
    exact = kernel.impedance([np.log(m), np.log(0.3), np.log(n)], w / (2 * np.pi))
    assert np.median(np.abs(ladder / exact - 1)) < 1e-2
    plain = Kernel(parse("m1"), [Operation("free_line", (), ("n",), (n,))]).impedance([np.log(m), 1.0], FREQUENCY)
    np.testing.assert_allclose(plain[:3] / (S[:3] * m), 1, rtol=1e-3)  # all of it moves along at first
    x = S * np.sqrt(m * n)
    np.testing.assert_allclose(plain, S * m * np.tanh(x) / x, rtol=1e-9)


@ALL_PLACES
def test_a_slow_squeeze_film_is_a_damper_and_a_fast_one_a_spring(place: str) -> None:
    damper, spring = NETWORK.beside(place, Element("r9")), NETWORK.beside(place, Element("n9"))
    slow, fast = Operation("squeeze_film", (), ("r", "t"), (3.0,)), Operation("squeeze_film", (), ("r", "t"), (3e15,))
    assert_same(place, slow, [1, -40], damper, {"r9": 3.0})
    here = NETWORK.place(place).path
    kernel = Kernel(NETWORK, [Operation(fast.name, here, fast.parameters, fast.constants)])
    values = {**ELEMENTS, "n9": 1 / 9.0}  # 3 r/(s t)
    expected = Kernel(spring).impedance([np.log(values[e]) for e in spring.elements], FREQUENCY)
    np.testing.assert_allclose(kernel.impedance([*THETA, 1, np.log(1e15)], FREQUENCY), expected, rtol=1e-6)


@ALL_PLACES
def test_a_semi_inductance_is_a_power_law_beside(place: str) -> None:
    grown = NETWORK.beside(place, parse("p9^b9@95.49296585513720"))  # 600 rad/s
    theta = [*THETA, 0.7, 0.4]
    kernel = Kernel(NETWORK, [Operation("semi_inductance", NETWORK.place(place).path, ("c", "a"), (1.0, W0))])
    values = dict(zip((*NETWORK.elements, "p9", "b9"), [*THETA, np.log(0.7), 0.4], strict=True))
    expected = Kernel(grown).impedance([values[e] for e in grown.elements], FREQUENCY)
    np.testing.assert_allclose(kernel.impedance(theta, FREQUENCY), expected, rtol=1e-10)


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


POSITIVE = st.floats(-3.0, 3.0)  # logarithms
PHYSICAL = tuple(name for name in NAMES if TRAITS[name].passive)
"""Bodies: what happens in a channel, or in nerves, need not be passive."""


def draw_body(draw: st.DrawFn, network: Network) -> tuple[Operation, list[float]]:
    """A physical body at a place where it may be, near the frequencies of 1 rad/s where the random networks live."""
    name = draw(st.sampled_from(PHYSICAL))
    nodes = {place: network.at(place) for place in network.places()}
    springs = [p for p, node in nodes.items() if isinstance(node, Element) and node.name[0] == "n"]
    if TRAITS[name].places == ("springs",) and not springs:
        name = "relaxation"
    place = draw(st.sampled_from(springs if TRAITS[name].places == ("springs",) else network.places()))
    # A free line in place of any passive part is passive, as the reciprocal of a line around its reciprocal.
    scale = float(np.exp(draw(POSITIVE)))
    count = len(TRAITS[name].parameters)
    shapes = [draw(POSITIVE) for _ in range(count - 1)]
    constants = (scale, 1.0)
    if name == "add":
        constants = (scale, draw(st.sampled_from([1.0, 0.0, -1.0])))
    if name == "power":
        constants = (draw(st.floats(0.0, 1.0)), 1.0)
    if name == "bypass":
        shapes = [float(np.exp(shapes[0]))]
    if name == "sweep":
        constants = (scale, 1e-3, 1e6)
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
