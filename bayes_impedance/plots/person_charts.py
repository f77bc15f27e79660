"""Charts of one person, whom the reader chooses: recording, fit and residual, and the elements among everybody's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.types import Diagnosis
from bayes_impedance.plots import diagnosis_charts, fit_charts
from bayes_impedance.plots.access import identified, needed, samples, subjects, variable, varying
from bayes_impedance.plots.charts import Chart, Line, Own, Panel, Ribbon
from bayes_impedance.results.result import Result
from bayes_impedance.units import INTERVAL

NAME = "person"
"""Of the chart."""


@dataclass(frozen=True)
class Deviations:
    """How people's elements differ from the population's centre, in standard deviations between people.

    Attributes
    ----------
    elements : list of str
        Those that the recordings determine and that differ between people.
    quantiles : ndarray, shape (3, N, P)
        5 %, 50 % and 95 % quantiles of each person's posterior.
    """

    elements: list[str]
    quantiles: np.ndarray


def of_fit(result: Result) -> Chart:
    """The recording of a person with the fitted network, the population's band and the residual."""
    scale = fit_charts.magnitude_scale(result)
    shown = variable(result, "person_curve_re") is not None and not result.problems
    # The page holds what the network describes now without a suffix, and what it described before with one.
    suffixes = (("", "after"), ("_before", "before")) if fit_charts.has_before(result) else (("", ""),)
    panels = []
    for label, part, factor, values in (
        (scale.label("|z|"), 0, scale.factor, "magnitude"),
        ("phase (°)", 1, 1.0, "phase"),
    ):
        own = [Own(values=values, name="recording", colour="ink", points=True)]
        lines: list[Line] = []
        ribbons: list[Ribbon] = []
        if shown:
            own += [Own(values=f"fit_{values}{s}", name="fitted network", colour="chosen", when=w) for s, w in suffixes]
        if shown and len(subjects(result)) > 1:
            band = factor * needed(result, "band_recording")[part]
            centre = factor * needed(result, "band_centre")[part, 2]
            ribbons.append(Ribbon(name="90 % of new recordings", low=band[0], high=band[4], colour="outer"))
            lines.append(Line(name="population centre", y=centre, colour="red", dash="dash"))
        panels.append(
            Panel(label=label, logarithmic=part == 0, lines=tuple(lines), ribbons=tuple(ribbons), own=tuple(own))
        )
    if shown:
        noise = Own(values="noise_limit", name="90 % by noise alone", colour="grey", mirrored=True)
        panels.append(_residual(suffixes, noise))
    return Chart(name=NAME, panels=tuple(panels))


def of_diagnosis(diagnosis: Diagnosis) -> Chart:
    """The recording of a person with the fit and the residual of each model."""
    scale = diagnosis_charts.magnitude_scale(diagnosis)
    names = tuple(name for name, _ in diagnosis_charts.models(diagnosis))
    panels = []
    for label, values in ((scale.label("|z|"), "magnitude"), ("phase (°)", "phase")):
        ribbons = []
        for name, snapshot in diagnosis_charts.models(diagnosis):
            band = snapshot.phase_deg if values == "phase" else scale.factor * snapshot.magnitude
            ribbons.append(Ribbon(name="90 % of recordings", low=band[0], high=band[2], colour="outer", when=name))
        own = [Own(values=values, name="recording", colour="ink", points=True)]
        own += [Own(values=f"fit_{values}_{n}", name="fitted network", colour="chosen", when=n) for n in names]
        panels.append(Panel(label=label, logarithmic=values == "magnitude", ribbons=tuple(ribbons), own=tuple(own)))
    return Chart(name=NAME, panels=(*panels, _residual([(f"_{name}", name) for name in names])))


def _residual(suffixes: Sequence[tuple[str, str]], *more: Own) -> Panel:
    own = list(more)
    for suffix, when in suffixes:
        for values, said, colour in (
            ("residual_along", "residual of the magnitude", "blue"),
            ("residual_across", "residual of the phase (1 % is 0.57°)", "orange"),
        ):
            own.append(Own(values=values + suffix, name=said, colour=colour, when=when))
    return Panel(label="residual (% of |z|)", own=tuple(own))


def deviations(result: Result) -> Deviations | None:
    """Elements of everybody on the population's scale; None if there is no population, or no number may be used."""
    spread = variable(result, "dispersion_between_persons")
    seen = np.flatnonzero(identified(result) & varying(result))
    if spread is None or result.problems or not seen.size:
        return None
    draws = samples(result, "person_log_elements")
    own = np.stack([np.quantile(draws[:, :, i], INTERVAL, axis=0) for i in seen], axis=-1)
    centre = np.median(samples(result, "mu")[:, seen], axis=0)
    sd = np.median(samples(result, "dispersion_between_persons")[:, seen], axis=0)
    return Deviations([result.elements[i] for i in seen], (own - centre) / sd)
