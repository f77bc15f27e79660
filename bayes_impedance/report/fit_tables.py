"""Tables of the page: rows made from a result, as plain text for the template.

Only units, prefixes and digits are computed here. Numbers that must not be used do not appear in a row.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from shlex import quote
from typing import Any

import numpy as np

from bayes_impedance.mcmc.ensemble import QUICK, SamplerSettings
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.parameters import quantity_of
from bayes_impedance.network.spellings import in_both
from bayes_impedance.plots.access import (
    frequency,
    is_electrical,
    is_simulated,
    needed,
    samples,
    subjects,
    variable,
    who,
)
from bayes_impedance.population.diagnostics import FEWEST_EFFECTIVE, PARETO_LIMIT, RHAT_LIMIT, VARIANCE_LIMIT
from bayes_impedance.population.posterior import VARIANCE_WANTED
from bayes_impedance.results.result import Result
from bayes_impedance.units import INTERVAL, excludes_zero, hertz, scale_for, signed, significant, typeset, with_interval

NOT_DETERMINED = "not determined by these recordings"
_WITHHELD = "withheld"
_ABSENT = "–"

_ELECTRICAL = {
    "m": ("inductance", "Inductor: voltage proportional to the rate of change of the current."),
    "n": ("capacitance", "Capacitor: current proportional to the rate of change of the voltage."),
    "r": ("resistance", "Resistor: voltage proportional to the current."),
}
_CORRELATIONS = 12
"""Most pairs that are listed. By choice: completeness against the table's length."""
_RHAT_WANTED = SamplerSettings().rhat
_ESS_WANTED = 400
"""Effective sample size wanted: 5 % and 95 % quantiles then have an error of a tenth of a standard deviation."""
_ACCEPTANCE = 0.1, 0.9
"""Share of accepted steps, by choice: stretch moves work best around a third."""
_DRAWS_WANTED = 10
"""Effective number of draws wanted for a person. By choice: with ten the error of a mean is a third of the standard
deviation."""
_OUTLIERS = 3
"""Most subjects listed for each criterion. By choice: completeness against the table's length."""


@dataclass(frozen=True, kw_only=True)
class ElementRow:
    """A line of the table of elements; all fields are text for the page."""

    name: str
    title: str
    story: str
    identified: bool
    marked: bool
    value: str
    interval: str
    unit: str
    between_persons: str
    between_persons_interval: str
    between_repetitions: str
    between_repetitions_interval: str


@dataclass(frozen=True)
class Check:
    """A diagnostic: its name and value, the required value, whether it is met, and what it means."""

    name: str
    value: str
    wanted: str
    good: bool
    meaning: str


def population_name(result: Result) -> str:
    """The subjects with their number: ``71 simulated people``, ``one subject``."""
    n = len(subjects(result))
    adjective = "simulated " if is_simulated(result) else ""
    return f"{'one' if n == 1 else n} {adjective}{who(result, n)}"


def element_values(result: Result) -> dict[str, str]:
    """Central value with its unit, for the drawing."""
    return {
        row.name: f"{row.value} {row.unit}".strip() if row.identified and not result.problems else ""
        for row in element_rows(result)
    }


def element_rows(result: Result) -> list[ElementRow]:
    """The table of elements."""
    places = _groups_of(parse(result.attributes["network"]))
    rows = []
    for name in result.elements:
        entry = result.summary["elements"][name]
        quantity = quantity_of(name)
        plain = quantity.name, quantity.story
        noun, story = _ELECTRICAL.get(name[0], plain) if is_electrical(result) else plain
        if entry.get("pooling") == "shared":
            noun, story = (
                f"{noun}, the same for all",
                f"{story} It is the same for all {who(result)} and is taken to belong to the rig.",
            )
        central, unit = entry["central"], typeset(entry["unit"])
        value, interval = (_WITHHELD, "") if entry["identified"] else (NOT_DETERMINED, "")
        if entry["identified"] and central["median"] is not None:
            scale = scale_for(central["median"], entry["unit"])
            value, interval = with_interval(*(scale.factor * central[k] for k in ("median", "q05", "q95")))
            unit = scale.unit
        persons, repetitions = (
            _spread(entry[f"dispersion_between_{level}"])
            if entry["identified"] and entry.get("pooling") != "shared"
            else (_ABSENT, "")
            for level in ("persons", "repetitions")
        )
        title = f"{places[name]} {noun}" if places[name] else noun
        rows.append(
            ElementRow(
                name=name,
                title=title,
                story=story,
                identified=entry["identified"],
                marked=entry["marked"],
                value=value,
                interval=interval,
                unit=unit,
                between_persons=persons[0],
                between_persons_interval=persons[1],
                between_repetitions=repetitions[0],
                between_repetitions_interval=repetitions[1],
            )
        )
    return rows


