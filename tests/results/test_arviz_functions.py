"""ArviZ's functions work on the file of a result without adapter code, with what each of its versions calls them."""

from __future__ import annotations

import warnings
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS

from bayes_impedance.datasets import fingertip_folder
from bayes_impedance.population.fit import PopulationFit, fit_population
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.results.leave_one_out import leave_one_out
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import load_result, make_result, save_result

MODERN = int(version("arviz").split(".")[0]) >= 1
pytestmark = [
    pytest.mark.smoke,
    pytest.mark.filterwarnings("ignore"),  # of ArviZ about its own dependencies, and about large Pareto k
]
FEW = ["mu", "dispersion_between_persons"]
"""ArviZ 1 refuses more than 40 panels and has to be told which variables; 0.23 shows as many as fit."""


@pytest.fixture(scope="module")
def fit() -> PopulationFit:
    recordings = simulate_recordings(THREE_ELEMENTS, 9, 2, np.geomspace(5, 5000, 14), seed=2).recordings
    return fit_population(recordings, settings=SHORT, seed=1)


@pytest.fixture(scope="module")
def folders(fit: PopulationFit, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Results of the network that the people have, and of one that lacks their mass."""
    place = tmp_path_factory.mktemp("for_arviz")
    poor = fit_population(fit.recordings, "r1|n1", settings=SHORT, seed=1)
    for name, one in (("whole", fit), ("poor", poor)):
        save_result(make_result(one, predict(one, n_draws=50, n_replicates=20), {}), place / name)
    return {name: place / name for name in ("whole", "poor")}


@pytest.fixture(scope="module")
def az() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import arviz
    return arviz


@pytest.fixture(scope="module")
def data(az: Any, folders: dict[str, Path]) -> Any:
    return az.from_netcdf(folders["whole"] / "result.nc")


@pytest.fixture(autouse=True)
def _closed() -> Any:
    yield
    from matplotlib import pyplot as plt

    plt.close("all")


def drawn(plot: Any) -> int:
    """Panels of what a plot has returned that show something."""
    if hasattr(plot, "viz"):
        figure = plot.viz.ds["figure"].item()
        axes = figure.axes
    else:
        axes = list(np.ravel(np.asarray(plot, dtype=object)))
    return sum(bool(a.lines or a.collections or a.patches or a.containers) for a in axes if a is not None)


@pytest.mark.parametrize("group", ["posterior", "prior"])
def test_plot_ppc(az: Any, data: Any, group: str) -> None:
    if MODERN:
        assert drawn(az.plot_ppc_dist(data, group=f"{group}_predictive", num_samples=20)) == 3
    else:
        assert drawn(az.plot_ppc(data, group=group, num_pp_samples=20)) == 3


def test_plot_bpv(az: Any, data: Any) -> None:
    assert drawn(az.plot_ppc_pit(data, var_names="recordings") if MODERN else az.plot_bpv(data)) >= 1


def test_plot_loo_pit(az: Any, data: Any) -> None:
    plot = az.plot_loo_pit(data, var_names="recordings") if MODERN else az.plot_loo_pit(data, y="recordings")
    assert drawn(plot) == 1


def test_plot_trace(az: Any, data: Any) -> None:
    assert drawn(az.plot_trace(data, **({"var_names": FEW} if MODERN else {}))) >= 6


@pytest.mark.skipif(MODERN, reason="ArviZ 1 draws a panel for each number")
def test_plot_trace_of_many_parameters_hides_nothing(az: Any) -> None:
    """52 numbers of the shipped population, more than ArviZ has panels for: a row for each variable, with all in it."""
    data = az.from_netcdf(fingertip_folder() / "population" / "result.nc")
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        panels = az.plot_trace(data)
    assert not [one for one in said if issubclass(one.category, UserWarning)]
    assert panels.shape == (len(data.posterior.data_vars), 2)
    curves = [len(row[0].lines) for row in panels]
    assert curves == [own.size // (own.sizes["draw"]) for own in data.posterior.data_vars.values()]


def test_plot_pair(az: Any, data: Any) -> None:
    assert drawn(az.plot_pair(data, **({"var_names": ["mu"]} if MODERN else {}))) >= 3


def test_plot_forest(az: Any, data: Any) -> None:
    assert drawn(az.plot_forest(data)) >= 1


def test_summary_is_finite_and_names_each_number(az: Any, data: Any, folders: dict[str, Path]) -> None:
    table = az.summary(data)
    posterior = load_result(folders["whole"]).groups["posterior"]
    assert np.isfinite(table["mean"].astype(float)).all()
    assert np.isfinite(table["r_hat"].astype(float)).all()
    assert not [name for name in table.index if name.startswith("correlation") and "m1, m1" in name]
    own = posterior["person_log_elements"].mean(axis=(0, 1))
    for i, subject in enumerate(load_result(folders["whole"]).coords["subject"]):
        for k, element in enumerate(("m1", "r1", "n1")):
            said = float(table["mean"][f"person_log_elements[{element}, {subject}]"])
            assert said == pytest.approx(own[i, k], abs=0.01)


def test_loo_and_compare_say_the_same_as_the_package(az: Any, folders: dict[str, Path]) -> None:
    opened = {name: az.from_netcdf(folder / "result.nc") for name, folder in folders.items()}
    ours = {name: leave_one_out(load_result(folder)) for name, folder in folders.items()}
    for name, one in opened.items():
        found = az.loo(one)
        elpd = found.elpd if MODERN else found.elpd_loo
        assert float(elpd) == pytest.approx(ours[name].total[0], rel=1e-9)
    table = az.compare(opened)
    assert list(table.index) == ["whole", "poor"]
    difference, error = ours["whole"].less(ours["poor"])
    if not MODERN:  # 1.x rounds its table
        assert float(table["elpd_diff"]["poor"]) == pytest.approx(difference, rel=1e-6)
    assert difference > 3 * error


def test_names_axes_units_and_meanings(data: Any) -> None:
    observed = data["observed_data"]
    for group in ("posterior_predictive", "prior_predictive"):
        for name in observed.data_vars:
            assert data[group][name].dims == ("chain", "draw", *observed[name].dims)
            assert {"long_name", "units", "description"} <= set(observed[name].attrs)
    assert data["log_likelihood"]["recordings"].dims == ("chain", "draw", "subject")
    assert "absolute" in data["log_likelihood"]["recordings"].attrs["description"]
    assert "mean" in observed["recordings"].attrs["description"]
    for name in data["prior"].data_vars:
        assert data["prior"][name].dims == data["posterior"][name].dims


def test_predictions_are_those_of_new_people(data: Any) -> None:
    """Of nine people who were simulated from the model, nearly all lie between the predicted 1 % and 99 %."""
    predicted = np.asarray(data["posterior_predictive"]["log_magnitude"])
    flat = predicted.reshape(-1, *predicted.shape[2:])
    seen = np.asarray(data["observed_data"]["log_magnitude"])
    low, high = np.quantile(flat, [0.01, 0.99], axis=0)
    assert np.mean((seen > low) & (seen < high)) > 0.9
    # Not far too wide: people differ by 0.2 to 0.3 in log elements, and the centre is uncertain by a third of that.
    assert 0.1 < np.median(flat.std(axis=0)) < 0.5
    level = np.asarray(data["posterior_predictive"]["recordings"])
    np.testing.assert_allclose(level, predicted.mean(axis=-1), atol=0.002)
    wide = np.asarray(data["prior_predictive"]["log_magnitude"])
    assert np.nanstd(wide) > 3 * flat.std()


def test_large_populations_keep_fewer_frequencies_and_are_drawn_in_parts(
    fit: PopulationFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayes_impedance.results import checked_predictions as checked

    sets = len(fit.parameters.mu)
    monkeypatch.setattr(checked, "MOST_NUMBERS", 3 * sets * 9)
    monkeypatch.setattr(checked, "_AT_ONCE", 9 * 3 * 100)
    found = checked.checked_predictions(fit, predict(fit, n_draws=20, n_replicates=4))
    assert found.frequency_hz.size == 3
    assert found.posterior_predictive["log_magnitude"].shape == (2, sets // 2, 9, 3)
    assert np.all(np.isfinite(found.posterior_predictive["recordings"]))
    first, last = found.posterior_predictive["log_magnitude"].reshape(sets, -1)[[0, -1]]
    assert not np.any(first == last)
