"""Folders of results while a command runs: their files, what is removed, and what remains after an interruption."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.output_folder import output_folder, require_ours

if TYPE_CHECKING:
    from bayes_impedance.commands.fit_options import FitOptions
    from bayes_impedance.recordings.files import Recordings

CHECKPOINT_FOLDER, PICTURE_FOLDER = "checkpoint", "pictures"
EXTENDED_FOLDER = "extended"
"""Where a diagnosis writes the result of the network with what it found."""

DIAGNOSIS_CHECKPOINT_FOLDER = "diagnosis_checkpoint"
REPORT_FILE, DIAGNOSIS_FILE, VERDICT_FILE = "report.html", "diagnosis.html", "verdict.json"
PICTURE_KINDS = ("svg", "png")
FIT_FILES = ("result.nc", "summary.json", "seconds.json", "persons.parquet")


@contextmanager
def fit_folder(
    out: Path, names: Iterable[str], recordings: Recordings, options: FitOptions, resume: bool
) -> Iterator[None]:
    """Lock the folder of a fit. The options are checked first; until then nothing in the folder is changed."""
    from bayes_impedance.population.requirements import checked_model
    from bayes_impedance.runtime.checkpoint import discard, require_own

    checked_model(recordings, options.network, options.covariates)
    if options.prior is not None:
        _require_prior(recordings, options)
    checkpoint = out / CHECKPOINT_FOLDER
    if not resume:
        require_own(checkpoint)
    with output_folder(out, names, options.overwrite):
        if not resume:
            discard(checkpoint)
        with discarded_if_useless(checkpoint, resume):
            yield


def _require_prior(recordings: Recordings, options: FitOptions) -> None:
    """Refuse a prior that does not belong to the network."""
    from bayes_impedance.population.calibrated import within_rig
    from bayes_impedance.population.fit import prior_for
    from bayes_impedance.population.requirements import checked_model

    model = checked_model(recordings, within_rig(recordings, options.network), options.covariates)
    prior_for(model.kernel, recordings, options.settings())


@contextmanager
def discarded_if_useless(checkpoint: Path, resume: bool) -> Iterator[None]:
    """Keep the checkpoint if the work ends early, unless the input turns out to be unusable."""
    from bayes_impedance.runtime.checkpoint import discard

    try:
        yield
    except InputError:
        if not resume:
            discard(checkpoint)
        raise


@contextmanager
def interrupted(words: str) -> Iterator[None]:
    """Attach a message for the user to an interruption: what remains. With nested contexts the innermost is used."""
    try:
        yield
    except KeyboardInterrupt as stop:
        stop.args = stop.args or (words,)
        raise


def page_files() -> list[str]:
    """File names of a fit's report and its pictures."""
    from bayes_impedance.plots import PICTURES

    return [REPORT_FILE, *pictures(picture.name for picture in PICTURES)]


def extended_files() -> list[str]:
    """File names of the result of an extended network."""
    return [*FIT_FILES, *page_files()]


def require_extended(out: Path, overwrite: bool) -> None:
    """Refuse the folder of a diagnosis whose folder of the extended network holds another's files."""
    require_ours(out / EXTENDED_FOLDER, extended_files(), overwrite)


def remove_extended(out: Path, overwrite: bool) -> None:
    """Remove an earlier diagnosis' result of an extended network: it contradicts one that has none."""
    folder = out / EXTENDED_FOLDER
    if not folder.is_dir():
        return
    with output_folder(folder, extended_files(), overwrite):
        remove(folder, extended_files())
    with suppress(OSError):  # what is not the package's stays
        (folder / PICTURE_FOLDER).rmdir()
    with suppress(OSError):
        folder.rmdir()


def pictures(names: Iterable[str]) -> list[str]:
    """File names of the pictures with these names."""
    return [f"{PICTURE_FOLDER}/{name}.{kind}" for name in names for kind in PICTURE_KINDS]


def remove(out: Path, names: Iterable[str]) -> None:
    """Remove files from a locked folder, so that no old file contradicts the new results."""
    for name in names:
        (out / name).unlink(missing_ok=True)