def _spread(entry: dict[str, float | None]) -> tuple[str, str]:
    if entry["median"] is None:
        return _ABSENT, ""
    median, low, high = (math.exp(float(entry[k] or 0.0)) for k in ("median", "q05", "q95"))
    digits = 3 if high < 1.1 else 2
    return f"×{median:.{digits}f}", f"{low:.{digits}f} to {high:.{digits}f}"


def _groups_of(network: Network) -> dict[str, str]:
    """Label of the smallest labelled group around each element, or an empty text."""
    return {p.name: _innermost(network, path) for path, node in network.walk() for p in node.own_parameters}


def _innermost(network: Network, path: tuple[int, ...]) -> str:
    node, label = network, network.label
    for i in path:
        node = node.parts[i]
        label = node.label or label
    return label or ""


def correlation_rows(result: Result) -> list[tuple[str, str, str]]:
    """Pairs whose 90 % interval excludes zero, with correlation and interval; only the strongest."""
    known = {name for name, entry in result.summary["elements"].items() if entry["identified"]}
    sure = [row for row in result.summary["correlation"] if excludes_zero(row[3], row[4]) and known >= set(row[:2])]
    sure.sort(key=lambda row: -abs(row[2]))
    return [
        (f"{a} and {b}", signed(middle), f"{signed(low)} to {signed(high)}")
        for a, b, middle, low, high in sure[:_CORRELATIONS]
    ]


def slope_rows(result: Result) -> list[tuple[str, str, str, str]]:
    """Effect of each covariate on each element: a factor for one standard deviation of the covariate."""
    if variable(result, "slope") is None or result.problems:
        return []
    slopes, rows = np.exp(samples(result, "slope")), []
    for i, name in enumerate(result.elements):
        if not result.summary["elements"][name]["identified"]:
            continue
        for j, covariate in enumerate(result.coords["covariate"]):
            if np.all(np.isfinite(slopes[:, i, j])):
                low, middle, high = np.quantile(slopes[:, i, j], INTERVAL)
                rows.append((name, str(covariate), f"×{middle:.2f}", f"{low:.2f} to {high:.2f}"))
    return rows


def recording_rows(result: Result) -> list[tuple[str, str]]:
    """Description of the recordings: rows of name and value."""
    repetitions = needed(result, "repetitions")
    low, high = int(repetitions.min()), int(repetitions.max())
    f, magnitude = frequency(result), np.hypot(needed(result, "observed_re"), needed(result, "observed_im"))
    scale = scale_for(float(np.nanmedian(magnitude)), result.attributes["unit"])
    ends = f"{significant(np.nanmin(magnitude) * scale.factor)} to {significant(np.nanmax(magnitude) * scale.factor)}"
    return [
        ("Title", str(result.attributes["title"])),
        ("Source", str(result.attributes.get("source") or "not stated")),
        ("Licence", str(result.attributes.get("licence") or "not stated")),
        (who(result).capitalize(), population_name(result)),
        ("Repetitions", str(low) if low == high else f"{low} to {high}"),
        ("Frequencies", f"{f.size}, from {hertz(f[0])} to {hertz(f[-1])}"),
        ("Impedance", f"z = {'V/i' if is_electrical(result) else 'F/v'} in {typeset(result.attributes['unit'])}"),
        ("Range of |z|", f"{ends} {scale.unit}"),
    ]


def reading_warnings(result: Result) -> list[str]:
    """Warnings from reading the recordings."""
    return [str(warning) for warning in json.loads(result.attributes.get("reading_warnings") or "[]")]


