"""The one criterion: dispersions integrated, against quadrature; rig against body with known truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Experiment, concealing, entry, toy, with_mass
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.additions_step import central_values
from bayes_impedance.diagnosis.fit.extend import with_pooling
from bayes_impedance.diagnosis.fit.normal_equations import log_densities, marginal, quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import (
    LEAST_GAIN,
    Comparison,
    compare,
    log_evidence,
    typical_gain,
)
from bayes_impedance.diagnosis.selection.finalists import in_order
from bayes_impedance.diagnosis.selection.trial import Trial, poolings_for, try_candidate


def masses(experiment: Experiment, fit: Refit) -> tuple[Trial, Trial]:
    """A mass at the port as the rig's and as the body's."""
    rig, body = (
        try_candidate(experiment.refitter, fit, Candidate(entry(name), "port", {}), 1e-4, (pooling,))[0]
        for name, pooling in (("rig.mass", "shared"), ("body.mass", "varying"))
    )
    return rig, body


def normal_density(fit: Refit, relative: float, mean: float) -> float:
    """Log density of everybody's own estimates of the only coefficient, if people differ by this part of its mean."""
    model = with_pooling(fit.model, 0, "varying")
    h, d, _ = quadratic(model, fit.data, fit.u, fit.equations, fit.population.covariance)
    estimates, variances = h[:, 0] / d[:, 0, 0], 1 / d[:, 0, 0]
    covariance = np.diag(variances + (relative * mean) ** 2) + model.parameters[0].prior_sd ** 2
    return float(multivariate_normal.logpdf(estimates, np.zeros(len(estimates)), covariance))


@pytest.mark.parametrize("which", [0, 1], ids=["fitted as the rig's", "fitted as the body's"])
def test_the_dispersion_is_integrated_over_its_prior(which: int) -> None:
    """With one coefficient everybody's estimate is normal, and so are all of them together."""
    experiment = concealing("rig.mass", "port", 0.3, seed=3, n=12)
    fit = masses(experiment, experiment.fit())[which].fit
    if which == 0:  # the same fit, said to be the body's: people differ, then
        item = replace(fit.model.additions[0], effect=entry("body.mass"))
        fit = replace(fit, model=replace(fit.model, additions=(item,)))
    mean = abs(float(fit.u[:, -1].mean()))
    held = 0.0 if which == 0 else fit.model.parameters[0].dispersion
    start = normal_density(fit, held, mean)
    integral = quad(lambda x: norm.pdf(x) * np.exp(normal_density(fit, 0.35 * 2**x, mean) - start), -8, 8)[0]
    price = 0.5 * np.log(len(fit.u))
    assert log_evidence(fit) == pytest.approx(fit.evidence.sum() - price + np.log(integral), abs=0.02)


def test_densities_of_many_dispersions_are_those_of_each() -> None:
    experiment = concealing("rig.mass", "port", 0.3, seed=3, n=12)
    fit = masses(experiment, experiment.fit())[1].fit
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    tau = np.array([[0.0], [0.1], [0.4]])
    each = [marginal(fit.model, h, d, row).log_density for row in tau]
    np.testing.assert_allclose(log_densities(fit.model, h, d, tau), each, rtol=1e-12)


@pytest.mark.parametrize("hidden", ["rig.mass", "body.mass"])
def test_of_one_formula_the_better_is_whose_it_was(hidden: str) -> None:
    """A mass that is the same for all is the rig's, one that differs by a quarter or more the body's."""
    experiment = concealing(hidden, "port", 2.0, seed=2, n=16)
    fit = experiment.fit()
    rig, body = masses(experiment, fit)
    assert (log_evidence(body.fit) > log_evidence(rig.fit)) == (hidden == "body.mass")
    ranked = in_order([rig, body], [entry("rig.mass"), entry("body.mass")])
    assert (ranked[0].effect.id == hidden) or abs(rig.gain - body.gain) < 1.0


def test_what_is_missing_is_better_and_what_is_not_is_no_better() -> None:
    concealed = concealing("rig.mass", "port", 1.0, seed=2, n=16)
    fit = concealed.fit()
    rig, _ = masses(concealed, fit)
    there, back = compare(rig.fit, fit), compare(fit, rig.fit)
    assert there.decided
    assert not back.decided
    assert back.difference == -there.difference
    assert back.standard_error == there.standard_error > 0
    nothing = toy(*TOY, seed=4)
    fit = nothing.fit()
    rig, body = masses(nothing, fit)
    assert not compare(rig.fit, fit).decided
    assert not compare(body.fit, fit).decided


def test_what_one_person_gains_is_not_decided() -> None:
    experiment = toy(*TOY, seed=4, hidden=with_mass(0.0))
    fit = experiment.fit()
    own = np.zeros(len(fit.data))
    own[3] = 50.0
    alone = compare(replace(fit, evidence=fit.evidence + own), fit)
    assert alone.difference == pytest.approx(50.0)
    assert not alone.decided
    everybody = compare(replace(fit, evidence=fit.evidence + 50.0 / own.size), fit)
    assert everybody.decided


def test_few_people_have_no_scatter_and_no_dispersion() -> None:
    experiment = toy(*TOY, seed=4, n=2, hidden=with_mass(0.0))
    fit = experiment.fit()
    rig, _ = masses(experiment, fit)
    assert compare(rig.fit, fit).standard_error == 0.0
    assert log_evidence(rig.fit) == pytest.approx(rig.fit.evidence.sum() - 0.5 * np.log(len(fit.u)))


def test_what_is_the_rigs_is_the_same_for_all() -> None:
    assert poolings_for(entry("rig.mass"), 71) == ("shared",)
    assert poolings_for(entry("body.mass"), 71) == ("varying",)
    assert poolings_for(entry("body.mass"), 2) == ("shared",)


