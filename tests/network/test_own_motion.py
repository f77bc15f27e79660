"""Elements that follow the amplitude of their own motion: by plain recursion, and derivatives by differences."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Place, parse
from bayes_impedance.network.operations import Operation
from bayes_impedance.network.own_motion import motion_per_force, saturating_share
from bayes_impedance.person.likelihood import Likelihood, normal_equations

FREQUENCY = np.geomspace(0.01, 4.0, 31)  # around one radian per second, for elements around one
S = 2j * np.pi * FREQUENCY
CASES = [
    (network, place)
    for network, places in {
        "n1": ["n1"],
        "n1-r1": ["n1", "r1"],
        "m1|r1|n1": ["n1"],
        "r1-(m1|n1)-m2": ["n1", "r1"],
        "m1|n1|(r2-n2)": ["n2", "r2"],
        "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))": ["n3", "n1", "n2", "r2"],
        "(n1-whole:(m1|inner:(r1-n2)))|m2": ["n2", "n1"],
        "line_free[m2](n1|r1)-p1^a1-m1": ["n1", "r1"],
        "delay[d1=0.02]((n3|r3)-(m2|r1|n1))": ["n3", "n1"],
    }.items()
    for place in places
]
"""In parallel and in series, at the port and inside, in labelled groups and inside of wrappers."""

EACH = pytest.mark.parametrize(("text", "name"), CASES)


def follower(path: tuple[int, ...], number: int = 0) -> Operation:
    return Operation("own_motion", path, (f"x{number}", f"k{number}"), (0.7, 0.0, 0.0))


def values_of(text: str, u: np.ndarray) -> dict[str, np.ndarray]:
    free = [p for p in parse(text).parameters if not p.held]
    return {p.name: np.asarray(p.value(u[:, i, None])) for i, p in enumerate(free)}


def some(text: str, more: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(scale=0.7, size=(3, len(parse(text).elements) + more))


@EACH
def test_it_is_the_network_with_another_element_at_every_frequency(text: str, name: str) -> None:
    network = parse(text)
    place = network.place(name)
    u = some(text, 2)
    own = values_of(text, u)
    share = saturating_share(motion_per_force(network, place.path, S, own), np.exp(u[:, -1, None]))
    stiffer = np.exp(0.7 * u[:, -2, None] * share)
    changed = own | {name: own[name] / stiffer if name[0] == "n" else own[name] * stiffer}
    z = Kernel(network, [follower(place.path)]).impedance(u, FREQUENCY)
    np.testing.assert_allclose(z, network.impedance(S, changed), rtol=1e-12)
    assert np.abs(z / Kernel(network).impedance(u[:, :-2], FREQUENCY) - 1).max() > 0.02


@EACH
@pytest.mark.parametrize("several", [False, True])
def test_derivatives_are_those_of_differences(text: str, name: str, several: bool) -> None:
    network = parse(text)
    path = network.place(name).path
    operations = [follower(path)]
    if several:  # twice at one place, and behind an operation of the rig
        operations += [Operation("hysteresis", (), ("e",), (0.2,)), follower(path, 1)]
    kernel = Kernel(network, operations)
    u = np.random.default_rng(2).normal(scale=0.7, size=(3, len(kernel.elements)))
    _, dz = kernel.derivative(u, FREQUENCY)
    for k, one in enumerate(np.eye(u.shape[1])):
        near, far = (
            (kernel.impedance(u + h * one, FREQUENCY) - kernel.impedance(u - h * one, FREQUENCY)) / (2 * h)
            for h in (1e-4, 2e-4)
        )
        np.testing.assert_allclose(dz[:, k], (4 * near - far) / 3, atol=1e-8 * np.abs(dz).max())


def test_elements_that_are_held_move_as_well() -> None:
    """A held element counts in the motion, and has no derivative of its own."""
    network = parse("m1|r1|n1|(m2-n2)")
    operation = follower(network.place("n2").path)
    free, held = Kernel(network, [operation]), Kernel(network, [operation], {"m2": 0.3, "k0": -0.2})
    u = np.random.default_rng(3).normal(scale=0.5, size=(2, len(free.elements)))
    u[:, [free.elements.index("m2"), free.elements.index("k0")]] = 0.3, -0.2
    left = [free.elements.index(name) for name in held.elements]
    z, dz = free.derivative(u, FREQUENCY)
    again, dagain = held.derivative(u[:, left], FREQUENCY)
    np.testing.assert_allclose(again, z, rtol=1e-13)
    np.testing.assert_allclose(dagain, dz[:, left], rtol=1e-10, atol=1e-13)


def test_normal_equations_take_it_in_blocks_of_frequencies() -> None:
    network = parse("m1|r1|n1|(m2-n2)")
    kernel = Kernel(network, [follower(network.place("n2").path)])
    f = np.geomspace(0.01, 3.0, 251)
    u = np.random.default_rng(4).normal(scale=0.5, size=len(kernel.elements))
    z, dz = kernel.derivative(u, f)
    data = Likelihood.make(f, np.zeros((1, f.size), dtype=complex), np.ones((1, f.size)), np.zeros((1, u.size)))
    chi, gradient, information = normal_equations(kernel.program, u, data.omega, data.z[0], data.weight[0])
    assert chi == pytest.approx(np.sum(np.abs(z) ** 2))
    np.testing.assert_allclose(gradient, np.real(dz.conj() @ z), rtol=1e-9, atol=1e-9 * np.abs(gradient).max())
    np.testing.assert_allclose(information, np.real(dz.conj() @ dz.T), rtol=1e-9, atol=1e-9 * np.abs(information).max())


def test_motions_of_one_force() -> None:
    """By the laws of springs: what bears the whole force, what shares it, what shares the motion."""
    own = {"n1": 2.0, "n2": 3.0}
    chain, group = parse("n1-n2"), parse("n1|n2")
    for network, motion in ((chain, (5.0, 2.0, 3.0)), (group, (1.2, 1.2, 1.2))):
        for path, expected in zip(((), (0,), (1,)), motion, strict=True):
            np.testing.assert_allclose(motion_per_force(network, path, S, own), expected)
    assert Place((0,), "n1") == chain.place("n1")


def test_half_of_the_change_is_at_the_knee() -> None:
    np.testing.assert_allclose(saturating_share([0.0, 1e-3, 1.0, 1e3], 1.0), [0.0, 1e-6, 0.5, 1.0], atol=2e-6)
