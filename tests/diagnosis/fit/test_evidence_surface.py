"""Coefficient and time constant of a relaxation that are told apart only together, and those of one that is seen well.

The corner of a slow relaxation is at the lower end of the band, where each person's recordings know the ratio of
damping and time constant, and little else.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from experiments import Experiment, Serial, enlarged, entry, toy, with_mass
from scipy.stats import binom

from bayes_impedance.diagnosis.fit.additions_step import central_values, following
from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior, coefficient_posterior, reported
from bayes_impedance.diagnosis.fit.evidence_posterior import evidence_posterior
from bayes_impedance.diagnosis.fit.evidence_surface import EvidenceSurface, climbed
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.measured import with_measured_dispersions
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.refit import Refit

RELAXATION, MASS = entry("body.relaxation"), entry("body.mass")
N, DAMPING, DIFFERENCES = 30, 1.5, 0.3
SLOW, SEEN = 0.03, 0.0005
CENTRES = {"n1": 1e-3, "r1": 2.0, "m1": 2e-3}


def world(time: float, seed: int) -> Experiment:
    def relaxing(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        damping = DAMPING * np.exp(DIFFERENCES * rng.normal(size=(N, 1, 1)))
        own = time * np.exp(DIFFERENCES * rng.normal(size=(N, 1, 1)))
        return z + damping / (1 + s * own), damping[:, 0, 0]

    return toy("n1|r1|m1", CENTRES, seed, n=N, hidden=relaxing, frequency_hz=np.geomspace(4, 800, 60))


def model_of(e: Experiment, time: float) -> Model:
    addition = Addition(
        effect=RELAXATION, place="port", pooling="free", dispersion=DIFFERENCES, other_dispersions=(DIFFERENCES,)
    )
    return build(e.model.network, [addition], e.model.scales, [{"time_constant": time}])


@cache
def fitted(time: float, seed: int) -> tuple[Experiment, Refit]:
    """As a search leaves it: by the quadratic expansion."""
    e = world(time, seed)
    model = model_of(e, 1.3 * time)
    u, population = enlarged(e.fit(), model)
    u[:, len(CENTRES)] = population.mu[len(CENTRES)] = RELAXATION.coefficients[0].unbounded(DAMPING, model.scales)
    fit = e.refitter.fit(model, u, population, 100)
    for _ in range(2):
        fit = with_measured_dispersions(e.refitter, fit, seed)
    return e, fit


def truth(fit: Refit, time: float) -> np.ndarray:
    """Of the central values: the mean of a log-normal distribution, and the logarithm of the median."""
    damping, constant = RELAXATION.coefficients
    mean = damping.unbounded(DAMPING * np.exp(0.5 * DIFFERENCES**2), fit.model.scales)
    return np.array([mean, constant.unbounded(time, fit.model.scales)])


# The surface


def test_parameters_follow_to_where_the_central_values_are_held() -> None:
    e, fit = fitted(SLOW, 0)
    step = np.array([0.1, -0.2])
    there = following(fit, step)
    np.testing.assert_allclose(central_values(there), central_values(fit) + step)
    surface = EvidenceSurface(e.refitter, fit, 1)
    held, value = surface.at(fit, central_values(fit) + step)
    np.testing.assert_allclose(central_values(held), central_values(fit) + step)
    assert value == pytest.approx(held.evidence.sum(), abs=5)  # and the prior
    spread = [p.dispersion * a for p, a in zip(held.model.parameters[:1], central_values(held), strict=False)]
    before = [p.dispersion * a for p, a in zip(fit.model.parameters[:1], central_values(fit), strict=False)]
    np.testing.assert_allclose(spread, before)  # the standard deviation between people is the same


@pytest.mark.parametrize("time", [SLOW, SEEN])
def test_climbing_ends_at_a_maximum(time: float) -> None:
    e, fit = fitted(time, 1)
    top = EvidenceSurface(e.refitter, fit, 1)
    begin = top.value
    top.climb()
    assert top.value >= begin
    assert climbed(e.refitter, fit, 1).evidence.sum() == top.fit.evidence.sum()
    for axis in top.axes().T:
        for sign in (1.0, -1.0):
            assert top.at(top.fit, top.centre + sign * axis)[1] < top.value + 0.3


def test_the_evidence_of_a_ridge_holds_the_truth_where_the_expansion_does_not() -> None:
    """Twice the difference from the maximum is chi-square with two degrees of freedom, the dispersions being known."""
    behind, expanded = [], []
    for seed in range(8):
        e, fit = fitted(SLOW, seed)
        free = e.refitter.fit(model_of(e, SLOW), fit.u, fit.population)
        top = EvidenceSurface(e.refitter, free, 1)
        for _ in range(3):
            top.climb()
        behind.append(top.value - top.at(top.fit, truth(fit, SLOW))[1])
        posterior = coefficient_posterior(fit, seed)
        off = posterior.central.mean(axis=0) - truth(fit, SLOW)
        expanded.append(0.5 * off @ np.linalg.solve(posterior.covariance, off))
    assert np.min(behind) >= 0
    assert np.sum(behind) < 20.0  # chi-square with 16 degrees of freedom: 0.1 %
    assert np.sum(behind) < np.sum(expanded)


def test_without_additions_there_is_nothing_to_climb() -> None:
    e = world(SEEN, 0)
    fit = e.fit(rounds=1)
    assert climbed(e.refitter, fit, 1) is fit


# The posterior


@cache
def posterior(time: float, seed: int) -> CoefficientPosterior:
    e, fit = fitted(time, seed)
    return evidence_posterior(e.refitter, fit, seed)


@pytest.mark.parametrize("time", [SLOW, SEEN])
def test_intervals_cover_sizes_shapes_and_their_dispersions(time: float) -> None:
    hits = []
    for seed in range(12):
        fit = fitted(time, seed)[1]
        rows = {r.name: r for r in reported(fit.model, 0, posterior(time, seed), fit.population.mu[:3])}
        for name, true in (("damping", DAMPING), ("time_constant", time)):
            low, high = rows[name].dispersion_interval or (np.nan, np.nan)
            hits += [rows[name].q05 < true < rows[name].q95, low < DIFFERENCES < high]
    assert sum(hits) >= binom.ppf(0.001, len(hits), 0.9)


def test_the_same_seed_gives_the_same_draws() -> None:
    e, fit = fitted(SLOW, 0)
    one, other = evidence_posterior(e.refitter, fit, 3), evidence_posterior(e.refitter, fit, 3)
    np.testing.assert_array_equal(one.central, other.central)
    np.testing.assert_array_equal(one.relative_dispersion, other.relative_dispersion)
    assert not one.is_sampled


def test_the_mean_of_known_masses_is_known_to_their_standard_error() -> None:
    """A ratio of dispersion and mean that is held would say what the mean is."""
    spread = 0.5
    e = toy("n1|r1", {"n1": 1e-3, "r1": 2.0}, 3, n=40, noise=2e-4, hidden=with_mass(spread))
    model = e.grown(Addition(effect=MASS, place="port", pooling="varying", dispersion=spread))
    u, population = enlarged(e.fit(), model)
    assert e.coefficients is not None
    masses = e.coefficients / MASS.coefficients[0].value(1.0, model.scales)
    u[:, 2], population.mu[2] = masses[e.refitter.owner], masses.mean()
    central = evidence_posterior(e.refitter, e.refitter.fit(model, u, population), 1).central[:, 0]
    assert central.mean() == pytest.approx(masses.mean(), rel=0.02)
    assert central.std() == pytest.approx(masses.std() / np.sqrt(40), rel=0.15)


def test_a_shape_that_was_taken_as_the_same_for_all_may_differ() -> None:
    e = fitted(SEEN, 2)[0]
    addition = Addition(effect=RELAXATION, place="port", pooling="varying", dispersion=DIFFERENCES)
    model = build(e.model.network, [addition], e.model.scales, [{"time_constant": SEEN}])
    u, population = enlarged(e.fit(), model)
    u[:, len(CENTRES)] = population.mu[len(CENTRES)] = RELAXATION.coefficients[0].unbounded(DAMPING, model.scales)
    same = e.refitter.fit(model, u, population, 100)
    found = evidence_posterior(e.refitter, same, 1)
    low, high = np.quantile(found.relative_dispersion[:, 1], (0.05, 0.95))
    assert 0.15 < low < DIFFERENCES < high < 0.6
    both = np.quantile(found.central[:, 1], (0.05, 0.95)), np.quantile(posterior(SEEN, 2).central[:, 1], (0.05, 0.95))
    np.testing.assert_allclose(*both, atol=0.5 * posterior(SEEN, 2).central[:, 1].std())


def test_of_one_specimen_there_are_no_dispersions() -> None:
    e = toy("n1|r1", {"n1": 1e-3, "r1": 2.0}, 3, n=1, hidden=with_mass(0.0))
    refitter = Refitter(e.data, Serial(), one_person=True)
    model = e.grown(Addition(effect=MASS, place="port", pooling="shared"))
    u, population = enlarged(e.fit(), model)
    found = evidence_posterior(refitter, refitter.fit(model, u, population), 1)
    assert e.coefficients is not None
    mass = MASS.coefficients[0].value(found.central[:, 0], model.scales)
    assert abs(mass.mean() - e.coefficients[0]) < 3 * mass.std()
    assert not found.relative_dispersion.any()
