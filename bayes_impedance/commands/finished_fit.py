"""From a finished fit to the files of its result: examined, with predictions, pictures and report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.commands.proposed_network import plain_network
from bayes_impedance.commands.result_folders import PICTURE_FOLDER, extended_files, remove
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from bayes_impedance.commands.fit_options import FitOptions
    from bayes_impedance.diagnosis import Diagnosis
    from bayes_impedance.population.fit import PopulationFit
    from bayes_impedance.quality.findings import Finding
    from bayes_impedance.recordings.files import Recordings
    from bayes_impedance.results.model_before import ModelBefore
    from bayes_impedance.results.result import Result
    from bayes_impedance.runtime.progress import Progress

_MOST_DESCRIBED = 1000
"""Most subjects for whom the network without its additions is fitted too. By choice, as for the check of the
recordings: it loads all of them into memory."""


def examined_result(
    fit: PopulationFit,
    options: FitOptions,
    clock: Clock,
    executor: Executor,
    progress: Progress,
    findings: Sequence[Finding],
    helper: Executor | None = None,
    before: ModelBefore | None = None,
) -> Result:
    """The fit examined, with its predictions.

    Parameters
    ----------
    fit : PopulationFit
    options : FitOptions
    clock : Clock
    executor : Executor
    progress : callable
    findings : sequence of Finding
        Of the recordings.
    helper : Executor, optional
        Another process, which prepares for the pictures.
    before : ModelBefore, optional
        The network to which something was added.
    """
    from bayes_impedance.diagnosis.examine import examine
    from bayes_impedance.results.model_before import with_model_before
    from bayes_impedance.results.predictive import predict
    from bayes_impedance.results.result import make_result

    with clock.measure("examine"):
        progress("examining the fit", 0, 1)
        adequacy = examine(fit, executor=executor)
        progress("examining the fit", 1, 1)
    if helper is not None:
        from bayes_impedance.plots import prepare

        helper.submit(prepare)
    clock.seconds.update(fit.seconds)
    with clock.measure("predictive"):
        progress("predictions", 0, 1)
        predictive = predict(fit, seed=options.seed)
        progress("predictions", 1, 1)
    told = [f.message for f in findings if f.severity == "warning"]
    said = None if before is None else before.summary()
    result = make_result(fit, predictive, clock.seconds, options.subjects, adequacy, told, said)
    return result if before is None else with_model_before(result, before)


def model_before(
    recordings: Recordings, options: FitOptions, clock: Clock, executor: Executor, progress: Progress
) -> ModelBefore | None:
    """The network to which the fitted one adds something, described as a diagnosis describes it.

    None if no such network is known, or for a comparison of networks, which describes each of them anyway.
    """
    network = plain_network(recordings, options)
    if network is None or len(recordings.subjects) > _MOST_DESCRIBED:
        return None
    from bayes_impedance.diagnosis.verdict.model_bands import described
    from bayes_impedance.results.model_before import ModelBefore

    def of_it(stage: str, done: int, total: int) -> None:
        progress(f"the network before: {stage}", done, total)

    with clock.measure("network before"):
        return ModelBefore(network, described(recordings, network, options.seed, executor, of_it))


def write_extended(
    diagnosis: Diagnosis,
    out: Path,
    options: FitOptions,
    executor: Executor,
    progress: Progress,
    helper: Executor | None = None,
) -> Result:
    """The population of the network with what was found as an ordinary result: files, pictures and report.

    `helper` is another process, which draws some of the pictures.
    """
    from bayes_impedance.results.model_before import ModelBefore
    from bayes_impedance.results.result import save_result

    fit = diagnosis.fit
    assert fit is not None  # there is an extended network
    before = ModelBefore(diagnosis.verdict.network[0], diagnosis.before)
    with output_folder(out, extended_files(), options.overwrite):
        result = examined_result(fit, options, Clock(), executor, progress, (), helper, before)
        remove(out, extended_files())
        save_result(result, out)
        write_pages(result, out, (), progress, helper)
    return result


def write_pages(
    result: Result, out: Path, findings: Sequence[Finding], progress: Progress, helper: Executor | None = None
) -> None:
    """Pictures and report; `helper` is another process, which draws some of the pictures."""
    from bayes_impedance.plots import write_pictures
    from bayes_impedance.report import write_report

    progress("pictures and report", 0, 2)
    drawn = write_pictures(result, out / PICTURE_FOLDER, helper)
    progress("pictures and report", 1, 2)
    write_report(result, out, findings, drawn)
    progress("pictures and report", 2, 2)
