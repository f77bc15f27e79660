"""Priors of a centre with tails: the same distribution sampled and maximised, and overruled by recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS
from scipy import stats

from bayes_impedance.errors import InputError
from bayes_impedance.plots.joint import prior_density
from bayes_impedance.population import prior_tails
from bayes_impedance.population.fit import fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior, read_prior
from bayes_impedance.population.ordered_centres import Centres
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import make_result

T = stats.t(prior_tails.DEGREES)


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return simulate_recordings(THREE_ELEMENTS, 6, 1, np.geomspace(5, 5000, 12), seed=3).recordings


@pytest.fixture
def mixed() -> Prior:
    return Prior(
        centre=np.array([1.0, -2.0, 0.5]), centre_sd=np.array([0.3, 2.0, 0.7]), heavy=np.array([False, True, True])
    )


def test_coordinates_are_quantiles() -> None:
    u = np.array([-7.5, -3.0, -0.1, 0.0, 0.4, 2.0, 7.5])
    z = prior_tails.from_standard(u)
    np.testing.assert_allclose(z[:4], T.ppf(stats.norm.cdf(u[:4])), rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(z[4:], T.isf(stats.norm.sf(u[4:])), rtol=1e-7)
    np.testing.assert_allclose(prior_tails.to_standard(z), u, rtol=1e-7, atol=1e-12)
    step = 1e-5
    ahead, behind = prior_tails.from_standard(u + step), prior_tails.from_standard(u - step)
    np.testing.assert_allclose(prior_tails.slope(u), (ahead - behind) / (2 * step), rtol=1e-6)
    assert np.all(np.isfinite(prior_tails.from_standard(np.array([-50.0, 50.0]))))


def test_densities_agree(mixed: Prior) -> None:
    """Of centres, and of their coordinates with the Jacobian; the misfit is its negative."""
    rng = np.random.default_rng(1)
    values = mixed.centre + mixed.centre_sds * rng.normal(size=(20, 3)) * [1, 4, 2]
    z = (values - mixed.centre) / mixed.centre_sds
    expected = stats.norm.logpdf(z[:, 0]) + T.logpdf(z[:, 1]) + T.logpdf(z[:, 2])
    np.testing.assert_allclose(prior_tails.density(z), T.pdf(z), rtol=1e-9)
    found = mixed.log_density(values)
    np.testing.assert_allclose(found - found[0], expected - expected[0], rtol=1e-9)
    np.testing.assert_allclose([-mixed.misfit(row) for row in values], found)
    centres = Centres(mixed)
    u = centres.coordinates(values)
    np.testing.assert_allclose(centres.values(u), values)
    jacobian = np.log(prior_tails.slope(u[:, 1:])).sum(axis=1)
    of_u = centres.log_prior(u) - jacobian
    np.testing.assert_allclose(of_u - of_u[0], expected - expected[0], rtol=1e-7, atol=1e-9)


def test_gradient_is_the_derivative(mixed: Prior) -> None:
    centres, u = Centres(mixed), np.array([[0.3, -2.5, 1.2]])
    target = np.array([0.2, 3.0, -1.0])

    def log_posterior(u: np.ndarray) -> float:
        return float(centres.log_prior(u)[0] - 0.5 * np.sum((centres.values(u) - target) ** 2))

    slope = centres.slope(u, target - centres.values(u))[0]
    for k, step in enumerate(1e-5 * np.eye(3)):
        assert slope[k] == pytest.approx((log_posterior(u + step) - log_posterior(u - step)) / 2e-5, rel=1e-6)


def test_the_local_normal_prior_draws_as_the_tails_do(mixed: Prior) -> None:
    there, step = mixed.centre + np.array([0.5, 9.0, -1.0]), 1e-5
    force = (there - mixed.centre) / mixed.local_sds(there) ** 2
    for k, own in enumerate(step * np.eye(3)):
        assert force[k] == pytest.approx((mixed.misfit(there + own) - mixed.misfit(there - own)) / (2 * step), rel=1e-6)


def test_draws_of_the_prior_are_student_t(recordings: Recordings, tmp_path: Path) -> None:
    file = tmp_path / "prior.toml"
    file.write_text('[elements.m1]\ncentre = 2e-4\nscale = 0.1\nkind = "student_t"\n', encoding="utf-8")
    given = read_prior(file)
    assert GivenPrior.of_text(given.text()) == given
    drawn = sample_prior(recordings, settings=replace(SHORT, prior=given), n=4000, seed=1)
    own = drawn.kernel.elements.index("m1")
    z = (drawn.parameters.mu[:, own] - np.log(2e-4)) / 0.1
    assert stats.kstest(z, T.cdf).pvalue > 0.01
    assert stats.kstest(z, stats.norm.cdf).pvalue < 1e-4


def test_recordings_overrule_a_prior_with_tails_and_not_a_normal_one() -> None:
    """A centre that is wrong by a factor of three, with a scale of 0.1: the posterior is the product of densities."""
    # Of fewer people the centre's own likelihood has tails, which draws without the prior do not reach.
    recordings = simulate_recordings(THREE_ELEMENTS, 16, 1, np.geomspace(5, 5000, 12), seed=3).recordings
    usual = fit_population(recordings, settings=SHORT, seed=1)
    k = usual.kernel.elements.index("r1")
    mu, sd = usual.parameters.mu[:, k].mean(), usual.parameters.mu[:, k].std()
    fits = {}
    for kind in ("normal", "student_t"):
        own = ElementPrior(centre=float(np.exp(mu + 1.1)), scale=0.1, kind=kind)
        settings = replace(SHORT, prior=GivenPrior(elements={"r1": own}))
        fits[kind] = fit_population(recordings, settings=settings, seed=1)
    moved = {kind: (fit.parameters.mu[:, k].mean() - mu) / sd for kind, fit in fits.items()}
    assert moved["normal"] > 3
    # Weights of the draws without the given prior, whose own prior is flat here (a scale of 3).
    draws = usual.parameters.mu[:, k]
    weights = np.exp(prior_tails.log_density((draws - mu - 1.1) / 0.1))
    expected = (np.average(draws, weights=weights) - mu) / sd
    assert moved["student_t"] == pytest.approx(expected, abs=0.35)
    result = make_result(fits["student_t"], predict(fits["student_t"], n_draws=20, n_replicates=4), {})
    kinds = {name: own["kind"] for name, own in result.summary["prior"]["elements"].items()}
    assert kinds == {"m1": "normal", "r1": "student_t", "n1": "normal"}
    grid = np.linspace(-5, 5, 11)
    np.testing.assert_allclose(prior_density(result, k, 1.0, 2.0)(grid), stats.t(prior_tails.DEGREES, 1, 2).pdf(grid))
    np.testing.assert_allclose(prior_density(result, 1 - k, 1.0, 2.0)(grid), stats.norm(1, 2).pdf(grid))


def test_a_kind_that_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match='kind is "cauchy", but must be one of normal, student_t'):
        ElementPrior(kind="cauchy")


def test_one_person_has_the_prior_too(recordings: Recordings) -> None:
    one = replace(recordings, subjects=recordings.subjects[:1])
    usual = fit_population(one, settings=SHORT, seed=1)
    k = usual.kernel.elements.index("r1")
    mu = usual.parameters.mu[:, k].mean()
    centre = float(np.exp(mu + 3))
    moved = {}
    for kind in ("normal", "student_t"):
        given = GivenPrior(elements={"r1": ElementPrior(centre=centre, scale=0.1, kind=kind)})
        fit = fit_population(one, settings=replace(SHORT, prior=given), seed=1)
        moved[kind] = fit.parameters.mu[:, k].mean() - mu
    assert moved["student_t"] < 0.5 * moved["normal"]


def test_first_fits_are_not_held_where_the_prior_is_wrong() -> None:
    """They would end elsewhere than the others, and be told as another solution, with the evidence of the same one."""
    recordings = simulate_recordings(THREE_ELEMENTS, 12, 1, np.geomspace(5, 5000, 24), seed=1).recordings
    given = GivenPrior(elements={"r1": ElementPrior(centre=30.0, scale=0.1, kind="student_t")})
    fit = fit_population(recordings, "m1|r1|n1", settings=replace(SHORT, prior=given), seed=1)
    result = make_result(fit, predict(fit, n_draws=20, n_replicates=4), {})
    assert not [remark for remark in result.summary["remarks"] if remark.startswith("Another solution")]
