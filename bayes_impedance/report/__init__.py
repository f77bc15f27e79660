"""Reports: one self-contained page of a run, ``report.html``, and one of a diagnosis, ``diagnosis.html``.

Input: a result or a diagnosis, with its pictures. Output: a page of HTML that needs neither network nor other files.
Open this file first (the context of a run's page), then :mod:`.fit_sentences` and :mod:`.fit_tables` (its words and
numbers), :mod:`.diagnosis_page` with :mod:`.findings` (the page of a diagnosis). The network is drawn by
:mod:`bayes_impedance.network.schematic`; :mod:`.live_data` and :mod:`.live_page` make the charts answer;
:mod:`.alternatives` says what pictures show.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Protocol

from bayes_impedance.datasets.beside import beside
from bayes_impedance.network.notation import parse
from bayes_impedance.network.schematic import schematic
from bayes_impedance.network.spellings import circuit_of
from bayes_impedance.plots import write_pictures
from bayes_impedance.plots.access import is_electrical, is_simulated, subjects, who
from bayes_impedance.population.diagnostics import PARETO_LIMIT
from bayes_impedance.report import alternatives, fit_sentences, fit_tables, live_data
from bayes_impedance.report.group_tables import group_table
from bayes_impedance.report.page_template import embedded_picture, template_environment
from bayes_impedance.results.distribution import is_student_t
from bayes_impedance.results.misfit import MISFIT_SCALE
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.atomic_files import write_text

__all__ = ["REPORT_FILE", "write_report"]

REPORT_FILE = "report.html"
_TEMPLATE = "page.html.j2"
_OF_VALUES = frozenset({"bands", "corner_central", "corner_dispersion", "correlation", "errors", "forest", "overview"})
"""Pictures of estimates: left out if the diagnostics say that the estimates must not be used."""


class FindingLike(Protocol):
    """A finding of :mod:`bayes_impedance.quality.checks`."""

    @property
    def severity(self) -> str:
        """``note`` or ``warning``."""

    @property
    def message(self) -> str:
        """One sentence with a remedy."""


def write_report(
    result: Result,
    folder: str | os.PathLike[str],
    findings: Iterable[FindingLike] = (),
    pictures: Mapping[str, Path] | None = None,
) -> Path:
    """Write the page of a run.

    It is one file that needs neither network nor other files. Without scripts it shows pictures in place of charts.

    Parameters
    ----------
    result : Result
    folder : path
        Made if it does not exist.
    findings : iterable of Finding
        What the check of the recordings found.
    pictures : mapping of str to Path, optional
        PNG files by the names of :data:`bayes_impedance.plots.PICTURES`; drawn into ``folder/pictures`` if not given.

    Returns
    -------
    Path
        Of the page. It appears under its name only when it is complete.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    if pictures is None:
        pictures = write_pictures(result, folder / "pictures")
    text = template_environment().get_template(_TEMPLATE).render(**_context(result, list(findings), pictures))
    return write_text(folder / REPORT_FILE, text)


def _context(result: Result, findings: list[FindingLike], pictures: Mapping[str, Path]) -> dict[str, object]:
    from markupsafe import Markup

    drawing = schematic(
        parse(result.attributes["network"]), fit_tables.element_values(result), electrical=is_electrical(result)
    )
    unit, errors = fit_tables.error_table(result)
    shown = {
        name: embedded_picture(file) for name, file in pictures.items() if not (result.problems and name in _OF_VALUES)
    }
    return {
        "title": result.attributes["title"],
        "people": fit_tables.population_name(result),
        "who": who(result),
        "one_who": who(result, 1),
        "number": len(subjects(result)),
        "single": len(subjects(result)) == 1,
        "tails": is_student_t(result.summary),
        "groups": group_table(result),
        "repeated": any(row.between_repetitions_interval for row in fit_tables.element_rows(result)),
        "electrical": is_electrical(result),
        "simulated": is_simulated(result),
        "problems": result.problems,
        "remarks": result.summary["remarks"],
        "findings": findings,
        "reading_warnings": fit_tables.reading_warnings(result),
        "headline": fit_sentences.headline(result),
        "details": fit_sentences.details(result),
        "recordings": fit_tables.recording_rows(result),
        "network": result.attributes["network"],
        "circuit_of": partial(circuit_of, unit=result.attributes["unit"]),
        "schematic": Markup(drawing),
        "elements": fit_tables.element_rows(result),
        "correlations": fit_tables.correlation_rows(result),
        "slopes": fit_tables.slope_rows(result),
        "beside": beside(result.summary, result.summary.get("beside", ())),
        "before": result.summary.get("before", {}).get("network", ""),
        "before_and_after": [] if result.problems else fit_tables.before_and_after(result),
        "error_unit": unit,
        "errors": errors,
        "replication": fit_sentences.replication_sentence(result),
        "coverage": {level: fit_sentences.coverage_in_words(result, level) for level in result.summary["coverage"]},
        "chance": fit_sentences.chance_in_words(result),
        "misfit_scale": f"{MISFIT_SCALE:g}",
        "pareto_limit": f"{PARETO_LIMIT:g}",
        "outliers": fit_tables.outlier_rows(result),
        "alternatives": alternatives.of_fit(result),
        "checks": fit_tables.checks(result),
        "provenance": fit_tables.provenance_rows(result),
        "command": fit_tables.command(result),
        "pictures": shown,
        **live_data.of_fit(result),
    }
