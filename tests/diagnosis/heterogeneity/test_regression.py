"""Covariates and drift: ordinary regression as a special case, recovery, false alarms, what cannot be tested."""

from __future__ import annotations

import numpy as np
import pytest
from populations_of_likelihoods import (
    covariance,
    informations,
    mostly,
    names,
    observed,
    population,
    rarely,
    repetitions,
)
from scipy.stats import linregress

from bayes_impedance.diagnosis.heterogeneity.correlations import correlation_test
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.regression import find_covariates
from bayes_impedance.diagnosis.heterogeneity.subgroups import find_subgroup
from bayes_impedance.diagnosis.heterogeneity.within_persons import find_within_persons
from bayes_impedance.errors import InputError


def test_with_perfect_recordings_it_is_ordinary_regression():
    rng = np.random.default_rng(7)
    force = np.exp(rng.normal(0, 0.5, 12))
    theta = population(rng, 12, covariance(2)) + np.outer(np.log(force), [0.5, 0])
    found = find_covariates(observed(rng, theta, informations(rng, 12, 2, sd=1e-5)), {"contact_force_n": force})
    assert {t.element for t in found.trends} == {"n1", "n2"}
    for trend in found.trends:
        ordinary = linregress(np.log(force), theta[:, names(2).index(trend.element)])
        assert trend.transform == "log"
        np.testing.assert_allclose(trend.estimate, ordinary.slope, atol=1e-4)
        np.testing.assert_allclose(trend.degrees_of_freedom, 10, rtol=1e-3)
        # The weak prior of the correlation moves variances by some percent with twelve persons.
        np.testing.assert_allclose(trend.statistic, ordinary.slope / ordinary.stderr, rtol=0.05)
    one = PersonLikelihoods(("n1",), theta[:, :1] * 1e10, np.full((12, 1, 1), 1e10))
    alone = find_covariates(one, {"force": force}).trends[0]
    np.testing.assert_allclose(alone.p_value, linregress(np.log(force), theta[:, 0]).pvalue, rtol=1e-3)
    assert alone.p_corrected == alone.p_value


def test_slopes_are_recovered_and_intervals_are_honest():
    rng = np.random.default_rng(8)
    inside, tests, t = 0, 0, covariance(3)
    for _ in range(60):
        force, temperature = np.exp(rng.normal(0, 0.5, 25)), rng.normal(30, 3, 25)
        truth = {"force": np.array([0.35, 0, -0.2]), "temperature_c": np.array([0.0, 0.02, 0])}
        theta = population(rng, 25, t) + np.outer(np.log(force), truth["force"])
        theta += np.outer(temperature - 30, truth["temperature_c"])
        found = find_covariates(
            observed(rng, theta, informations(rng, 25, 3, unseen=1)), {"force": force, "temperature_c": temperature}
        )
        # Slopes of one covariate are counted for one element, or the three of a population would not be independent.
        trend = next(x for x in found.trends if x.element == "n2" and x.covariate == "temperature_c")
        assert trend.transform == "linear"
        inside += trend.q05 < 0.02 < trend.q95
        trend = next(x for x in found.trends if x.element == "n3" and x.covariate == "force")
        inside += trend.q05 < -0.2 < trend.q95
        tests += 2
    assert mostly(inside, tests, 0.9)
    assert rarely(inside, tests, 0.95)


def test_covariates_raise_no_false_alarms():
    rng = np.random.default_rng(9)
    least = []
    for k in range(60):
        people = observed(
            rng, population(rng, 8 + k % 30, covariance(3)), informations(rng, 8 + k % 30, 3, 0.2, unseen=1)
        )
        found = find_covariates(people, {q: np.exp(rng.normal(size=len(people))) for q in ("force", "age")})
        least.append(min(t.p_corrected for t in found.trends))
    assert rarely(int(np.sum(np.array(least) < 0.05)), len(least), 0.05)
    assert rarely(int(np.sum(np.array(least) <= 0.005)), len(least), 0.005)