def test_a_few_people_who_gain_much_do_not_make_a_gain_of_all_doubtful() -> None:
    rng = np.random.default_rng(3)
    gains = np.abs(rng.normal(size=70))
    gains[:2] = [900.0, 500.0]
    assert gains.sum() < 2 * np.sqrt(70) * gains.std(ddof=1)
    assert typical_gain(gains) > 5


def test_one_persons_gain_is_none_of_all() -> None:
    gains = np.full(30, -0.5) + 0.2 * np.random.default_rng(4).normal(size=30)
    gains[4] = 1000.0
    assert typical_gain(gains) < 0


def test_unequal_gains_of_few_count_as_much_as_equal_ones_of_as_many() -> None:
    """Ten of 52 people with a layer, of whom one gains more than all others together; three are too few either way."""
    gains = np.full(52, -0.5) + 0.3 * np.random.default_rng(4).normal(size=52)
    gains[:8] = [826.0, 303.0, 268.0, 65.0, 62.0, 58.0, 32.0, 20.0]
    assert gains.sum() < 2 * np.sqrt(52) * gains.std(ddof=1)
    assert typical_gain(gains) > 2
    assert typical_gain(gains, of_most=True) < 2
    gains[3:8] = -0.5
    assert typical_gain(gains) < 2
    gains[:3] = 300.0
    assert gains.sum() < 2 * np.sqrt(52) * gains.std(ddof=1)


def test_next_to_nothing_in_everybody_is_no_agreement_about_one_persons_gain() -> None:
    gains = np.full(30, 0.01) + 0.002 * np.random.default_rng(4).normal(size=30)
    gains[4] = 33.0
    assert typical_gain(gains) == 0
    assert typical_gain(100 * gains) > 5


def test_clipped_differences_about_zero_exceed_two_standard_errors_by_chance_only() -> None:
    draws = np.random.default_rng(5).standard_cauchy(size=(4000, 25))
    share = np.mean([typical_gain(own) > 2 for own in draws])
    assert share < 0.023 + 4 * np.sqrt(0.023 / 4000) + 0.01  # 25 people: a t distribution
    assert typical_gain(np.zeros(12)) == 0


# Which of two


def test_excluded_is_what_the_better_of_two_leaves_unlikely() -> None:
    """Three nats, and no more scatter over people than such a difference has: 3 > 0.5 se^2/3."""
    assert Comparison(8.5, 5.3).separated
    assert not Comparison(8.5, 5.3).decided
    assert not Comparison(2.9, 0.1).separated
    assert not Comparison(8.5, 7.0).separated
    assert not Comparison(-8.5, 1.0).separated
    assert Comparison(8.5, 7.0, typical=2.5).separated


def test_what_is_wrong_in_both_excludes_only_what_is_decided() -> None:
    assert Comparison(20.0, 12.0).separated
    assert not Comparison(20.0, 12.0, 2.5).separated
    assert Comparison(20.0, 5.0, 2.5).separated


@pytest.mark.parametrize("apart", [2.0, 4.0])
def test_the_truth_is_rarely_excluded(apart: float) -> None:
    """Log likelihoods of 40 people, of a right and a wrong explanation that are so many standard deviations apart."""
    rng = np.random.default_rng(1)
    own = rng.normal(apart**2 / 80, apart / np.sqrt(40), size=(4000, 40))

    def separated(differences: np.ndarray) -> np.ndarray:
        errors = np.sqrt(40) * differences.std(axis=1, ddof=1)
        return np.array(
            [
                Comparison(float(d.sum()), float(e), typical=typical_gain(d)).separated
                for d, e in zip(differences, errors, strict=True)
            ]
        )

    # The sum is normal, with mean apart^2 / 2 and standard deviation apart; 4000 draws know a share to 0.008.
    least = max(LEAST_GAIN, np.sqrt(LEAST_GAIN / 2) * apart)
    above, below = norm.sf((least - apart**2 / 2) / apart), norm.cdf((-LEAST_GAIN - apart**2 / 2) / apart)
    assert separated(own).mean() == pytest.approx(above, abs=0.05)
    assert separated(-own).mean() < below + 0.005


def test_a_dispersion_is_worth_what_refits_with_it_say() -> None:
    """A relaxation whose corner is far below the band: its time constant trades with its damping."""

    def stiffness(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        k = 60.0 * np.exp(0.3 * rng.normal(size=len(z)))
        return z + k[:, None, None] / s, k

    centre = {"m1": 0.18, "r1": 4.0}
    experiment = toy("m1|r1", centre, seed=5, n=30, hidden=stiffness, frequency_hz=np.geomspace(8, 600, 60))
    candidate = Candidate(entry("body.relaxation"), "port", {"time_constant": 0.2})
    trial = try_candidate(experiment.refitter, experiment.fit(), candidate, 12.0, ("varying",))[0]
    fit = experiment.refitter.fit(trial.fit.model, trial.fit.u, trial.fit.population, 80)
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    mean, here = float(fit.u[:, fit.model.columns(0)[0]].mean()), central_values(fit)
    followed = []
    for dispersion in (0.15, 0.2, 0.6):
        other = experiment.refitter.fit(with_pooling(fit.model, 0, "varying", [dispersion]), fit.u, fit.population, 80)
        refitted = float(other.evidence.sum() - fit.evidence.sum())
        tau = np.array([[dispersion * mean, 0.0], [fit.model.parameters[0].dispersion * mean, 0.0]])
        held, free = (-np.diff(log_densities(fit.model, h, d, tau, a))[0] for a in (here, None))
        assert held == pytest.approx(refitted, abs=1.5)
        followed.append(abs(free - refitted))
    assert max(followed) > 5
