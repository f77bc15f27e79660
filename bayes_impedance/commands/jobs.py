"""What the commands do: whole jobs from a dataset on disk to files in a folder.

Every file is complete or absent: it is written to a temporary name and renamed. While a fit runs, first fits, rounds of
the point estimate and chains are kept in ``checkpoint`` inside the output folder; a killed run continues from there if
it is started again with the same arguments, and gives the same numbers as one that was not interrupted.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json, write_text
from bayes_impedance.runtime.clock import Clock

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from bayes_impedance.classical import MethodComparison
    from bayes_impedance.diagnosis import Diagnosis
    from bayes_impedance.population.fit import FitSettings
    from bayes_impedance.quality.checks import Finding
    from bayes_impedance.recordings.files import Recordings
    from bayes_impedance.results.result import Result
    from bayes_impedance.runtime.progress import Progress

CHECKPOINT_FOLDER, PICTURE_FOLDER = "checkpoint", "pictures"
VERDICT_FILE = "verdict.json"

_THREADS = 2
"""Of this process, if nothing is said: two cores are what a machine has at least, and the shipped dataset is done
sooner than processes have started."""


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """What a user may choose about a fit.

    Attributes
    ----------
    network : str or None
        Notation; None for the dataset's own.
    covariance : str
        ``full`` or ``diagonal``.
    covariates : tuple of str
    subjects : tuple of str
        Whom to use; empty for all.
    seed : int
    quick : bool
        Fewer draws and shorter chains: for a first look.
    workers : int or None
        Processes of this machine that do what is done person by person, and threads of this process that sample; None
        for two threads that do all. Does not change the result.
    scheduler : str or None
        Address of a Dask scheduler whose workers do what is done person by person; does not change the result.
    """

    network: str | None = None
    covariance: str = "full"
    covariates: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()
    seed: int = 1
    quick: bool = False
    workers: int | None = None
    scheduler: str | None = None

    @property
    def threads(self) -> int:
        """Threads of this process, which sample: ensembles share what is in its memory."""
        return _THREADS if self.workers is None else self.workers

    def settings(self) -> FitSettings:
        """Settings of the fit."""
        from bayes_impedance.population.fit import QUICK_SETTINGS, FitSettings

        base = QUICK_SETTINGS if self.quick else FitSettings()
        return FitSettings(self.covariance, self.covariates, base.draws, base.sampler)


def fit_dataset(dataset: Path, out: Path, options: FitOptions, resume: bool, progress: Progress) -> Result:
    """Read, fit, predict; write ``result.nc`` and ``summary.json``.

    Parameters
    ----------
    dataset : Path
        Folder or CSV file.
    out : Path
        Folder for the results.
    options : FitOptions
    resume : bool
        Continue an interrupted fit.
    progress : callable

    Raises
    ------
    InputError
        If the input cannot be used, or `resume` meets the checkpoint of another fit.
    WorkerError
        If processes or a cluster's workers die again and again; what was sampled is kept for `resume`.
    """
    return _fit(dataset, out, options, resume, progress)[0]


def run_dataset(
    dataset: Path,
    out: Path,
    options: FitOptions,
    resume: bool,
    progress: Progress,
    helper: Executor | None = None,
) -> Result:
    """Everything: check, fit, pictures and report.

    Parameters
    ----------
    dataset, out, options, resume, progress
        As in :func:`fit_dataset`.
    helper : Executor, optional
        Another process, which draws some of the pictures.
    """
    from bayes_impedance.quality.checks import check_recordings

    result, recordings = _fit(dataset, out, options, resume, progress, helper)
    _write_pages(result, out, check_recordings(recordings.in_memory()), progress, helper)
    return result


def report_result(out: Path, progress: Progress, dataset: Path | None = None) -> Result:
    """Pictures and report of a finished fit, from its files alone.

    Parameters
    ----------
    out : Path
        Folder with ``result.nc`` and ``summary.json``.
    progress : callable
    dataset : Path, optional
        The recordings, if the report is to tell what is odd about them.
    """
    from bayes_impedance.results.result import load_result

    result = load_result(out)
    _write_pages(result, out, check_dataset(dataset)[2] if dataset is not None else (), progress)
    return result


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
        Of the population fit, which is left in ``out/fit``.
    result : Path or None
        Folder of a finished fit of the same recordings, which is taken instead.
    resume : bool
        Continue an interrupted fit.
    progress : callable

    Raises
    ------
    InputError
        If the input cannot be used, or the finished fit is of other recordings or another network.
    """
    from bayes_impedance.recordings.files import read_recordings

    recordings = _selected(read_recordings(dataset), options).in_memory()
    if result is None:
        fit = _fit(dataset, out / "fit", options, resume, progress)[0]
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
    out.mkdir(parents=True, exist_ok=True)
    identity = {"seed": options.seed, "data_sha256": recordings.sha256, "version": version("bayes_impedance")}
    summary = {**comparison.summary(), **identity}
    write_json(out / "comparison.json", summary)
    write_text(out / "comparison.csv", comparison.csv())
    write_comparison(comparison, out)
    return comparison


