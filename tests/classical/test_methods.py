"""The paper's methods side by side: one curve each, eq. 5 for all, and the population network among them."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.classical import MethodComparison, compare_methods
from bayes_impedance.classical.methods import FAMILIES
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.plots import style, write_comparison
from bayes_impedance.plots.comparison import BODE_METHODS, COMPARISON_PICTURES
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import Result, make_result

PAPER_COLUMNS = {
    "magnitude_mean": "amplitude, Mean",
    "magnitude_median": "amplitude, Median",
    "phase_mean": "phase, Mean",
    "phase_median": "phase, Median",
    "lookup_mean": "LuT Mean",
    "lookup_median": "LuT Median",
    "vector_fitting_mean": "VFMean",
    "vector_fitting_median": "VFMedian",
    "sit": "SIT",
}


@pytest.fixture(scope="module")
def result(small_fit: PopulationFit) -> Result:
    return make_result(small_fit, predict(small_fit), {})


@pytest.fixture(scope="module")
def comparison(small_fit: PopulationFit, result: Result) -> MethodComparison:
    return compare_methods(small_fit.recordings, result)


def test_has_every_column_of_the_paper_and_ours(comparison):
    named = {m.id: m.paper for m in comparison.methods if m.paper}
    assert named == PAPER_COLUMNS
    assert {m.id for m in comparison.methods} - set(named) == {
        "phase_scaled_mean",
        "phase_scaled_median",
        "complex_mean",
        "complex_median",
        "population_network",
        "posterior_predictive",
    }
    assert {m.family for m in comparison.methods} == set(FAMILIES)


def test_errors_are_eq_5_of_the_curves(comparison):
    for method in comparison.methods:
        by_hand = np.mean(np.sqrt((np.abs(method.curve) - np.abs(comparison.observed)) ** 2), axis=0)
        np.testing.assert_allclose(method.errors.magnitude, by_hand, rtol=1e-12)
        phase = np.mean(np.abs(np.angle(method.curve / comparison.observed, deg=True)), axis=0)
        np.testing.assert_allclose(method.errors.phase_deg, phase, rtol=1e-9, atol=1e-9)
        summary = method.errors.summary()
        assert summary["delta_magnitude"] == pytest.approx(by_hand.mean())
        assert summary["delta_magnitude_sd"] == pytest.approx(by_hand.std())


def test_elements_make_the_curve_of_their_method(comparison):
    kernel = Kernel(parse(comparison.network))
    with_elements = [m for m in comparison.methods if m.elements is not None]
    assert len(with_elements) == 9
    for method in with_elements:
        curve = kernel.impedance(np.log([method.elements[e] for e in kernel.elements]), comparison.frequency_hz)
        np.testing.assert_allclose(np.abs(curve), np.abs(method.curve), rtol=2e-3)


def test_rational_functions_make_theirs_and_are_judged(comparison):
    for id in ("sit", "vector_fitting_mean", "vector_fitting_median"):
        method = comparison.method(id)
        np.testing.assert_allclose(method.transfer(2j * np.pi * comparison.frequency_hz), method.curve, rtol=1e-6)
        assert method.passivity.positive_real == (not method.passivity.reasons)
        assert len(method.transfer.denominator) == 4  # as the network's: 3 poles
    assert comparison.method("sit").transfer.denominator[-1] == 0.0


def test_no_single_curve_beats_the_median_table_in_magnitude(comparison):
    best = comparison.method("lookup_median").errors.magnitude
    for method in comparison.methods:
        assert np.all(method.errors.magnitude >= best - 1e-12)


def test_phases_alone_have_large_magnitude_errors_that_the_scale_explains(comparison):
    size = {m.id: m.errors.summary()["delta_magnitude"] for m in comparison.methods}
    assert size["phase_median"] > 1.5 * size["phase_scaled_median"]
    phase = {m.id: m.errors.summary()["delta_phase_deg"] for m in comparison.methods}
    assert phase["phase_median"] == pytest.approx(phase["phase_scaled_median"], rel=0.05)


def test_the_population_network_is_no_worse_than_rational_functions(comparison):
    for part in ("delta_magnitude", "delta_phase_deg"):
        ours = comparison.method("population_network").errors.summary()
        for id in ("sit", "vector_fitting_mean", "vector_fitting_median"):
            theirs = comparison.method(id).errors.summary()
            assert ours[part] <= theirs[part] + theirs[f"{part}_sd"]


def test_the_table_is_plain_csv_and_the_summary_plain_json(comparison):
    rows = list(csv.DictReader(io.StringIO(comparison.csv())))
    assert [r["id"] for r in rows] == [m.id for m in comparison.methods]
    assert float(rows[0]["delta_magnitude"]) == comparison.methods[0].errors.summary()["delta_magnitude"]
    frame = comparison.to_dataframe()
    assert frame.shape == (len(comparison.methods), len(rows[0]) - 1)
    assert frame.attrs["units"]["delta_magnitude"] == "N s/m"
    assert frame.attrs["units"]["delta_phase_deg_sd"] == "deg"
    assert list(frame.index) == [r["id"] for r in rows]
    words = {True: "True", False: "False", None: ""}
    passive = [None if m.passivity is None else bool(m.passivity.positive_real) for m in comparison.methods]
    assert [r["positive_real"] for r in rows] == [words[p] for p in passive]
    assert frame.positive_real.isna().tolist() == [p is None for p in passive]
    summary = json.loads(json.dumps(comparison.summary(), allow_nan=False))
    assert summary["schema"] == 1
    assert summary["methods"][0]["in_the_paper"] == "amplitude, Mean"
    assert summary["normality"]["chi_square_magnitude"] is None  # 15 people fill too few bins
    assert 0 <= summary["normality"]["shapiro_magnitude"] <= 1
    assert summary["mapping_of_sit"]["distance"] == comparison.mapping.distance


def test_one_person_can_be_compared_too(small_fit, result):
    """The look-up table is then the recording itself, and nothing is said of normality."""
    name = small_fit.recordings.names[0]
    alone = replace(result, coords={**result.coords, "subject": [name]})
    comparison = compare_methods(small_fit.recordings.select([name]), alone)
    assert comparison.normality is None
    assert comparison.method("lookup_mean").errors.magnitude.max() < 1e-12
    assert comparison.method("magnitude_mean").elements == pytest.approx(comparison.method("magnitude_median").elements)


def test_refuses_a_fit_of_others(small_fit, result):
    with pytest.raises(InputError, match="other subjects"):
        compare_methods(small_fit.recordings.select(small_fit.recordings.names[:3]), result)


def test_pictures_are_written_and_the_same_again(comparison, tmp_path):
    first = write_comparison(comparison, tmp_path / "a")
    second = write_comparison(comparison, tmp_path / "b")
    assert set(first) == set(second) == set(COMPARISON_PICTURES) == {"comparison", "recordings", "bode"}
    for name, file in first.items():
        assert file.read_bytes() == second[name].read_bytes()
        assert file.with_suffix(".svg").read_bytes() == second[name].with_suffix(".svg").read_bytes()


def test_the_bode_picture_shows_the_papers_models_and_ours(comparison):
    with style():
        figure = COMPARISON_PICTURES["bode"](comparison)
    labels = {line.get_label() for line in figure.axes[0].get_lines()}
    assert {comparison.method(id).label for id in BODE_METHODS} <= labels
