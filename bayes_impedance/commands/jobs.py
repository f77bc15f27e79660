"""The work of the commands: whole jobs from a dataset on disk to files in a folder.

Every file is complete or absent: it is written under a temporary name and renamed. While a fit runs, first fits,
iterations of the point estimate and chains are saved in ``checkpoint`` inside the output folder; a killed run continues
from there if it is started again with the same arguments, and gives the same numbers as an uninterrupted run.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.commands.checking import distinct, require_prior, require_quantity
from bayes_impedance.commands.finished_fit import examined_result, model_before, write_extended, write_pages
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.result_folders import (
    CHECKPOINT_FOLDER,
    DIAGNOSIS_CHECKPOINT_FOLDER,
    DIAGNOSIS_FILE,
    EXTENDED_FOLDER,
    FIT_FILES,
    PICTURE_FOLDER,
    REPORT_FILE,
    VERDICT_FILE,
    discarded_if_useless,
    fit_folder,
    interrupted,
    page_files,
    pictures,
    remove,
    remove_extended,
    require_extended,
)
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from bayes_impedance.diagnosis import Diagnosis
    from bayes_impedance.quality.findings import Finding
    from bayes_impedance.recordings.files import Recordings
    from bayes_impedance.results.result import Result
    from bayes_impedance.runtime.progress import Progress

_MOST_CHECKED = 1000
"""Most subjects for which a fit checks its recordings. By choice: the check loads all of them into memory; for more
subjects use the command ``check``."""


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
        If the input cannot be used, or `resume` finds the checkpoint of another fit.
    WorkerError
        If processes or a cluster's workers fail repeatedly; samples drawn so far are kept for `resume`.
    """
    recordings, options, clock = _read(dataset, options)
    pages = page_files() if (out / PICTURE_FOLDER).exists() or (out / REPORT_FILE).exists() else []
    with fit_folder(out, [*FIT_FILES, *pages], recordings, options, resume):
        return _fit(recordings, out, options, clock, progress, pages, _findings(recordings))


def run_dataset(
    dataset: Path,
    out: Path,
    options: FitOptions,
    resume: bool,
    progress: Progress,
    helper: Executor | None = None,
) -> Result:
    """The whole analysis: check, fit, pictures and report.

    Parameters
    ----------
    dataset, out, options, resume, progress
        As in :func:`fit_dataset`.
    helper : Executor, optional
        Another process, which draws some of the pictures.
    """
    recordings, options, clock = _read(dataset, options)
    pages = page_files()
    with fit_folder(out, [*FIT_FILES, *pages], recordings, options, resume):
        findings = _findings(recordings)
        result = _fit(recordings, out, options, clock, progress, pages, findings, helper)
        with interrupted(f"the fit is finished: 'bayes-impedance report {shlex.quote(str(out))}' draws the pictures"):
            write_pages(result, out, findings, progress, helper)
    return result


def report_result(
    out: Path, progress: Progress, dataset: Path | None = None, overwrite: bool = False, beside: Sequence[str] = ()
) -> Result:
    """Pictures and report of a finished fit, from its files alone.

    Parameters
    ----------
    out : Path
        Folder with ``result.nc`` and ``summary.json``.
    progress : callable
    dataset : Path, optional
        The recordings, if the report is to list their anomalies.
    overwrite : bool
        Replace pages that this package did not write.
    beside : sequence of str
        Published sets that are laid beside the fit, in place of those that it was made with.

    Raises
    ------
    InputError
        If the folder holds no fit, or `dataset` is not the dataset that was fitted.
    """
    from bayes_impedance.results.result import load_result

    result = load_result(out)
    if beside:
        result.summary["beside"] = list(beside)
    findings: Sequence[Finding] = ()
    if dataset is not None:
        from bayes_impedance.quality.checks import check_recordings
        from bayes_impedance.recordings.files import read_recordings

        recordings = read_recordings(dataset)
        if recordings.sha256 != result.attributes["data_sha256"]:
            raise InputError(f"{dataset}: {out} is a fit of other recordings; name those, or leave out --dataset")
        names = [str(name) for name in result.coords["subject"]]
        findings = check_recordings(recordings.select(names).in_memory())
    pages = page_files()
    with output_folder(out, pages, overwrite):
        remove(out, pages)
        write_pages(result, out, findings, progress)
    return result


