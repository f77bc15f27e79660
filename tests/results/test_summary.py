"""The contents of ``summary.json`` for a fit made of plain arrays: which numbers are given or null, and the remarks."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from datasets import recordings as recordings_of
from datasets import subject

from bayes_impedance.population.diagnostics import Diagnostics
from bayes_impedance.population.draw_error import DrawError
from bayes_impedance.population.fit import FitSettings, PopulationFit
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.results.adequacy import Adequacy
from bayes_impedance.results.curve_errors import ErrorCurves
from bayes_impedance.results.predictive import Band, Predictive, Replication
from bayes_impedance.results.summary import FEW_PERSONS, summary_of

DRAWS = 101
GRID = np.linspace(0, 1, DRAWS)
"""Its quantiles of 5, 50 and 95 % are 0.05, 0.5 and 0.95 exactly."""
INTERVAL = {"median": 0.5, "q05": 0.05, "q95": 0.95}
NOTHING = {"median": None, "q05": None, "q95": None}


def fit_of(network: str, subjects: int = 12, repetitions: int = 2, **changes: Any) -> PopulationFit:
    """Every dispersion and every log element is :data:`GRID`, in all elements."""
    data = replace(recordings_of(*(subject(f"S{i}", repetitions) for i in range(subjects))), network=network)
    model = checked_model(data, None)
    p = len(model.kernel.elements)
    grid = np.repeat(GRID[:, None], p, axis=1)
    correlation = np.tile(np.eye(p), (DRAWS, 1, 1))
    if p > 1:
        correlation[:, 1, 0], correlation[:, 1, 1] = GRID, np.sqrt(1 - GRID**2)
    parameters = PopulationParameters(
        mu=grid,
        between_persons=grid,
        correlation_cholesky=correlation,
        between_repetitions=grid,
        slopes=np.zeros((DRAWS, p, 0)),
    )
    diagnostics = Diagnostics(
        rhat_max=1.001,
        effective_min=5000.0,
        autocorrelation_max=20.0,
        acceptance=0.3,
        ensembles=2,
        steps=500,
        walkers=24,
        log_likelihood_variance=0.01,
        pareto_k=np.linspace(0.1, 0.3, subjects),
        effective_draws=np.linspace(100, 200, subjects),
        effective_draws_rarely=90.0,
        unconverged=(),
        redrawn=1,
        missed=0.0,
        rivals=(),
        draw_error=DrawError(interval_end=0.01, least_effective=100.0),
    )
    fit = PopulationFit(
        recordings=data,
        kernel=model.kernel,
        written=model.written,
        combinations=model.combinations,
        prior=Prior(centre=np.zeros(p)),
        settings=FitSettings(),
        seed=7,
        parameters=parameters,
        n_ensembles=1,
        log_probability=np.zeros((1, DRAWS)),
        person_draws=np.zeros((1, DRAWS, subjects, p)),
        person_log_likelihood=np.zeros((1, DRAWS, subjects)),
        deviations=(),
        noise=(),
        noise_model=None,
        noise_scale=np.ones(subjects),
        identified=np.ones(p, dtype=bool),
        diagnostics=diagnostics,
        seconds={},
    )
    return replace(fit, **changes)


def predictive_of(fit: PopulationFit) -> Predictive:
    n, f = len(fit.recordings.subjects), 5
    band = Band(np.ones((5, f)), np.zeros((5, f)))
    curves = ErrorCurves(np.array([1.0, 3.0, 1.0, 3.0, np.nan]), np.full(f, 4.0))
    return Predictive(
        frequency_hz=np.arange(1.0, f + 1),
        observed=np.ones((n, f), dtype=complex),
        centre=band,
        person=band,
        recording=band,
        network_magnitude=np.ones(f),
        network_phase_deg=np.zeros(f),
        errors=dict.fromkeys(("population_network", "lookup_mean", "lookup_median"), curves),
        replication=Replication(
            magnitude=np.ones((3, f)),
            phase_deg=np.ones((3, f)),
            magnitude_rank=np.ones(f),
            phase_rank=np.ones(f),
            mean_magnitude_rank=0.4,
            mean_phase_rank=0.6,
            replicates=20,
        ),
        coverage50=np.array([[0.4] * f, [0.6] * f]),
        coverage90=np.array([[0.8] * f, [1.0] * f]),
        person_relative_rms=np.linspace(0.01, 0.03, n),
        person_delta_magnitude=np.full(n, 0.2),
        person_delta_phase_deg=np.full(n, 0.5),
        person_curve=np.ones((n, f), dtype=complex),
    )


def told(fit: PopulationFit, adequacy: Adequacy | None = None) -> dict[str, Any]:
    return summary_of(fit, predictive_of(fit), {"modes": 1.23456}, adequacy or Adequacy(), ["odd"], {"numpy": "2"})


def test_central_values_are_in_units_and_dispersions_in_logarithms() -> None:
    element = told(fit_of("m1|r1"))["elements"]["m1"]
    assert (element["unit"], element["kind"], element["pooling"], element["scale"]) == ("kg", "mass", "varying", "log")
    assert element["central"] == pytest.approx({key: np.exp(value) for key, value in INTERVAL.items()})
    assert element["dispersion_between_persons"] == pytest.approx(INTERVAL)
    assert element["dispersion_between_repetitions"] == pytest.approx(INTERVAL)


def test_an_element_that_is_not_determined_has_no_number_and_no_correlation() -> None:
    summary = told(fit_of("m1|r1|n1", identified=np.array([True, True, False])))
    levels = ("central", "dispersion_between_persons", "dispersion_between_repetitions")
    assert [summary["elements"]["n1"][key] for key in levels] == [NOTHING] * 3
    assert summary["elements"]["n1"]["identified"] is False
    assert [row[:2] for row in summary["correlation"]] == [["m1", "r1"]]
    assert summary["correlation"][0][2:] == pytest.approx([0.5, 0.05, 0.95])
    assert summary["reliable"] is True
    assert any("do not determine n1:" in remark for remark in summary["remarks"])


@pytest.mark.parametrize("by", ["the sampler", "a gross misfit"])
def test_no_number_is_given_where_none_may_be_used(by: str) -> None:
    fit, adequacy = fit_of("m1|r1"), Adequacy()
    if by == "the sampler":
        fit = replace(fit, diagnostics=replace(fit.diagnostics, rhat_max=1.3))
    else:
        adequacy = Adequacy(gross=("nothing is described",))
    summary = told(fit, adequacy)
    assert summary["reliable"] is False
    assert len(summary["problems"]) == 1
    assert ("R-hat 1.300" if by == "the sampler" else "nothing is described") in summary["problems"][0]
    for element in summary["elements"].values():
        assert element["identified"] is True
        assert element["central"] == element["dispersion_between_persons"] == NOTHING
    assert summary["correlation"] == []


def test_what_is_wrong_with_the_network_is_said_before_the_remarks() -> None:
    fit = replace(fit_of("m1|r1", subjects=4, repetitions=1), noise_scale=np.array([4.0, 4.0, 1.0, 1.0]))
    misfit = Adequacy(misfit=("a delay is missing",), bent={"m1": 0.5})
    summary = told(fit, misfit)
    starts = [
        "a delay is missing",
        "The network does not describe these recordings: the residuals are 4.0 times the noise (median of the 2 of 4",
        "There are only 4 subjects",
        "There is one repetition per subject: the dispersion between people includes that between repetitions",
    ]
    assert len(summary["remarks"]) == len(starts)
    for remark, start in zip(summary["remarks"], starts, strict=True):
        assert remark.startswith(start)
    assert "deviates by 2.0 % (median)" in summary["remarks"][1]
    assert summary["elements"]["m1"]["marked"] is True
    assert summary["elements"]["r1"]["marked"] is False
    assert summary["elements"]["m1"]["dispersion_between_repetitions"] == NOTHING
    gross = told(fit, Adequacy(gross=("nothing is described",)))
    assert not any("does not describe" in remark for remark in gross["remarks"])  # it is a problem already


@pytest.mark.parametrize(("subjects", "few"), [(FEW_PERSONS - 1, True), (FEW_PERSONS, False)])
def test_dispersions_of_few_people_are_remarked_on(subjects: int, few: bool) -> None:
    remarks = told(fit_of("m1|r1", subjects))["remarks"]
    assert any("dispersions rest on the prior" in remark for remark in remarks) == few


@pytest.mark.parametrize(("subjects", "few"), [(3, True), (4, False)])
def test_correlations_need_two_people_more_than_elements(subjects: int, few: bool) -> None:
    fit = fit_of("m1|r1", subjects)
    if few:
        fit = replace(fit, settings=FitSettings(covariance="diagonal"))
    summary = told(fit)
    assert any(f"{subjects} subjects are too few to estimate" in remark for remark in summary["remarks"]) == few
    assert (summary["correlation"] == []) == few


def test_one_person_has_values_but_no_dispersion() -> None:
    summary = told(fit_of("m1|r1", subjects=1, repetitions=1))
    assert summary["subjects"] == 1
    for element in summary["elements"].values():
        assert element["central"]["median"] == pytest.approx(np.exp(0.5))
        assert element["dispersion_between_persons"] == element["dispersion_between_repetitions"] == NOTHING
    assert summary["correlation"] == []
    assert [remark.split(":")[0] for remark in summary["remarks"]] == [
        "There is one subject",
        "There is one repetition per subject",
    ]
    assert "dispersion between people" not in summary["remarks"][1]


def test_a_parameter_that_is_the_same_for_all_has_no_dispersion_and_no_correlation() -> None:
    summary = told(fit_of("m1*|r1"))
    assert summary["elements"]["m1"]["pooling"] == "shared"
    assert summary["elements"]["m1"]["central"]["median"] is not None
    assert summary["elements"]["m1"]["dispersion_between_persons"] == NOTHING
    assert summary["elements"]["r1"]["dispersion_between_persons"] != NOTHING
    assert summary["correlation"] == []


def test_combined_elements_are_listed_with_what_replaces_them() -> None:
    fit = fit_of("m1|m2|r1")
    (combination,) = fit.combinations
    summary = told(fit)
    assert summary["network_as_written"] == "m1|m2|r1"
    assert summary["network"] == str(fit.kernel.network) != summary["network_as_written"]
    assert summary["combinations"] == [
        {"name": combination.name, "elements": ["m1", "m2"], "expression": combination.expression}
    ]
    for name in ("m1", "m2"):
        if name != combination.name:
            element = summary["elements"][name]
            assert (element["unit"], element["identified"]) == ("kg", False)
            assert (element["combined_in"], element["central"]) == (combination.name, NOTHING)
    assert any("m1 or m2 alone" in remark for remark in summary["remarks"])


def test_what_no_recording_can_determine_is_not_said_twice() -> None:
    """A mass and a compliance on either side of dampers: more elements than coefficients."""
    network = "(r1-(r2|m1))|(r3-(r4|m2))"
    fit = fit_of(network)
    fit = replace(fit, identified=np.zeros(len(fit.kernel.elements), dtype=bool))
    remarks = [remark for remark in told(fit)["remarks"] if "determine" in remark]
    (impossible,) = remarks
    assert impossible.startswith("No recording can determine r1, r2, m1, r3, r4 and m2,")


def test_errors_and_coverage_are_means_over_frequency_and_people() -> None:
    fit = fit_of("m1|r1")
    summary = told(replace(fit, noise_scale=np.array([2.0, *[1.0] * 11])))
    errors = summary["errors"]
    assert errors["population_network"]["delta_magnitude"] == 2.0
    assert errors["population_network"]["delta_magnitude_sd"] == 1.0
    assert errors["population_network"]["replicated_rank_magnitude"] == 0.4
    assert errors["population_network"]["replicated_rank_phase"] == 0.6
    assert "replicated_rank_phase" not in errors["lookup_mean"]
    assert errors["subjects"] == pytest.approx(
        {"relative_rms_median": 0.02, "relative_rms_max": 0.03, "delta_magnitude": 0.2, "delta_phase_deg": 0.5}
    )
    assert summary["coverage"] == pytest.approx({"50": 0.5, "90": 0.9})
    assert summary["coverage_by_frequency"] == {"50": [0.4, 0.6], "90": [0.8, 1.0]}
    assert summary["noise_scale"] == {"median": 1.0, "max": 2.0, "affected": 1, "affected_median": 2.0}
    assert summary["sampler"]["pareto_k_max"] == pytest.approx(0.3)
    assert summary["sampler"]["effective_draws_min"] == pytest.approx(100.0)
    assert (summary["seed"], summary["seconds"], summary["findings"]) == (7, {"modes": 1.235}, ["odd"])


def test_what_is_not_finite_in_the_diagnostics_is_null_and_can_be_written() -> None:
    fit = fit_of("m1|r1")
    hopeless = replace(fit.diagnostics, pareto_k=np.array([0.3, np.inf]), log_likelihood_variance=float("nan"))
    summary = told(replace(fit, diagnostics=hopeless))
    assert summary["sampler"]["pareto_k_max"] is None
    assert summary["sampler"]["log_likelihood_variance"] is None
    json.dumps(summary, allow_nan=False)
