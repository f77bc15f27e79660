"""A fit that walks away from an optimum: a small layer in a fifth of the people, beside a delay of the rig.

Compliance and time constant of the layer change the curve nearly alike. Members are far from a mean over everybody,
whose dispersion is held at a share of it, so that smaller compliances are nearer to it in every round, the mean and its
dispersion follow them, and the shape follows the compliances.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.fit import fitter
from bayes_impedance.diagnosis.fit.extend import extended_start
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.model import DISPERSION_IN_SOME, Addition, build
from bayes_impedance.diagnosis.fit.refit import Refit

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


@pytest.mark.parametrize("bounded", [True, False])
def test_a_fit_ends_at_the_best_place_that_it_met(
    bounded: bool, world: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not bounded:
        monkeypatch.setattr(fitter, "RAN_AWAY", np.inf)
    first, last = (float(fitted(world, rounds).evidence.sum()) for rounds in (1, 40))
    assert (last > first - 10) if bounded else (last < first - 100)


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
