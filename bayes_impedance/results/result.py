"""The files of a run: a summary (JSON) and a netCDF file that holds everything the report needs.

The netCDF file follows ArviZ: a chain is an ensemble, and the axes element, subject and frequency_hz have labels.
Elements that the recordings do not determine are NaN in the posterior and null in the summary, so that no number can be
mistaken for a result.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.network.parameters import Parameter, unit_of_parameter
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.population.covariate_terms import correlations_of
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.heavy_tails import NORMAL
from bayes_impedance.results.adequacy import Adequacy
from bayes_impedance.results.arviz_layout import LAYOUT, LAYOUT_ATTRIBUTE, file_dims, for_file, from_file
from bayes_impedance.results.checked_predictions import Checks, checked_predictions
from bayes_impedance.results.meanings import DIFFERENCE, MEMBER, SHARE, TAIL, meanings_of
from bayes_impedance.results.pointwise import POINTWISE, pointwise_log_densities
from bayes_impedance.results.predictive import PROBABILITIES, Predictive
from bayes_impedance.results.sampled_variables import sampled_variables, second_group_probability
from bayes_impedance.results.shown import one_line, result_html
from bayes_impedance.results.summary import summary_of
from bayes_impedance.runtime.atomic_files import write_json
from bayes_impedance.runtime.input_files import read_json
from bayes_impedance.units import INTERVAL

if TYPE_CHECKING:
    import pandas as pd

RESULT_FILE, SUMMARY_FILE, SECONDS_FILE = "result.nc", "summary.json", "seconds.json"
"""Times are in a separate file, so that the same seed and data give the same bytes in the others."""

DENSITY_ATTRIBUTE = "log_likelihood"
"""Attribute that says that ``log_likelihood`` is absolute. In results of earlier versions, where it is
missing, each subject's values lack a constant that differs between networks."""

_PACKAGES = ("bayes_impedance", "numpy", "scipy", "numba", "emcee", "arviz", "xarray", "pandas")


@dataclass(frozen=True)
class Result:
    """A finished run, as plain arrays with names.

    Attributes
    ----------
    summary : dict
        Contents of ``summary.json``.
    groups : dict of dict of ndarray
        The groups ``posterior``, ``posterior_predictive``, ``log_likelihood``, ``sample_stats``, ``prior``,
        ``prior_predictive``, ``observed_data``, ``constant_data`` and their variables. In the netCDF file some are
        laid out differently (:mod:`~bayes_impedance.results.arviz_layout`).
    coords : dict
        Labels of the axes element, element_2, subject, frequency_hz, predictive_frequency_hz, probability, part.
    attributes : dict
        Network, seed, versions, data digest, title, unit, source; ``distribution`` if it is not the normal.
    """

    summary: dict[str, Any]
    groups: dict[str, dict[str, np.ndarray]]
    coords: dict[str, Any]
    attributes: dict[str, Any]

    def __repr__(self) -> str:
        return one_line(self)

    def _repr_html_(self) -> str:
        return result_html(self)

    @property
    def elements(self) -> list[str]:
        """Names of the elements."""
        return [str(e) for e in self.coords["element"]]

    @property
    def noise_model(self) -> NoiseModel | None:
        """From which the noise of every recording follows; None if all recordings came with theirs."""
        sd = self.groups["constant_data"].get("noise_model_sd")
        if sd is None:
            return None
        relative, floor = bool(self.attributes["noise_is_relative"]), float(self.attributes["noise_floor"])
        return NoiseModel(np.asarray(self.coords["noise_frequency_hz"], dtype=float), sd, relative, floor)

    @property
    def problems(self) -> list[str]:
        """Reasons why the numbers must not be used; empty if they may be used."""
        return list(self.summary["problems"])

    def element_unit(self, element: str) -> str:
        """Unit of an element's value."""
        return unit_of_parameter(element, self.attributes["unit"])

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The network's parameters, in the order of :attr:`elements`."""
        own = {p.name: p for p in parse(self.attributes["network"]).parameters}
        return tuple(own[name] for name in self.elements)

    def elements_table(self) -> pd.DataFrame:
        """The population's elements: :func:`bayes_impedance.results.tables.elements_table`."""
        from bayes_impedance.results.tables import elements_table

        return elements_table(self)

    def to_dataframe(self) -> pd.DataFrame:
        """The population's elements: :meth:`elements_table`."""
        return self.elements_table()

    def persons_table(self, intervals: bool = False) -> pd.DataFrame:
        """Each person's elements and fit: :func:`bayes_impedance.results.tables.persons_table`."""
        from bayes_impedance.results.tables import persons_table

        return persons_table(self, intervals)


