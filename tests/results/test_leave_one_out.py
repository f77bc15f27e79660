"""Leave-one-out over people: the numbers are ArviZ's, and those of fits that have not seen the person."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SHORT
from densities_by_grid import log_density, mass_and_damper, recordings_of

from bayes_impedance.errors import InputError
from bayes_impedance.population.fit import PopulationFit, fit_population
from bayes_impedance.population.held_out_person import held_out_log_densities
from bayes_impedance.population.simulate import Simulation
from bayes_impedance.results.leave_one_out import LeftOut, leave_one_out, refit_without, with_noise
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import load_result, make_result, save_result


@pytest.fixture(scope="module")
def folders(
    small_fit: PopulationFit, small_simulation: Simulation, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """Results of the network that the people have, and of one that lacks their skin."""
    place = tmp_path_factory.mktemp("results")
    poor = fit_population(small_simulation.recordings, "m2|r1|n1", settings=SHORT, seed=3)
    for name, fit in (("whole", small_fit), ("poor", poor)):
        save_result(make_result(fit, predict(fit), {}), place / name)
    return {name: place / name for name in ("whole", "poor")}


def arviz_module() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ArviZ announces its own future at import
        import arviz
    return arviz


@pytest.mark.filterwarnings("ignore")
def test_arviz_gives_the_same_numbers_for_the_files(folders: dict[str, Path]) -> None:
    arviz = arviz_module()
    if not hasattr(arviz, "InferenceData"):
        pytest.skip("ArviZ 1 names its columns differently")
    opened = {name: arviz.from_netcdf(folder / "result.nc") for name, folder in folders.items()}
    ours = {name: leave_one_out(load_result(folder)) for name, folder in folders.items()}
    for name, data in opened.items():
        assert data["log_likelihood"]["recordings"].dims == ("chain", "draw", "subject")
        found = arviz.loo(data, pointwise=True)
        assert tuple(found.loo_i["subject"].values) == ours[name].subjects
        np.testing.assert_allclose(found.loo_i.values, ours[name].elpd, rtol=1e-12)
        np.testing.assert_allclose(found.pareto_k.values, ours[name].pareto_k, rtol=1e-9)
        np.testing.assert_allclose((found.elpd_loo, found.se), ours[name].total, rtol=1e-12)
        assert found.p_loo == pytest.approx(ours[name].p_loo, rel=1e-9)
    table = arviz.compare(opened, ic="loo")
    assert list(table.index) == ["whole", "poor"]
    difference, error = ours["whole"].less(ours["poor"])
    assert (table.elpd_diff["poor"], table.dse["poor"]) == pytest.approx((difference, error), rel=1e-9)
    assert difference > 3 * error > 0


def test_the_variable_says_what_it_is(folders: dict[str, Path]) -> None:
    import h5py

    with h5py.File(folders["whole"] / "result.nc") as data:
        attributes = data["log_likelihood/recordings"].attrs
        assert "natural logarithm" in attributes["description"]
        assert "N s/m" in attributes["units"]


@pytest.mark.filterwarnings("ignore")
def test_elements_without_number_change_nothing_and_are_not_complained_of(
    folders: dict[str, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The posterior has NaN for elements that are not determined: ArviZ knows no efficiency then."""
    result = load_result(folders["whole"])
    posterior = result.groups["posterior"]
    blind = {**posterior, "mu": posterior["mu"] * np.array([np.nan, 1, 1, 1, 1])}
    result = replace(result, groups={**result.groups, "posterior": blind})
    save_result(result, tmp_path)
    found = leave_one_out(load_result(tmp_path))
    assert capfd.readouterr() == ("", "")
    arviz = arviz_module()
    if hasattr(arviz, "InferenceData"):
        expected = arviz.loo(arviz.from_netcdf(tmp_path / "result.nc"), pointwise=True)
        np.testing.assert_allclose(expected.loo_i.values, found.elpd, rtol=1e-12)
    whole = leave_one_out(load_result(folders["whole"]))
    sure = ~whole.doubtful  # of the others, the density depends on the tail that is smoothed, and so on the efficiency
    assert sure.mean() > 0.6
    np.testing.assert_allclose(found.elpd[sure], whole.elpd[sure], atol=0.2)


