"""Fits with Student t noise: a concealed truth, comparison with normal noise, everything that follows a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from noise_with_tails import BETWEEN_PERSONS, BETWEEN_REPETITIONS, CENTRE, people_with_noise
from saved_fits import read_again

from bayes_impedance import FitSettings, fit_population
from bayes_impedance.diagnosis.examine import examine
from bayes_impedance.errors import InputError
from bayes_impedance.population.fit import QUICK_SETTINGS, PopulationFit
from bayes_impedance.population.held_out_person import held_out_log_densities
from bayes_impedance.results import predict
from bayes_impedance.results.leave_one_out import leave_one_out
from bayes_impedance.results.network_comparison import UNDECIDED
from bayes_impedance.results.pointwise import pointwise_log_densities
from bayes_impedance.results.result import Result

NORMAL = replace(QUICK_SETTINGS, covariance="diagonal")
STUDENT = replace(NORMAL, noise_distribution="student_t")
TAILS, NONE = 3.0, np.inf
Fits = dict[tuple[float, str], PopulationFit]


@pytest.fixture(scope="module")
def truth() -> dict[float, np.ndarray]:
    return {nu: people_with_noise(14, nu, 1)[1] for nu in (TAILS, NONE)}


@pytest.fixture(scope="module")
def fits() -> Fits:
    """Noise with and without tails, each fitted with both distributions."""
    found = {}
    for nu in (TAILS, NONE):
        recordings, _ = people_with_noise(14, nu, 1)
        for settings in (NORMAL, STUDENT):
            found[nu, settings.noise_distribution] = fit_population(recordings, settings=settings, seed=5, workers=1)
    return found


@pytest.fixture(scope="module")
def saved(fits: Fits, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[float, str], Result]:
    read = read_again({f"{nu} {name}": fit for (nu, name), fit in fits.items()}, tmp_path_factory)
    return {key: read[f"{key[0]} {key[1]}"] for key in fits}


def people(fit: PopulationFit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both ends of the people's 90 % intervals, and their means."""
    draws = fit.person_draws.reshape(-1, *fit.person_draws.shape[2:])
    low, high = np.quantile(draws, (0.05, 0.95), axis=0)
    return low, high, draws.mean(axis=0)


def test_concealed_degrees_of_freedom_are_found(fits: Fits) -> None:
    best, low, high = fits[TAILS, "student_t"].noise_tail
    assert low <= 1 / TAILS <= high
    assert low <= best <= high < low + 0.12
    assert fits[NONE, "student_t"].noise_tail[0] <= 0.03  # as good as normal above 30
    assert fits[TAILS, "normal"].noise_tail is None
    assert not any(fit.diagnostics.problems for fit in fits.values())


def test_peoples_intervals_are_narrower_and_hold(fits: Fits, truth: dict[float, np.ndarray]) -> None:
    widths, errors = {}, {}
    for name in ("normal", "student_t"):
        low, high, mean = people(fits[TAILS, name])
        widths[name] = np.mean(high - low)
        errors[name] = np.sqrt(np.mean((mean - truth[TAILS]) ** 2))
        inside = np.mean((low <= truth[TAILS]) & (truth[TAILS] <= high))
        assert inside > 0.9 - 3 * np.sqrt(0.09 / truth[TAILS].size), name
    # Of three degrees of freedom normal noise has sqrt(3) the scale, and Student t noise 1/sqrt(0.71): a ratio of 0.68.
    assert 0.6 < widths["student_t"] / widths["normal"] < 0.85
    assert errors["student_t"] < errors["normal"]
    same = [np.mean(np.subtract(*people(fits[NONE, name])[1::-1])) for name in ("normal", "student_t")]
    assert same[1] == pytest.approx(same[0], rel=0.05)


def test_held_out_density_prefers_the_right_noise(saved: dict[tuple[float, str], Result]) -> None:
    better, error = leave_one_out(saved[TAILS, "student_t"]).less(leave_one_out(saved[TAILS, "normal"]))
    assert better > 100
    assert better > UNDECIDED * error
    same, error = leave_one_out(saved[NONE, "student_t"]).less(leave_one_out(saved[NONE, "normal"]))
    assert abs(same) < max(UNDECIDED * error, 5)


def test_a_fit_of_the_others_predicts_a_person_alike(fits: Fits, saved: dict[tuple[float, str], Result]) -> None:
    """The density that weights give, against that of a refit without the person."""
    fit = fits[TAILS, "student_t"]
    noisy = [replace(s, noise_sd=sd / k) for s, sd, k in zip(fit.recordings.subjects, fit.noise, fit.noise_scale)]  # noqa: B905
    recordings = replace(fit.recordings, subjects=tuple(noisy))
    others = fit_population(recordings.select(recordings.names[1:]), settings=STUDENT, seed=2, workers=1)
    draws = held_out_log_densities(others, recordings.subjects[0], np.random.SeedSequence(3))
    refitted = np.logaddexp.reduce(draws) - np.log(draws.size)
    assert refitted == pytest.approx(leave_one_out(saved[TAILS, "student_t"]).elpd[0], abs=2.0)


