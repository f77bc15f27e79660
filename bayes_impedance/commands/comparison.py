"""The job behind ``bayes-impedance compare``: the paper's methods and the population network in one table."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.commands.checking import distinct
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.jobs import fit_dataset, selected
from bayes_impedance.commands.result_folders import PICTURE_KINDS
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json, write_text
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    from bayes_impedance.classical import MethodComparison
    from bayes_impedance.runtime.progress import Progress


def compare_dataset(
    dataset: Path, out: Path, options: FitOptions, result: Path | None, resume: bool, progress: Progress
) -> MethodComparison:
    """The paper's methods and ours in one table; writes ``comparison.json``, ``comparison.csv`` and the pictures.

    Parameters
    ----------
    dataset : Path
    out : Path
        Folder for the results.
    options : FitOptions
        Options of the population fit, which is written to ``out/fit``.
    result : Path or None
        Folder of a finished fit of the same recordings, which is used instead.
    resume : bool
        Continue an interrupted fit.
    progress : callable

    Raises
    ------
    InputError
        If the input cannot be used, or the finished fit is of other recordings or another network.
    """
    from bayes_impedance.plots.comparison import COMPARISON_PICTURES
    from bayes_impedance.recordings.files import read_recordings

    recordings = distinct(selected(read_recordings(dataset), options).in_memory(), dataset)
    names = ["comparison.json", "comparison.csv", *(f"{n}.{k}" for n in COMPARISON_PICTURES for k in PICTURE_KINDS)]
    if result is None:
        with output_folder(out, names, options.overwrite):  # before the fit: it takes long
            fit = fit_dataset(dataset, out / "fit", options, resume, progress)
    else:
        from bayes_impedance.network.notation import parse
        from bayes_impedance.results.result import load_result

        fit = load_result(result)
        if fit.attributes["data_sha256"] != recordings.sha256:
            raise InputError(f"{result}: is a fit of other recordings than {dataset}; name the right folder or none")
        if options.network is not None and str(parse(options.network)) != fit.attributes["network"]:
            raise InputError(f"{result}: is a fit of the network {fit.attributes['network']}; leave out --network")

    from bayes_impedance.classical import compare_methods
    from bayes_impedance.plots import write_comparison

    comparison = compare_methods(recordings, fit, seed=options.seed, progress=progress)
    identity = {"seed": options.seed, "data_sha256": recordings.sha256, "version": version("bayes_impedance")}
    summary = {**comparison.summary(), **identity}
    with output_folder(out, names, options.overwrite):
        write_json(out / "comparison.json", summary)
        write_text(out / "comparison.csv", comparison.csv())
        write_comparison(comparison, out)
    return comparison
