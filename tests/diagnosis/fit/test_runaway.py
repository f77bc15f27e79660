"""A fit that would walk away from an optimum: a small layer in a fifth of the people, beside a delay of the rig.

Compliance and time constant of the layer change the curve nearly alike. Members are far from a mean over everybody,
whose dispersion is a share of it, so that smaller compliances are nearer to it in every round, the mean and its
dispersion follow them, and the shape follows the compliances; unless a step takes that into account.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.fit import additions_step, fitter
from bayes_impedance.diagnosis.fit.additions_step import central_values
from bayes_impedance.diagnosis.fit.evidence_surface import EvidenceSurface
from bayes_impedance.diagnosis.fit.extend import extended_start
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.model import DISPERSION_IN_SOME, Addition, build
from bayes_impedance.diagnosis.fit.normal_equations import marginal, quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.shape_force import shape_force

NETWORK = "m1|n1|(r2-n2)"
CENTRES = {"m1": 0.0235, "n1": 2.1e-4, "r2": 79.0, "n2": 9.1e-5}
COMPLIANCE, TIME, DELAY = 1.7e-7, 2.2e-3, -1.1e-6
N, WITH_LAYER = 40, np.arange(40) % 5 == 0


def layer(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    compliance = np.where(WITH_LAYER, COMPLIANCE * np.exp(0.3 * rng.normal(size=N)), 0.0)
    return np.exp(-s * DELAY) / (1 / z + s * compliance[:, None, None] / (1 + s * TIME)), compliance


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy(NETWORK, CENTRES, 1, N, 1, tau=0.25, frequency_hz=np.geomspace(6.5, 3150, 80), hidden=layer)


def fitted(world: Experiment, rounds: int) -> Refit:
    """From the truth."""
    delay, some = entry("rig.delay"), entry("body.subgroup")
    additions = (
        Addition(effect=delay, place="port", pooling="shared"),
        Addition(effect=some, place="port", pooling="varying", dispersion=DISPERSION_IN_SOME),
    )
    shapes = {"time_constant": TIME, "compliance": 0.0}
    model = build(world.model.network, additions, world.model.scales, [{"delay": 0.0}, shapes])
    u, population = extended_start(world.fit(), model)
    scales = model.scales
    column = {name.split(".")[2]: i for i, name in enumerate(model.kernel.elements) if "." in name}
    assert world.coefficients is not None
    u[:, : model.n_elements] = world.u
    u[:, column["delay"]] = DELAY / delay.coefficients[0].scale(scales)
    u[:, column["compliance"]] = world.coefficients / some.coefficients[0].scale(scales)
    population.mu[-1] = u[:, column["compliance"]].mean()
    return world.refitter.fit(model, u, population, rounds)


def without_its_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(additions_step, "shape_force", lambda *args: np.zeros(len(args[-2])))


@pytest.mark.parametrize("named", [True, False])
def test_a_step_knows_that_the_dispersion_follows(
    named: bool, world: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fitter, "RAN_AWAY", np.inf)
    if not named:
        without_its_force(monkeypatch)
    first, last = (float(fitted(world, rounds).evidence.sum()) for rounds in (1, 40))
    assert (last > first - 3) if named else (last < first - 100)


@pytest.mark.parametrize("bounded", [True, False])
def test_a_fit_ends_at_the_best_place_that_it_met(
    bounded: bool, world: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_its_force(monkeypatch)
    if not bounded:
        monkeypatch.setattr(fitter, "RAN_AWAY", np.inf)
    first, last = (float(fitted(world, rounds).evidence.sum()) for rounds in (1, 40))
    assert (last > first - 10) if bounded else (last < first - 100)


@pytest.mark.parametrize("rounds", [1, 3, 40])
@pytest.mark.parametrize("own_shape", [-0.3, 0.0, 0.3])
def test_force_on_a_shape_is_the_derivative_of_the_evidence(rounds: int, own_shape: float, world: Experiment) -> None:
    """With the mean where the expansion sees it for the shape, and the dispersion its share."""
    fit = fitted(world, rounds)
    surface = EvidenceSurface(world.refitter, fit, 1)
    names = [p.name.split(".")[2] for p in fit.model.parameters]
    shape, mean = names.index("time_constant"), names.index("compliance")
    step = np.zeros(len(names))
    step[shape] = own_shape
    fit, _ = surface.held(fit, surface.centre + step, fit.model)
    a = central_values(fit)
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    tau = np.zeros(len(names))
    tau[mean] = np.sqrt(fit.population.covariance[-1, -1])
    own = marginal(fit.model, h, d, tau)
    p = own.precision
    y = np.array([fit.u[fit.owner == i, fit.model.n_elements :].mean(axis=0) for i in range(N)])
    beside = shape_force(fit.model, h, d, y, tau, a, p)
    expanded = p @ (own.mean - a)
    along = np.zeros(len(names))
    along[shape], along[mean] = 1.0, -p[mean, shape] / p[mean, mean]
    ahead, back = (surface.held(fit, a + t * along, fit.model)[1] for t in (0.02, -0.02))
    measured_force = (ahead - back) / 0.04
    assert beside[mean] == 0
    assert beside[names.index("delay")] == 0
    assert along @ (expanded + beside) == pytest.approx(measured_force, abs=1.0)


@pytest.mark.parametrize("lost", [0.1, 1.0])
def test_what_measuring_loses_is_not_taken_over(
    lost: float, world: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth in each of 40 people is what other dispersions cost; one in each is a fit that has run away."""
    begin = fitted(world, 1)
    away = replace(begin, evidence=begin.evidence - lost)
    monkeypatch.setattr("bayes_impedance.diagnosis.fit.measured.searched_shapes", lambda *_: begin)
    monkeypatch.setattr("bayes_impedance.diagnosis.fit.measured.climbed", lambda *_: away)
    assert measured(world.refitter, begin, 1) is (begin if lost * N > fitter.RAN_AWAY else away)
