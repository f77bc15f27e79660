"""Arguments of the commands: their names, types, defaults and help."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from bayes_impedance.commands.import_arguments import import_arguments
from bayes_impedance.commands.terminal import tell
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import number_in, shown
from bayes_impedance.units import HIGHEST_HZ, LOWEST_HZ

LARGEST_SEED = 2**63 - 1
"""Largest signed 64-bit integer, the type in which results keep the seed."""
MOST_WORKERS = 1024
"""Most worker processes. By choice: each takes some hundred megabytes, and few machines have more processors."""
MOST_PEOPLE, MOST_REPETITIONS, MOST_POINTS = 1_000_000, 10_000, 1_000_000
"""Limits on each number of a simulation. By choice: far above any study; their product has a separate limit."""
MOST_USERS, MOST_GAINS = 1_000_000, 1000
"""Most virtual users of an export, and most gains on each axis of its map. By choice: stability is computed for every
pair of gains and every user."""
LARGEST_NOISE = 100.0
"""Largest relative noise. By choice: at a hundred times the impedance, recordings hold practically no information."""
LARGEST_DAMPING = 1e6
"""Largest virtual damping in N s/m. By choice: far above what devices can render."""


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
    compare.add_argument("--result", type=Path, metavar="FOLDER", help="use this finished fit of the same recordings")
    compare.add_argument(
        "--full", dest="quick", action="store_false", help="as many draws as 'run' (default: fewer, as with --quick)"
    )
    compare.set_defaults(quick=True)

    diagnose = commands.add_parser("diagnose", help="what the network leaves out: verdict.json and a report")
    _dataset(diagnose)
    _diagnose_arguments(diagnose)

    report = commands.add_parser("report", help="pictures and report of a finished fit")
    report.add_argument("out", type=Path, metavar="OUT", help="folder that 'run' or 'fit' has written")
    report.add_argument("--dataset", type=Path, help="the recordings, to list the findings of 'check'")
    _overwrite(report)

    export = commands.add_parser("export", help="design inputs from a finished fit: users, transfer, SPICE, stability")
    _export_arguments(export)

    simulate = commands.add_parser("simulate", help="virtual recordings with known truth")
    simulate.add_argument("-o", "--out", type=Path, required=True, help="folder for the new dataset")
    simulate.add_argument(
        "--population",
        type=Path,
        help="summary.json of a fit, or truth.json (default: the population of virtual fingertips)",
    )
    simulate.add_argument(
        "--subjects", type=_whole(MOST_PEOPLE), metavar="N", help="number of subjects (default: 71; of signals 8)"
    )
    simulate.add_argument(
        "--repetitions", type=_whole(MOST_REPETITIONS), default=3, metavar="J", help="for each subject (default: 3)"
    )
    simulate.add_argument(
        "--points",
        type=_whole(MOST_POINTS, at_least=3),
        metavar="F",
        help="number of frequencies (default: 401; of signals 30)",
    )
    simulate.add_argument(
        "--band",
        type=_number(at_least=LOWEST_HZ, at_most=HIGHEST_HZ),
        nargs=2,
        default=(5.0, 5000.0),
        metavar=("LOW", "HIGH"),
        help="in Hz (default: 5 5000)",
    )
    simulate.add_argument(
        "--noise",
        type=_number(at_least=0, at_most=LARGEST_NOISE),
        help="relative standard deviation of the noise of Re z and of Im z (default: 0.01)",
    )
    simulate.add_argument("--seed", type=_whole(LARGEST_SEED, at_least=0), default=1, help="random seed (default: 1)")
    simulate.add_argument(
        "--signals",
        action="store_true",
        help="raw force and acceleration of a rig with errors instead of spectra, with an unloaded run and runs of two "
        "known masses, for 'import'",
    )
    _overwrite(simulate)
    return parser


def option_names(command: str) -> dict[str, str]:
    """Options of a command: name of the attribute of the parsed arguments to the option as it is typed."""
    (commands,) = (a for a in parser_of_commands()._actions if isinstance(a, argparse._SubParsersAction))
    actions = commands.choices[command]._actions
    return {action.dest: action.option_strings[-1] for action in actions if action.option_strings}


def _dataset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", type=Path, metavar="DATASET", help="folder with recordings.csv, or one CSV file")


def _with(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--with",
        dest="proposed",
        type=Path,
        metavar="VERDICT",
        help="verdict.json of a diagnosis: fit the network with everything that it found missing",
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
        "--covariate",
        action="append",
        default=[],
        metavar="NAME",
        help="covariate on which the elements may depend; repeatable",
    )
    parser.add_argument(
        "--subject", action="append", default=[], metavar="NAME", help="use only this subject; repeatable"
    )
    parser.add_argument(
        "--seed",
        type=_whole(LARGEST_SEED, at_least=0),
        default=1,
        help="random seed (default: 1); the same seed gives the same result",
    )
    parser.add_argument("--quick", action="store_true", help="fewer draws, for a first look")
    parser.add_argument(
        "--exact-calibration",
        action="store_true",
        help="take the calibration of imported recordings as exact (default: its error is estimated along)",
    )
    parser.add_argument("--resume", action="store_true", help="continue a fit that was interrupted")
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
        "--subject", action="append", default=[], metavar="NAME", help="use only this subject; repeatable"
    )
    parser.add_argument(
        "--seed",
        type=_whole(LARGEST_SEED, at_least=0),
        default=1,
        help="random seed (default: 1); the same seed gives the same verdict",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="faster: no held-out frequencies, and no computed proposals of separating measurements",
    )
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
        type=_whole(MOST_WORKERS),
        metavar="N",
        help="number of local processes that fit people (default: two threads of this process)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of a Dask scheduler whose workers fit people (needs the extra 'dask')",
    )


def _export_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("result", type=Path, metavar="RESULT", help="folder that 'run' or 'fit' has written")
    parser.add_argument("-o", "--out", type=Path, default=Path("design"), help="folder for the files (default: design)")
    parser.add_argument(
        "--what",
        action="append",
        choices=("users", "transfer", "spice", "stability"),
        help="files to write; repeatable (default: all)",
    )
    parser.add_argument(
        "--users", type=_whole(MOST_USERS), default=1000, metavar="N", help="number of virtual users (default: 1000)"
    )
    parser.add_argument(
        "--spanning",
        type=_whole(MOST_USERS),
        default=8,
        metavar="N",
        help="number of users chosen to span the 95 %% region (default: 8)",
    )
    parser.add_argument(
        "--one-touch",
        action="store_true",
        help="draw users as in one touch, with the dispersion between repetitions; default: the mean of many touches",
    )
    parser.add_argument(
        "--assume",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="value of an element that the recordings do not determine; repeatable",
    )
    parser.add_argument(
        "--device", type=Path, metavar="TOML", help="device that the users hold (default: a PHANTOM 1.0)"
    )
    parser.add_argument(
        "--damping",
        type=_number(at_least=0, at_most=LARGEST_DAMPING),
        default=0.0,
        metavar="B",
        help="damping of the virtual wall in N s/m (default: 0)",
    )
    parser.add_argument(
        "--share",
        type=_number(above=0, below=1),
        default=0.99,
        help="share of users for whom the loop must be stable (default: 0.99)",
    )
    parser.add_argument(
        "--grid",
        type=_whole(MOST_GAINS, at_least=2),
        default=40,
        metavar="N",
        help="gains on each axis of the stability map (default: 40)",
    )
    parser.add_argument(
        "--unreliable",
        action="store_true",
        help="export a fit although it is not reliable; every file carries the warning",
    )
    parser.add_argument("--no-pictures", dest="pictures", action="store_false", help="write tables only")
    parser.add_argument(
        "--seed",
        type=_whole(LARGEST_SEED, at_least=0),
        default=1,
        help="random seed (default: 1); the same seed gives the same users",
    )
    parser.add_argument(
        "--workers",
        type=_whole(MOST_WORKERS),
        default=2,
        metavar="N",
        help="threads that compute the stability map (default: 2)",
    )
    _overwrite(parser)


def _whole(at_most: int, at_least: int = 1) -> Callable[[str], int]:
    """Reader of a whole number within a range."""

    def read(text: str) -> int:
        # Every allowed number has at most twenty digits; Python refuses to convert thousands of digits.
        digits = text.strip().removeprefix("+")
        value = int(digits) if digits.isascii() and digits.isdigit() and len(digits) <= 20 else -1
        if not at_least <= value <= at_most:
            raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number from {at_least} to {at_most}")
        return value

    return read


def _number(**bounds: float) -> Callable[[str], float]:
    """Reader of a finite number within a range."""

    def read(text: str) -> float:
        try:
            value: object = float(text)
        except ValueError:
            value = text
        try:
            return number_in(value, "it", **bounds)
        except InputError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


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
