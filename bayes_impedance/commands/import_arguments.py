"""Arguments of the command ``import``."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import shown

MOST_AVERAGES = 1_000_000
"""Most averages behind a spectrum. By choice: far above any measurement."""


def import_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``import``."""
    parser.add_argument(
        "sources",
        type=Path,
        nargs="*",
        metavar="SOURCE",
        help="files or folders: CSV and other text, xlsx, mat, npz, UFF 58, s1p, lvm, wav, tdms",
    )
    parser.add_argument("-o", "--out", type=Path, required=True, metavar="DATASET", help="folder for the new dataset")
    parser.add_argument(
        "--again", type=Path, metavar="DATASET", help="take sources and options from the dataset.toml of an import"
    )
    parser.add_argument("--title", default="", help="title of the dataset")
    parser.add_argument("--source", default="", help="where the recordings come from")
    parser.add_argument("--licence", default="", help="their licence")
    parser.add_argument("--network", help="network with which they are usually described")
    parser.add_argument("--subjects", type=Path, metavar="FILE", help="table of the subjects' covariates")
    _names_and_tables(parser.add_argument_group("files"))
    _spectra(parser.add_argument_group("spectra"))


def _names_and_tables(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--subject-from-name",
        dest="who",
        metavar="REGEX",
        help="named groups subject, repetition, realisation (others are noted) of a file's name, for instance "
        "'(?P<subject>[^_]+)_(?P<repetition>\\d+)' (default: the name is the subject)",
    )
    group.add_argument("--record", metavar="NAME", help="sheet, group or record, of files with several")
    group.add_argument(
        "--separator", choices=("tab", "semicolon", "comma", "bar", "space"), help="of text (default: found out)"
    )
    group.add_argument("--decimal", choices=("point", "comma"), help="decimal mark of text (default: found out)")
    group.add_argument("--encoding", help="of text (default: UTF-8 or UTF-16 by its mark, else cp1252)")


def _spectra(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--columns",
        nargs="+",
        action="extend",
        default=[],
        metavar="ROLE=NAME",
        help="columns by name or number, with unit and sign: frequency=f[kHz] real=Re imaginary=-Im, or magnitude, "
        "phase[deg], complex, subject, repetition, coherence, noise_sd (default: guessed where clear)",
    )
    group.add_argument(
        "--recipe", metavar="NAME", help="columns of gamry, biologic, zview, autolab, zahner, chi, or a TOML file"
    )
    group.add_argument(
        "--form", help="receptance, mobility, accelerance, dynamic stiffness, impedance or apparent mass (or: by unit)"
    )
    group.add_argument("--unit", help="of the values, e.g. 'm/s^2/N', 'g/lbf', 'mm/N', 'N m s/rad', 'ohm'")
    group.add_argument("--frequency-unit", metavar="UNIT", help="of the frequencies, e.g. kHz or rad/s (default: Hz)")
    group.add_argument("--conjugated", action="store_true", help="the files use exp(-jwt): take the conjugate")
    group.add_argument("--negated", action="store_true", help="force or motion is counted the other way")
    group.add_argument(
        "--averages", type=_averages, metavar="N", help="number of averages behind the files' coherence: gives noise_sd"
    )


def _averages(text: str) -> int:
    digits = text.strip()
    if not (digits.isascii() and digits.isdigit() and 2 <= int(digits[:9]) <= MOST_AVERAGES):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number from 2 to {MOST_AVERAGES}")
    return int(digits)


def require_sources(sources: list[Path]) -> None:
    """Refuse an import of nothing.

    Raises
    ------
    InputError
        If there is no source.
    """
    if not sources:
        raise InputError("no SOURCE is given; name the files to import, or a dataset with --again")
