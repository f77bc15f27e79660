"""Arguments of the command ``import``."""

from __future__ import annotations

import argparse
from pathlib import Path

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import shown

LARGEST_OVERLAP = 0.95
"""Of a segment. By choice: more gives the same spectra and only takes longer."""
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
    _signals(parser.add_argument_group("signals"))
    _calibration(parser.add_argument_group("calibration"))


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
        "--recipe", metavar="NAME", help="columns of gamry, biologic, zview, z60w, autolab, zahner, chi, or a TOML file"
    )
    group.add_argument(
        "--form", help="receptance, mobility, accelerance, dynamic stiffness, impedance or apparent mass (or: by unit)"
    )
    group.add_argument("--unit", help="of the values, e.g. 'm/s^2/N', 'g/lbf', 'mm/N', 'N m s/rad', 'ohm'")
    group.add_argument("--frequency-unit", metavar="UNIT", help="of the frequencies, e.g. kHz or rad/s (default: Hz)")
    group.add_argument("--conjugated", action="store_true", help="the files use exp(-jwt): take the conjugate")
    group.add_argument("--negated", action="store_true", help="force or motion is counted the other way")
    group.add_argument(
        "--driving-point", action="store_true", help="force and motion are of one place, although it looks otherwise"
    )
    group.add_argument(
        "--stopped-sweeps",
        action="store_true",
        help="sweeps were stopped early where a file has only the first frequencies of the others: it was not cut",
    )
    group.add_argument(
        "--averages",
        type=_averages,
        metavar="N",
        help="number of averages behind the files' noise_sd, or behind their coherence, which then gives noise_sd",
    )


def _signals(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--force",
        metavar="CHANNEL",
        help="force, torque or what stands for it: NAME[N], or NAME@22.4 mV/N with a sensitivity (default: by units)",
    )
    group.add_argument("--motion", metavar="CHANNEL", help="acceleration, velocity or displacement: NAME[g], ...")
    group.add_argument("--reference", metavar="NAME", help="signal sent to the exciter: its lines are the excited ones")
    group.add_argument("--sampling-rate", type=_positive, metavar="HZ", help="if the file does not say it")
    group.add_argument(
        "--excitation",
        choices=("periodic", "stepped sine", "noise", "hammer"),
        help="(default: found out, except stepped sines)",
    )
    group.add_argument(
        "--estimator",
        choices=("H1", "H2", "Hv", "local polynomial"),
        default="H1",
        help="of noise and hits (default: H1); periodic excitation has its own",
    )
    group.add_argument(
        "--window", choices=("hann", "hamming", "blackman", "flattop", "boxcar"), help="of noise (default: hann)"
    )
    group.add_argument("--segment", type=_positive, metavar="S", help="seconds of each segment or hit")
    group.add_argument("--overlap", type=_share, default=0.5, help="of segments of noise (default: 0.5)")
    group.add_argument("--period", type=_positive, metavar="S", help="seconds (default: found out)")
    group.add_argument(
        "--drop-periods",
        type=_count,
        metavar="N",
        help="leading periods to leave out (default: until they settle; 5 of each step)",
    )
    group.add_argument("--band", type=_positive, nargs=2, metavar=("LOW", "HIGH"), help="frequencies to keep, in Hz")


def _calibration(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--unloaded",
        type=Path,
        nargs="+",
        action="extend",
        default=[],
        metavar="RUN",
        help="files or folders recorded without a load: subtracted (each from the recording of its subject and "
        "repetition, if there is one for all), or the open load of --known-load",
    )
    group.add_argument(
        "--known-load",
        nargs="+",
        action="extend",
        default=[],
        metavar="LOAD:RUN",
        help="runs with known loads, e.g. open:empty.csv 'mass=10 g:ten.csv' 'mass=30 g:thirty.csv' (or stiffness, "
        "damper): gain, skew, seismic mass and mount of the rig are found and taken out",
    )
    group.add_argument(
        "--rig",
        choices=("smooth", "each frequency"),
        help="how known loads are used: few parameters for all frequencies, or a two-port of each (default: the first "
        "if it describes the runs)",
    )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a number above zero")
    return value


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 <= value <= LARGEST_OVERLAP:
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a number from 0 to {LARGEST_OVERLAP}")
    return value


def _count(text: str) -> int:
    digits = text.strip()
    if not (digits.isascii() and digits.isdigit() and len(digits) <= 9):
        raise argparse.ArgumentTypeError(f"{shown(text)} is not a whole number from 0")
    return int(digits)


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
