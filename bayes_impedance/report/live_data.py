"""What a page holds for its charts: curves of everybody once, charts, and a section for each person.

Only digits and words are chosen here; :mod:`bayes_impedance.plots.charts` says what a chart shows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.plots import diagnosis_charts, fit_charts, person_charts
from bayes_impedance.plots.access import element_scale, frequency, needed, samples, subjects
from bayes_impedance.plots.charts import Chart, as_data, kept_frequencies, kept_people, rounded
from bayes_impedance.report.findings import ABSENT, number_text
from bayes_impedance.report.live_page import contents, embedded_data, scripts, security_policy
from bayes_impedance.results.result import Result
from bayes_impedance.units import INTERVAL, joined, with_interval

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.types import Diagnosis

_FACTS = ("person_relative_rms", "noise_scale", "pareto_k")


def of_fit(result: Result) -> dict[str, Any]:
    """Context of the template's live parts, for a run.

    Parameters
    ----------
    result : Result

    Returns
    -------
    dict
        ``data`` is the JSON of the page; the other values are for the template.
    """
    names, curves = subjects(result), fit_charts.people_curves(result)
    rms, scale, tail = (needed(result, name) for name in _FACTS)
    notable = np.argsort(-scale).tolist()
    people = kept_people(len(names), len(curves), notable)
    spread = person_charts.deviations(result)
    elements = None
    if spread is not None:
        low, middle, high = (rounded(part[people], 3) for part in spread.quantiles)
        elements = {"names": spread.elements, "low": low, "middle": middle, "high": high}
    persons: list[dict[str, Any]] = []
    for i in people:
        facts = [("Recorded", _times(int(needed(result, "repetitions")[i])))]
        if not result.problems:
            facts += [
                ("Error of the individual fit", f"{100 * rms[i]:.2f} %"),
                ("Residual / noise", f"{scale[i]:.2f}"),
                ("Pareto k", f"{tail[i]:.2f}".replace("-", "−")),
            ]
        persons.append({"facts": facts, "elements": []})
    if spread is not None:
        for entry, rows in zip(persons, _element_rows(result, spread, people), strict=True):
            entry["elements"] = rows
    charts = [*fit_charts.fit_charts(result), person_charts.of_fit(result)]
    models = ["before", "after"] if fit_charts.has_before(result) and not result.problems else ["fit"]
    return _context(
        frequency(result), [names[i] for i in people], people, curves, charts, persons, models, elements, notable[0]
    )


def of_diagnosis(diagnosis: Diagnosis) -> dict[str, Any]:
    """Context of the template's live parts, for a diagnosis; as :func:`of_fit`."""
    models = diagnosis_charts.models(diagnosis)
    curves = diagnosis_charts.people_curves(diagnosis)
    errors = [snapshot.subject_rms_relative for _, snapshot in models]
    notable = np.argsort(-np.nan_to_num(errors[0]), kind="stable").tolist()
    people = kept_people(len(diagnosis.subjects), len(curves), notable)
    persons = []
    for i in people:
        facts = [
            (f"Error of the individual fit{f', {name}' if len(models) > 1 else ''}", _percent(rms[i]))
            for (name, _), rms in zip(models, errors, strict=True)
        ]
        persons.append({"facts": facts, "elements": []})
    charts = [*diagnosis_charts.diagnosis_charts(diagnosis), person_charts.of_diagnosis(diagnosis)]
    names = [diagnosis.subjects[i] for i in people]
    grid = diagnosis.before.frequency_hz
    return _context(grid, names, people, curves, charts, persons, [name for name, _ in models], None, notable[0])


def _context(
    grid: np.ndarray,
    names: Sequence[str],
    people: Sequence[int],
    curves: Mapping[str, np.ndarray],
    charts: Sequence[Chart],
    persons: Sequence[Mapping[str, Any]],
    models: Sequence[str],
    elements: Mapping[str, Any] | None,
    first: int,
) -> dict[str, Any]:
    kept = kept_frequencies(len(people), grid.size, len(curves))
    rows = list(people)
    data = {
        "x": rounded(grid[kept], 6),
        "people": list(names),
        "first": rows.index(first),
        "models": list(models),
        "curves": {name: rounded(values[rows][:, kept]) for name, values in curves.items()},
        "charts": [as_data(chart, kept, rows) for chart in charts],
        "persons": list(persons),
        "elements": elements,
    }
    return {
        "charts": {chart.name for chart in charts},
        "people_names": list(names),
        "place_of": {i: row for row, i in enumerate(rows)},
        "models": list(models),
        "has_elements": elements is not None,
        "data": embedded_data(data),
        "scripts": scripts(),
        "policy": security_policy(),
        "contents": contents,
    }


def _element_rows(
    result: Result, spread: person_charts.Deviations, people: Sequence[int]
) -> list[list[tuple[str, ...]]]:
    """For each person a row for each element: name, value, 90 % interval, population's centre, distance from it."""
    rows: list[list[tuple[str, ...]]] = [[] for _ in people]
    draws, central = samples(result, "person_log_elements"), samples(result, "central")
    for k, name in enumerate(spread.elements):
        i = result.elements.index(name)
        scale, own = element_scale(result, i), result.parameters[i]
        quantiles = own.value(np.quantile(draws[:, :, i], INTERVAL, axis=0)) * scale.factor
        low, middle, high = np.quantile(central[:, i], INTERVAL) * scale.factor
        centre = joined(with_interval(middle, low, high)[0], scale.unit)
        for row, person in zip(rows, people, strict=True):
            a, b, c = quantiles[:, person].tolist()
            value, interval = with_interval(b, a, c)
            distance = spread.quantiles[1, person, k]
            said = f"{abs(distance):.1f} sd {'above' if distance > 0 else 'below'}"
            row.append((name, joined(value, scale.unit), interval, centre, said))
    return rows


def _times(number: int) -> str:
    return "once" if number == 1 else f"{number} times"


def _percent(share: float) -> str:
    return f"{number_text(100 * share)} %" if np.isfinite(share) else ABSENT
