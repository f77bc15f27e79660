"""The command line: one job for each command, and a short text. Large modules are imported only when needed."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.arguments import parser_of_commands
from bayes_impedance.commands.progress_bars import Bars
from bayes_impedance.commands.result_text import tell_result
from bayes_impedance.commands.terminal import complain, prepare_streams, sentence_of, tell
from bayes_impedance.errors import BusyError, InputError, WorkerError
from bayes_impedance.runtime.freed_memory import return_freed_memory
from bayes_impedance.units import counted

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.verdict_types import Verdict
    from bayes_impedance.results.result import Result

DONE, FAILED, BAD_INPUT = 0, 1, 2
"""Exit status; wrong arguments count as bad input."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 done, 1 failed (or a result that must not be used), 2 bad input.
    """
    prepare_streams()
    return_freed_memory()
    try:
        options = parser_of_commands().parse_args(arguments)
        return _JOBS[options.command](options)
    except InputError as error:
        complain(f"error: {error}")
        return BAD_INPUT
    except (WorkerError, BusyError) as error:
        complain(f"error: {error}")
        return FAILED
    except KeyboardInterrupt as stop:
        complain(f"interrupted; {' '.join(map(str, stop.args)) or 'nothing was kept: start the command again'}")
        return FAILED
    except MemoryError:
        complain("error: there is not enough memory; use fewer subjects, points, users or gains")
        return FAILED
    except OSError as error:
        complain(f"error: {sentence_of(error)}")
        return FAILED


# -------------------------------------------------------------------- jobs


def _run(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import run_dataset
    from bayes_impedance.runtime.worker_processes import Processes

    with Bars() as bars, Processes(1) as helper:
        result = run_dataset(options.dataset, options.out, _fit_options(options), options.resume, bars, helper)
    return _finish(result, f"report: {options.out / 'report.html'}")


def _fit(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import fit_dataset

    with Bars() as bars:
        result = fit_dataset(options.dataset, options.out, _fit_options(options), options.resume, bars)
    return _finish(result, f"summary: {options.out / 'summary.json'}")


def _compare(options: argparse.Namespace) -> int:
    if any(getattr(options, name) is not None for name in ("networks", "distributions", "noise_distributions")):
        return _compare_networks(options)
    from bayes_impedance.commands.comparison import compare_dataset
    from bayes_impedance.network.spellings import in_both

    with Bars() as bars:
        comparison = compare_dataset(
            options.dataset, options.out, _fit_options(options), options.result, options.resume, bars
        )
    for problem in comparison.problems:
        tell(f"NOT RELIABLE (population rows): {problem}")
    tell()
    tell(f"{counted(len(comparison.observed), 'subject')}, network {in_both(comparison.network, comparison.unit)}")
    tell("error of one curve for all (eq. 5), mean ± standard deviation over frequency")
    tell()
    tell(f"{'':32}{'the paper':20}{'|z|, ' + comparison.unit:>20}{'phase, deg':>20}  passive")
    for method in comparison.methods:
        errors = method.errors.summary()
        cells = [f"{errors[k]:.3g} ± {errors[k + '_sd']:.2g}" for k in ("delta_magnitude", "delta_phase_deg")]
        passive = "" if method.passivity is None else "yes" if method.passivity.positive_real else "no"
        tell(f"{method.label:32}{method.paper:20}{cells[0]:>20}{cells[1]:>20}  {passive}".rstrip())
    mapping = comparison.mapping
    exact = "exactly" if any(s.positive for s in mapping.exact) else f"to {100 * mapping.distance:.2g} %"
    tell()
    tell(f"the network reproduces the function of the system identification {exact} over the band")
    shares = {} if comparison.normality is None else comparison.normality.summary()
    tested = {part: shares.get(f"chi_square_{part}", math.nan) for part in ("magnitude", "phase")}
    if all(math.isfinite(share) for share in tested.values()):
        told = ", ".join(f"{part} {100 * share:.0f} %" for part, share in tested.items())
        tell(
            f"share of frequencies at which the chi-square test at 5 % does not reject normality: {told} (expected: 95 "
            "%)"
        )
    tell()
    tell(f"table: {options.out / 'comparison.json'}, .csv, .png")
    return FAILED if comparison.problems else DONE


def _compare_networks(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.network_comparison import compare_networks, lines_of

    for name in ("network", "result"):
        if options.networks is not None and getattr(options, name) is not None:
            raise InputError(
                f"--{name} and --networks exclude each other: give it as one of the networks of --networks"
            )
    with Bars() as bars:
        kinds = options.distributions or (), options.noise_distributions or ()
        comparison = compare_networks(
            options.dataset, options.out, options.networks or (), _fit_options(options), options.resume, bars, *kinds
        )
    for line in lines_of(comparison):
        tell(line)
    tell()
    tell(f"table: {options.out / 'networks.json'}, .csv")
    return FAILED if any(entry.result.problems for entry in comparison.entries) else DONE


def _covariates(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.covariate_search import lines_of, search_dataset
    from bayes_impedance.commands.fit_options import FitOptions

    chosen = FitOptions(
        network=options.network,
        covariates=tuple(options.covariate),
        subjects=tuple(options.subject),
        seed=options.seed,
        workers=options.workers,
        scheduler=options.scheduler,
        overwrite=options.overwrite,
    )
    with Bars() as bars:
        found = search_dataset(options.dataset, options.out, chosen, bars)
    for line in lines_of(found):
        tell(line)
    tell(f"table: {options.out / 'covariates.json'}, .csv")
    return DONE


def _diagnose(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.fit_options import FitOptions
    from bayes_impedance.commands.jobs import diagnose_dataset
    from bayes_impedance.population.given_prior import read_prior
    from bayes_impedance.runtime.worker_processes import Processes

    chosen = FitOptions(
        network=options.network,
        covariance=options.covariance,
        covariates=tuple(options.covariate),
        subjects=tuple(options.subject),
        seed=options.seed,
        quick=options.quick,
        exact_calibration=options.exact_calibration,
        workers=options.workers,
        scheduler=options.scheduler,
        overwrite=options.overwrite,
        prior=None if options.priors is None else read_prior(options.priors),
    )
    with Bars() as bars, Processes(1) as helper:
        diagnosis = diagnose_dataset(
            options.dataset, options.out, chosen, options.simulation, options.resume, bars, helper
        )
    _tell_verdict(diagnosis.verdict)
    tell(f"report: {options.out / 'diagnosis.html'}, verdict: {options.out / 'verdict.json'}")
    return DONE if diagnosis.verdict.reliable else FAILED


def _tell_verdict(verdict: Verdict) -> None:
    """Print a verdict. What was found is listed only if it can be relied on; `verdict.json` has it for the search."""
    from bayes_impedance.diagnosis.verdict.sentence import body_of
    from bayes_impedance.network.spellings import in_both

    body = body_of(verdict.unit)
    sides = {"rig": "rig", "body": body}
    if not verdict.reliable:
        tell(f"NOT RELIABLE: {verdict.shortcomings[0] if verdict.shortcomings else 'the fit did not converge'}")
    for remark in verdict.remarks:
        if verdict.reliable or remark not in verdict.shortcomings[:1]:
            tell(f"note: {remark}")
    tell()
    tell(f"{verdict.summary}")
    tell()
    tell(f"network {in_both(verdict.network[0], verdict.unit)}")
    extended = verdict.extended_network or verdict.network[1]
    if verdict.reliable and extended != verdict.network[0]:
        tell(f"with what was found: {in_both(extended, verdict.unit)}")
    tell()
    if not verdict.reliable:
        return
    for entry in verdict.physics:
        tell(f"{entry.id} at {entry.place} ({sides.get(entry.side or '', f'rig or {body} not decided')}): {entry.name}")
        for name, row in entry.parameters.items():
            tell(f"    {name:16} {row.median:.4g} ({row.q05:.4g} to {row.q95:.4g}) {row.unit}")
        for alias in [a for a in entry.aliases if not a.separated][:3]:
            tell(f"    not separated from {alias.id} at {alias.place}; this would: {alias.would_separate}")
    if verdict.physics:
        tell()


def _report(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import report_result

    with Bars() as bars:
        result = report_result(options.out, bars, options.dataset, options.overwrite, _beside(options))
    return _finish(result, f"report: {options.out / 'report.html'}")


def _export(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.export import DESIGN_INPUTS, ExportOptions, assumed, export_result

    chosen = ExportOptions(
        what=tuple(options.what or DESIGN_INPUTS),
        users=options.users,
        seed=options.seed,
        spanning=options.spanning,
        repetitions=options.one_touch,
        assume=assumed(options.assume),
        device=options.device,
        damping=options.damping,
        share=options.share,
        grid=options.grid,
        pictures=options.pictures,
        workers=options.workers,
        overwrite=options.overwrite,
        unreliable=options.unreliable,
    )
    with Bars() as bars:
        files, notes, answer = export_result(options.result, options.out, chosen, bars)
    for file in files:
        tell(str(file))
    for note in notes:
        tell(f"note: {note}")
    if answer is not None:
        tell()
        tell(f"{answer}")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.checking import check_dataset
    from bayes_impedance.network.spellings import in_both

    description, _, findings = check_dataset(options.dataset, options.network)
    for key, value in description.items():
        if key == "network" and value:
            value = in_both(value, description["unit"])
        shown = " to ".join(f"{v:.4g}" for v in dict.fromkeys(value)) if _is_range(value) else value
        label = key.replace("_hz", ", Hz").replace("_", " ")
        tell(f"{label:14} {(', '.join(map(str, value)) or 'none') if isinstance(shown, list) else shown}")
    for finding in findings:
        tell(f"{finding.severity}: {finding.message}")
    if not findings:
        tell("no problem was found")
    return DONE


def _import(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.import_files import import_dataset, recorded_arguments, recorded_digests

    digests: dict[str, str] | None = None
    if options.again is not None:
        if options.sources:
            raise InputError("SOURCE and --again exclude each other; leave one out")
        digests = recorded_digests(options.again)
        words = ["import", *recorded_arguments(options.again), "-o", str(options.out)]
        options = parser_of_commands().parse_args([*words, *(["--overwrite"] if options.overwrite else [])])
    with Bars() as bars:
        imported = import_dataset(options, bars)
    changed = [] if digests is None else [name for name, digest in imported.sources if digests.get(name) != digest]
    for note in (*imported.notes, *(f"{name}: has changed since the first import" for name in changed)):
        tell(f"note: {note}")
    subjects = imported.recordings.subjects
    points = sorted({subject.frequency_hz.size for subject in subjects})
    count = f"{points[0]}" if len(points) == 1 else f"{points[0]} to {points[-1]}"
    tell(
        f"{counted(len(subjects), 'subject')}, up to {counted(imported.recordings.repetitions_max, 'repetition')}, "
        f"{count} frequencies, z in {imported.recordings.unit}: {options.out}"
    )
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.simulate import simulate_dataset

    lines = simulate_dataset(
        options.out,
        options.population,
        options.subjects,
        options.repetitions,
        options.points,
        tuple(options.band),
        options.noise,
        options.seed,
        options.signals,
        options.overwrite,
    )
    for line in lines:
        tell(line)
    return DONE


_JOBS = {
    "run": _run,
    "import": _import,
    "check": _check,
    "fit": _fit,
    "compare": _compare,
    "covariates": _covariates,
    "diagnose": _diagnose,
    "report": _report,
    "export": _export,
    "simulate": _simulate,
}


def _fit_options(options: argparse.Namespace) -> Any:
    from bayes_impedance.commands.fit_options import FitOptions
    from bayes_impedance.commands.proposed_network import plain_in, proposed_network, start_in
    from bayes_impedance.population.given_prior import read_prior

    network, proposed, plain, start = options.network, getattr(options, "proposed", None), None, None
    if proposed is not None:
        if network is not None:
            raise InputError(
                "--network and --with exclude each other, because each names the network to fit; leave one out"
            )
        network, plain, start = proposed_network(proposed), plain_in(proposed), start_in(proposed)
        tell(f"network: {network}")
    return FitOptions(
        network=network,
        start=start,
        covariance=options.covariance,
        covariates=tuple(options.covariate),
        subjects=tuple(options.subject),
        seed=options.seed,
        quick=options.quick,
        exact_calibration=options.exact_calibration,
        workers=options.workers,
        scheduler=options.scheduler,
        overwrite=options.overwrite,
        plain=plain,
        prior=None if options.priors is None else read_prior(options.priors),
        distribution=options.distribution,
        noise_distribution=options.noise_distribution,
        beside=_beside(options),
    )


def _beside(options: argparse.Namespace) -> tuple[str, ...]:
    """Names of published sets, each of which exists."""
    from bayes_impedance.datasets.published_sets import published_set

    return tuple(published_set(name).name for name in getattr(options, "beside", ()))


# -------------------------------------------------------------------- text


def _finish(result: Result, last: str) -> int:
    """Print the result, and tell whether its numbers may be used."""
    tell_result(result, last)
    return FAILED if result.summary["problems"] else DONE


def _is_range(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(v, int | float) for v in value) and bool(value)
