"""The network that a diagnosis proposes, for ``run --with`` and ``compare --networks``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.result_folders import VERDICT_FILE
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.input_files import read_json

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.verdict_types import Verdict


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


def before_in(file: Path) -> dict[str, Any] | None:
    """Network and errors before anything was added, from the same file; None if the verdict has no comparison.

    Raises
    ------
    InputError
        If it is no verdict of this version.
    """
    from bayes_impedance.diagnosis.verdict_file import before_of

    return before_of(_read(file))


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