def test_the_result_says_what_the_noise_is(fits: Fits, saved: dict[tuple[float, str], Result]) -> None:
    result = saved[TAILS, "student_t"]
    entry = result.summary["noise_distribution"]
    assert entry["name"] == "student_t"
    nu = entry["degrees_of_freedom"]
    assert nu["q05"] <= nu["most_probable"] <= nu["q95"]
    assert nu["most_probable"] == pytest.approx(1 / fits[TAILS, "student_t"].noise_tail[0])
    assert any(remark.startswith("The noise follows a Student t") for remark in result.summary["remarks"])
    assert result.attributes["noise_distribution"] == "student_t"
    assert result.noise_model is not None
    for key in ((TAILS, "normal"), (NONE, "normal")):
        assert "noise_distribution" not in saved[key].summary
        assert "noise_distribution" not in saved[key].attributes


def test_predictions_and_points_have_tails(fits: Fits) -> None:
    fit = fits[TAILS, "student_t"]
    assert fit.noise_weights is not None
    assert [w.shape for w in fit.noise_weights] == [s.z.shape for s in fit.recordings.subjects]
    np.testing.assert_allclose(fit.effective_noise[0], fit.noise[0] / np.sqrt(fit.noise_weights[0]))
    assert np.median(fit.noise_scale) == pytest.approx(1, abs=0.3)
    covered = predict(fit, n_draws=400, n_replicates=20, seed=1)
    assert 0.8 < covered.coverage90.mean() < 0.98
    frequency = fit.recordings.subjects[0].frequency_hz
    both = [pointwise_log_densities(fits[TAILS, name], frequency) for name in ("student_t", "normal")]
    assert np.all(np.isfinite(both))
    assert both[0].min() > both[1].min() + 5  # the point that is farthest off
    assert both[0].sum() > both[1].sum()


def test_points_far_off_are_no_missing_physics(fits: Fits) -> None:
    assert examine(fits[TAILS, "student_t"], workers=1).misfit == ()


@pytest.mark.long
def test_same_seed_same_numbers_and_interrupted_fits_continue(tmp_path) -> None:
    recordings, _ = people_with_noise(6, TAILS, 4)
    first, second = (fit_population(recordings, settings=STUDENT, seed=7, workers=w) for w in (1, 2))
    assert np.array_equal(first.person_draws, second.person_draws)
    assert np.array_equal(first.noise_tail, second.noise_tail)

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "population estimate" and done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_population(recordings, settings=STUDENT, seed=7, workers=1, checkpoint=tmp_path, progress=stop)
    continued = fit_population(recordings, settings=STUDENT, seed=7, workers=1, checkpoint=tmp_path)
    assert np.array_equal(first.person_draws, continued.person_draws)
    assert np.array_equal(first.noise_tail, continued.noise_tail)


def test_one_person_and_noise_that_is_known() -> None:
    recordings, truth = people_with_noise(1, TAILS, 3, repetitions=3, points=60, known=True)
    fit = fit_population(recordings, settings=STUDENT, seed=1, workers=1)
    low, high = np.quantile(fit.parameters.mu, (0.001, 0.999), axis=0)
    assert np.all((low < truth[0]) & (truth[0] < high))
    assert fit.noise_tail[1] > 0.1  # ten degrees of freedom and more are excluded by 180 points
    assert fit.noise_model is None
    assert fit.noise_scale[0] == pytest.approx(1, abs=0.25)
    assert fit.noise_weights is not None
    assert np.all(np.isfinite(fit.person_log_likelihood))


def test_a_parameter_that_is_the_same_for_everybody() -> None:
    recordings, _ = people_with_noise(8, TAILS, 6)
    fit = fit_population(recordings, "m1*|r1|n1", settings=STUDENT, seed=1, workers=1)
    assert fit.noise_weights is not None
    assert not fit.diagnostics.problems


def test_unknown_distribution_is_refused() -> None:
    with pytest.raises(InputError, match="noise_distribution is 'cauchy': choose 'normal' or 'student_t'"):
        FitSettings(noise_distribution="cauchy")


@pytest.mark.slow
def test_intervals_are_calibrated() -> None:
    """Over small populations with noise of 3, 5 and infinitely many degrees of freedom: 90 % intervals."""
    inside, count = np.zeros(5), np.zeros(5)
    for k, nu in enumerate([3.0, 5.0, np.inf] * 10):
        recordings, truth = people_with_noise(12, nu, 100 + k)
        fit = fit_population(recordings, settings=STUDENT, seed=k, workers=1)
        assert not fit.diagnostics.problems
        p, (low, high, _) = fit.parameters, people(fit)
        inside[0] += np.sum((low <= truth) & (truth <= high))
        count[0] += truth.size
        rho = np.full(3, BETWEEN_REPETITIONS)
        truths = [(p.mu, CENTRE), (p.between_persons, BETWEEN_PERSONS), (p.between_repetitions, rho)]
        for q, (values, true) in enumerate(truths, start=1):
            ends = np.quantile(values, (0.05, 0.95), axis=0)
            inside[q] += np.sum((ends[0] <= true) & (true <= ends[1]))
            count[q] += true.size
        if np.isfinite(nu):
            inside[4] += fit.noise_tail[1] <= 1 / nu <= fit.noise_tail[2]
            count[4] += 1
    share = inside / count
    assert np.all(share > 0.9 - 3 * np.sqrt(0.09 / count)), share
