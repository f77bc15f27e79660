"""The summary of a run: the contents of ``summary.json``, problems first.

Numbers that must not be used are null: those of elements that the recordings do not determine, and all of them where
the sampler has not converged or the network does not describe the recordings at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bayes_impedance.network.parameters import unit_of_parameter
from bayes_impedance.population.calibrated import inseparable_given
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.requirements import too_few_for_correlations
from bayes_impedance.results.adequacy import Adequacy
from bayes_impedance.results.distribution import (
    distribution_remark,
    distribution_summary,
    interval,
    noise_remark,
    noise_summary,
)
from bayes_impedance.results.misfit import coverage_by_frequency, misfit_words, network_misfits, noise_scale_summary
from bayes_impedance.results.predictive import Predictive
from bayes_impedance.runtime.atomic_files import finite_or_none
from bayes_impedance.units import INTERVAL, who

SCHEMA = 1
"""Version of the layout of ``summary.json``."""

FEW_PERSONS = 10
"""With fewer persons, dispersions depend on the prior as much as on the data: the standard deviation of nine values has
a relative standard error of a quarter at best."""


def _not_separable(unit: str, stands_for_it: str) -> dict[str, Any]:
    """Entry of an element that was combined with others into one element."""
    nothing = interval(np.array([np.nan]))
    levels = ("central", "dispersion_between_persons", "dispersion_between_repetitions")
    return {"unit": unit, "identified": False, "marked": False, "combined_in": stands_for_it} | dict.fromkeys(
        levels, nothing
    )


def summary_of(
    fit: PopulationFit,
    predictive: Predictive,
    seconds: Mapping[str, float],
    adequacy: Adequacy,
    findings: Sequence[str],
    versions: Mapping[str, str],
) -> dict[str, Any]:
    """Contents of ``summary.json``.

    Parameters
    ----------
    fit : PopulationFit
    predictive : Predictive
    seconds : mapping
        Time of each step.
    adequacy : Adequacy
        Misfits of the model.
    findings : sequence of str
        Anomalies of the recordings.
    versions : mapping of str to str
        Of packages.
    """
    p, d = fit.parameters, fit.diagnostics
    problems = [*adequacy.gross, *d.problems]
    elements: dict[str, dict[str, Any]] = {}
    for i, (name, parameter) in enumerate(zip(fit.kernel.elements, fit.kernel.parameters, strict=True)):
        known = bool(fit.identified[i]) and not problems
        varies = known and not fit.one_person and not parameter.shared
        elements[name] = {
            "unit": unit_of_parameter(name, fit.recordings.unit),
            "kind": parameter.quantity.name,
            "pooling": "shared" if parameter.shared else "varying",
            "scale": parameter.link,
            "identified": bool(fit.identified[i]),
            "marked": name in adequacy.bent,
            "central": interval(parameter.value(p.mu[:, i]), known),
            "dispersion_between_persons": interval(p.between_persons[:, i], varies),
            "dispersion_between_repetitions": interval(p.between_repetitions[:, i], varies and fit.repeated),
        }
        if fit.settings.covariates:
            elements[name]["slopes"] = {
                covariate: interval(p.slopes[:, i, q], known and not parameter.shared)
                for q, covariate in enumerate(fit.settings.covariates)
            }
    for combination in fit.combinations:
        for name in combination.elements:
            elements[name] = _not_separable(unit_of_parameter(name, fit.recordings.unit), combination.name)
    correlation = []
    shared = [parameter.shared for parameter in fit.kernel.parameters]
    if fit.settings.covariance == "full" and not fit.one_person and not problems:
        for i, a in enumerate(fit.kernel.elements):
            for j in range(i):
                if fit.identified[i] and fit.identified[j] and not (shared[i] or shared[j]):
                    low, middle, high = np.quantile(p.correlation[:, i, j], INTERVAL)
                    correlation.append([fit.kernel.elements[j], a, float(middle), float(low), float(high)])
    errors: dict[str, Any] = {name: curve.summary() for name, curve in predictive.errors.items()}
    r = predictive.replication
    errors["population_network"]["replicated_rank_magnitude"] = r.mean_magnitude_rank
    errors["population_network"]["replicated_rank_phase"] = r.mean_phase_rank
    errors["subjects"] = {
        "relative_rms_median": float(np.median(predictive.person_relative_rms)),
        "relative_rms_max": float(np.max(predictive.person_relative_rms)),
        "delta_magnitude": float(np.mean(predictive.person_delta_magnitude)),
        "delta_phase_deg": float(np.mean(predictive.person_delta_phase_deg)),
    }
    distribution = distribution_summary(p, fit.kernel.elements, fit.identified, known=not problems)
    noise = noise_summary(fit.noise_tail)
    return {
        "schema": SCHEMA,
        "reliable": not problems,
        "problems": problems,
        "remarks": [*adequacy.misfit, *_remarks(fit, predictive, bool(adequacy.gross)), *d.remarks],
        "findings": list(findings),
        "adequacy": adequacy.summary(),
        "title": fit.recordings.title,
        "network": str(fit.kernel.network),
        "network_as_written": str(fit.written),
        "combinations": [
            {"name": c.name, "elements": list(c.elements), "expression": c.expression} for c in fit.combinations
        ],
        "unit": fit.recordings.unit,
        "subjects": len(fit.recordings.subjects),
        "repetitions": max(len(s.repetitions) for s in fit.recordings.subjects),
        "seed": fit.seed,
        "data_sha256": fit.recordings.sha256,
        "covariance": fit.settings.covariance,
        **({} if distribution is None else {"distribution": distribution}),
        **({} if noise is None else {"noise_distribution": noise}),
        "prior": _prior(fit),
        "covariates": _covariates(fit),
        "elements": elements,
        "correlation": correlation,
        "errors": errors,
        "coverage": {
            "50": float(np.mean(predictive.coverage50)),
            "90": float(np.mean(predictive.coverage90)),
        },
        "coverage_by_frequency": coverage_by_frequency({"50": predictive.coverage50, "90": predictive.coverage90}),
        "noise_scale": noise_scale_summary(fit.noise_scale),
        "sampler": {
            "ensembles": d.ensembles,
            "steps": d.steps,
            "walkers": d.walkers,
            "rhat_max": finite_or_none(d.rhat_max),
            "ess_min": finite_or_none(d.effective_min),
            "tau_max": finite_or_none(d.autocorrelation_max),
            "acceptance": finite_or_none(d.acceptance),
            "log_likelihood_variance": finite_or_none(d.log_likelihood_variance),
            "pareto_k_max": finite_or_none(np.max(d.pareto_k)),
            "effective_draws_min": finite_or_none(np.min(d.effective_draws)),
            "reference_moved": d.redrawn,
        },
        "versions": dict(versions),
        "seconds": {k: round(v, 3) for k, v in seconds.items()},
    }


def _prior(fit: PopulationFit) -> dict[str, Any]:
    """The prior of the fit: medians of central values in their units, standard deviations on the estimated scales."""
    prior, parameters = fit.prior, fit.kernel.parameters
    return {
        "given": fit.settings.prior is not None,
        "elements": {
            parameter.name: {
                "centre": float(parameter.value(prior.centre[i])),
                "scale": float(prior.centre_sds[i]),
                "kind": "student_t" if prior.tailed[i] else "normal",
                "dispersion": None if parameter.shared or fit.one_person else float(prior.dispersion_sds[i]),
            }
            for i, parameter in enumerate(parameters)
        },
        "concentration": prior.concentration,
        "slope": prior.slope_sd,
        "order": [list(names) for names in prior.order.names],
    }


def _covariates(fit: PopulationFit) -> dict[str, dict[str, float]]:
    """Mean and standard deviation of each covariate: slopes are of one standard deviation."""
    found = {}
    for name in fit.settings.covariates:
        values = np.array([s.covariates[name] for s in fit.recordings.subjects], dtype=float)
        found[name] = {"mean": float(values.mean()), "sd": float(values.std())}
    return found


def _remarks(fit: PopulationFit, predictive: Predictive, gross: bool) -> list[str]:
    """Remarks for the user about the fit, in full sentences, the most important first."""
    remarks = []
    n, scale = len(fit.recordings.subjects), noise_scale_summary(fit.noise_scale)
    if not gross and network_misfits({"subjects": n, "noise_scale": scale}):
        remarks.append(
            f"The network does not describe these recordings: the residuals are {misfit_words(scale, n, 'subjects')}, "
            f"and each subject's individual fit deviates by {100 * np.median(predictive.person_relative_rms):.1f} % "
            "(median). The values below are those of the closest network of this form, and their intervals are valid "
            "only for this form."
        )
    if fit.one_person:
        remarks.append("There is one subject: the values are this subject's, and no dispersion can be estimated.")
    elif n < FEW_PERSONS:
        remarks.append(f"There are only {n} subjects: dispersions rest on the prior as much as on the data.")
    if (said := distribution_remark(fit.parameters, fit.recordings.unit)) is not None:
        remarks.append(said)
    if (said := noise_remark(fit.noise_tail)) is not None:
        remarks.append(said)
    own = sum(not parameter.shared for parameter in fit.kernel.parameters)
    if not fit.one_person and too_few_for_correlations(n, own):
        remarks.append(
            f"{n} subjects are too few to estimate the correlations of {own} elements, which are taken as zero."
        )
    if not fit.repeated:
        between = f"the dispersion between {who(fit.recordings.unit)} includes that between repetitions, and "
        mixed = "" if fit.one_person else between
        remarks.append(
            f"There is one repetition per subject: {mixed}the noise was estimated from the roughness of the curves."
        )
    left = fit.recordings.calibration
    if left is not None:
        remarks.append(
            f"The calibration's own error, which is the same in all recordings, is estimated along: "
            f"{100 * left.share:.3g} % of its variance as {', '.join(left.parameters)}, with the calibration's prior. "
            "--exact-calibration takes the calibration as exact instead."
        )
    if fit.recordings.calibration_map is not None:
        remarks.append(
            "The calibration's own error, which is the same in all recordings and differs from frequency to frequency, "
            "is carried on: it counts as noise of each frequency, and what does not average out is in the intervals "
            "of centres and of single subjects. --exact-calibration takes the calibration as exact instead."
        )
    for c in fit.combinations:
        remarks.append(
            f"Recordings can determine only {c.expression}, not {' or '.join(c.elements)} alone: one element, "
            f"{c.name}, replaces them."
        )
    lost = inseparable_given(fit.kernel, fit.prior)
    if lost:
        remarks.append(
            f"No recording can determine {', '.join(lost[:-1])} and {lost[-1]}, because a change of one of them can be "
            "compensated by the others: the network has more elements than its impedance has coefficients. No number "
            "is reported for them."
        )
    unseen = [e for e, seen in zip(fit.kernel.elements, fit.identified, strict=True) if not seen and e not in lost]
    if unseen:
        remarks.append(
            f"The recordings do not determine {', '.join(unseen)}: a wide range of values, of one or of several "
            "together, gives the same impedance in the measured band, so no number is reported."
        )
    return remarks
