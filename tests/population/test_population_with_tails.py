"""Fits of Student t populations: robust centres, concealed degrees of freedom, comparison with normal populations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from populations_with_tails import CENTRE, SCALE, people_with_tails
from saved_fits import read_again
from scipy.stats import kstest

from bayes_impedance import FitSettings, fit_population
from bayes_impedance.design.users import population_of
from bayes_impedance.errors import InputError
from bayes_impedance.population.described_population import population_from
from bayes_impedance.population.fit import QUICK_SETTINGS, PopulationFit
from bayes_impedance.population.held_out_person import held_out_log_densities
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.results import make_result, predict, save_result
from bayes_impedance.results.leave_one_out import leave_one_out
from bayes_impedance.results.result import Result

STUDENT = replace(QUICK_SETTINGS, distribution="student_t")
UNCORRELATED = replace(STUDENT, covariance="diagonal")


@pytest.fixture(scope="module")
def outlying() -> dict[str, PopulationFit]:
    """Two of 24 people are eight scales away in everything; fitted with both distributions."""
    recordings = people_with_tails(24, np.inf, 1, repetitions=2, outlying=2)
    return {s.distribution: fit_population(recordings, settings=s, seed=5) for s in (QUICK_SETTINGS, STUDENT)}


@pytest.fixture(scope="module")
def saved(outlying: dict[str, PopulationFit], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    return read_again(outlying, tmp_path_factory)


def test_people_far_from_the_others_move_the_centre_less(outlying):
    normal, student = outlying["normal"].parameters, outlying["student_t"].parameters
    off = {k: np.abs(p.mu.mean(axis=0) - CENTRE) / SCALE for k, p in (("normal", normal), ("student", student))}
    assert np.all(off["student"] < 0.35)  # the standard error of a centre is 0.2 scales
    assert np.all(off["normal"] > 0.4)
    spread = normal.between_persons.mean(axis=0) / SCALE, student.between_persons.mean(axis=0) / SCALE
    assert np.all(spread[1] < 1.3)
    assert np.all(spread[0] > 1.8)
    assert not any(fit.diagnostics.problems for fit in outlying.values())
    assert normal.tail is None
    assert np.quantile(1 / student.tail, 0.95) < 10


def test_the_right_distribution_predicts_people_left_out_better(saved):
    better, error = leave_one_out(saved["student_t"]).less(leave_one_out(saved["normal"]))
    assert better > 5
    assert error > 0


def test_result_says_what_dispersions_are(saved):
    summary = saved["student_t"].summary
    nu = summary["distribution"]["degrees_of_freedom"]
    tail = saved["student_t"].groups["posterior"]["inverse_degrees_of_freedom"]
    assert nu["median"] == pytest.approx(np.quantile(1 / tail, 0.5))
    assert 2 < nu["q05"] < nu["q95"]
    assert "uniform" in summary["distribution"]["prior"]
    assert population_from(summary, "summary.json").degrees_of_freedom == nu["median"]
    assert any("Student t" in remark for remark in summary["remarks"])
    assert saved["student_t"].attributes["distribution"] == "student_t"
    assert saved["student_t"].elements_table().attrs["degrees_of_freedom"] == nu
    assert "inverse_degrees_of_freedom" in saved["student_t"].groups["prior"]
    assert "distribution" not in saved["normal"].summary
    assert "distribution" not in saved["normal"].attributes


@pytest.mark.filterwarnings("ignore")
def test_functions_of_arviz_take_the_result(saved, outlying, tmp_path):
    """With the reciprocal of the degrees of freedom as one variable more."""
    import arviz as az
    from matplotlib import pyplot as plt

    fit = outlying["student_t"]
    save_result(make_result(fit, predict(fit, seed=1), {}), tmp_path)
    data = az.from_netcdf(tmp_path / "result.nc")
    table = az.summary(data)
    assert "inverse_degrees_of_freedom" in table.index
    assert np.all(np.isfinite(table.select_dtypes("number")))
    assert "scale" in data["posterior"]["inverse_degrees_of_freedom"].attrs["description"]
    az.plot_trace(data, var_names=["inverse_degrees_of_freedom", "mu"])
    az.plot_forest(data, var_names=["inverse_degrees_of_freedom"])
    az.plot_ppc(data, var_names=["recordings"], num_pp_samples=10)
    plt.close("all")
    elpd = float(az.loo(data)["elpd_loo"]) if hasattr(az.loo(data), "__getitem__") else float(az.loo(data).elpd)
    assert elpd == pytest.approx(leave_one_out(saved["student_t"]).total[0], abs=0.05)


def test_users_are_drawn_from_the_t_distribution(saved):
    """Their distance from the centre of their own population: the normal population's is chi-square."""
    tails = {}
    for name, result in saved.items():
        population = population_of(result)
        users = population.draw(4000, seed=2)
        rows = np.linspace(0, len(population.mu) - 1, 4000).astype(int)
        white = np.linalg.solve(population.factor[rows], (users.u - population.mu[rows])[..., None])[..., 0]
        tails[name] = np.sum(white**2, axis=1)
        weights = population.weights(users, 5)
        np.testing.assert_allclose(weights.sum(axis=1), 1)
        assert np.min(1 / np.sum(weights**2, axis=1)) > 200
    assert kstest(tails["normal"], "chi2", args=(3,)).pvalue > 0.01
    assert kstest(tails["student_t"], "chi2", args=(3,)).pvalue < 1e-6
    assert np.quantile(tails["student_t"], 0.99) > 2 * np.quantile(tails["normal"], 0.99)
    assert "Student t" in population_of(saved["student_t"]).note
    assert population_of(saved["normal"]).note == ""


