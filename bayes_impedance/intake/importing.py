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
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.formats.registry import files_of, read_file
from bayes_impedance.intake.names import Who, who_is
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
    table : TableFormat
    record : str or None
        Sheet, group or record to use of files that have several.
    who : Pattern or None
        Of ``--subject-from-name``.
    title, source, licence : str
    network : str or None
    """

    spectra: SpectraSettings = field(default_factory=SpectraSettings)
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
    for i, file in enumerate(files):
        progress("reading files", i, len(files))
        found, told = _recordings_of(file, settings)
        spectra += found
        notes += told
        digests.append((str(file), _digest(file)))
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


def _recordings_of(file: Path, settings: ImportSettings) -> tuple[list[Spectrum], list[str]]:
    who = who_is(str(file), settings.who)
    spectra: list[Spectrum] = []
    notes: list[str] = []
    for contents in read_file(file, settings.table, settings.record):
        found, told = _of_contents(contents, who, settings)
        spectra += found
        notes += told
    return spectra, notes


def _of_contents(contents: Contents, who: Who, settings: ImportSettings) -> tuple[list[Spectrum], list[str]]:
    return spectra_of(contents, who, settings.spectra)


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
