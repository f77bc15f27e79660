"""The command line: arguments in, one job, a short text out. Nothing heavy is imported before it is needed."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.progress_bars import Bars
from bayes_impedance.errors import InputError, WorkerError

if TYPE_CHECKING:
    from bayes_impedance.results.result import Result

DONE, FAILED, BAD_INPUT = 0, 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command.

    Returns
    -------
    int
        0 done, 1 failed (or a result that must not be used), 2 bad input.
    """
    options = _parser().parse_args(arguments)
    try:
        return int(options.job(options))
    except InputError as error:
        _tell(f"error: {error}", sys.stderr)
        return BAD_INPUT
    except WorkerError as error:
        _tell(f"error: {error}", sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        _tell("\ninterrupted; the same command with --resume continues a fit where it was", sys.stderr)
        return FAILED
    except OSError as error:
        _tell(
            f"error: {error.filename or ''}: {error.strerror or error}; check the path, permissions and space",
            sys.stderr,
        )
        return FAILED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="bayes-impedance",
        description="Population parameters of mechanical impedance networks, with honest uncertainty.",
        epilog="Exit status: 0 done, 1 failed or result not reliable, 2 bad input.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="everything: check, fit, pictures and one report")
    _dataset(run)
    _fit_arguments(run)
    run.set_defaults(job=_run)

    check = commands.add_parser("check", help="what a dataset holds and what is odd about it")
    _dataset(check)
    check.set_defaults(job=_check)

    fit = commands.add_parser("fit", help="fit only: result.nc and summary.json")
    _dataset(fit)
    _fit_arguments(fit)
    fit.set_defaults(job=_fit)

    compare = commands.add_parser("compare", help="the paper's methods and the population network in one table")
    _dataset(compare)
    _fit_arguments(compare)
    compare.add_argument("--result", type=Path, metavar="FOLDER", help="finished fit of the same recordings to use")
    compare.add_argument("--full", dest="quick", action="store_false", help="as many draws as 'run'; default: --quick")
    compare.set_defaults(job=_compare, quick=True)

    diagnose = commands.add_parser("diagnose", help="what the network leaves out: verdict.json and a report")
    _dataset(diagnose)
    _diagnose_arguments(diagnose)
    diagnose.set_defaults(job=_diagnose)

    report = commands.add_parser("report", help="pictures and report of a finished fit")
    report.add_argument("out", type=Path, metavar="OUT", help="folder that 'run' or 'fit' has written")
    report.add_argument("--dataset", type=Path, help="the recordings, to list what is odd about them")
    report.set_defaults(job=_report)

    export = commands.add_parser("export", help="design inputs from a finished fit: users, transfer, SPICE, stability")
    _export_arguments(export)
    export.set_defaults(job=_export)

    simulate = commands.add_parser("simulate", help="virtual recordings with known truth")
    simulate.add_argument("-o", "--out", type=Path, required=True, help="folder for the new dataset")
    simulate.add_argument("--population", type=Path, help="summary.json of a fit or truth.json (default: fingertips)")
    simulate.add_argument("--subjects", type=_count, default=71, metavar="N", help="default: 71")
    simulate.add_argument("--repetitions", type=_count, default=3, metavar="J", help="default: 3")
    simulate.add_argument("--points", type=_count, default=401, metavar="F", help="frequencies; default: 401")
    simulate.add_argument("--band", type=float, nargs=2, default=(5.0, 5000.0), metavar=("LOW", "HIGH"), help="in Hz")
    simulate.add_argument("--noise", type=float, help="relative noise of each part (default: 0.01)")
    simulate.add_argument("--seed", type=_seed, default=1, help="default: 1")
    simulate.set_defaults(job=_simulate)
    return parser


def _dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder with recordings.csv, or one CSV file")


def _fit_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder for the results (default: out)")
    parser.add_argument("--network", help='for instance "(n3|r3)-(m2|r1|n1)"; default: the one in dataset.toml')
    parser.add_argument("--covariance", choices=("full", "diagonal"), default="full", help="between persons")
    parser.add_argument(
        "--covariate", action="append", default=[], metavar="NAME", help="elements follow it; repeatable"
    )
    parser.add_argument("--subject", action="append", default=[], metavar="NAME", help="use only this one; repeatable")
    parser.add_argument("--seed", type=_seed, default=1, help="default: 1; the same seed gives the same result")
    parser.add_argument("--quick", action="store_true", help="fewer draws: a first look")
    parser.add_argument("--resume", action="store_true", help="continue a fit that was interrupted")
    _worker_arguments(parser)


def _diagnose_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder for the results (default: out)")
    parser.add_argument("--network", help="the network as claimed; default: the one in dataset.toml")
    parser.add_argument(
        "--simulation", type=Path, metavar="DATASET", help="simulated population that claims to describe the recordings"
    )
    parser.add_argument(
        "--covariance", choices=("full", "diagonal"), default="full", help="claim about people; default: full"
    )
    parser.add_argument("--subject", action="append", default=[], metavar="NAME", help="use only this one; repeatable")
    parser.add_argument("--seed", type=_seed, default=1, help="default: 1; the same seed gives the same verdict")
    parser.add_argument("--quick", action="store_true", help="without held-out frequencies and without proposals")
    _worker_arguments(parser)


def _worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Who does what is done person by person; the result is the same."""
    parser.add_argument(
        "--workers", type=_count, metavar="N", help="local processes that fit people (default: two threads of this one)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler, whose workers fit people (extra: dask)")


def _export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that 'run' or 'fit' has written")
    parser.add_argument("-o", "--out", type=Path, default=Path("design"), help="folder for the files (default: design)")
    parser.add_argument(
        "--what",
        action="append",
        choices=("users", "transfer", "spice", "stability"),
        help="repeatable (default: all of them)",
    )
    parser.add_argument("--users", type=_count, default=1000, metavar="N", help="virtual users (default: 1000)")
    parser.add_argument("--spanning", type=_count, default=8, metavar="N", help="users who span the 95 %% region")
    parser.add_argument("--one-touch", action="store_true", help="users as in one touch, not as the mean of many")
    parser.add_argument(
        "--assume", action="append", default=[], metavar="NAME=VALUE", help="of an element not determined; repeatable"
    )
    parser.add_argument("--device", type=Path, metavar="TOML", help="device to be held (default: a PHANTOM 1.0)")
    parser.add_argument(
        "--damping", type=float, default=0.0, metavar="B", help="of the virtual wall, N s/m (default: 0)"
    )
    parser.add_argument("--share", type=float, default=0.99, help="of users who must be stable (default: 0.99)")
    parser.add_argument("--grid", type=_count, default=40, metavar="N", help="gains on each axis (default: 40)")
    parser.add_argument("--no-pictures", dest="pictures", action="store_false", help="tables only")
    parser.add_argument("--seed", type=_seed, default=1, help="default: 1; the same seed gives the same users")
    parser.add_argument("--workers", type=_count, default=2, metavar="N", help="threads of the map (default: 2)")


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not at least 1")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if value < 0:
        raise argparse.ArgumentTypeError("a seed is not negative")
    return value


class _Version(argparse.Action):
    """Print the version; looking it up costs time that other commands need not spend."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        _tell(f"bayes-impedance {version('bayes_impedance')}")
        parser.exit()


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
    from bayes_impedance.commands.jobs import compare_dataset

    with Bars() as bars:
        comparison = compare_dataset(
            options.dataset, options.out, _fit_options(options), options.result, options.resume, bars
        )
    for problem in comparison.problems:
        _tell(f"NOT RELIABLE (population rows): {problem}")
    _tell(f"\n{len(comparison.observed)} subject(s), network {comparison.network}")
    _tell("error of one curve for all (eq. 5), mean ± standard deviation over frequency\n")
    _tell(f"{'':32}{'the paper':20}{'|z|, ' + comparison.unit:>20}{'phase, deg':>20}  passive")
    for method in comparison.methods:
        errors = method.errors.summary()
        cells = [f"{errors[k]:.3g} ± {errors[k + '_sd']:.2g}" for k in ("delta_magnitude", "delta_phase_deg")]
        passive = "" if method.passivity is None else "yes" if method.passivity.positive_real else "no"
        _tell(f"{method.label:32}{method.paper:20}{cells[0]:>20}{cells[1]:>20}  {passive}".rstrip())
    mapping = comparison.mapping
    exact = "exactly" if any(s.positive for s in mapping.exact) else f"to {100 * mapping.distance:.2g} %"
    _tell(f"\nthe network meets the system identification's function {exact} over the band")
    shares = {} if comparison.normality is None else comparison.normality.summary()
    tested = {part: shares.get(f"chi_square_{part}", math.nan) for part in ("magnitude", "phase")}
    if all(math.isfinite(share) for share in tested.values()):
        told = ", ".join(f"{part} {100 * share:.0f} %" for part, share in tested.items())
        _tell(f"frequencies at which chi-square at 5 % finds impedances normal: {told} (95 % if all are)")
    _tell(f"\ntable: {options.out / 'comparison.json'}, .csv, .png")
    return FAILED if comparison.problems else DONE


def _diagnose(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import FitOptions, diagnose_dataset

    chosen = FitOptions(
        network=options.network,
        covariance=options.covariance,
        subjects=tuple(options.subject),
        seed=options.seed,
        quick=options.quick,
        workers=options.workers,
        scheduler=options.scheduler,
    )
    with Bars() as bars:
        diagnosis = diagnose_dataset(options.dataset, options.out, chosen, options.simulation, bars)
    verdict = diagnosis.verdict
    for remark in verdict.remarks:
        _tell(f"note: {remark}")
    if not verdict.reliable:
        _tell("NOT RELIABLE: the fit did not come to rest")
    _tell(f"\n{verdict.summary}\n")
    for entry in verdict.physics:
        _tell(f"{entry.id} at {entry.place} ({entry.side or 'rig or body not decided'}): {entry.name}")
        for name, row in entry.parameters.items():
            _tell(f"    {name:16} {row.median:.4g} ({row.q05:.4g} to {row.q95:.4g}) {row.unit}")
        for alias in [a for a in entry.aliases if not a.separated][:3]:
            _tell(f"    not told from    {alias.id} at {alias.place}; would separate: {alias.would_separate}")
    _tell(f"\nreport: {options.out / 'report.html'}, verdict: {options.out / 'verdict.json'}")
    return DONE if verdict.reliable else FAILED


def _report(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import report_result

    with Bars() as bars:
        result = report_result(options.out, bars, options.dataset)
    return _finish(result, f"report: {options.out / 'report.html'}")


def _export(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.export import PRODUCTS, ExportOptions, assumed, export_result

    chosen = ExportOptions(
        what=tuple(options.what or PRODUCTS),
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
    )
    with Bars() as bars:
        files, answer = export_result(options.result, options.out, chosen, bars)
    for file in files:
        _tell(str(file))
    if answer is not None:
        _tell(f"\n{answer}")
    return DONE


def _check(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import check_dataset

    description, warnings, findings = check_dataset(options.dataset)
    for key, value in description.items():
        shown = " to ".join(f"{v:.4g}" for v in dict.fromkeys(value)) if _is_range(value) else value
        _tell(f"{key.replace('_', ' '):14} {shown}")
    for warning in warnings:
        _tell(f"read: {warning}")
    for finding in findings:
        _tell(f"{finding.severity}: {finding.message}")
    if not findings:
        _tell("nothing odd was found")
    return DONE


def _simulate(options: argparse.Namespace) -> int:
    from bayes_impedance.commands.jobs import simulate_dataset

    simulate_dataset(
        options.out,
        options.population,
        options.subjects,
        options.repetitions,
        options.points,
        tuple(options.band),
        options.noise,
        options.seed,
    )
    _tell(f"{options.subjects} virtual subjects in {options.out}, the truth in {options.out / 'truth.json'}")
    return DONE


def _fit_options(options: argparse.Namespace) -> Any:
    from bayes_impedance.commands.jobs import FitOptions

    return FitOptions(
        network=options.network,
        covariance=options.covariance,
        covariates=tuple(options.covariate),
        subjects=tuple(options.subject),
        seed=options.seed,
        quick=options.quick,
        workers=options.workers,
        scheduler=options.scheduler,
    )


# -------------------------------------------------------------------- text


def _finish(result: Result, last: str) -> int:
    """Print what matters: problems first, then remarks, then the table."""
    summary = result.summary
    for problem in summary["problems"]:
        _tell(f"NOT RELIABLE: {problem}")
    for remark in summary["remarks"]:
        _tell(f"note: {remark}")
    _tell(f"\n{summary['subjects']} subject(s), network {summary['network']}\n")
    _tell(f"{'':6}{'unit':9}{'central value (90 %)':32}{'between persons':24}between repetitions")
    for name, element in summary["elements"].items():
        if not element["identified"]:
            _tell(f"{name:6}{element['unit']:9}not determined by these recordings")
            continue
        cells = [_interval(element["central"], ".3g")]
        cells += [_interval(element[f"dispersion_between_{level}"], ".2f") for level in ("persons", "repetitions")]
        _tell(f"{name:6}{element['unit']:9}{cells[0]:32}{cells[1]:24}{cells[2]}".rstrip())
    _tell("\ndispersions are standard deviations of the natural logarithm")
    _tell(f"\n{'error of one curve for all (eq. 5)':36}{'|z|, ' + summary['unit']:>16}{'phase, deg':>14}")
    for key, label in (
        ("population_network", "population network"),
        ("lookup_mean", "look-up table of the mean"),
        ("lookup_median", "look-up table of the median"),
    ):
        error = summary["errors"][key]
        _tell(f"{label:36}{error['delta_magnitude']:16.3g}{error['delta_phase_deg']:14.3g}")
    _tell(f"\n{last}")
    return FAILED if summary["problems"] else DONE


def _interval(values: dict[str, float | None], style: str) -> str:
    if values["median"] is None:
        return "-"
    return "{} ({} to {})".format(*(format(values[k], style) for k in ("median", "q05", "q95")))


def _is_range(value: object) -> bool:
    return isinstance(value, list | tuple) and all(isinstance(v, int | float) for v in value) and bool(value)


def _tell(text: str, stream: Any = None) -> None:
    (stream or sys.stdout).write(text + "\n")
