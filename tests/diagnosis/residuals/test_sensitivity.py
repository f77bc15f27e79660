"""Adjoint sensitivities and local impedances inside the network, against finite differences and the plain formula."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest
from experiments import entry
from fingertip_effects import BEFORE, FOOT, FREQUENCY, NAIL, NETWORK, OMEGA, PAD, SCALES, THETA, S, assert_slope
from hypothesis import given
from strategies import network_impedance, networks_with_elements, repeatable

from bayes_impedance.diagnosis.fit.model import Addition, Model, build, inner_places
from bayes_impedance.diagnosis.residuals.sensitivity import BEFORE_CHANNELS, INSIDE, local_impedances, motion_at
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.network.operations import Operation
from bayes_impedance.network.own_motion import saturating_share


def probed(model: Model, u: np.ndarray, path: tuple[int, ...]) -> Callable[[float], np.ndarray]:
    """The port's impedance with a damper beside a place, after all that happens there."""
    kernel = model.kernel
    probe = Operation("add", path, ("probe",), (1.0, 0.0))
    rank = [*kernel.network.elements, *(p for o in kernel.operations for p in o.parameters)]
    order = [kernel.elements.index(name) for name in rank]
    with_probe = Kernel(kernel.network, [*kernel.operations, probe])

    def curve(step: float) -> np.ndarray:
        return with_probe.impedance(np.column_stack([u[:, order], np.full(len(u), step)]), FREQUENCY)

    return curve


MODELS: dict[str, Sequence[Addition]] = {
    "nothing": (),
    "operations": (
        *BEFORE,
        Addition(effect=entry("body.line"), place="n2|r2", pooling="varying"),
        Addition(effect=entry("rig.series_compliance"), place="port", pooling="shared"),
        Addition(effect=entry("body.subgroup"), place="port", pooling="varying"),
    ),
    "branches": (
        Addition(effect=NAIL, place="n3", pooling="varying"),
        Addition(effect=PAD, place="limb", pooling="varying"),
        Addition(effect=FOOT, place="port", pooling="shared"),
    ),
    "both": (
        Addition(effect=NAIL, place="tissue", pooling="varying"),
        *BEFORE,
        Addition(effect=PAD, place="r3", pooling="shared"),
    ),
}


@pytest.mark.parametrize("name", MODELS)
def test_adjoints_against_differences(name: str) -> None:
    starts = [{"time_constant": 0.01} for _ in MODELS[name]]
    model = build(NETWORK, MODELS[name], SCALES, starts)
    rng = np.random.default_rng(3)
    own = [np.full(3, p.start) + (0.1 if p.is_coefficient else 0.3) * rng.normal(size=3) for p in model.parameters]
    u = np.column_stack([THETA, *own])
    local = local_impedances(model, u, OMEGA)
    assert set(local) == {place.name for place in NETWORK.places()} | {INSIDE, BEFORE_CHANNELS}
    del local[INSIDE], local[BEFORE_CHANNELS]
    paths = inner_places(model)
    for place, here in local.items():
        curve = probed(model, u, paths[place])
        assert_slope(curve, here.adjoint, 1 / np.abs(here.z) + np.abs(here.adjoint / curve(0.0)))
    np.testing.assert_allclose(local["port"].z, model.kernel.impedance(u, FREQUENCY), rtol=1e-10)
    np.testing.assert_array_equal(local["port"].adjoint, 1)


def test_an_element_that_follows_its_own_motion_is_in_the_impedances() -> None:
    """Of the places around it and of itself, as in the compiled model; the motion is that of the network at rest."""
    effect = entry("body.amplitude", "own_motion")
    knee = float(effect.coefficients[1].values(SCALES)[1])
    model = build(NETWORK, [Addition(effect=effect, place="n1", pooling="varying")], SCALES, [{"knee": knee}])
    u = np.column_stack([THETA, np.full(3, 0.4), np.full(3, np.log(knee))])
    local = local_impedances(model, u, OMEGA)
    np.testing.assert_allclose(local["port"].z, model.kernel.impedance(u, FREQUENCY), rtol=1e-12)
    share = saturating_share(motion_at(model, u, OMEGA, inner_places(model)["n1"]), knee)
    spring = 1 / (S * np.exp(u[:, NETWORK.elements.index("n1"), None]))
    np.testing.assert_allclose(local["n1"].z, spring * np.exp(0.4 * share), rtol=1e-12)
    assert np.ptp(share) > 0.05
    # What changes the impedance of n1 by a factor, the change itself does by its share.
    change = model.kernel.derivative(u, FREQUENCY)[1][:, model.columns(0)[0]]
    np.testing.assert_allclose(local["n1"].adjoint * local["n1"].z * share, change, rtol=1e-9)


def test_the_rigs_mechanics_is_measured_through_its_channels() -> None:
    """Before the channels is behind masses, springs and dampers of the rig, whichever was found first."""
    delay, damper = (Addition(effect=entry(f"rig.{k}"), place="port", pooling="shared") for k in ("delay", "damping"))
    for additions in ((delay, damper), (damper, delay)):
        model = build(NETWORK, additions, SCALES, [{}, {}])
        u = np.column_stack([THETA, np.full((3, 2), 0.2)])
        size = {a.effect.id: 0.2 * a.effect.coefficients[0].scale(SCALES) for a in additions}
        local = local_impedances(model, u, OMEGA)
        channel = np.exp(-1j * OMEGA * size["rig.delay"])
        bare = build(NETWORK, (), SCALES, ()).kernel.impedance(THETA, FREQUENCY)
        np.testing.assert_allclose(local[INSIDE].z, bare, rtol=1e-10)
        np.testing.assert_allclose(local[BEFORE_CHANNELS].z, bare + size["rig.damping"], rtol=1e-10)
        np.testing.assert_allclose(local["port"].z, (bare + size["rig.damping"]) * channel, rtol=1e-10)
        for place in (INSIDE, BEFORE_CHANNELS):
            np.testing.assert_allclose(local[place].adjoint, np.broadcast_to(channel, bare.shape), rtol=1e-10)


@repeatable
@given(networks_with_elements())
def test_local_impedances_of_any_network(drawn: tuple[Network, np.ndarray]) -> None:
    network, theta = drawn
    local = local_impedances(build(network, (), SCALES, ()), theta[None], 2 * np.pi * FREQUENCY)
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    for place in network.places():
        expected = network_impedance(network.at(place), S, values)
        np.testing.assert_allclose(local[place.name].z[0], expected, rtol=1e-9)
