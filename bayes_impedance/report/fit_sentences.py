"""Sentences of the page, made from a result, as plain text for the template.

Only units, prefixes and digits are computed here. Numbers that must not be used do not appear in a sentence.
"""

from __future__ import annotations

import math

import numpy as np

from bayes_impedance.plots.access import frequency, needed, subjects, who
from bayes_impedance.report.fit_tables import element_rows, population_name
from bayes_impedance.results.distribution import is_student_t
from bayes_impedance.results.misfit import misfit_words, network_misfits, range_by_chance
from bayes_impedance.results.result import Result
from bayes_impedance.units import hertz, scale_for, significant

_RARE = 0.05
"""If fewer of the replicated populations than this share have an error as large as the measured one, the measured error
is called larger than the model explains. By choice: the usual level of 5 %."""


def headline(result: Result) -> list[str]:
    """What was described, and whether it is: two sentences."""
    summary, n = result.summary, len(subjects(result))
    f = frequency(result)
    repetitions = int(summary["repetitions"])
    times = "once" if repetitions == 1 else f"{repetitions} times" if n == 1 else f"up to {repetitions} times each"
    if n > 1 and len(set(needed(result, "repetitions").tolist())) == 1 and repetitions > 1:
        times = f"{repetitions} times each"
    subject = population_name(result)
    text = [
        f"The impedance of {subject}, recorded {times} from {hertz(f[0])} to {hertz(f[-1])}, was described by a "
        f"network of {len(result.elements)} elements."
    ]
    if result.problems:
        return [*text, "The computation did not reach the required accuracy, so no number is given here."]
    if network_misfits(summary):
        return [
            *text,
            "It leaves out something that the recordings show: the residuals are "
            f"{misfit_words(summary['noise_scale'], n, who(result))}, and all numbers are those of the closest network "
            "of this form.",
        ]
    return [*text, *_quality_in_words(result, n)[:1]]


def details(result: Result) -> list[str]:
    """The values, and how well they describe everybody, where numbers may be used."""
    if result.problems:
        return []
    n = len(subjects(result))
    quality = _quality_in_words(result, n)
    return [*_values_in_words(result, n), *(quality if network_misfits(result.summary) else quality[1:])]


def _values_in_words(result: Result, n: int) -> list[str]:
    rows = element_rows(result)
    # No line break inside an equation.
    known = [f"{row.name} = {row.value} {row.unit}".strip().replace(" ", "\u00a0") for row in rows if row.identified]
    missing = [row.name for row in rows if not row.identified]
    text = []
    if known:
        owner = f"this {who(result, 1)}" if n == 1 else f"the population's centre, a typical {who(result, 1)}"
        text.append(f"The values of {owner}: {', '.join(known)}.")
    if missing:
        text.append(f"These recordings do not determine {' and '.join(missing)}.")
    identified = [e for e in result.summary["elements"].values() if e["identified"]]
    spreads = [e["dispersion_between_persons"]["median"] for e in identified]
    factors = sorted(math.exp(s) for s in spreads if s is not None)
    if factors:
        ends = dict.fromkeys(f"{factor:.2f}" for factor in (factors[0], factors[-1]))  # once if they are equal
        kind = "geometric scale" if is_student_t(result.summary) else "geometric standard deviation"
        text.append(f"Between {who(result)} the elements vary by a factor of {' to '.join(ends)} ({kind}).")
    return text


def _quality_in_words(result: Result, n: int) -> list[str]:
    errors = result.summary["errors"]
    own = errors["subjects"]
    middle, worst = 100 * own["relative_rms_median"], 100 * own["relative_rms_max"]
    if n == 1:
        text = [f"The network deviates from the recording by {significant(middle, 2)} % (relative root mean square)."]
    else:
        text = [
            f"Fitted to each {who(result, 1)} individually, the network deviates from the recordings by "
            f"{significant(middle, 2)} % (relative root mean square, median; worst {significant(worst, 2)} %)."
        ]
        network, table = errors["population_network"], errors["lookup_median"]
        scale = scale_for(network["delta_magnitude"], result.attributes["unit"])
        text.append(
            f"The network with the central values deviates from an individual by "
            f"{significant(network['delta_magnitude'] * scale.factor)} {scale.unit} and "
            f"{significant(network['delta_phase_deg'], 2)}° on average; because {who(result)} differ, no single curve "
            f"can be closer than {significant(table['delta_magnitude'] * scale.factor)} {scale.unit} and "
            f"{significant(table['delta_phase_deg'], 2)}°."
        )
        text.append(f"The predicted 90 % band contains {coverage_in_words(result, '90')}.")
    return text


def coverage_in_words(result: Result, level: str) -> str:
    """Average share inside a band, and the range over frequency, which an average hides."""
    least, most = (f"{100 * share:.0f} %" for share in result.summary["coverage_by_frequency"][level])
    mean = f"{100 * result.summary['coverage'][level]:.0f} %"
    return f"on average {mean} of the recordings ({least} to {most} at single frequencies)"


def chance_in_words(result: Result) -> str:
    """Range of the shares at single frequencies that chance alone produces if the bands are correct."""
    n = len(subjects(result))
    ranges = []
    for level in result.summary["coverage"]:
        low, high = range_by_chance(int(level) / 100, np.array(n))
        ranges.append(f"between {100 * low:.0f} % and {100 * high:.0f} % ({level} % band)")
    return f"With {n} {who(result, n)} and correct bands, nine of ten frequencies lie {' and '.join(ranges)}."


def replication_sentence(result: Result) -> str:
    """Whether replicated populations are as far from the model's centre as the measured one."""
    entry = result.summary["errors"]["population_network"]
    ranks = [entry["replicated_rank_magnitude"], entry["replicated_rank_phase"]]
    shares = f"{100 * ranks[0]:.0f} % of them for the magnitude and {100 * ranks[1]:.0f} % for the phase"
    kind = "populations" if len(subjects(result)) > 1 else "recordings"
    if network_misfits(result.summary):
        verdict = (
            "This concerns the variation between subjects and the size of the residuals only: the network does not "
            "describe the recordings."
        )
        if min(ranks) < _RARE:
            verdict = "The recordings deviate from the network by more than the model explains."
    elif min(ranks) < _RARE:
        verdict = "The recordings deviate from the network by more than the model explains."
    elif min(ranks) > 1 - _RARE:
        verdict = "The model predicts more scatter than the recordings show."
    else:
        verdict = "So the size of the error is as the model predicts."
    return (
        f"If {kind} like this one are drawn from the fitted model, their error is at least as large as the measured "
        f"one in {shares}. {verdict}"
    )
