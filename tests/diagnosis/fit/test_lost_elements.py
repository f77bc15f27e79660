"""A branch of the network that a fit has lost comes back in the place of an addition that stands for it."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.fit.lost_elements import lost_elements, with_lost_elements
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.exchange import without

ELEMENTS = {"m1": 0.05, "n1": 5e-5, "r2": 3.6, "n2": 1e-2}
"""A resonance at 100 Hz that nothing damps, beside a weak branch that relaxes at 4 Hz."""


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy("m1|n1|(r2-n2)", ELEMENTS, 5, 12, frequency_hz=np.geomspace(1, 1000, 81))


@pytest.fixture(scope="module")
def misled(world: Experiment) -> Refit:
    """The branch is gone, and a relaxation is in its place."""
    effect = entry("body.relaxation")
    addition, start = Addition(effect=effect, place="port", pooling="free"), {"time_constant": 0.036}
    model = build(world.model.network, [addition], world.model.scales, [start])
    network, scales = model.network.elements, model.scales
    size, shape = effect.coefficients
    u = np.column_stack([world.u, np.zeros((len(world.u), 2))])
    r2, n2 = (world.u[:, network.index(name)].copy() for name in ("r2", "n2"))
    u[:, model.n_elements] = np.exp(r2) / size.scale(scales)
    u[:, model.n_elements + 1] = [shape.unbounded(np.exp(value), scales) for value in r2 + n2]
    u[:, network.index("r2")], u[:, network.index("n2")] = -12.0, -16.0
    covariance = np.diag(np.append(np.diag(world.population.covariance), [1.0, 0.1]))
    population = Population(u.mean(axis=0), covariance, np.append(world.population.rho, [1e-3, 1e-3]))
    return world.refitter.fit(model, u, population, 60)


def test_elements_that_nobody_feels_are_lost(world: Experiment, misled: Refit) -> None:
    names = misled.model.network.elements
    assert [name for name, lost in zip(names, lost_elements(misled), strict=True) if lost] == ["r2", "n2"]
    assert not lost_elements(world.fit()).any()


def test_they_come_back_where_the_addition_is_left_out(world: Experiment, misled: Refit) -> None:
    again = without(world.refitter, misled, 0, 1)
    truth = world.fit()
    assert again.evidence.sum() == pytest.approx(truth.evidence.sum(), abs=1.0)
    assert again.evidence.sum() > misled.evidence.sum()
    np.testing.assert_allclose(again.population.mu, truth.population.mu, atol=0.01)


def test_a_fit_that_has_lost_nothing_stays(world: Experiment) -> None:
    fit = world.fit()
    assert with_lost_elements(world.refitter, fit, fit.u, lost_elements(fit), 20) is fit


def test_a_fit_that_has_lost_too_much_to_search_stays(world: Experiment) -> None:
    fit = world.fit()
    assert with_lost_elements(world.refitter, fit, fit.u, np.ones(4, dtype=bool), 20) is fit