DIMS: dict[str, list[str]] = {
    "mu": ["element"],
    "central": ["element"],
    "dispersion_between_persons": ["element"],
    "dispersion_between_repetitions": ["element"],
    "correlation": ["element", "element_2"],
    "slope": ["element", "covariate"],
    DIFFERENCE: ["element"],
    MEMBER: ["subject"],
    TAIL: [],
    SHARE: [],
    "person_log_elements": ["subject", "element"],
    "recordings": ["subject"],
    "log_magnitude": ["subject", "predictive_frequency_hz"],
    "phase_deg": ["subject", "predictive_frequency_hz"],
    "observed_re": ["subject", "frequency_hz"],
    "observed_im": ["subject", "frequency_hz"],
    "band_centre": ["part", "probability", "frequency_hz"],
    "band_person": ["part", "probability", "frequency_hz"],
    "band_recording": ["part", "probability", "frequency_hz"],
    "network_curve": ["part", "frequency_hz"],
    "error_population_network": ["part", "frequency_hz"],
    "error_lookup_mean": ["part", "frequency_hz"],
    "error_lookup_median": ["part", "frequency_hz"],
    "replicated_error": ["part", "replicate_quantile", "frequency_hz"],
    "replicated_rank": ["part", "frequency_hz"],
    "coverage_50": ["part", "frequency_hz"],
    "coverage_90": ["part", "frequency_hz"],
    "noise_relative": ["subject", "frequency_hz"],
    POINTWISE: ["subject", "frequency_hz"],
    "covariate_correlation": ["covariate", "other_covariate"],
    "noise_model_sd": ["noise_frequency_hz"],
    "noise_scale": ["subject"],
    "person_relative_rms": ["subject"],
    "person_delta_magnitude": ["subject"],
    "person_delta_phase_deg": ["subject"],
    "person_curve_re": ["subject", "frequency_hz"],
    "person_curve_im": ["subject", "frequency_hz"],
    "before_band_recording": ["part", "replicate_quantile", "frequency_hz"],
    "before_error": ["part", "frequency_hz"],
    "before_coverage_90": ["part", "frequency_hz"],
    "before_person_curve_re": ["subject", "frequency_hz"],
    "before_person_curve_im": ["subject", "frequency_hz"],
    "pareto_k": ["subject"],
    "effective_draws": ["subject"],
    "repetitions": ["subject"],
    "identified": ["element"],
    "prior_centre": ["element"],
    "prior_centre_sd": ["element"],
    "prior_dispersion_sd": ["element"],
}
"""Axes of every variable besides chain and draw; ``part`` is magnitude, then phase in degrees."""