def test_results_of_earlier_versions_are_refused(folders: dict[str, Path]) -> None:
    result = load_result(folders["whole"])
    before = {name: value for name, value in result.attributes.items() if name != "log_likelihood"}
    with pytest.raises(InputError, match="earlier version"):
        leave_one_out(replace(result, attributes=before))


@pytest.mark.long
def test_a_fit_without_a_person_gives_what_the_weights_promise() -> None:
    mu = np.array([-5.0, 0.7])
    recordings = recordings_of(mass_and_damper, "m1|r1", mu, [2] * 7 + [1] * 7, 12, seed=8)
    settings = replace(SHORT, draws=512)
    fit = fit_population(recordings, settings=settings, seed=1)
    result = make_result(fit, predict(fit), {})
    left_out = leave_one_out(result)
    for i, subject in enumerate(with_noise(recordings, result).subjects):
        np.testing.assert_allclose(subject.noise_sd, fit.noise[i] / fit.noise_scale[i], rtol=1e-9)
    assert left_out.pareto_k[[2, 9]].max() < 0.5
    np.testing.assert_array_equal(left_out.doubtful, left_out.pareto_k > 0.7)
    exact = refit_without(recordings, [2, 9], left_out, result, settings, 1, lambda *_: None)
    assert list(np.flatnonzero(exact.refitted)) == [2, 9]
    changed = exact.elpd - left_out.elpd
    assert np.all(changed[~exact.refitted] == 0)
    assert np.all(np.abs(changed[[2, 9]]) < 0.15)  # Monte-Carlo error of 640 draws
    assert np.all(changed[[2, 9]] != 0)


@pytest.mark.parametrize("distribution", ["normal", "mixture"])
def test_fewer_people_than_the_model_takes_are_no_refit(distribution: str) -> None:
    """Four people are the fewest for correlations of two elements, and for two groups; three would be another model."""
    recordings = recordings_of(mass_and_damper, "m1|r1", np.array([-5.0, 0.7]), [2] * 4, 12, seed=8)
    settings = replace(SHORT, covariance="full", distribution=distribution)
    fit = fit_population(recordings, settings=settings, seed=1)
    assert fit.settings.covariance == "full"
    result = make_result(fit, predict(fit), {})
    left_out = leave_one_out(result)
    kept = refit_without(recordings, [2], left_out, result, settings, 1, lambda *_: None)
    assert not kept.refitted.any()
    np.testing.assert_array_equal(kept.elpd, left_out.elpd)


def test_the_density_of_somebody_unseen_equals_a_brute_force_integral() -> None:
    mu = np.array([-5.0, 0.7])
    recordings = recordings_of(mass_and_damper, "m1|r1", mu, [2] * 12 + [1] * 4, 30, seed=6)
    fit = fit_population(recordings.select(recordings.names[1:]), settings=SHORT, seed=1)
    person = recordings.subjects[0]
    sigma = 0.06 * np.tile(np.abs(person.z).mean(axis=0), (2, 1))
    person = replace(person, noise_sd=sigma)
    found = held_out_log_densities(fit, person, np.random.SeedSequence(3))
    order = [fit.kernel.elements.index(e) for e in ("m1", "r1")]
    p = fit.parameters
    smallest = np.minimum(p.between_persons, p.between_repetitions).min(axis=1)
    for row in np.flatnonzero(smallest > 0.03)[::60][:3]:
        covariance = p.covariance[row][np.ix_(order, order)]
        centre, rho = p.mu[row, order], p.between_repetitions[row, order]
        expected = log_density(mass_and_damper, person.frequency_hz, person.z, sigma, centre, covariance, rho, 49)
        assert found[row] == pytest.approx(expected, abs=0.05)


def test_differences_are_of_pairs() -> None:
    names = ("a", "b", "c", "d")
    nobody = np.zeros(4, dtype=bool)
    hard = np.array([0.0, -100.0, -300.0, -5.0])
    one = LeftOut(names, hard, np.array([0.1, 0.9, np.inf, 0.2]), nobody, 1.0)
    other = LeftOut(names, hard - np.array([1.0, 2.0, 3.0, 2.0]), np.zeros(4), nobody, 1.0)
    assert one.less(other) == pytest.approx((8.0, np.sqrt(4 * 0.5)))
    assert list(one.doubtful) == [False, True, True, False]
    with pytest.raises(ValueError, match="same people"):
        one.less(replace(other, subjects=names[::-1]))
