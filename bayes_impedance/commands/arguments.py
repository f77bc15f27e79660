"""Arguments of the commands: their names, types, defaults and help."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any, NoReturn

from bayes_impedance.commands.export_arguments import export_arguments
from bayes_impedance.commands.help_texts import add_examples
from bayes_impedance.commands.import_arguments import import_arguments
from bayes_impedance.commands.number_arguments import LARGEST_SEED, MOST_WORKERS, number, whole
from bayes_impedance.commands.shipped_names import dataset_path
from bayes_impedance.commands.terminal import tell
from bayes_impedance.errors import InputError
from bayes_impedance.units import HIGHEST_HZ, LOWEST_HZ

MOST_PEOPLE, MOST_REPETITIONS, MOST_POINTS = 1_000_000, 10_000, 1_000_000
"""Limits on each number of a simulation. By choice: far above any study; their product has a separate limit."""
LARGEST_NOISE = 100.0
"""Largest relative noise. By choice: at a hundred times the impedance, recordings hold practically no information."""


def parser_of_commands() -> argparse.ArgumentParser:
    """Parser of all commands; the name of the given command is the attribute `command` of the parsed arguments.

    It raises :class:`InputError` if arguments cannot be used.
    """
    parser = _Parser(
        prog="bayes-impedance",
        description="Population parameters of mechanical impedance networks, with honest uncertainty.",
        epilog="Exit status: 0 done, 1 failed or result not reliable, 2 bad input.",
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(title="commands", dest="command", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="everything: check, fit, pictures and one report")
    _dataset(run)
    _fit_arguments(run)
    _beside(run)
    _with(run)

    imports = commands.add_parser("import", help="signals or other programs' files to a dataset")
    import_arguments(imports)
    _overwrite(imports)

    check = commands.add_parser("check", help="what a dataset contains and what looks wrong in it")
    _dataset(check)
    check.add_argument("--network", help="notation, to tell accelerance and the like (default: the dataset's)")

    fit = commands.add_parser("fit", help="fit only: result.nc and summary.json")
    _dataset(fit)
    _fit_arguments(fit)
    _beside(fit)
    _with(fit)

    compare = commands.add_parser(
        "compare",
        help="the paper's methods in one table; with --networks, how well each network predicts people left out",
        description="Without --networks: the paper's methods and the population network in one table. With --networks: "
        "each network is fitted (results in OUT/1, OUT/2, ...) and each person is predicted from all others; "
        "networks.json and networks.csv give the difference of each network from the best one in predictive density, "
        "with its standard error over people.",
    )
    _dataset(compare)
    _fit_arguments(compare)
    compare.add_argument(
        "--networks",
        nargs="+",
        metavar="NETWORK",
        help="two or more, each of them a network in quotation marks, a text file with a network, the folder of a "
        "finished fit of the same recordings, or the verdict.json of a diagnosis (the network with what was missing)",
    )
    compare.add_argument(
        "--distributions",
        nargs="+",
        choices=("normal", "student_t", "mixture"),
        metavar="NAME",
        help="compare these distributions of people, such as normal, student_t and mixture, for each network (default: "
        "that of --distribution)",
    )
    compare.add_argument(
        "--noise-distributions",
        nargs="+",
        choices=("normal", "student_t"),
        metavar="NAME",
        help="compare noise with these distributions, such as normal and student_t, in the same way",
    )
    compare.add_argument("--result", type=Path, metavar="FOLDER", help="use this finished fit of the same recordings")
    compare.add_argument(
        "--full", dest="quick", action="store_false", help="as many draws as 'run' (default: fewer, as with --quick)"
    )
    compare.set_defaults(quick=True)

    covariates = commands.add_parser(
        "covariates",
        help="which elements follow which covariate, corrected for all that were tested",
        description="Tests every element of the network against every covariate of the dataset; writes covariates.json "
        "and covariates.csv. To estimate slopes that were found, use 'fit --covariate'.",
    )
    _dataset(covariates)
    _covariate_arguments(covariates)

    diagnose = commands.add_parser("diagnose", help="what the network leaves out: verdict.json and a report")
    _dataset(diagnose)
    _diagnose_arguments(diagnose)

    report = commands.add_parser("report", help="pictures and report of a finished fit")
    report.add_argument("out", type=Path, metavar="OUT", help="folder that 'run' or 'fit' has written")
    report.add_argument("--dataset", type=Path, help="the recordings, to list the findings of 'check'")
    _beside(report)
    _overwrite(report)

    export = commands.add_parser("export", help="design inputs from a finished fit: users, transfer, SPICE, stability")
    export_arguments(export)
    _overwrite(export)

    simulate = commands.add_parser("simulate", help="virtual recordings with known truth")
    simulate.add_argument("-o", "--out", type=Path, required=True, help="folder for the new dataset")
    simulate.add_argument(
        "--population",
        type=Path,
        help="summary.json of a fit, or truth.json (default: the population of virtual fingertips)",
    )
    simulate.add_argument(
        "--subjects", type=whole(MOST_PEOPLE), metavar="N", help="number of subjects (default: 71; of signals 8)"
    )
    simulate.add_argument(
        "--repetitions", type=whole(MOST_REPETITIONS), default=3, metavar="J", help="for each subject (default: 3)"
    )
    simulate.add_argument(
        "--points",
        type=whole(MOST_POINTS, at_least=3),
        metavar="F",
        help="number of frequencies (default: 401; of signals 30)",
    )
    simulate.add_argument(
        "--band",
        type=number(at_least=LOWEST_HZ, at_most=HIGHEST_HZ),
        nargs=2,
        default=(5.0, 5000.0),
        metavar=("LOW", "HIGH"),
        help="in Hz (default: 5 5000)",
    )
    simulate.add_argument(
        "--noise",
        type=number(at_least=0, at_most=LARGEST_NOISE),
        help="relative standard deviation of the noise of Re z and of Im z (default: 0.01)",
    )
    simulate.add_argument("--seed", type=whole(LARGEST_SEED, at_least=0), default=1, help="random seed (default: 1)")
    simulate.add_argument(
        "--signals",
        action="store_true",
        help="raw force and acceleration of a rig with errors instead of spectra, with an unloaded run and runs of two "
        "known masses, for 'import'",
    )
    _overwrite(simulate)
    add_examples(commands.choices)
    return parser


def option_names(command: str) -> dict[str, str]:
    """Options of a command: name of the attribute of the parsed arguments to the option as it is typed."""
    (commands,) = (a for a in parser_of_commands()._actions if isinstance(a, argparse._SubParsersAction))
    actions = commands.choices[command]._actions
    return {action.dest: action.option_strings[-1] for action in actions if action.option_strings}


def _dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "dataset",
        type=dataset_path,
        metavar="DATASET",
        help="folder with recordings.csv, one CSV file, or the name of shipped recordings: fingertip_71, appendix_a",
    )


def _with(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--with",
        dest="proposed",
        type=Path,
        metavar="VERDICT",
        help="verdict.json of a diagnosis: fit the network with what it found missing, and begin there too",
    )


def _fit_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder for the results (default: out)")
    parser.add_argument("--network", help='for instance "(n3|r3)-(m2|r1|n1)" (default: the one in dataset.toml)')
    parser.add_argument(
        "--covariance",
        choices=("full", "diagonal"),
        default="full",
        help="covariance of the elements between persons (default: full)",
    )
    parser.add_argument(
        "--distribution",
        choices=("normal", "student_t", "mixture"),
        default="normal",
        help="of people's log elements: student_t has heavier tails, its degrees of freedom inferred; mixture is two "
        "groups of people, which differ in their central values (default: normal)",
    )
    parser.add_argument(
        "--noise-distribution",
        choices=("normal", "student_t"),
        default="normal",
        help="of the noise: with student_t points far off count little, its degrees of freedom estimated (default: "
        "normal)",
    )
    parser.add_argument(
        "--covariate",
        action="append",
        default=[],
        metavar="NAME",
        help="covariate or column of text on which elements may depend, or interaction (age_y:sex); repeatable",
    )
    parser.add_argument(
        "--priors", type=Path, metavar="TOML", help="prior of elements, dispersions and correlations (default: broad)"
    )
    _subjects_and_seed(parser, "result")
    parser.add_argument("--quick", action="store_true", help="fewer draws, for a first look")
    _exact_calibration(parser)
    parser.add_argument("--resume", action="store_true", help="continue a fit that was interrupted")
    _overwrite(parser)
    _worker_arguments(parser)


def _subjects_and_seed(parser: argparse.ArgumentParser, what: str) -> None:
    parser.add_argument(
        "--subject", action="append", default=[], metavar="NAME", help="use only this subject; repeatable"
    )
    parser.add_argument(
        "--seed",
        type=whole(LARGEST_SEED, at_least=0),
        default=1,
        help=f"random seed (default: 1); the same seed gives the same {what}",
    )


def _exact_calibration(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--exact-calibration",
        action="store_true",
        help="take the calibration of imported recordings as exact (default: its error is carried on)",
    )


def _beside(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--beside",
        action="append",
        default=[],
        metavar="NAME",
        help="lay published values beside those of the fit, such as pen_grip_x; repeatable",
    )


def _covariate_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder for the tables (default: out)")
    parser.add_argument("--network", help="the network (default: the one in dataset.toml)")
    parser.add_argument(
        "--covariate",
        action="append",
        default=[],
        metavar="NAME",
        help="test only this covariate, column of text, or interaction; repeatable (default: all of the dataset)",
    )
    _subjects_and_seed(parser, "result")
    _overwrite(parser)
    _worker_arguments(parser)


def _diagnose_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("-o", "--out", type=Path, default=Path("out"), help="folder for the results (default: out)")
    parser.add_argument("--network", help="the network to be examined (default: the one in dataset.toml)")
    parser.add_argument(
        "--simulation",
        type=Path,
        metavar="DATASET",
        help="simulated population that is claimed to describe the recordings",
    )
    parser.add_argument(
        "--covariance",
        choices=("full", "diagonal"),
        default="full",
        help="claimed covariance between persons (default: full)",
    )
    parser.add_argument(
        "--covariate",
        action="append",
        default=[],
        metavar="NAME",
        help="test only whether elements follow this covariate; repeatable (default: every covariate of the dataset)",
    )
    parser.add_argument("--priors", type=Path, metavar="TOML", help="prior of the network's elements (default: broad)")
    _subjects_and_seed(parser, "verdict")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="faster: no held-out frequencies, and no computed proposals of separating measurements",
    )
    _exact_calibration(parser)
    parser.add_argument(
        "--resume", action="store_true", help="continue a diagnosis that was interrupted, from its fit of the network"
    )
    _overwrite(parser)
    _worker_arguments(parser)


def _overwrite(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--overwrite",
        action="store_true",
        help="also replace files that this package did not write, or that were changed since",
    )


def _worker_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments for parallel computation over persons, which do not change the result."""
    parser.add_argument(
        "--workers",
        type=whole(MOST_WORKERS),
        metavar="N",
        help="number of local processes that fit people (default: two threads of this process)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler whose workers fit people (needs the extra 'dask')",
    )


class _Parser(argparse.ArgumentParser):
    """A parser that reports errors in one line, like those of all other input."""

    def error(self, message: str) -> NoReturn:
        raise InputError(f"{message}; see {self.prog} --help")


class _Version(argparse.Action):
    """Print the version; it is looked up only here, because that takes time."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        tell(f"bayes-impedance {version('bayes_impedance')}")
        parser.exit()