def diagnose_dataset(
    dataset: Path,
    out: Path,
    options: FitOptions,
    simulation: Path | None,
    resume: bool,
    progress: Progress,
    helper: Executor | None = None,
) -> Diagnosis:
    """Diagnose what the network leaves out; writes ``verdict.json``, the report and its pictures.

    Parameters
    ----------
    dataset : Path
    out : Path
        Folder for the results.
    options : FitOptions
        Network, covariance, covariates (those that are tested; all if none are named), subjects, seed, quick,
        exact_calibration, workers and scheduler.
    simulation : Path or None
        Dataset of a simulated population that claims to describe the recordings.
    resume : bool
        Continue the fit of the network in an interrupted diagnosis.
    progress : callable
    helper : Executor, optional
        Another process: it writes the diagnosis' page while this one examines the extended network, and then draws
        some of that one's pictures.

    Raises
    ------
    InputError
        If the input cannot be used, or `resume` finds the checkpoint of another diagnosis.
    BusyError
        If another process writes to the folder.
    WorkerError
        If processes or a cluster's workers fail repeatedly.
    """
    from bayes_impedance.recordings.files import read_recordings

    recordings = distinct(selected(read_recordings(dataset), options).in_memory(), dataset)
    recordings, options = with_terms_of(recordings, options)
    recordings = _with_covariates(recordings, options.covariates)
    claimed = None if simulation is None else with_terms_of(read_recordings(simulation).in_memory(), options)[0]
    if claimed is not None and claimed.unit != recordings.unit:
        raise InputError(
            f"{simulation}: the unit is {claimed.unit}, but that of {dataset} is {recordings.unit}; convert one of them"
        )

    from bayes_impedance.diagnosis import diagnose
    from bayes_impedance.diagnosis.verdict_file import to_json
    from bayes_impedance.plots.missing_physics import DIAGNOSIS_PICTURES
    from bayes_impedance.population.requirements import checked_model
    from bayes_impedance.report.diagnosis_page import write_diagnosis_report
    from bayes_impedance.runtime.checkpoint import discard, require_own
    from bayes_impedance.runtime.executors import executor_of

    network = options.network if options.network is not None or claimed is None else recordings.network
    network = network or (claimed.network if claimed is not None else None)
    for given in (recordings, *(() if claimed is None else (claimed,))):
        checked_model(given, network, options.covariates)
        require_quantity(given, network)
    require_prior(recordings, network, options.prior)
    names = [VERDICT_FILE, DIAGNOSIS_FILE, *pictures(DIAGNOSIS_PICTURES)]
    checkpoint = out / DIAGNOSIS_CHECKPOINT_FOLDER
    require_own(checkpoint)
    require_extended(out, options.overwrite)
    with output_folder(out, names, options.overwrite):
        if not resume:
            discard(checkpoint)
        kept = "the same command with --resume continues the fit of the network and then searches anew"
        with (
            interrupted(kept),
            discarded_if_useless(checkpoint, resume),
            executor_of(options.threads, options.workers, options.scheduler) as executor,
        ):
            diagnosis = diagnose(
                recordings,
                network,
                simulation=claimed,
                diagonal=options.covariance == "diagonal",
                quick=options.quick,
                seed=options.seed,
                progress=progress,
                executor=executor,
                checkpoint=checkpoint,
                prior=options.prior,
            )
            progress("pictures and report", 0, 1)
            remove(out, names)
            write_json(out / VERDICT_FILE, to_json(diagnosis.verdict))
            page = None
            if helper is not None and diagnosis.fit is not None:
                page = helper.submit(write_diagnosis_report, replace(diagnosis, fit=None), out)
            else:
                write_diagnosis_report(diagnosis, out)
                progress("pictures and report", 1, 1)
            try:
                if diagnosis.fit is None:
                    remove_extended(out, options.overwrite)
                else:
                    write_extended(diagnosis, out / EXTENDED_FOLDER, options, executor, progress, helper)
            finally:  # the page of the diagnosis is there even if the extended network's files cannot be written
                if page is not None:
                    page.result()
        discard(checkpoint)
    return diagnosis


def _read(dataset: Path, options: FitOptions) -> tuple[Recordings, FitOptions, Clock]:
    from bayes_impedance.recordings.files import read_recordings

    clock = Clock()
    with clock.measure("read"):
        recordings = distinct(selected(read_recordings(dataset), options), dataset)
        require_quantity(recordings, options.network)
        recordings, options = with_terms_of(recordings, options)
        options.settings()  # refused before anything is written
        return recordings, options, clock


def _fit(
    recordings: Recordings,
    out: Path,
    options: FitOptions,
    clock: Clock,
    progress: Progress,
    stale: Sequence[str],
    findings: Sequence[Finding],
    helper: Executor | None = None,
) -> Result:
    """Fit, predict, save; pages of an earlier fit are removed before the new numbers are written."""
    from bayes_impedance.population.fit import fit_population
    from bayes_impedance.results.result import save_result
    from bayes_impedance.runtime.checkpoint import discard
    from bayes_impedance.runtime.executors import executor_of

    settings = options.settings()
    checkpoint = out / CHECKPOINT_FOLDER
    with interrupted("the same command with --resume continues the fit where it was"):
        with executor_of(options.threads, options.workers, options.scheduler) as executor:
            before = model_before(recordings, options, clock, executor, progress)
            fit = fit_population(
                recordings,
                options.network,
                settings=settings,
                seed=options.seed,
                workers=options.threads,
                progress=progress,
                checkpoint=checkpoint,
                executor=executor,
                start=options.start,
            )
            result = examined_result(fit, options, clock, executor, progress, findings, helper, before)
        result.summary["beside"] = list(options.beside)
        remove(out, (*stale, *FIT_FILES))
        save_result(result, out)
    discard(checkpoint)
    return result


def _findings(recordings: Recordings) -> tuple[Finding, ...]:
    """Anomalies of the recordings; none are searched for if there are too many recordings to hold in memory."""
    from bayes_impedance.quality.checks import check_recordings

    return check_recordings(recordings.in_memory()) if len(recordings.subjects) <= _MOST_CHECKED else ()


def _with_covariates(recordings: Recordings, names: Sequence[str]) -> Recordings:
    """The recordings with some of their covariates only; with all of them if none are named."""
    if not names:
        return recordings
    return replace(
        recordings,
        subjects=tuple(
            replace(s, covariates={name: value for name, value in s.covariates.items() if name in names})
            for s in recordings.subjects
        ),
    )


def with_terms_of(recordings: Recordings, options: FitOptions) -> tuple[Recordings, FitOptions]:
    """Recordings and options with the covariates that categories and interactions stand for."""
    from bayes_impedance.population.covariate_terms import with_terms

    recordings, names = with_terms(recordings, options.covariates)
    return recordings, replace(options, covariates=names)


def selected(recordings: Recordings, options: FitOptions) -> Recordings:
    """The recordings of the subjects named in the options, or of all subjects."""
    if options.exact_calibration:
        recordings = replace(recordings, calibration=None, calibration_map=None)
    return recordings.select(options.subjects) if options.subjects else recordings
