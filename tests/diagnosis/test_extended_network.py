"""The network with what was found: some values of its new parameters give the curve of the model that was fitted."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from fingertip_effects import SCALES
from scipy.optimize import least_squares

from bayes_impedance.diagnosis.catalogue.effect import Effect, registered, shape_grid
from bayes_impedance.diagnosis.extended_network import extended_network, no_networks
from bayes_impedance.diagnosis.extended_posterior import extended_posterior
from bayes_impedance.diagnosis.extended_start import values_of
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.network.parameters import LOG
from bayes_impedance.population.parameters import PopulationParameters

NETWORK = parse("skin:(n3|r3)-tissue:(m2|r1|n1|(m1-(n2|r2)))")
CENTRE = {"n3": 9e-5, "r3": 30.0, "m2": 9e-4, "r1": 1.5, "n1": 1.2e-3, "m1": 1.7e-2, "n2": 5e-3, "r2": 3.2}
F = np.geomspace(5, 2000, 40)
NO_NETWORK = {"sweep", "amplitude", "own_motion"}
"""Operations that have no form in the language of networks."""


def effects() -> list[Effect]:
    return [effect for effect in registered() if effect.operation and effect.sites(NETWORK)]


def shapes_of(effect: Effect) -> dict[str, float]:
    grid = list(shape_grid(effect, SCALES))
    return grid[len(grid) // 2] if grid else {}


def model_of(effect: Effect, place: str, pooling: str, others: tuple[Addition, ...] = ()):
    additions = (*others, Addition(effect=effect, place=place, pooling=pooling))
    return build(NETWORK, additions, SCALES, [shapes_of(a.effect) for a in additions])


def curve_of(model, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Impedance with every coefficient of this size, and of the network alone."""
    u = np.array([np.log(CENTRE[e]) for e in NETWORK.elements] + [p.start for p in model.parameters])
    for k, p in enumerate(model.parameters, model.n_elements):
        if p.is_coefficient:
            u[k] = size
    return model.kernel.impedance(u, F), u[: model.n_elements]