@pytest.mark.long
def test_somebody_held_out_far_away_is_less_improbable(outlying):
    """Held-out density of an outlying person from fits of people without any."""
    recordings = outlying["normal"].recordings
    names, person = list(recordings.names), recordings.subjects[0]
    noisy = replace(person, noise_sd=np.asarray(outlying["normal"].noise[0]))
    found = {}
    for settings in (QUICK_SETTINGS, STUDENT):
        fit = fit_population(recordings.select(names[2:]), settings=settings, seed=2)
        draws = held_out_log_densities(fit, noisy, np.random.SeedSequence(3))
        found[settings.distribution] = np.logaddexp.reduce(draws) - np.log(draws.size)
    assert np.all(np.isfinite(list(found.values())))
    assert found["student_t"] > found["normal"] + 3


@pytest.mark.long
def test_same_seed_same_numbers():
    recordings = people_with_tails(8, 3.0, 4)
    first, second = (fit_population(recordings, settings=UNCORRELATED, seed=7, workers=w) for w in (1, 2))
    assert np.array_equal(first.parameters.tail, second.parameters.tail)
    assert np.array_equal(first.person_draws, second.person_draws)


@pytest.mark.long
def test_interrupted_fit_continues_with_its_weights(tmp_path):
    recordings = people_with_tails(8, 3.0, 4)
    whole = fit_population(recordings, settings=UNCORRELATED, seed=7, workers=1)

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "population estimate" and done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_population(recordings, settings=UNCORRELATED, seed=7, workers=1, checkpoint=tmp_path, progress=stop)
    continued = fit_population(recordings, settings=UNCORRELATED, seed=7, workers=1, checkpoint=tmp_path)
    assert np.array_equal(whole.parameters.tail, continued.parameters.tail)


def test_one_person_has_no_distribution():
    fit = fit_population(people_with_tails(1, np.inf, 1), settings=STUDENT, seed=1)
    assert fit.settings.distribution == "normal"
    assert fit.parameters.tail is None


def test_unknown_distribution_is_refused():
    with pytest.raises(InputError, match="student_t"):
        FitSettings(distribution="cauchy")


def test_prior_of_people_has_tails():
    recordings = people_with_tails(8, 3.0, 4)
    tails = sample_prior(recordings, settings=STUDENT, n=4000, seed=1)
    assert tails.parameters.tail is not None
    white = np.linalg.solve(tails.parameters.covariance_cholesky, (tails.people - tails.parameters.mu)[..., None])[
        ..., 0
    ]
    factors = np.sum(white**2, axis=1)
    assert kstest(factors, "chi2", args=(3,)).pvalue < 1e-6
    assert sample_prior(recordings, settings=QUICK_SETTINGS, n=10, seed=1).parameters.tail is None


@pytest.mark.slow
def test_degrees_of_freedom_and_scales_are_calibrated():
    """Over small populations of 3, 5 or infinitely many degrees of freedom, ranks of 90 % intervals.

    With nu infinite the truth is at the end of its range, so only centres and scales count there.
    """
    inside, count = np.zeros(3), np.zeros(3)
    for k, nu in enumerate([3.0, 5.0, np.inf] * 8):
        fit = fit_population(people_with_tails(20, nu, 100 + k), settings=STUDENT, seed=k)
        assert not fit.diagnostics.problems
        p = fit.parameters
        truths = [(p.mu, CENTRE), (p.between_persons, SCALE)]
        if np.isfinite(nu):
            truths.append((p.tail[:, None], np.array([1 / nu])))
        for q, (values, truth) in enumerate(truths):
            low, high = np.quantile(values, (0.05, 0.95), axis=0)
            inside[q] += np.sum((low <= truth) & (truth <= high))
            count[q] += truth.size
    share = inside / count
    assert np.all(share > 0.9 - 3 * np.sqrt(0.09 / count)), share


@pytest.mark.slow
def test_concealed_degrees_of_freedom_of_many_people():
    """120 people tell 3 degrees of freedom from a normal distribution, and the other way round."""
    found = {}
    for nu in (3.0, np.inf):
        fit = fit_population(people_with_tails(120, nu, 11), settings=STUDENT, seed=1)
        found[nu] = np.quantile(1 / fit.parameters.tail, (0.05, 0.95))
    assert found[3.0][0] < 3.0 < found[3.0][1] < 8
    assert found[np.inf][0] > 8
