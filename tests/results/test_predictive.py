"""Bands, coverage and replicated errors against their definitions."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import SHORT, SMALL

from bayes_impedance.population.fit import PopulationFit, fit_population
from bayes_impedance.population.simulate import Simulation, simulate_recordings
from bayes_impedance.results.curve_errors import error_curves
from bayes_impedance.results.predictive import PROBABILITIES, Predictive, predict


@pytest.fixture(scope="module")
def predictive(small_fit: PopulationFit) -> Predictive:
    return predict(small_fit, seed=2)


def test_bands_are_ordered_and_nested(predictive: Predictive) -> None:
    for band in (predictive.centre, predictive.person, predictive.recording):
        for rows in (band.magnitude, band.phase_deg):
            assert rows.shape == (len(PROBABILITIES), predictive.frequency_hz.size)
            assert np.all(np.diff(rows, axis=0) > 0)
    widths = [b.magnitude[4] - b.magnitude[0] for b in (predictive.centre, predictive.person, predictive.recording)]
    assert np.all(widths[0] < widths[1])  # what is known of the centre is less uncertain than a person is different
    assert np.abs(np.log(widths[2] / widths[1])).max() < 0.15  # one per cent of noise; bands of 1000 curves wobble


def test_a_recording_has_noise_on_top_of_what_people_differ_by(small_fit: PopulationFit) -> None:
    # Bands of 1000 curves wobble by some per cent, so that the noise must widen them by more.
    noisy = predict(replace(small_fit, noise=tuple(40 * own for own in small_fit.noise)), seed=2)
    person, recording = (b.magnitude[4] - b.magnitude[0] for b in (noisy.person, noisy.recording))
    assert np.mean(person < recording) > 0.95
    assert np.mean(np.log(recording / person)) > 0.1


def test_person_band_is_that_of_the_posterior(predictive: Predictive, small_fit: PopulationFit) -> None:
    rng = np.random.default_rng(0)
    p = small_fit.parameters
    people = [
        rng.multivariate_normal(p.mu[i], p.covariance[i], method="cholesky")
        for i in rng.integers(p.mu.shape[0], size=4000)
    ]
    z = small_fit.kernel.impedance(np.array(people), predictive.frequency_hz)
    low, high = np.quantile(np.abs(z), (0.05, 0.95), axis=0)
    spread = np.abs(z).std(axis=0)
    assert np.all(np.abs(predictive.person.magnitude[0] - low) < 0.25 * spread)
    assert np.all(np.abs(predictive.person.magnitude[4] - high) < 0.35 * spread)


def test_new_people_from_the_same_population_fall_inside_at_the_nominal_rate(predictive: Predictive) -> None:
    people = simulate_recordings(SMALL, 400, 3, predictive.frequency_hz, seed=77).recordings
    magnitude = np.array([np.abs(s.mean) for s in people.subjects])
    phase = np.array([np.angle(s.mean, deg=True) for s in people.subjects])
    band = predictive.recording
    for values, rows in ((magnitude, band.magnitude), (phase, band.phase_deg)):
        assert 0.82 < np.mean((values > rows[0]) & (values < rows[4])) < 0.98
        assert 0.38 < np.mean((values > rows[1]) & (values < rows[3])) < 0.65


def test_coverage_counts_people(predictive: Predictive) -> None:
    inside = (np.abs(predictive.observed) >= predictive.recording.magnitude[0]) & (
        np.abs(predictive.observed) <= predictive.recording.magnitude[4]
    )
    assert predictive.coverage90[0] == pytest.approx(inside.mean(axis=0))
    assert np.all(predictive.coverage50 <= predictive.coverage90)


def test_errors_are_those_of_the_population_network(predictive: Predictive, small_fit: PopulationFit) -> None:
    z = small_fit.kernel.impedance(np.median(small_fit.parameters.mu, axis=0), predictive.frequency_hz)
    expected = error_curves(np.abs(z), np.angle(z, deg=True), predictive.observed)
    assert predictive.errors["population_network"].magnitude == pytest.approx(expected.magnitude)
    best = predictive.errors["lookup_median"]
    for name in ("population_network", "lookup_mean"):
        assert np.all(predictive.errors[name].magnitude >= best.magnitude - 1e-12)


def test_replicates_contain_the_observed_error_of_a_true_network(predictive: Predictive) -> None:
    r = predictive.replication
    seen = predictive.errors["population_network"].magnitude
    assert np.mean((seen > r.magnitude[0]) & (seen < r.magnitude[2])) > 0.6
    assert 0.02 < r.mean_magnitude_rank < 0.98
    assert 0.02 < r.mean_phase_rank < 0.98
    assert np.all((r.magnitude_rank > 0) & (r.magnitude_rank <= 1))


@pytest.mark.long
def test_replicates_show_that_a_wrong_network_is_wrong(small_simulation: Simulation) -> None:
    fit = fit_population(small_simulation.recordings, "r3-(m2|r1|n1)", settings=SHORT, seed=1)
    good = predict(fit_population(small_simulation.recordings, settings=SHORT, seed=1), seed=1)
    bad = predict(fit, seed=1)
    assert bad.person_relative_rms.mean() > 3 * good.person_relative_rms.mean()
    assert bad.errors["population_network"].phase_deg.mean() > good.errors["population_network"].phase_deg.mean()


def test_own_networks_come_as_close_as_the_noise(predictive: Predictive) -> None:
    # Real and imaginary part have 1 % each, rising below 8 Hz: 1.4 % and a little more.
    assert 0.012 < np.median(predictive.person_relative_rms) < 0.03


def test_same_seed_same_bands(small_fit: PopulationFit, predictive: Predictive) -> None:
    again = predict(small_fit, seed=2)
    assert np.array_equal(again.recording.magnitude, predictive.recording.magnitude)
    assert not np.array_equal(predict(small_fit, seed=3).recording.magnitude, predictive.recording.magnitude)


def test_different_grids_are_brought_together(small_simulation: Simulation) -> None:
    subjects = tuple(
        replace(s, frequency_hz=s.frequency_hz[i % 3 :], z=s.z[:, i % 3 :])
        for i, s in enumerate(small_simulation.recordings.subjects)
    )
    fit = fit_population(replace(small_simulation.recordings, subjects=subjects), settings=SHORT, seed=1)
    p = predict(fit, n_draws=200, n_replicates=20)
    assert np.isnan(p.observed[2, 0])
    assert not np.isnan(p.observed[0, 0])
    for curve in p.errors.values():
        assert np.all(np.isfinite(curve.magnitude))
    assert np.all(np.isfinite(p.coverage90))