def error_table(result: Result) -> tuple[str, list[tuple[str, str, str]]]:
    """Unit of the magnitude's error; rows of name, magnitude and phase, each mean ± sd over frequency."""
    errors, n = result.summary["errors"], len(subjects(result))
    scale = scale_for(errors["population_network"]["delta_magnitude"], result.attributes["unit"])
    names = {"population_network": "population network" if n > 1 else "network"}
    if n > 1:
        names |= {"lookup_mean": "look-up table, mean", "lookup_median": "look-up table, median"}
    rows = []
    for key, name in names.items():
        entry = errors[key]
        magnitude = (entry["delta_magnitude"] * scale.factor, entry["delta_magnitude_sd"] * scale.factor)
        phase = (entry["delta_phase_deg"], entry["delta_phase_deg_sd"])
        rows.append((name, " ± ".join(map(significant, magnitude)), " ± ".join(map(significant, phase))))
    if n > 1:
        own = errors["subjects"]
        rows.append(
            (
                f"individual fit of each {who(result, 1)}",
                significant(own["delta_magnitude"] * scale.factor),
                significant(own["delta_phase_deg"]),
            )
        )
    return scale.unit, rows


def before_and_after(result: Result) -> list[tuple[str, str, str]]:
    """What the additions to a network change: quantity, before, and after; empty if the network before is not known."""
    before = result.summary.get("before")
    if before is None:
        return []
    errors, n = result.summary["errors"], len(subjects(result))
    curve, own = errors["population_network"], errors["subjects"]
    scale = scale_for(curve["delta_magnitude"], result.attributes["unit"])
    one = "one network for all" if n > 1 else "the network"
    rows = [
        (f"Magnitude error of {one} (eq. 5)", "delta_magnitude", curve, scale.factor, f" {scale.unit}"),
        (f"Phase error of {one} (eq. 5)", "delta_phase_deg", curve, 1.0, "°"),
        (
            f"Error of each {who(result, 1)}'s own network (relative)",
            "subject_rms_relative",
            {"subject_rms_relative": own["relative_rms_median"]},
            100.0,
            " %",
        ),
    ]
    if n > 1:
        after = {"coverage90": result.summary["coverage"]["90"]}
        rows.append(("Recordings inside of the predicted 90 % band, average", "coverage90", after, 100.0, " %"))
    return [
        (name, f"{significant(before[key] * factor)}{unit}", f"{significant(values[key] * factor)}{unit}")
        for name, key, values, factor, unit in rows
        if before[key] is not None
    ]


def outlier_rows(result: Result) -> list[tuple[str, str, str, str, str]]:
    """Subjects that stand out: name, relative error, residual over noise, Pareto k, and why the subject is listed."""
    names = subjects(result)
    criteria = {
        "largest error": needed(result, "person_relative_rms"),
        "largest residual": needed(result, "noise_scale"),
        "highest Pareto k": needed(result, "pareto_k"),
    }
    reasons: dict[int, list[str]] = {}
    for reason, values in criteria.items():
        for place, i in enumerate(np.argsort(-values)[:_OUTLIERS].tolist()):
            reasons.setdefault(i, []).append(reason if place == 0 else f"{_ORDINAL[place]} {reason}")
    rms, scale, k = criteria.values()
    return [
        (
            names[i],
            f"{100 * rms[i]:.2f} %",
            f"{scale[i]:.2f}",
            f"{k[i]:.2f}".replace("-", "−"),
            ", ".join(why) if len(names) > 1 else "",
        )
        for i, why in reasons.items()
    ]


_ORDINAL = {1: "second", 2: "third"}
"""Words for a subject's rank in a criterion, counted from zero; the first needs none."""


