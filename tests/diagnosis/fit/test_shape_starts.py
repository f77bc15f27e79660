"""People whose resonance is two octaves from most people's."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import Experiment, enlarged, entry, toy

from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.shape_starts import searched_shapes

N, MASS, FREQUENCY_HZ, DAMPING_RATIO = 12, 2e-3, 60.0, 0.1
OWN_HZ = FREQUENCY_HZ * np.exp(np.r_[-0.9, 1.5, np.linspace(-0.45, 0.45, N - 2)])
RESONATOR = entry("body.resonator")


def resonators(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Each person's mass on a spring, moved along with the load."""
    omega = 2 * np.pi * OWN_HZ[:, None, None]
    loss = 2 * DAMPING_RATIO * omega * s
    return z + s * MASS * (loss + omega**2) / (s**2 + loss + omega**2), np.full(len(z), MASS)


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy("m1|r1|n1", {"m1": 4e-3, "r1": 1.0, "n1": 1e-3}, seed=5, n=N, hidden=resonators)


def fitted(world: Experiment, pooling: str) -> Refit:
    """From everybody's true elements, and the resonance of most people."""
    addition = Addition(effect=RESONATOR, place="port", pooling=pooling, other_dispersions=(0.4, 0.1))
    shapes = {"frequency": 2 * np.pi * FREQUENCY_HZ, "damping_ratio": DAMPING_RATIO}
    model = build(world.model.network, [addition], world.model.scales, [shapes])
    u, population = enlarged(world.fit(), model)
    mass = float(RESONATOR.coefficients[0].unbounded(MASS, model.scales))
    u[:, model.n_elements] = population.mu[model.n_elements] = mass
    return world.refitter.fit(model, u, population)


def hertz(fit: Refit) -> np.ndarray:
    first = np.searchsorted(fit.owner, np.arange(N))
    column = fit.model.columns(0)[1]
    return RESONATOR.coefficients[1].value(fit.u[first, column], fit.model.scales) / (2 * np.pi)


def test_who_is_two_octaves_off_is_found(world: Experiment) -> None:
    stuck = fitted(world, "free")
    assert np.sum(np.abs(np.log(hertz(stuck) / OWN_HZ)) > 0.2) > 0
    found = searched_shapes(world.refitter, stuck)
    np.testing.assert_allclose(hertz(found), OWN_HZ, rtol=0.05)
    assert found.evidence.sum() > stuck.evidence.sum() + 50
    assert found.settled


def test_who_is_there_already_stays(world: Experiment) -> None:
    found = searched_shapes(world.refitter, fitted(world, "free"))
    assert searched_shapes(world.refitter, found) is found


def test_a_frequency_that_is_the_same_for_all_is_not_searched(world: Experiment) -> None:
    fit = fitted(world, "varying")
    assert searched_shapes(world.refitter, fit) is fit
