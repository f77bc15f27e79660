"""Examples and expected durations below the help of every command.

Durations are of two idle cores. Those of ``run`` and ``diagnose`` are measured in ``benchmarks/README.md`` and rounded
up; the others are rough, for knowing whether to wait or to come back.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from textwrap import fill

_WIDTH = 80
"""Characters of a line. By choice: the narrowest terminal in use."""

EXAMPLES: dict[str, tuple[tuple[str, ...], str]] = {
    "run": (
        (
            "bayes-impedance run fingertip_71 -o out/demo",
            'bayes-impedance run mine --network "m1|r1|n1" --quick -o out/first',
            "bayes-impedance run mine -o out/mine --resume",
        ),
        "71 people with 3 repetitions at 401 frequencies and 8 elements: about a minute; first time in an environment "
        "half a minute more, for compilation. It grows with the number of people; --quick takes about half.",
    ),
    "import": (
        (
            "bayes-impedance import spectra.csv -o mine",
            "bayes-impedance import run1.tdms --force 'ch0@22.4 mV/N' --motion 'ch1@10.2 mV/g' -o mine",
            "bayes-impedance import folder --subject-from-name '(?P<subject>[^_]+)_(?P<repetition>\\d+)' -o mine",
        ),
        "spectra: seconds; signals: about a second for ten megabytes.",
    ),
    "check": (
        ("bayes-impedance check fingertip_71", "bayes-impedance check mine"),
        "a second for 71 people.",
    ),
    "fit": (
        (
            'bayes-impedance fit mine -o out/mine --network "(n3|r3)-(m2|r1|n1)"',
            "bayes-impedance fit mine -o out/mine --covariate age_y --workers 8",
        ),
        "as 'run' without its pictures: about a minute for the shipped recordings.",
    ),
    "compare": (
        (
            "bayes-impedance compare fingertip_71 -o out/methods",
            'bayes-impedance compare mine -o out/networks --networks "m1|r1" "m1|r1|n1" out/mine',
            "bayes-impedance compare mine -o out/people --distributions normal student_t mixture",
            "bayes-impedance compare mine -o out/noise --noise-distributions normal student_t",
        ),
        "the paper's methods: about two minutes for the shipped recordings; with --networks one fit for each network, "
        "and one more for each person whom the others do not predict reliably.",
    ),
    "covariates": (
        ("bayes-impedance covariates mine -o out/covariates", "bayes-impedance covariates mine --covariate age_y"),
        "seconds to half a minute: the network is fitted once.",
    ),
    "diagnose": (
        (
            "bayes-impedance diagnose fingertip_71 -o out/diagnosis",
            "bayes-impedance diagnose mine --simulation simulated -o out/difference",
            "bayes-impedance diagnose mine -o out/first --quick",
        ),
        "half a minute for the shipped recordings, in which nothing is missing; minutes to half an hour where several "
        "effects are, because each is searched, fitted and held against its rivals.",
    ),
    "report": (
        ("bayes-impedance report out/demo", "bayes-impedance report out/mine --dataset mine"),
        "about half a minute.",
    ),
    "export": (
        (
            "bayes-impedance export fingertip_71 -o design --what users",
            "bayes-impedance export out/mine -o design",
            "bayes-impedance export out/mine -o design --what stability --device mine.toml --damping 2 --share 0.99",
        ),
        "a few seconds; with the stability map of 1000 users about half a minute.",
    ),
    "simulate": (
        (
            "bayes-impedance simulate -o virtual --subjects 20 --points 60 --seed 3",
            "bayes-impedance simulate -o virtual --population out/mine/summary.json",
            "bayes-impedance simulate --signals -o raw --subjects 4 --band 50 5000",
        ),
        "seconds; signals about a second for each recording.",
    ),
}
"""Command to its examples, and to the time it takes."""


def add_examples(commands: Mapping[str, argparse.ArgumentParser]) -> None:
    """Write examples and durations below the help of each command; examples keep their lines."""
    for name, parser in commands.items():
        examples, duration = EXAMPLES[name]
        shown = "\n".join(f"  {example}" for example in examples)
        parser.formatter_class = argparse.RawDescriptionHelpFormatter  # which fills nothing itself
        parser.description = parser.description and fill(parser.description, _WIDTH)
        told = fill(duration, _WIDTH, initial_indent="  ", subsequent_indent="  ")
        parser.epilog = f"examples:\n{shown}\n\nexpected duration:\n{told}".replace("%", "%%")  # argparse formats it
