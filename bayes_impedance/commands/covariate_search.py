"""The job behind ``bayes-impedance covariates``: every element against every covariate."""

from __future__ import annotations

import csv
import io
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.jobs import selected
from bayes_impedance.runtime.atomic_files import write_json, write_text
from bayes_impedance.runtime.output_folder import output_folder
from bayes_impedance.units import counted

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.covariate_search import CovariateSearch
    from bayes_impedance.runtime.progress import Progress

TABLES = ("covariates.json", "covariates.csv")
_SHOWN = 12
"""Most slopes that the terminal lists if none is significant beyond: a screenful; the tables hold all."""


def search_dataset(dataset: Path, out: Path, options: FitOptions, progress: Progress) -> CovariateSearch:
    """Test the covariates of a dataset; writes ``covariates.json`` and ``covariates.csv``.

    Parameters
    ----------
    dataset : Path
    out : Path
        Folder for the tables.
    options : FitOptions
        Network, covariates (all if none are named), subjects, seed, workers and scheduler.
    progress : callable

    Raises
    ------
    InputError
        If the input cannot be used; nothing was written then.
    """
    from bayes_impedance.commands.checking import distinct, require_quantity
    from bayes_impedance.diagnosis.covariate_search import search_covariates
    from bayes_impedance.population.covariate_terms import with_terms
    from bayes_impedance.recordings.files import read_recordings
    from bayes_impedance.runtime.executors import executor_of

    recordings = distinct(selected(read_recordings(dataset), options).in_memory(), dataset)
    require_quantity(recordings, options.network)
    recordings, names = with_terms(recordings, options.covariates)
    with output_folder(out, TABLES, options.overwrite):
        with executor_of(options.threads, options.workers, options.scheduler) as executor:
            found = search_covariates(
                recordings,
                options.network,
                covariates=names,
                seed=options.seed,
                progress=progress,
                executor=executor,
            )
        identity = {"seed": options.seed, "data_sha256": recordings.sha256, "version": version("bayes_impedance")}
        write_json(out / TABLES[0], {**found.summary(), **identity})
        text = io.StringIO()
        writer = csv.DictWriter(text, list(found.rows()[0]) if found.trends else ["element"], lineterminator="\n")
        writer.writeheader()
        writer.writerows(found.rows())
        write_text(out / TABLES[1], text.getvalue())
    return found


def lines_of(found: CovariateSearch) -> list[str]:
    """The search as text: remarks, the table, then what it says."""
    lines = [f"note: {remark}" for remark in found.remarks]
    lines += [
        "",
        f"{counted(found.subjects, 'subject')}, network {found.network}, {counted(found.tried, 'slope')} tested",
        "",
    ]
    lines.append(f"{'element':10}{'covariate':24}{'slope (90 %)':34}{'p':>10}{'corrected':>12}")
    for t in found.trends[: max(_SHOWN, len(found.found))]:
        kind = "exponent" if t.transform == "log" else "per unit"
        slope = f"{t.estimate:.3g} ({t.q05:.3g} to {t.q95:.3g}) {kind}"
        lines.append(f"{t.element:10}{t.covariate:24}{slope:34}{t.p_value:10.2g}{t.p_corrected:12.2g}")
    if len(found.trends) > max(_SHOWN, len(found.found)):
        lines.append("the others are in the tables")
    lines.append("")
    for name, (gain, error) in found.gains.items():
        who = ", ".join(t.element for t in found.found if t.covariate == name)
        verb = "follow" if "," in who else "follows"
        lines.append(f"{who} {verb} {name}: subjects left out are predicted better by {gain:.1f} ± {error:.1f} nats")
    if not found.found:
        lines.append("no element follows a covariate, corrected for all that were tested")
    return lines
