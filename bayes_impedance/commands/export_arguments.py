"""Arguments of ``export``."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_impedance.commands.number_arguments import LARGEST_SEED, MOST_WORKERS, number, whole
from bayes_impedance.commands.shipped_names import result_path

MOST_USERS, MOST_GAINS = 1_000_000, 1000
"""Most virtual users of an export, and most gains on each axis of its map. By choice: stability is computed for every
pair of gains and every user."""
LARGEST_DAMPING = 1e6
"""Largest virtual damping in N s/m. By choice: far above what devices can render."""


def export_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``export``."""
    parser.add_argument(
        "result",
        type=result_path,
        metavar="RESULT",
        help="folder that 'run' or 'fit' has written, or the name of the shipped population: fingertip_71",
    )
    parser.add_argument("-o", "--out", type=Path, default=Path("design"), help="folder for the files (default: design)")
    parser.add_argument(
        "--what",
        action="append",
        choices=("users", "transfer", "spice", "mat", "modelica", "people", "stability"),
        help="files to write; repeatable (default: all but people, the values of those who were recorded)",
    )
    parser.add_argument(
        "--users", type=whole(MOST_USERS), default=1000, metavar="N", help="number of virtual users (default: 1000)"
    )
    parser.add_argument(
        "--spanning",
        type=whole(MOST_USERS),
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
        type=number(at_least=0, at_most=LARGEST_DAMPING),
        default=0.0,
        metavar="B",
        help="damping of the virtual wall in N s/m (default: 0)",
    )
    parser.add_argument(
        "--share",
        type=number(above=0, below=1),
        default=0.99,
        help="share of users for whom the loop must be stable (default: 0.99)",
    )
    parser.add_argument(
        "--grid",
        type=whole(MOST_GAINS, at_least=2),
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
        type=whole(LARGEST_SEED, at_least=0),
        default=1,
        help="random seed (default: 1); the same seed gives the same users",
    )
    parser.add_argument(
        "--workers",
        type=whole(MOST_WORKERS),
        default=2,
        metavar="N",
        help="threads that compute the stability map (default: 2)",
    )