def test_a_power_law_is_found_in_a_population_of_the_papers_size():
    rng = np.random.default_rng(10)
    seen = 0
    for _ in range(10):
        force = np.exp(rng.normal(0, 0.5, 71))
        theta = population(rng, 71, covariance(8)) + np.outer(np.log(force), 0.35 * (np.arange(8) == 3))
        found = find_covariates(observed(rng, theta, informations(rng, 71, 8)), {"force": force})
        assert found.tried == 8
        seen += found.trends[0].element == "n4" and found.trends[0].p_corrected < 0.005
    assert mostly(seen, 10, 0.9)  # expected statistic 4.6, and 3.4 is needed


def test_a_companion_of_the_cause_gets_no_credit():
    rng = np.random.default_rng(11)
    force = np.exp(rng.normal(0, 0.5, 60))
    age = 40 * force**0.8 * np.exp(rng.normal(0, 0.3, 60))  # correlation 0.8 with the force
    theta = population(rng, 60, covariance(3)) + np.outer(np.log(force), [0.6, 0, 0])
    people = observed(rng, theta, informations(rng, 60, 3))
    alone = find_covariates(people, {"age_y": age})
    assert alone.trends[0].p_corrected < 0.005
    both = find_covariates(people, {"age_y": age, "contact_force_n": force})
    assert both.beside == ("contact_force_n",)
    assert min(t.p_corrected for t in both.trends if t.covariate == "age_y") > 0.05


def test_what_cannot_be_tested_is_said():
    rng = np.random.default_rng(12)
    h = informations(rng, 20, 3)
    h[:, 2], h[:, :, 2] = 0, 0
    people = observed(rng, population(rng, 20, covariance(3)), h)
    age = rng.uniform(20, 60, 20)
    age[:4] = np.nan
    found = find_covariates(
        people, {"age_y": age, "hand": np.arange(20) % 2 + 1, "force": np.full(20, 0.5), "x": np.full(20, np.nan)}
    )
    assert {(t.element, t.covariate) for t in found.trends} == {(e, q) for e in ("n1", "n2") for q in ("age_y", "hand")}
    assert found.tried == 4
    assert {t.covariate: (t.persons, t.transform) for t in found.trends} == {
        "age_y": (16, "log"),
        "hand": (20, "linear"),
    }
    said = " / ".join(found.remarks)
    for words in ("n3 is not determined", "'force' is the same", "unknown for 4 persons", "'x' is known for 0"):
        assert words in said
    # Persons without a value have no influence.
    other = find_covariates(people.persons(np.arange(4, 20)), {"age_y": age[4:]})
    first, second = ({t.element: t for t in f.trends if t.covariate == "age_y"} for f in (found, other))
    np.testing.assert_allclose(first["n1"].estimate, second["n1"].estimate, rtol=1e-2)
    with pytest.raises(InputError, match="one number for each of 20"):
        find_covariates(people, {"age_y": age[:5]})


@pytest.mark.parametrize("n", [1, 2, 3])
def test_with_too_few_persons_nothing_is_tested(n):
    rng = np.random.default_rng(13)
    people = observed(rng, population(rng, n, covariance(2)), informations(rng, n, 2))
    trends = find_covariates(people, {"age": np.arange(n) + 1.0})
    correlations, group = correlation_test(people, 0), find_subgroup(people, np.zeros(2), covariance(2), 0)
    drift = find_within_persons(repetitions(rng, n, 2, 3))
    assert trends.trends == drift.trends == correlations.pairs == ()
    for result in (trends, drift, correlations, group):
        assert f"{n} subject" in result.reason
        assert result.tried == 0
    assert (correlations.p_corrected, group.p_corrected, group.membership.tolist()) == (1.0, 1.0, [0.0] * n)
    assert find_covariates(observed(rng, population(rng, 9, covariance(2)), informations(rng, 9, 2)), {}).reason
