"""Log densities of single points, against the normal density written out, and where a network is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS
from scipy.stats import norm

from bayes_impedance import fit_population, make_result, predict, save_result, simulate_recordings
from bayes_impedance.mcmc.arviz_file import load_groups
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.results.pointwise import POINTWISE, pointwise_log_densities

FREQUENCY = np.geomspace(20, 2000, 16)


@pytest.fixture(scope="module")
def fit() -> PopulationFit:
    """Five people with two repetitions; the last was recorded at every other frequency, and at one of its own."""
    recordings = simulate_recordings(THREE_ELEMENTS, 5, 2, FREQUENCY, 2).recordings
    last = recordings.subjects[-1]
    fewer = replace(last, frequency_hz=last.frequency_hz[::2], z=last.z[:, ::2])
    recordings = replace(recordings, subjects=(*recordings.subjects[:-1], fewer))
    return fit_population(recordings, settings=replace(SHORT, covariance="diagonal"), seed=1)


def test_one_draw_is_the_normal_density(fit: PopulationFit) -> None:
    alone = replace(fit, person_draws=fit.person_draws[:1, :1])
    found = pointwise_log_densities(alone, FREQUENCY)
    subject, theta = fit.recordings.subjects[1], fit.person_draws[0, 0, 1]
    expected = np.zeros(FREQUENCY.size)
    for z, deviation, sd in zip(subject.z, fit.deviations[1], fit.noise[1], strict=True):
        model = fit.kernel.impedance((theta + deviation)[None], FREQUENCY)[0]
        expected += norm(model.real, sd).logpdf(z.real) + norm(model.imag, sd).logpdf(z.imag)
    np.testing.assert_allclose(found[1], expected, rtol=1e-9)


def test_points_that_were_not_recorded_have_none(fit: PopulationFit) -> None:
    found = pointwise_log_densities(fit, FREQUENCY)
    assert np.all(np.isfinite(found[:-1]))
    assert np.array_equal(np.isfinite(found[-1]), np.arange(16) % 2 == 0)
    assert np.all(np.isnan(pointwise_log_densities(fit, FREQUENCY * 1.001)))


def test_a_mean_of_densities_lies_between_them(fit: PopulationFit) -> None:
    found = pointwise_log_densities(fit, FREQUENCY)[0]
    draws = fit.person_draws.reshape(-1, 1, *fit.person_draws.shape[2:])
    each = [pointwise_log_densities(replace(fit, person_draws=d[None]), FREQUENCY)[0] for d in draws[::40]]
    assert np.all(found < np.max(each, axis=0) + 0.1)
    assert np.all(found > np.min(each, axis=0) - 0.1)


def test_they_say_where_a_network_is_wrong(fit: PopulationFit) -> None:
    """Without its spring a network is wrong at low frequencies, in units of the noise at hand."""
    right = pointwise_log_densities(fit, FREQUENCY)
    wrong = fit_population(fit.recordings, "m1|r1", settings=fit.settings, seed=1)
    worse = np.nanmean(right - pointwise_log_densities(wrong, FREQUENCY), axis=0)
    assert worse[:4].mean() > worse[-4:].mean()
    assert worse[:4].mean() > 1


def test_they_are_in_the_file_with_their_meaning(fit: PopulationFit, tmp_path: Path) -> None:
    result = make_result(fit, predict(fit, n_draws=20, n_replicates=4), {})
    save_result(result, tmp_path)
    import arviz as az

    data = az.from_netcdf(tmp_path / "result.nc")
    variable = data["constant_data"][POINTWISE]
    assert variable.dims == ("subject", "frequency_hz")
    assert "posterior draws" in variable.attrs["description"]
    assert "density" in variable.attrs["units"]
    assert list(data["log_likelihood"].data_vars) == ["recordings"]  # so that loo and compare need no name
    groups, _, _ = load_groups(tmp_path / "result.nc")
    np.testing.assert_array_equal(groups["constant_data"][POINTWISE], result.groups["constant_data"][POINTWISE])
