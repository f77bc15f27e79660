"""The network that a diagnosis proposes, for ``run --with`` and ``compare --networks``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.input_files import read_json

_REMEDY = "diagnose the recordings again"


def proposed_network(file: Path) -> str:
    """Notation of the network with everything that a diagnosis found missing.

    Parameters
    ----------
    file : Path
        A ``verdict.json``, or the folder that has one.

    Raises
    ------
    InputError
        If it is no verdict, or what was found is no network.
    """
    path = file / "verdict.json" if file.is_dir() else file
    record = read_json(path, _REMEDY)
    networks = record.get("network")
    if not (isinstance(networks, list) and len(networks) == 2 and all(isinstance(n, str) for n in networks)):
        raise InputError(
            f"{path}: is not the verdict of a diagnosis, because it has no pair of networks; give another file"
        )
    proposed = record.get("extended_network")
    if isinstance(proposed, str):
        return proposed
    effects = [e for e in record.get("physics", []) if isinstance(e, dict) and e.get("parameters")]
    if effects and networks[0] == networks[1]:
        names = ", ".join(sorted({str(e.get("id")) for e in effects}))
        raise InputError(
            f"{path}: what was found ({names}) cannot be written as a network; fit {networks[0]} without --with"
        )
    return str(networks[1])


def before_in(file: Path) -> dict[str, Any] | None:
    """Network and errors before anything was added, from the same file; None if the verdict has no comparison.

    Raises
    ------
    InputError
        If it is no verdict of this version.
    """
    from bayes_impedance.diagnosis.verdict_file import before_of, from_json

    path = file / "verdict.json" if file.is_dir() else file
    try:
        return before_of(from_json(read_json(path, _REMEDY)))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
