"""Sources to recordings one by one, before they are put together: which file holds spectra and which signals."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bayes_impedance.display import Chosen
from bayes_impedance.errors import InputError
from bayes_impedance.intake.channels import guessed_channels
from bayes_impedance.intake.columns import looks_like_frequency
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.registry import files_of, read_file
from bayes_impedance.intake.names import Who, who_is
from bayes_impedance.intake.signals import Record, SignalSettings, record_of, spectrum_of
from bayes_impedance.intake.spectra import SpectraSettings, spectra_of
from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.intake.text_tables import TableFormat

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True, repr=False)
class ReadingSettings(Chosen):
    """How sources are read.

    Attributes
    ----------
    spectra : SpectraSettings
    signals : SignalSettings
        Files hold signals if they name a channel.
    table : TableFormat
    record : str or None
        Sheet, group or record to use of files that have several.
    who : Pattern or None
        Of ``--subject-from-name``.
    any_name : bool
        Files that it does not match are named by their own name, as calibration runs may be, instead of refused.
    """

    spectra: SpectraSettings = field(default_factory=SpectraSettings)
    signals: SignalSettings = field(default_factory=SignalSettings)
    table: TableFormat = field(default_factory=TableFormat)
    record: str | None = None
    who: re.Pattern[str] | None = None
    any_name: bool = False


def read_spectra(
    sources: Sequence[Path],
    settings: ReadingSettings,
    progress: Progress = lambda *_: None,
    without: Sequence[Path] = (),
) -> tuple[list[Spectrum], list[str], list[Path]]:
    """Recordings of files and folders, what was guessed, and the files.

    Parameters
    ----------
    sources : sequence of Path
    settings : ReadingSettings
    progress : callable
    without : sequence of Path
        Files and folders to leave out, because they are calibration runs in the same folder.

    Raises
    ------
    InputError
        If a file cannot be used.
    """
    files = [file for source in sources for file in files_of(source)]
    twice = next((file for i, file in enumerate(files) if file in files[:i]), None)
    if twice is not None:
        raise InputError(f"{twice}: is named twice; name it once")
    left_out = {file.resolve() for source in without for file in files_of(source)}
    files = [file for file in files if file.resolve() not in left_out]
    spectra: list[Spectrum] = []
    notes: list[str] = []
    done = 0
    for group in _groups(files, settings):
        progress("reading files", done, len(files))
        found, told = _recordings_of(group, settings)
        spectra += found
        notes += told
        done += len(group)
    progress("reading files", len(files), len(files))
    return spectra, notes, files


def _groups(files: Sequence[Path], settings: ReadingSettings) -> list[list[Path]]:
    """Files of one subject and repetition that differ in the realisation are read together, all others one by one."""
    groups: dict[tuple[str, ...], list[Path]] = {}
    for file in files:
        who = _who(file, settings)
        own = (who.subject, who.repetition) if who.realisation else (str(file),)
        groups.setdefault(own, []).append(file)
    return list(groups.values())


def _recordings_of(files: Sequence[Path], settings: ReadingSettings) -> tuple[list[Spectrum], list[str]]:
    """Recordings of one file, or the one of several realisations; only their contents are in memory."""
    spectra: list[Spectrum] = []
    records: list[Record] = []
    notes: list[str] = []
    for file in files:
        who = _who(file, settings)
        for contents in read_file(file, settings.table, settings.record):
            if settings.signals.given or _holds_signals(contents, settings):
                record, told = record_of(contents, settings.signals)
                records.append(record)
                notes += told
            else:
                found, told = spectra_of(contents, who, settings.spectra)
                spectra += found
                notes += told
    if records:
        found_one, told = spectrum_of(records, _who(files[0], settings), settings.signals)
        spectra.append(found_one)
        notes += told
    return spectra, notes


def _who(file: Path, settings: ReadingSettings) -> Who:
    """Subject, repetition and realisation of a file; a calibration run need not have a name like the recordings'."""
    try:
        return who_is(str(file), settings.who)
    except InputError:
        if not settings.any_name:
            raise
        return who_is(str(file), None)


def _holds_signals(contents: Contents, settings: ReadingSettings) -> bool:
    """Whether a file that nothing is said about has one channel of force and one of motion, and no frequency."""
    said = settings.spectra
    if said.columns or said.recipe is not None or said.form is not None or said.unit is not None:
        return False
    return guessed_channels(contents) is not None and not any(
        looks_like_frequency(variable) for variable in contents.variables
    )
