"""Structure of the population: closed forms, recovery, false alarms and power of its four tests."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import binom, chi2, linregress, multivariate_normal, norm, ttest_1samp

from bayes_impedance.diagnosis.folds import FOLDS
from bayes_impedance.diagnosis.heterogeneity.bootstrap import Residuals, replicates, tail_probability
from bayes_impedance.diagnosis.heterogeneity.correlations import correlation_test
from bayes_impedance.diagnosis.heterogeneity.gain import gain_of_covariate, gain_of_drift
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods, data_sd, log_marginal
from bayes_impedance.diagnosis.heterogeneity.regression import RepetitionLikelihoods, find_covariates, find_drift
from bayes_impedance.diagnosis.heterogeneity.reml import (
    AdditiveCovariance,
    FullCovariance,
    Problem,
    centred_fit,
    fit_normal_population,
)
from bayes_impedance.diagnosis.heterogeneity.subgroups import find_subgroup
from bayes_impedance.diagnosis.heterogeneity.two_groups import along
from bayes_impedance.errors import InputError

SURE = 1e-4  # A check by counting fails by chance this often.


def names(p):
    return tuple(f"n{k + 1}" for k in range(p))


def informations(rng, n, p, sd=0.1, unseen=0):
    """Unequal information: element sd about `sd`, persons differ fourfold; every other one sees no `unseen`."""
    a = rng.normal(size=(n, p, 2 * p)) / np.sqrt(2 * p)
    scale = np.exp(rng.normal(0, 0.3, (n, p)) + rng.normal(0, 0.35, (n, 1))) / sd
    h = (a @ np.swapaxes(a, 1, 2)) * scale[:, :, None] * scale[:, None, :]
    h[::2, :unseen], h[::2, :, :unseen] = 0, 0
    return h


def observed(rng, theta, h):
    """Likelihoods of persons whose log elements are theta, with noise."""
    values, vectors = np.linalg.eigh(h)
    noise = vectors * np.sqrt(np.maximum(values, 0))[:, None, :] @ rng.normal(size=(*theta.shape, 1))
    return PersonLikelihoods(names(theta.shape[1]), (h @ theta[..., None] + noise)[..., 0], h)


def covariance(p, sd=0.3, r=0.4):
    """Elements that vary together with alternating sign."""
    sign = (-1.0) ** np.arange(p)
    return sd**2 * (np.eye(p) * (1 - r) + r * np.outer(sign, sign))


def population(rng, n, t, centre=-5.0):
    return centre + rng.normal(size=(n, t.shape[0])) @ np.linalg.cholesky(t).T


def rarely(count, trials, probability):
    """Whether an event of at most this probability may have happened so often."""
    return binom.sf(count - 1, trials, probability) > SURE


def mostly(count, trials, probability):
    """Whether an event of at least this probability may have happened so rarely."""
    return binom.cdf(count, trials, probability) > SURE


# ---- closed forms


def test_log_marginal_is_a_normal_density():
    rng = np.random.default_rng(0)
    h, t = informations(rng, 7, 3), covariance(3)
    people = observed(rng, population(rng, 7, t), h)
    means = -5 + rng.normal(0, 0.2, (7, 3))
    expected = []
    for b, hi, m in zip(people.linear, h, means, strict=True):
        y = np.linalg.solve(hi, b)
        peak = 0.5 * y @ b + 0.5 * (3 * np.log(2 * np.pi) - np.linalg.slogdet(hi)[1])
        expected.append(multivariate_normal(y, t + np.linalg.inv(hi)).logpdf(m) + peak)
    np.testing.assert_allclose(log_marginal(people, means, t), expected, rtol=1e-10)


def test_log_marginal_is_an_integral():
    people = PersonLikelihoods(("n1",), np.array([[1.3], [0.0], [-4.0]]), np.array([[[2.0]], [[0.0]], [[9.0]]]))
    values = log_marginal(people, np.array([0.4]), np.array([[0.25]]))
    for value, b, h in zip(values, (1.3, 0, -4), (2, 0, 9), strict=True):
        integral = quad(lambda x, b=b, h=h: norm.pdf(x, 0.4, 0.5) * np.exp(b * x - 0.5 * h * x * x), -6, 6)[0]
        np.testing.assert_allclose(value, np.log(integral), atol=1e-9)


def test_an_element_that_is_not_seen_drops_out_of_the_marginal():
    rng = np.random.default_rng(1)
    h, t = informations(rng, 6, 3, unseen=1), covariance(3)
    people = observed(rng, population(rng, 6, t), h)
    dark = people.persons(np.arange(0, 6, 2))
    rest = PersonLikelihoods(names(2), dark.linear[:, 1:], dark.information[:, 1:, 1:])
    np.testing.assert_allclose(log_marginal(dark, np.full(3, -5.0), t), log_marginal(rest, np.full(2, -5.0), t[1:, 1:]))


def test_without_dispersion_the_marginal_is_the_likelihood_at_the_mean():
    rng = np.random.default_rng(2)
    people = observed(rng, population(rng, 4, covariance(2)), informations(rng, 4, 2))
    m = np.array([-5.1, -4.8])
    expected = people.linear @ m - 0.5 * np.einsum("p,npq,q->n", m, people.information, m)
    np.testing.assert_allclose(log_marginal(people, m, np.zeros((2, 2))), expected, rtol=1e-12)


@pytest.mark.parametrize("kind", ["full", "additive"])
def test_scoring_is_the_derivative_of_the_objective(kind):
    rng = np.random.default_rng(3)
    people = observed(rng, population(rng, 9, covariance(3), 0.0), informations(rng, 9, 3, unseen=1))
    x = np.stack([np.ones(9), rng.normal(size=9)], axis=1)
    design = np.einsum("nk,pq->npkq", x, np.eye(3)).reshape(9, 3, -1)
    parts = np.stack([np.diag([1.0, 1, 0]), np.diag([0.0, 0, 1])])
    structure = (
        FullCovariance(covariance(3))
        if kind == "full"
        else AdditiveCovariance(covariance(3, 0.1), parts, np.array([0.05, 0.2]))
    )
    problem = Problem.of(people, design, structure.matrix)
    gradient = problem.fit(structure).scoring()[0]
    step = 1e-4 * np.eye(gradient.size)
    ends = [[problem.fit(structure.moved(s * e)).objective for s in (1, -1)] for e in step]
    np.testing.assert_allclose(gradient, np.diff(ends)[:, 0] / -2e-4, atol=1e-5)


def test_objective_is_the_restricted_likelihood():
    # The likelihood of any T with the coefficients integrated out numerically differs by one constant.
    rng = np.random.default_rng(4)
    people = observed(rng, population(rng, 5, covariance(1), 0.0), informations(rng, 5, 1))
    design = np.ones((5, 1, 1))
    problem = Problem.of(people, design, np.eye(1))
    difference = []
    for variance in (0.01, 0.1, 1.0):
        t = np.array([[variance]])

        offset = float(np.sum(log_marginal(people, problem.fit(FullCovariance(t)).coefficients, t)))

        def integrand(m, t=t, offset=offset):
            return norm.pdf(m, 0, 10) * np.exp(np.sum(log_marginal(people, np.array([m]), t)) - offset)

        integral = quad(integrand, -3, 3, points=[0.0], limit=200)[0]
        difference.append(np.log(integral) + offset - problem.fit(FullCovariance(t)).objective)
    np.testing.assert_allclose(difference, difference[0], atol=1e-7)


def test_the_fit_is_a_maximum_wherever_it_starts():
    rng = np.random.default_rng(5)
    people = observed(rng, population(rng, 40, covariance(4), 0.0), informations(rng, 40, 4, unseen=1))
    design = np.broadcast_to(np.eye(4), (40, 4, 4))
    fits = [fit_normal_population(people, design, FullCovariance(s * np.eye(4))) for s in (0.002, 0.09, 3.0)]
    for fit in fits:
        gradient, information = fit.scoring()
        assert gradient @ np.linalg.solve(information, gradient) < 1e-4
        np.testing.assert_allclose(fit.covariance, fits[0].covariance, atol=2e-3 * 0.09)


def test_huge_information_is_no_trouble():
    # 1e9 of information at log elements near -12: differences of 1e11 decide about numbers of order one.
    rng = np.random.default_rng(6)
    theta = population(rng, 30, covariance(3), -12.0)
    centre, fit = centred_fit(observed(rng, theta, informations(rng, 30, 3, sd=3e-5)))
    np.testing.assert_allclose(centre, theta.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(np.diag(fit.covariance), theta.var(axis=0, ddof=1), rtol=0.1)


def test_data_sd_counts_only_what_the_others_leave():
    # Two elements of which only the sum is seen: with the other one held by the population, something is known.
    h = np.full((10, 2, 2), 1e6)
    t = np.diag([0.04, 0.09])
    np.testing.assert_allclose(
        data_sd(PersonLikelihoods(names(2), np.zeros((10, 2)), h), t), [0.3, 0.2] / np.sqrt(10), rtol=1e-3
    )
    dark = data_sd(PersonLikelihoods(names(2), np.zeros((3, 2)), np.zeros((3, 2, 2))), t)
    assert np.all(np.isinf(dark))


def test_shapes_are_checked():
    with pytest.raises(InputError, match="give"):
        PersonLikelihoods(names(2), np.zeros((3, 2)), np.zeros((3, 2, 3)))
    with pytest.raises(InputError, match="not finite"):
        PersonLikelihoods(names(1), np.full((3, 1), np.nan), np.ones((3, 1, 1)))
    with pytest.raises(InputError, match="own number"):
        RepetitionLikelihoods(names(1), (np.zeros((2, 1)),), (np.ones((2, 1, 1)),), (np.array([0, 0]),))


# ---- covariates


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
    for words in ("n3 is not determined", "'force' is the same", "unknown of 4 persons", "'x' is known of 0"):
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
    drift = find_drift(repetitions(rng, n, 2, 3))
    assert trends.trends == drift.trends == correlations.pairs == ()
    for result in (trends, drift, correlations, group):
        assert f"{n} persons" in result.reason
        assert result.tried == 0
    assert (correlations.p_corrected, group.p_corrected, group.membership.tolist()) == (1.0, 1.0, [0.0] * n)
    assert find_covariates(observed(rng, population(rng, 9, covariance(2)), informations(rng, 9, 2)), {}).reason


def test_gain_of_a_covariate_is_cross_validated_regression():
    """Elements known exactly: ordinary regression in each fold, residual variance with its degrees of freedom."""
    rng = np.random.default_rng(40)
    x = rng.normal(size=30)
    y = 0.3 * x + rng.normal(0, 0.4, 30)
    data = PersonLikelihoods(("n1",), 1e8 * y[:, None], np.full((30, 1, 1), 1e8))
    gains = np.zeros(30)
    fold = np.random.default_rng(7).permutation(30) % FOLDS
    for k in range(FOLDS):
        inside, outside = fold == k, fold != k
        for degree, sign in ((1, 1), (0, -1)):
            line = np.polyfit(x[outside], y[outside], degree)
            sd = np.sqrt(np.sum((y[outside] - np.polyval(line, x[outside])) ** 2) / (outside.sum() - degree - 1))
            gains[inside] += sign * norm.logpdf(y[inside], np.polyval(line, x[inside]), sd)
    gain, se = gain_of_covariate(data, 3 * x + 5, ["n1"], 7)
    np.testing.assert_allclose([gain, se], [gains.sum(), np.sqrt(30) * gains.std(ddof=1)], rtol=2e-3)


def test_a_covariate_that_nothing_follows_gains_nothing_on_other_people():
    rng = np.random.default_rng(41)
    gains = []
    for _ in range(25):
        people = observed(rng, population(rng, 25, covariance(2)), informations(rng, 25, 2))
        gains.append(gain_of_covariate(people, rng.normal(size=25), ["n1"], 1)[0])
    assert np.mean(gains) < 0.0


def test_gain_of_a_drift():
    rng = np.random.default_rng(42)
    real = [gain_of_drift(repetitions(rng, 20, 2, 3, beta=0.08), ["n1", "n2"], 1) for _ in range(5)]
    none = [gain_of_drift(repetitions(rng, 20, 2, 3), ["n1", "n2"], 1) for _ in range(12)]
    assert min(gain - 2 * se for gain, se in real) > 0
    assert np.mean([gain for gain, _ in none]) < 0.0


# ---- drift


def repetitions(rng, n, p, j, beta=0.0, omega=0.0, rho=0.05, sd=0.03, drop=0.0, unseen=0):
    """Recordings of n persons with offsets, common and own slopes; some repetitions are missing."""
    parts = []
    for _ in range(n):
        order = np.flatnonzero(rng.random(j) >= drop)
        slope = beta + omega * rng.normal(size=p)
        deviation = rng.normal(0, 0.1, p) + order[:, None] * slope + rho * rng.normal(size=(order.size, p))
        one = observed(rng, deviation, informations(rng, order.size, p, sd, unseen))
        parts.append((one.linear, one.information, order))
    linear, information, order = zip(*parts, strict=True)
    return RepetitionLikelihoods(names(p), linear, information, order)


def test_two_perfect_repetitions_are_a_t_test_of_the_difference():
    rng = np.random.default_rng(14)
    data = repetitions(rng, 9, 1, 2, beta=0.03, sd=1e-5)
    deviation = np.array([b[:, 0] / h[:, 0, 0] for b, h in zip(data.linear, data.information, strict=True)])
    difference = np.diff(deviation)[:, 0]
    trend = find_drift(data).trends[0]
    np.testing.assert_allclose(trend.estimate, difference.mean(), rtol=1e-3)
    np.testing.assert_allclose(trend.p_value, ttest_1samp(difference, 0).pvalue, rtol=1e-2)


def test_drift_is_recovered_with_missing_repetitions():
    rng = np.random.default_rng(15)
    inside, found = 0, 0
    for _ in range(60):
        trends = find_drift(repetitions(rng, 30, 2, 3, beta=0.04, drop=0.2, unseen=1)).trends
        trend = next(t for t in trends if t.element == "n2")
        assert trend.covariate == "repetition"
        inside += trend.q05 < 0.04 < trend.q95
        found += trend.p_corrected < 0.005
    assert mostly(inside, 60, 0.9)
    assert rarely(
        inside, 60, 0.97
    )  # the dispersion of slopes cannot be negative, so intervals are wide where it is zero
    assert mostly(found, 60, 0.6)


@pytest.mark.parametrize("omega", [0.0, 0.1])
def test_drift_raises_no_false_alarms(omega):
    # With own slopes of 0.1 and repetitions that differ by 0.05 a test without them would fail.
    rng = np.random.default_rng(16)
    least = [
        min(t.p_corrected for t in find_drift(repetitions(rng, 6 + k % 20, 2, 3, omega=omega, drop=0.1)).trends)
        for k in range(60)
    ]
    assert rarely(int(np.sum(np.array(least) < 0.05)), len(least), 0.05)
    assert rarely(int(np.sum(np.array(least) <= 0.005)), len(least), 0.005)


def test_drift_of_an_unseen_element_is_not_tested():
    rng = np.random.default_rng(17)
    data = repetitions(rng, 12, 2, 3)
    dark = tuple(h * np.outer([0, 1], [0, 1]) for h in data.information)
    linear = tuple(b * [0, 1] for b in data.linear)
    found = find_drift(RepetitionLikelihoods(data.elements, linear, dark, data.order))
    assert [t.element for t in found.trends] == ["n2"]
    assert found.remarks == ("n1 is not determined by the repetitions",)
    once = tuple(x[:1] for x in data.linear), tuple(x[:1] for x in data.information), tuple(x[:1] for x in data.order)
    assert "0 persons" in find_drift(RepetitionLikelihoods(data.elements, *once)).reason


# ---- replicates


def test_replicates_are_estimated_again():
    # With perfect recordings the new covariance is that of the replicate, whose white pulls have unit covariance again.
    rng = np.random.default_rng(18)
    _, fit = centred_fit(observed(rng, population(rng, 60, covariance(3)), informations(rng, 60, 3, sd=1e-4)))
    for batch in replicates(fit, 7, 4, 1):
        assert batch.pull.shape[0] in (3, 4)
        unit = np.swapaxes(batch.pull, 1, 2) @ batch.pull / 59
        assert np.abs(unit - np.eye(3)).max() < 0.05  # the prior's two persons in sixty
        assert np.abs(batch.pull.mean(axis=1)).max() < 1e-4
        spread = np.array([np.diag(f @ f.T) for f in batch.factor]) / np.diag(fit.covariance)
        assert 0.05 < np.std(np.log(spread)) < 0.5  # sqrt(2 / 59) = 0.18 expected
    again = [b.pull for b in replicates(fit, 7, 4, 1)]
    np.testing.assert_array_equal(again[-1], batch.pull)


def test_pulls_of_replicates_have_their_weights_as_covariance(monkeypatch):
    # Before the population is estimated again, and but for its mean.
    monkeypatch.setattr("bayes_impedance.diagnosis.heterogeneity.bootstrap._STEPS", 0)
    rng = np.random.default_rng(19)
    _, fit = centred_fit(observed(rng, population(rng, 25, covariance(2)), informations(rng, 25, 2, 0.3, unseen=1)))
    batches = [b.in_elements() for b in replicates(fit, 1000, 250, 3)]
    pulls, weights = (np.concatenate(x) for x in zip(*batches, strict=True))
    y, root = weights[0], np.linalg.inv(fit.factor)
    np.testing.assert_allclose(y, root.T @ fit.weight @ root, atol=1e-9)
    expected = np.sum(y - y @ fit.variance @ y, axis=0)
    # 12 000 pulls of the first element, which every other person does not see, have a variance known to 1.3 %.
    np.testing.assert_allclose(np.einsum("rnp,rnp->p", pulls, pulls) / 1000, np.diag(expected), rtol=0.055)
    assert np.abs(pulls[:, ::2, 0]).max() < 1e-6  # others are of order one


def test_tail_probability_of_known_tails():
    null = chi2.isf((np.arange(400) + 0.5) / 400, 2)
    for p in (0.5, 0.2, 0.03, 0.005, 1e-5):
        said = tail_probability(float(chi2.isf(p, 2)), null)
        assert p / 1.2 < said < (1.1 * p + 0.003 if p >= 0.1 else 2 * p**0.8)
    assert tail_probability(-1.0, null) == 1.0


# ---- correlations


def test_correlations_raise_no_false_alarms():
    rng = np.random.default_rng(20)
    p_values = []
    for k in range(60):
        people = observed(
            rng, population(rng, 10 + k % 40, covariance(3, r=0)), informations(rng, 10 + k % 40, 3, unseen=1)
        )
        p_values.append(correlation_test(people, k, 100).p_corrected)
    assert rarely(int(np.sum(np.array(p_values) < 0.05)), len(p_values), 0.05)
    assert rarely(int(np.sum(np.array(p_values) <= 0.005)), len(p_values), 0.005)


def test_a_correlation_is_found_and_its_interval_is_honest():
    rng = np.random.default_rng(21)
    t = 0.09 * np.eye(4)
    t[0, 1] = t[1, 0] = -0.5 * 0.09
    inside, found = 0, 0
    for k in range(40):
        result = correlation_test(observed(rng, population(rng, 71, t), informations(rng, 71, 4, 0.05)), k, 60)
        assert result.tried == 7
        pair = next(c for c in result.pairs if {c.first, c.second} == {"n1", "n2"})
        inside += pair.q05 < -0.5 < pair.q95
        found += result.p_corrected < 0.005 and result.pairs[0] is pair
    assert mostly(inside, 40, 0.9)
    assert mostly(found, 40, 0.75)  # expected statistic 4.2 before noise, and 3.2 is needed


def test_correlations_of_unseen_elements_are_not_tested():
    rng = np.random.default_rng(22)
    h = informations(rng, 30, 3)
    h[:, 0], h[:, :, 0] = 0, 0
    result = correlation_test(observed(rng, population(rng, 30, covariance(3, r=0)), h), 0, 60)
    assert [(c.first, c.second) for c in result.pairs] == [("n2", "n3")]
    assert result.remarks == ("n1 is not determined by the recordings",)
    h[:, 1], h[:, :, 1] = 0, 0
    assert "fewer than two" in correlation_test(observed(rng, population(rng, 30, covariance(3)), h), 0).reason


# ---- subgroups


def test_the_mixture_along_a_line_is_the_mixture_of_all_elements():
    # Oracle: the whole likelihood, with the one-group reference maximised over mean and spread along the line.
    rng = np.random.default_rng(23)
    theta = population(rng, 40, covariance(3), 0.0) + np.outer(np.arange(40) < 12, [0.9, 0, 0])
    people = observed(rng, theta, informations(rng, 40, 3, unseen=1))
    centre, fit = centred_fit(people)
    around = people.around(centre)
    direction = np.array([0.6, -0.7, 0.2])
    found = along(Residuals.of(fit), (direction / np.linalg.norm(direction))[None, None])
    v = fit.factor @ direction / np.linalg.norm(direction)
    m, d, t, share = (float(x[0, 0]) for x in (found.middle, found.shift, found.spread, found.share))

    def one(parameters):
        moved = fit.covariance + (np.exp(parameters[1]) - 1) * np.outer(v, v)
        return -np.sum(log_marginal(around, parameters[0] * v, moved))

    reference = -minimize(one, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}).fun
    inside = fit.covariance + (t - 1) * np.outer(v, v)
    first, second = (log_marginal(around, x * v, inside) for x in (m, m + d))
    both = np.sum(np.logaddexp(np.log1p(-share) + first, np.log(share) + second))
    np.testing.assert_allclose(found.statistic[0, 0], 2 * (both - reference), atol=1e-3)
    member = 1 / (1 + np.exp(np.log1p(-share) + first - np.log(share) - second))
    np.testing.assert_allclose(found.membership[0, 0], member, atol=2e-2)  # one round of the iteration behind


def test_subgroups_raise_no_false_alarms():
    # Full correlations, persons fourfold different, an element that every other person does not see.
    rng = np.random.default_rng(24)
    p_values = []
    for k in range(40):
        n, t = 15 + k, covariance(3, r=0.8 * (k % 2))
        people = observed(rng, population(rng, n, t), informations(rng, n, 3, 0.15, unseen=k % 2))
        p_values.append(find_subgroup(people, np.full(3, -5.0), t, k, 80).p_corrected)
    assert rarely(int(np.sum(np.array(p_values) < 0.05)), len(p_values), 0.05)
    assert rarely(int(np.sum(np.array(p_values) <= 0.005)), len(p_values), 0.005)


def test_a_group_is_found_with_its_members():
    rng = np.random.default_rng(25)
    t = covariance(4, r=0.3)
    right, count = np.zeros(3, dtype=int), 8
    for k in range(count):
        member = np.arange(71) < 20
        theta = population(rng, 71, t) + np.outer(member, [0, 1.5, 0, 0])  # five standard deviations
        group = find_subgroup(observed(rng, theta, informations(rng, 71, 4, 0.08)), np.full(4, -5.0), t, k, 80)
        assert group.p_corrected < 0.005
        assert np.mean((group.membership > 0.5) == member) > 0.95
        assert group.separation > 4
        right += [
            group.shift_q05[1] < 1.5 < group.shift_q95[1],
            group.share_q05 < 20 / 71 < group.share_q95,
            group.element == "n2",  # not if the other elements differ, too, at the level of 1 %
        ]
    assert np.all([mostly(int(k), count, p) for k, p in zip(right, (0.85, 0.9, 0.97), strict=True)])


def test_a_group_that_differs_in_several_elements_is_found():
    rng = np.random.default_rng(26)
    t, member = covariance(4, r=0.0), np.arange(71) >= 45
    shift = np.array([1.1, -1.1, 1.1, 0.0])  # 3.7 standard deviations each
    people = observed(rng, population(rng, 71, t) + np.outer(member, shift), informations(rng, 71, 4, 0.08))
    group = find_subgroup(people, np.full(4, -5.0), t, 1)
    assert group.p_corrected < 0.005
    assert group.element == ""
    assert np.mean((group.membership > 0.5) == member) > 0.95
    assert np.all(np.abs(group.shift - shift) < 0.3)  # more than three standard errors of 0.09
    assert np.all(group.shift_q05[:3] * group.shift_q95[:3] > 0)


def test_a_known_cause_is_no_group():
    # Two contact forces make two groups, unless the means follow the force.
    rng = np.random.default_rng(27)
    t, means = covariance(2), -5 + np.outer(np.arange(50) % 2, [1.5, 0])
    people = observed(rng, population(rng, 50, t, 0.0) + means, informations(rng, 50, 2))
    assert find_subgroup(people, np.full(2, -5.0), t, 0).p_corrected < 0.005
    assert find_subgroup(people, means, t, 0).p_corrected > 0.05


def test_a_group_cannot_be_found_in_an_element_that_nobody_sees():
    rng = np.random.default_rng(28)
    people = observed(rng, population(rng, 30, covariance(2)), np.zeros((30, 2, 2)))
    group = find_subgroup(people, np.full(2, -5.0), covariance(2), 0)
    assert group.reason == "no element is determined"
    h = informations(rng, 30, 2)
    h[:, 0], h[:, :, 0] = 0, 0
    group = find_subgroup(observed(rng, population(rng, 30, covariance(2)), h), np.full(2, -5.0), covariance(2), 0)
    assert group.tried == 2
    assert group.remarks == ("n1 is not determined by the recordings",)
    assert np.all(np.isfinite(group.membership))