def checks(result: Result) -> list[Check]:
    """The table of diagnostics."""
    # None stands for what is not finite, which meets no limit.
    s = {name: float("nan") if value is None else value for name, value in result.summary["sampler"].items()}
    return [
        Check(
            "R-hat, worst",
            _finite(s["rhat_max"], ".3f"),
            f"below {_RHAT_WANTED}; refused above {RHAT_LIMIT}",
            s["rhat_max"] <= _RHAT_WANTED,
            "Compares ensembles that start and adapt independently. At 1 they have the same distribution.",
        ),
        Check(
            "Effective sample size, worst",
            _finite(s["ess_min"], ".0f"),
            f"above {_ESS_WANTED}; refused below {FEWEST_EFFECTIVE:g}",
            s["ess_min"] >= _ESS_WANTED,
            f"Number of independent draws with the same information as the correlated ones; {_ESS_WANTED} suffice for "
            "the ends of intervals.",
        ),
        Check(
            "Acceptance",
            _finite(s["acceptance"], ".2f"),
            f"{_ACCEPTANCE[0]} to {_ACCEPTANCE[1]}",
            _ACCEPTANCE[0] <= s["acceptance"] <= _ACCEPTANCE[1],
            "Share of proposed steps that were accepted. Near 0 the sampler does not move; near 1 its steps are too "
            "small.",
        ),
        Check(
            "Variance of the log-likelihood",
            _finite(s["log_likelihood_variance"], ".2g"),
            f"below {VARIANCE_WANTED}; refused above {VARIANCE_LIMIT:g}",
            s["log_likelihood_variance"] <= VARIANCE_WANTED,
            f"The likelihood is a Monte-Carlo average over each {who(result, 1)}'s draws; this is its Monte-Carlo "
            "variance.",
        ),
        Check(
            "Pareto k, worst",
            _finite(s["pareto_k_max"], ".2f"),
            f"below {PARETO_LIMIT}",
            s["pareto_k_max"] <= PARETO_LIMIT,
            f"Shape of the tail of a {who(result, 1)}'s importance weights. Above {PARETO_LIMIT}, few draws carry most "
            "of the weight.",
        ),
        Check(
            "Effective draws, worst",
            _finite(s["effective_draws_min"], ".0f"),
            f"above {_DRAWS_WANTED}",
            s["effective_draws_min"] >= _DRAWS_WANTED,
            f"Number of equally weighted draws with the same information as a {who(result, 1)}'s weighted ones.",
        ),
    ]


def _finite(value: float, digits: str) -> str:
    return format(value, digits) if math.isfinite(value) else "not finite"


def provenance_rows(result: Result) -> list[tuple[str, str]]:
    """Provenance of the numbers: rows of name and value."""
    summary, s = result.summary, result.summary["sampler"]
    stages = {"persons": who(result)}
    seconds = ", ".join(f"{stages.get(k, k)} {value:.1f} s" for k, value in summary.get("seconds", {}).items())
    return [
        ("Network", in_both(summary["network"], summary["unit"])),
        ("Seed", str(summary["seed"])),
        ("SHA-256 of the data", summary["data_sha256"] or "none: the recordings did not come from a file"),
        ("Covariance between " + who(result), summary["covariance"]),
        ("Sampler", f"{s['ensembles']} ensembles of {s['walkers']} walkers, {s['steps']} steps"),
        ("Versions", ", ".join(f"{name} {version}" for name, version in summary["versions"].items())),
        ("Seconds", seconds or "not recorded"),
    ]


def command(result: Result) -> str:
    """The command that reproduces this result, quoted for the shell, because names come from the user's files."""
    summary: dict[str, Any] = result.summary
    parts = [
        "bayes-impedance run DATASET -o OUT",
        f"--network {quote(summary['network'])}",
        f"--seed {summary['seed']}",
    ]
    if summary["covariance"] != "full":
        parts.append(f"--covariance {summary['covariance']}")
    if "distribution" in summary:
        parts.append(f"--distribution {summary['distribution']['name']}")
    if "noise_distribution" in summary:
        parts.append(f"--noise-distribution {summary['noise_distribution']['name']}")
    parts += ["--priors FILE"] if result.attributes.get("prior") else []
    parts += [f"--beside {name}" for name in result.summary.get("beside", ())]
    parts += [f"--covariate {quote(str(name))}" for name in result.coords.get("covariate", [])]
    selected = json.loads(result.attributes.get("selected_subjects") or "[]")
    parts += [f"--subject {quote(str(name))}" for name in selected]
    if summary["sampler"]["ensembles"] == QUICK.ensembles:
        parts.append("--quick")
    return " ".join(parts)