def make_result(
    fit: PopulationFit,
    predictive: Predictive,
    seconds: Mapping[str, float],
    selected: Sequence[str] = (),
    adequacy: Adequacy | None = None,
    findings: Sequence[str] = (),
    before: Mapping[str, Any] | None = None,
) -> Result:
    """Collect a fit and its predictions.

    Parameters
    ----------
    fit : PopulationFit
    predictive : Predictive
    seconds : mapping
        Time of each step in s; in a separate file, so that equal runs give equal bytes in the others.
    selected : sequence of str
        The subjects that were selected by name; empty if all were taken.
    adequacy : Adequacy, optional
        Misfits of the model (:func:`bayes_impedance.diagnosis.examine.examine`).
    findings : sequence of str
        Anomalies of the recordings, in sentences.
    before : mapping, optional
        Of the network to which something was added: notation and errors, as
        :meth:`bayes_impedance.results.model_before.ModelBefore.summary` returns them.
    """
    recordings, elements = fit.recordings, list(fit.kernel.elements)
    attributes = {
        "title": recordings.title,
        "unit": recordings.unit,
        "source": recordings.source or "",
        "licence": recordings.licence or "",
        "network": str(fit.kernel.network),
        "seed": fit.seed,
        "data_sha256": recordings.sha256,
        "covariance": fit.settings.covariance,
        "versions": json.dumps(_versions()),
        "reading_warnings": json.dumps(list(recordings.warnings)),
        "selected_subjects": json.dumps(list(selected)),
        DENSITY_ATTRIBUTE: "absolute",
        "prior": "" if fit.settings.prior is None else fit.settings.prior.text(),
        "prior_concentration": fit.prior.concentration,
        "prior_slope_sd": fit.prior.slope_sd,
    }
    if fit.settings.distribution != NORMAL:
        attributes["distribution"] = fit.settings.distribution
    if fit.settings.noise_distribution != NORMAL:
        attributes["noise_distribution"] = fit.settings.noise_distribution
    checks = checked_predictions(fit, predictive)
    coords = {
        "element": elements,
        "element_2": elements,
        "subject": list(recordings.names),
        "covariate": list(fit.settings.covariates),
        "other_covariate": list(fit.settings.covariates),
        "frequency_hz": predictive.frequency_hz,
        "predictive_frequency_hz": checks.frequency_hz,
        "probability": list(PROBABILITIES),
        "replicate_quantile": list(INTERVAL),
        "part": ["magnitude", "phase_deg"],
    }
    if not fit.settings.covariates:
        del coords["covariate"], coords["other_covariate"]
    if fit.noise_model is not None:
        coords["noise_frequency_hz"] = fit.noise_model.frequency_hz
        attributes |= {"noise_is_relative": int(fit.noise_model.relative), "noise_floor": fit.noise_model.floor}
    result = Result({}, _groups(fit, predictive, checks), coords, attributes)
    result.summary.update(summary_of(fit, predictive, seconds, adequacy or Adequacy(), findings, _versions()))
    if before is not None:
        result.summary["before"] = dict(before)
    attributes["summary"] = without_seconds(result.summary)
    return result


def _groups(fit: PopulationFit, predictive: Predictive, checks: Checks) -> dict[str, dict[str, np.ndarray]]:
    posterior = sampled_variables(fit, fit.parameters, fit.n_ensembles)
    seen = np.where(fit.identified, 1.0, np.nan).astype(fit.person_draws.dtype)
    # Of many people the draws are too large to copy for nothing.
    posterior["person_log_elements"] = fit.person_draws if np.all(fit.identified) else fit.person_draws * seen
    noise = [
        np.sqrt(np.mean(n**2, axis=0)) / np.abs(s.mean) for s, n in zip(fit.recordings.subjects, fit.noise, strict=True)
    ]
    grid = np.log(predictive.frequency_hz)
    d, r = fit.diagnostics, predictive.replication
    model = {}
    if (together := correlations_of(fit.recordings, fit.settings.covariates)) is not None:
        model["covariate_correlation"] = together
    if fit.noise_model is not None:
        model["noise_model_sd"] = fit.noise_model.sd
    if fit.parameters.groups is not None:
        model[MEMBER] = second_group_probability(fit)
    return {
        "posterior": posterior,
        "posterior_predictive": checks.posterior_predictive,
        "prior": sampled_variables(fit, checks.prior, 1),
        "prior_predictive": checks.prior_predictive,
        "log_likelihood": {"recordings": fit.person_log_likelihood},
        "sample_stats": {"lp": fit.log_probability},
        "observed_data": checks.observed,
        "constant_data": {
            "observed_re": predictive.observed.real,
            "observed_im": predictive.observed.imag,
            "band_centre": _both(predictive.centre.magnitude, predictive.centre.phase_deg),
            "band_person": _both(predictive.person.magnitude, predictive.person.phase_deg),
            "band_recording": _both(predictive.recording.magnitude, predictive.recording.phase_deg),
            "network_curve": _both(predictive.network_magnitude, predictive.network_phase_deg),
            **{f"error_{k}": _both(v.magnitude, v.phase_deg) for k, v in predictive.errors.items()},
            "replicated_error": _both(r.magnitude, r.phase_deg),
            "replicated_rank": _both(r.magnitude_rank, r.phase_rank),
            "coverage_50": predictive.coverage50,
            "coverage_90": predictive.coverage90,
            "noise_relative": np.array(
                [
                    np.interp(grid, np.log(s.frequency_hz), n)
                    for s, n in zip(fit.recordings.subjects, noise, strict=True)
                ]
            ),
            **model,
            POINTWISE: pointwise_log_densities(fit, predictive.frequency_hz),
            "noise_scale": fit.noise_scale,
            "person_relative_rms": predictive.person_relative_rms,
            "person_delta_magnitude": predictive.person_delta_magnitude,
            "person_delta_phase_deg": predictive.person_delta_phase_deg,
            "person_curve_re": predictive.person_curve.real,
            "person_curve_im": predictive.person_curve.imag,
            "pareto_k": d.pareto_k,
            "effective_draws": d.effective_draws,
            "repetitions": np.array([len(s.repetitions) for s in fit.recordings.subjects]),
            "identified": fit.identified.astype(np.int8),
            "prior_centre": fit.prior.centre,
            "prior_centre_sd": fit.prior.centre_sds.copy(),
            "prior_dispersion_sd": fit.prior.dispersion_sds.copy(),
        },
    }


