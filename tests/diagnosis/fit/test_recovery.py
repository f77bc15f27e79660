"""Concealed effects are recovered by refits: estimates, intervals, dispersions, rig or body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from experiments import (
    DISPERSION,
    MASS,
    TOY,
    Experiment,
    concealing,
    entry,
    recovered,
    toy,
    with_mass,
)

from bayes_impedance.diagnosis.fit.coefficient_posterior import (
    coefficient_posterior,
    reported,
    verdict_on_side,
)
from bayes_impedance.diagnosis.fit.refit import Refit

SHARED = {
    "rig.delay": (entry("rig.delay"), "delay", 0.1),
    "rig.highpass": (entry("rig.highpass"), "corner", 0.05),
    "rig.mass": (entry("rig.mass"), "mass", 0.6),
}


@dataclass(frozen=True)
class Estimate:
    """An estimate with its posterior sd and 90 % interval, all in units of the operation."""

    true: float
    estimate: float
    draws: np.ndarray

    @property
    def z(self) -> float:
        return float((self.estimate - self.true) / self.draws.std())

    @property
    def covered(self) -> bool:
        low, high = np.quantile(self.draws, (0.05, 0.95))
        return bool(low < self.true < high)


@pytest.fixture(scope="module")
def shared_estimates() -> dict[str, list[Estimate]]:
    result: dict[str, list[Estimate]] = {}
    for name, (effect, own, strength) in SHARED.items():
        for seed in range(10):
            experiment = concealing(name, "port", strength, seed)
            fit = recovered(experiment, effect, "port", "shared")
            assert fit.settled, (name, seed)
            coefficient, scales = effect.coefficients[0], fit.model.scales
            true = experiment.case.values[own] * (2 * np.pi if coefficient.unit == "Hz" else 1.0)
            draws = coefficient.value(coefficient_posterior(fit, seed).central[:, 0], scales)
            estimate = float(coefficient.value(fit.shared_value[0], scales))
            result.setdefault(name, []).append(Estimate(true, estimate, draws))
    return result


@pytest.mark.parametrize("name", SHARED)
def test_shared_coefficients_are_recovered(name: str, shared_estimates: dict[str, list[Estimate]]) -> None:
    from scipy.stats import chi2

    z = np.array([e.z for e in shared_estimates[name]])
    assert np.abs(z).max() < 3.5  # of ten: 0.5 %
    assert chi2.ppf(0.001, 10) < np.sum(z**2) < chi2.ppf(0.999, 10)
    assert abs(z.mean()) < 3.1 / np.sqrt(10)
    # And they are not found because the prior says so: all are far from zero.
    assert min(abs(e.true) / e.draws.std() for e in shared_estimates[name]) > 3


def test_intervals_cover_as_often_as_they_say(shared_estimates: dict[str, list[Estimate]]) -> None:
    from scipy.stats import binom

    covered = [e.covered for estimates in shared_estimates.values() for e in estimates]
    assert binom.ppf(0.001, len(covered), 0.9) <= sum(covered) <= binom.ppf(0.999, len(covered), 0.9)
    for estimates in shared_estimates.values():
        for e in estimates:  # the draws are around the estimate
            assert abs(e.draws.mean() - e.estimate) < 0.2 * e.draws.std()


@pytest.fixture(scope="module")
def varying_masses() -> list[tuple[Experiment, Refit, Any]]:
    result = []
    for seed in range(10):
        experiment = toy(*TOY, seed=seed, n=30, hidden=with_mass(DISPERSION))
        fit = recovered(experiment, entry("body.mass"), "port", "varying")
        assert fit.settled
        posterior = coefficient_posterior(fit, seed)
        result.append((experiment, fit, reported(fit.model, 0, posterior, fit.population.mu[:2])[0]))
    return result


def test_varying_coefficient_has_its_median_and_dispersion(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    """Ten populations of thirty people: the centre and the dispersion of the masses that they were given."""
    from scipy.stats import binom

    medians = np.array([[r.q05, r.median, r.q95] for _, _, r in varying_masses])
    spreads = np.array([[r.dispersion_q05, r.dispersion, r.dispersion_q95] for _, _, r in varying_masses])
    least = binom.ppf(0.001, 10, 0.9)
    assert np.sum((medians[:, 0] < MASS) & (medians[:, 2] > MASS)) >= least
    assert np.sum((spreads[:, 0] < DISPERSION) & (spreads[:, 2] > DISPERSION)) >= least
    # Sampling 30 people: ln of the median has sd 0.3/sqrt(30), the dispersion 0.3/sqrt(60).
    assert abs(np.log(medians[:, 1] / MASS).mean()) < 3 * DISPERSION / np.sqrt(300)
    assert abs(spreads[:, 1].mean() - DISPERSION) < 3 * DISPERSION / np.sqrt(600)
    widths = np.log(medians[:, 2] / medians[:, 0]) / 3.29
    np.testing.assert_allclose(widths.mean(), DISPERSION / np.sqrt(30), rtol=0.25)


def test_a_varying_coefficient_comes_to_rest_in_a_few_rounds() -> None:
    """A search allows 30 rounds; with own coefficients that follow as far as they are free three are enough."""
    for seed in range(3):
        assert recovered(
            toy(*TOY, seed=seed, n=30, hidden=with_mass(DISPERSION)), entry("body.mass"), "port", "varying", 15
        ).settled


def test_everybodys_own_coefficient(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    for experiment, fit, _ in varying_masses[:3]:
        own = entry("body.mass").coefficients[0].value(fit.persons[:, 2], fit.model.scales)
        assert experiment.coefficients is not None
        assert np.corrcoef(own, experiment.coefficients)[0, 1] > 0.95
        assert not np.any(np.ptp(fit.u[:, 2].reshape(-1, 2), axis=1) > 0.02 * np.abs(fit.persons[:, 2]))


def test_rig_or_body_from_the_dispersion(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    sides = []
    for dispersion in (0.0, DISPERSION):
        experiment = toy(*TOY, seed=3, n=30, hidden=with_mass(dispersion))
        fit = recovered(experiment, entry("body.mass"), "port", "varying")
        sides.append(verdict_on_side(coefficient_posterior(fit, 1).relative_dispersion[:, 0]))
    assert sides == ["rig", "body"]


def test_a_varying_mass_in_the_fingertip_is_recovered() -> None:
    experiment = concealing("body.mass", "port", 1.0, 4, n=30, repetitions=2, points=121)
    fit = recovered(experiment, entry("body.mass"), "port", "varying")
    assert fit.settled
    mass = reported(fit.model, 0, coefficient_posterior(fit, 1), fit.population.mu[:8])[0]
    true = experiment.case.values["mass"]
    assert abs(mass.median - true) < 3 * (mass.q95 - mass.q05) / 3.29
    assert mass.q05 > 0.2 * true
    assert mass.dispersion_q05 < 0.4 < mass.dispersion_q95
    assert (mass.name, mass.unit) == ("mass", "kg")


def test_posterior_is_the_same_for_the_same_seed(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    fit = varying_masses[0][1]
    one, again, other = (coefficient_posterior(fit, seed, 200) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.central, again.central)
    assert not np.array_equal(one.central, other.central)
