"""The whole import: files to recordings, with what was guessed, and how to do it again."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.assembly import assemble
from bayes_impedance.intake.channels import guessed_channels
from bayes_impedance.intake.columns import looks_like_frequency
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.registry import files_of, read_file
from bayes_impedance.intake.names import who_is
from bayes_impedance.intake.signals import Record, SignalSettings, record_of, spectrum_of
from bayes_impedance.intake.spectra import SpectraSettings, spectra_of
from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.intake.text_tables import TableFormat
from bayes_impedance.recordings.dataset import Recordings

COHERENCE_FILE, REPETITIONS_FILE = "coherence.csv", "repetitions.csv"
_CHUNK = 2**20
"""Bytes of a source that are hashed at a time. By choice: the largest that does not matter for memory."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class ImportSettings:
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
    title, source, licence : str
    network : str or None
    """

    spectra: SpectraSettings = field(default_factory=SpectraSettings)
    signals: SignalSettings = field(default_factory=SignalSettings)
    table: TableFormat = field(default_factory=TableFormat)
    record: str | None = None
    who: re.Pattern[str] | None = None
    title: str = ""
    source: str = ""
    licence: str = ""
    network: str | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Imported:
    """What an import has found.

    Attributes
    ----------
    recordings : Recordings
    spectra : tuple of Spectrum
        The recordings one by one, with coherence, degrees of freedom and facts.
    notes : tuple of str
        What was guessed, changed or left out; each sentence once, with the number of other files it holds for.
    sources : tuple of (str, str)
        Every file and the SHA-256 of its bytes.
    """

    recordings: Recordings
    spectra: tuple[Spectrum, ...]
    notes: tuple[str, ...]
    sources: tuple[tuple[str, str], ...]

    def recipe(self, arguments: Sequence[str]) -> str:
        """The table ``[import]`` of dataset.toml: arguments, sources with their digests, notes."""
        lines = ["[import]", f"arguments = {_toml(list(arguments))}", f"notes = {_toml(list(self.notes))}"]
        for name, digest in self.sources:
            lines += ["", "[[import.sources]]", f"file = {_toml(name)}", f"sha256 = {_toml(digest)}"]
        return "\n".join(lines) + "\n"

    def beside(self) -> dict[str, bytes]:
        """Other files of the dataset: coherence, and what is noted of the repetitions."""
        files: dict[str, bytes] = {}
        if any(one.coherence is not None for one in self.spectra):
            rows: list[list[object]] = [["subject", "repetition", "frequency_hz", "coherence"]]
            for one in self.spectra:
                values = [] if one.coherence is None else zip(one.frequency_hz, one.coherence, strict=True)
                rows += [[one.subject, one.repetition, repr(float(f)), repr(float(c))] for f, c in values]
            files[COHERENCE_FILE] = _csv(rows)
        names = list(dict.fromkeys(name for one in self.spectra for name in _facts(one)))
        if names:
            table: list[list[object]] = [["subject", "repetition", *names]]
            for one in self.spectra:
                facts = _facts(one)
                table.append([one.subject, one.repetition, *(facts.get(name, "") for name in names)])
            files[REPETITIONS_FILE] = _csv(table)
        return files


def import_recordings(
    sources: Sequence[Path], settings: ImportSettings, progress: Progress = lambda *_: None
) -> Imported:
    """Read files of spectra or signals.

    Parameters
    ----------
    sources : sequence of Path
        Files and folders.
    settings : ImportSettings
    progress : callable

    Raises
    ------
    InputError
        If anything cannot be used; the message names the file, the row and the remedy.
    """
    files = [file for source in sources for file in files_of(source)]
    twice = next((file for i, file in enumerate(files) if file in files[:i]), None)
    if twice is not None:
        raise InputError(f"{twice}: is named twice; name it once")
    spectra: list[Spectrum] = []
    notes: list[str] = []
    digests = []
    done = 0
    for group in _groups(files, settings):
        progress("reading files", done, len(files))
        found, told = _recordings_of(group, settings)
        spectra += found
        notes += told
        digests += [(str(file), _digest(file)) for file in group]
        done += len(group)
    progress("reading files", len(files), len(files))
    subjects, kept, told = assemble(spectra)
    notes += told
    negative = sum(int(np.sum(one.z.real < 0)) for one in kept) / sum(one.z.size for one in kept)
    if negative > 0:
        notes.append(f"Re z is below zero at {negative:.1%} of the points")
    recordings = Recordings(
        title=settings.title or "imported recordings",
        unit=kept[0].unit,
        network=settings.network,
        source=settings.source or ", ".join(source.name for source in sources[:5]),
        licence=settings.licence,
        subjects=tuple(subjects),
        warnings=tuple(_merged(notes)),
    )
    return Imported(recordings=recordings, spectra=tuple(kept), notes=recordings.warnings, sources=tuple(digests))


def _groups(files: Sequence[Path], settings: ImportSettings) -> list[list[Path]]:
    """Files of one subject and repetition that differ in the realisation are read together, all others one by one."""
    groups: dict[tuple[str, ...], list[Path]] = {}
    for file in files:
        who = who_is(str(file), settings.who)
        own = (who.subject, who.repetition) if who.realisation else (str(file),)
        groups.setdefault(own, []).append(file)
    return list(groups.values())


def _recordings_of(files: Sequence[Path], settings: ImportSettings) -> tuple[list[Spectrum], list[str]]:
    """Recordings of one file, or the one of several realisations; only their contents are in memory."""
    spectra: list[Spectrum] = []
    records: list[Record] = []
    notes: list[str] = []
    for file in files:
        who = who_is(str(file), settings.who)
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
        found_one, told = spectrum_of(records, who_is(str(files[0]), settings.who), settings.signals)
        spectra.append(found_one)
        notes += told
    return spectra, notes


def _holds_signals(contents: Contents, settings: ImportSettings) -> bool:
    """Whether a file that nothing is said about has one channel of force and one of motion, and no frequency."""
    said = settings.spectra
    if said.columns or said.recipe is not None or said.form is not None or said.unit is not None:
        return False
    return guessed_channels(contents) is not None and not any(
        looks_like_frequency(variable) for variable in contents.variables
    )


def _facts(one: Spectrum) -> dict[str, object]:
    facts: dict[str, object] = dict(one.facts)
    if one.degrees_of_freedom is not None:
        facts["noise_degrees_of_freedom"] = f"{one.degrees_of_freedom:g}"
    return facts


def _merged(notes: Sequence[str]) -> list[str]:
    """Each sentence once: the same about several files is said of the first, with the number of others."""
    groups: dict[str, list[str]] = {}
    for note in notes:
        _, colon, said = note.partition(": ")
        groups.setdefault(said if colon else note, []).append(note)
    return [
        first + (f" (and so in {len(others)} more file{'s' if len(others) > 1 else ''})" if others else "")
        for first, *others in groups.values()
    ]


def _digest(file: Path) -> str:
    digest = hashlib.sha256()
    with file.open("rb") as stream:
        while chunk := stream.read(_CHUNK):
            digest.update(chunk)
    return digest.hexdigest()


def _csv(rows: Sequence[Sequence[object]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode()


def _toml(value: str | list[str]) -> str:
    """A string or list of strings as TOML, of which JSON is nearly a part (see recordings/files.py)."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
