"""The network that a diagnosis proposes, for ``run --with`` and ``compare --networks``, and the one it was added to."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.commands.result_folders import VERDICT_FILE
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.input_files import read_json

if TYPE_CHECKING:
    from bayes_impedance.commands.fit_options import FitOptions
    from bayes_impedance.diagnosis.verdict_types import Verdict
    from bayes_impedance.recordings.files import Recordings


def proposed_network(file: Path) -> str:
    """Notation of the network with everything that a diagnosis found missing.

    Parameters
    ----------
    file : Path
        A ``verdict.json``, or the folder that has one.

    Raises
    ------
    InputError
        If it is no verdict of this version, or what was found is no network.
    """
    verdict = _read(file)
    if verdict.extended_network is not None:
        return verdict.extended_network
    before, after = verdict.network
    effects = sorted({entry.id for entry in verdict.physics if entry.parameters})
    if effects and before == after:
        raise InputError(
            f"{_path(file)}: what was found ({', '.join(effects)}) cannot be written as a network; fit {before} "
            "without --with"
        )
    return after


def start_in(file: Path) -> dict[str, float] | None:
    """Values of the proposed network's parameters near which a fit begins; None if the verdict has none.

    Raises
    ------
    InputError
        If it is no verdict of this version.
    """
    verdict = _read(file)
    return None if verdict.start is None else dict(verdict.start)


def plain_in(file: Path) -> str | None:
    """Notation of the network without what the diagnosis found, from the same file; None if nothing was added.

    Raises
    ------
    InputError
        If it is no verdict of this version.
    """
    plain = _read(file).network[0]
    return None if proposed_network(file) == plain else plain


def plain_network(recordings: Recordings, options: FitOptions) -> str | None:
    """The network to which the fitted one adds something: that of the verdict, or the dataset's own if it is extended.

    Parameters
    ----------
    recordings : Recordings
    options : FitOptions
    """
    from bayes_impedance.network.additions import extends
    from bayes_impedance.network.notation import parse

    given, own = options.network, recordings.network
    if not options.with_before:
        return None
    if options.plain is not None:
        return options.plain
    if given is None or own is None:
        return None
    try:
        return own if extends(parse(given), parse(own)) else None
    except InputError:  # the dataset's own network cannot be read: it is not used
        return None


def _path(file: Path) -> Path:
    return file / VERDICT_FILE if file.is_dir() else file


def _read(file: Path) -> Verdict:
    from bayes_impedance.diagnosis.verdict_file import from_json

    path = _path(file)
    record = read_json(path, "diagnose the recordings again")
    try:
        return from_json(record)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