def _both(magnitude: np.ndarray, phase: np.ndarray) -> np.ndarray:
    return np.stack([magnitude, phase])


def _versions() -> dict[str, str]:
    return {name: version(name) for name in _PACKAGES}


def save_result(result: Result, folder: str | os.PathLike[str]) -> None:
    """Write ``result.nc``, ``summary.json`` and ``seconds.json`` into a folder, each complete or not at all.

    Of many people ``persons.parquet`` too (:mod:`bayes_impedance.results.persons_file`).
    """
    from bayes_impedance.mcmc.arviz_file import save
    from bayes_impedance.results.persons_file import write_persons

    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    groups, coords = for_file(result.groups, result.coords)
    attributes = result.attributes | {"summary": without_seconds(result.summary), LAYOUT_ATTRIBUTE: LAYOUT}
    save(
        folder / RESULT_FILE,
        groups,
        file_dims(groups, DIMS),
        coords,
        attributes,
        meanings_of(result.attributes["unit"], result.summary["subjects"] == 1),
    )
    write_json(folder / SECONDS_FILE, result.summary.get("seconds", {}))
    write_json(folder / SUMMARY_FILE, {name: value for name, value in result.summary.items() if name != "seconds"})
    write_persons(result, folder)


def load_result(folder: str | os.PathLike[str]) -> Result:
    """Read a run back.

    Raises
    ------
    InputError
        If the folder holds no finished run, one of its files is damaged, or the two files are of different fits.
    """
    from bayes_impedance.mcmc.arviz_file import load_groups

    folder = Path(folder)
    file, summary_file = folder / RESULT_FILE, folder / SUMMARY_FILE
    for needed in (file, summary_file):
        if not needed.is_file():
            raise InputError(
                f"{needed}: there is no such file; give the folder that 'bayes-impedance run -o FOLDER' has written"
            )
    summary = read_json(summary_file, "fit the recordings again, or take a copy")
    groups, coords, attributes = load_groups(file)
    if attributes.pop(LAYOUT_ATTRIBUTE, 1) == LAYOUT:
        groups, coords = from_file(groups, coords)
    if without_seconds(summary) != attributes.get("summary"):
        fits = (
            "are of different fits"
            if _is_of_other_fit(summary, attributes)
            else "do not agree, so one of them was changed"
        )
        raise InputError(f"{folder}: {RESULT_FILE} and {SUMMARY_FILE} {fits}; fit the recordings again, or take a copy")
    times = folder / SECONDS_FILE
    seconds = read_json(times, "delete it, or fit the recordings again") if times.is_file() else {}
    return Result(summary | {"seconds": seconds}, groups, coords, attributes)


def _is_of_other_fit(summary: Mapping[str, Any], attributes: Mapping[str, Any]) -> bool:
    return any(summary.get(name) != attributes.get(name) for name in ("data_sha256", "network", "seed"))


def without_seconds(summary: Mapping[str, Any]) -> str:
    """A summary without run times, as text that is identical for identical fits."""
    return json.dumps({k: v for k, v in summary.items() if k != "seconds"})