def closest(network, own: np.ndarray, z: np.ndarray) -> tuple[float, dict[str, float]]:
    """Smallest relative difference of the network's curve from z, over parameters besides the known ones; and all u."""
    kernel = Kernel(network)
    known = {e: u for e, u in zip(NETWORK.elements, own, strict=True) if e in kernel.elements}
    held = kernel.holding(known)
    size = {"m": 1e-3, "n": 1e-3, "r": 1.0, "p": 1.0, "k": 1e3, "d": 0.03, "f": 100.0, "e": 0.1, "t": 1e-3, "g": 1.0}
    starts = np.array([np.log(size[p.letter]) if p.link == LOG else 0.0 for p in held.parameters])

    def rest(u: np.ndarray) -> np.ndarray:
        difference = held.impedance(u, F) / z - 1
        return np.nan_to_num(np.concatenate([difference.real, difference.imag]), nan=1e3, posinf=1e3, neginf=-1e3)

    rng, best, u = np.random.default_rng(1), np.inf, starts
    for scale in (0.0, *[2.0] * 60, *[5.0] * 200):  # a line has many resonances, and compliances are small
        start = starts + scale * rng.normal(size=starts.size)
        for p, k in zip(held.parameters, range(starts.size), strict=True):
            if p.link == "signed":
                start[k] *= 1e-4
        there = least_squares(rest, start, x_scale="jac", method="trf", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        if np.abs(rest(there)).max() < best:
            best, u = float(np.abs(rest(there)).max()), there
        if best < 1e-6:
            break
    return best, {**known, **dict(zip(held.elements, u.tolist(), strict=True))}


def read_back(model, extended, u: dict[str, float]) -> np.ndarray:
    """The additions' parameters from the network's, as they are read from a posterior without any spread."""
    kernel = Kernel(extended.network)
    mu = np.array([[u[name] for name in kernel.elements]] * 2)
    parameters = PopulationParameters(
        mu=mu,
        between_persons=0 * mu,
        correlation_cholesky=np.stack([np.eye(mu.shape[1])] * 2),
        between_repetitions=0 * mu,
        slopes=np.zeros((*mu.shape, 0)),
    )
    fit = SimpleNamespace(kernel=kernel, parameters=parameters, diagnostics=SimpleNamespace(problems=()))
    posterior = extended_posterior(model, extended, fit)
    assert not posterior.relative_dispersion.any()
    return posterior.central[0]


@pytest.mark.parametrize("pooling", ["shared", "varying"])
@pytest.mark.parametrize("effect", effects(), ids=lambda e: f"{e.id}-{e.form}")
def test_every_effect_is_a_network(effect: Effect, pooling: str) -> None:
    sites = effect.sites(NETWORK)
    for place in {sites[0].name, sites[-1].name}:
        model = model_of(effect, place, pooling)
        extended = extended_network(model)
        network = extended.network
        if effect.operation in NO_NETWORK:
            assert network == NETWORK
            assert no_networks(model) == (effect.id,)
            # Coefficients above zero in everybody: others have no logarithm, and end before the network is asked.
            everybody = np.full((2, len(NETWORK.elements) + len(model.parameters)), 0.1)
            assert values_of(model, everybody, extended, Kernel(network), {}) is None
            continue
        assert no_networks(model) == ()
        assert parse(str(network)) == network
        assert not any("place_" in (node.label or "") for _, node in network.walk())
        new = [p for p in network.parameters if p.name not in NETWORK.elements]
        assert new
        if pooling == "shared":
            own = "p" if effect.operation == "power" else ""  # its size is that of the spring, which people differ in
            assert all(p.shared or p.letter == own for p in new)
        else:
            assert not (new[1] if effect.operation == "power" else new[0]).shared
        z, own = curve_of(model, 0.3)
        difference, u = closest(network, own, z)
        assert difference < 1e-6
        expected = [0.3 if p.is_coefficient else p.start for p in model.parameters]
        np.testing.assert_allclose(read_back(model, extended, u), expected, rtol=1e-3, atol=1e-4)
        everybody = np.tile([*own, *expected], (2, 1))
        values = values_of(model, everybody, extended, Kernel(network), {})
        assert values is not None
        start = [p.u(values[p.name][1]) for p in Kernel(network).parameters]
        np.testing.assert_allclose(Kernel(network).impedance(np.array(start), F), z, rtol=1e-5)


def test_several_effects_at_one_place_and_inside_of_others() -> None:
    by_form = {e.operation: e for e in registered()}
    skin = Addition(effect=by_form["beside_power"], place="skin", pooling="varying")
    spring = Addition(effect=by_form["relaxation"], place="n1", pooling="varying")
    delay = Addition(effect=by_form["delay"], place="port", pooling="shared")
    low = next(e for e in registered() if e.operation == "lowpass")
    model = model_of(low, "port", "shared", (skin, spring, delay))
    extended = extended_network(model)
    network = extended.network
    assert str(network).count("[") == 2
    assert "skin:" in str(network)
    assert "p1^a1*" in str(network)
    z, own = curve_of(model, 0.1)
    assert closest(network, own, z)[0] < 1e-6


@pytest.mark.parametrize(
    "text",
    ["m1|r1|n1", "m1|n1|(r2-n2)", "(n2|r2)-(m1|r1|n1)", "m2|((n2|r2)-(m1|r1|n1))", "m1-(r1|(n1-r2))", str(NETWORK)],
)
def test_no_two_candidates_are_the_same_network(text: str) -> None:
    """With the pooling with which they are tried: what is the same for all at the port is not what people differ in."""
    network, seen = parse(text), dict[str, str]()
    for effect in registered():
        for place in effect.sites(network):
            addition = Addition(effect=effect, place=place.name, pooling="shared" if effect.side == "rig" else "free")
            model = build(network, [addition], SCALES, [shapes_of(effect)])
            if not effect.operation or effect.operation not in NO_NETWORK:
                written = str(extended_network(model).network)
                assert written not in seen, (effect.id, place.name, seen[written])
                seen[written] = f"{effect.id} at {place.name}"


def test_a_network_without_additions_begins_at_its_own_elements() -> None:
    model = build(NETWORK, (), SCALES, [])
    u = np.log([[CENTRE[e] for e in NETWORK.elements]] * 2)
    values = values_of(model, u, extended_network(model), Kernel(NETWORK), {})
    assert values is not None
    assert {name: pytest.approx(own[1]) for name, own in values.items()} == CENTRE
    assert values_of(model, u, extended_network(model), Kernel(parse("m1|r1|r7")), {}) is None