def diagnose_dataset(
    dataset: Path,
    out: Path,
    options: FitOptions,
    simulation: Path | None,
    progress: Progress,
) -> Diagnosis:
    """What the network leaves out; writes ``verdict.json``, the report and its pictures.

    Parameters
    ----------
    dataset : Path
    out : Path
        Folder for the results.
    options : FitOptions
        Network, covariance, subjects, seed, quick, workers and scheduler.
    simulation : Path or None
        Dataset of a simulated population that claims to describe the recordings.
    progress : callable

    Raises
    ------
    InputError
        If the input cannot be used.
    WorkerError
        If processes or a cluster's workers die again and again.
    """
    from bayes_impedance.recordings.files import read_recordings

    recordings = _selected(read_recordings(dataset), options).in_memory()
    claimed = None if simulation is None else read_recordings(simulation).in_memory()
    if claimed is not None and claimed.unit != recordings.unit:
        raise InputError(
            f"{simulation}: unit is {claimed.unit}, of {dataset} {recordings.unit}; compare like with like"
        )

    from bayes_impedance.diagnosis import diagnose
    from bayes_impedance.diagnosis.verdict_file import to_json
    from bayes_impedance.report.diagnosis_page import write_diagnosis_report
    from bayes_impedance.runtime.executors import executor_of

    network = options.network if options.network is not None or claimed is None else recordings.network
    with executor_of(options.threads, options.workers, options.scheduler) as executor:
        diagnosis = diagnose(
            recordings,
            network or (claimed.network if claimed is not None else None),
            simulation=claimed,
            diagonal=options.covariance == "diagonal",
            quick=options.quick,
            seed=options.seed,
            progress=progress,
            executor=executor,
        )
    out.mkdir(parents=True, exist_ok=True)
    progress("pictures and report", 0, 1)
    write_diagnosis_report(diagnosis, out)
    _write_text(out / VERDICT_FILE, json.dumps(to_json(diagnosis.verdict), indent=2, allow_nan=False) + "\n")
    progress("pictures and report", 1, 1)
    return diagnosis


def check_dataset(dataset: Path) -> tuple[dict[str, Any], tuple[str, ...], tuple[Finding, ...]]:
    """What a dataset holds, what was changed on reading it, and what is odd about it."""
    from bayes_impedance.quality.checks import check_recordings, describe
    from bayes_impedance.recordings.files import read_recordings

    recordings = read_recordings(dataset).in_memory()
    return describe(recordings), recordings.warnings, check_recordings(recordings)


def _fit(
    dataset: Path, out: Path, options: FitOptions, resume: bool, progress: Progress, helper: Executor | None = None
) -> tuple[Result, Recordings]:
    """Read, fit, predict, save; the recordings are handed on so that nobody reads them twice."""
    from bayes_impedance.recordings.files import read_recordings

    clock = Clock()
    with clock.measure("read"):
        recordings = _selected(read_recordings(dataset), options)

    from bayes_impedance.population.fit import fit_population
    from bayes_impedance.results.predictive import predict
    from bayes_impedance.results.result import make_result, save_result
    from bayes_impedance.runtime.executors import executor_of

    settings = options.settings()
    checkpoint = out / CHECKPOINT_FOLDER
    if checkpoint.exists() and not resume:
        shutil.rmtree(checkpoint)
    try:
        with executor_of(options.threads, options.workers, options.scheduler) as executor:
            fit = fit_population(
                recordings,
                options.network,
                settings=settings,
                seed=options.seed,
                workers=options.threads,
                progress=progress,
                checkpoint=checkpoint,
                executor=executor,
            )
    except InputError:
        if not resume and checkpoint.exists():
            shutil.rmtree(checkpoint)
        if out.exists() and not any(out.iterdir()):
            out.rmdir()
        raise
    if helper is not None:
        from bayes_impedance.plots import prepare

        helper.submit(prepare)
    clock.seconds.update(fit.seconds)
    with clock.measure("predictive"):
        progress("predictions", 0, 1)
        predictive = predict(fit, seed=options.seed)
        progress("predictions", 1, 1)
    result = make_result(fit, predictive, clock.seconds)
    save_result(result, out)
    shutil.rmtree(checkpoint)
    return result, recordings


def _selected(recordings: Recordings, options: FitOptions) -> Recordings:
    return recordings.select(options.subjects) if options.subjects else recordings


def _write_pages(
    result: Result, out: Path, findings: Sequence[Finding], progress: Progress, helper: Executor | None = None
) -> None:
    from bayes_impedance.plots import write_pictures
    from bayes_impedance.report import write_report

    progress("pictures and report", 0, 2)
    pictures = write_pictures(result, out / PICTURE_FOLDER, helper)
    progress("pictures and report", 1, 2)
    write_report(result, out, findings, pictures)
    progress("pictures and report", 2, 2)


def _write_text(file: Path, text: str) -> None:
    temporary = file.with_name(file.name + ".tmp")
    temporary.write_text(text, encoding="utf-8")
    temporary.replace(file)
