"""The whole import: files to recordings, with what was guessed, and how to do it again."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.intake.assembly import SIGN, STOPPED, assemble
from bayes_impedance.intake.calibrating import Calibrated, CalibrationSettings, calibrated
from bayes_impedance.intake.calibration_files import RIG_FILE, calibration_files
from bayes_impedance.intake.moderated_noise import moderated
from bayes_impedance.intake.names import who_is
from bayes_impedance.intake.reading import Progress, ReadingSettings, read_spectra
from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.recordings.calibration_map import MAP_FILE
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.metadata import DRIVING_POINT, HERTZ, IMPEDANCE
from bayes_impedance.runtime.atomic_files import Content, csv_bytes

COHERENCE_FILE, REPETITIONS_FILE = "coherence.csv", "repetitions.csv"
CALIBRATION_SD_FILE = "calibration_sd.csv"
BESIDE = (COHERENCE_FILE, REPETITIONS_FILE, CALIBRATION_SD_FILE, MAP_FILE, RIG_FILE)
"""Every file that may stand beside the recordings."""
_NEGATIVE = 0.001
"""Share of points with Re z < 0 from which it is told. By choice: less is noise around zero, and is told as 0.0 %."""
_CHUNK = 2**20
"""Bytes of a source that are hashed at a time. By choice: the largest that does not matter for memory."""


@dataclass(frozen=True, kw_only=True, repr=False)
class ImportSettings(ReadingSettings):
    """How sources are read, calibrated and named.

    Attributes
    ----------
    calibration : CalibrationSettings
    title, source, licence : str
    network : str or None
    driving_point : bool
        Whether it is said that force and motion are of one place, whatever the curves look like.
    stopped_sweeps : bool
        Whether it is said that sweeps were stopped early, where a file has only the first frequencies of the others.
    """

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    title: str = ""
    source: str = ""
    licence: str = ""
    network: str | None = None
    driving_point: bool = False
    stopped_sweeps: bool = False


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Imported(Brief):
    """What an import has found.

    Attributes
    ----------
    recordings : Recordings
    spectra : tuple of Spectrum
        The recordings one by one, with coherence, degrees of freedom and facts.
    notes : tuple of str
        What was guessed, changed or left out; each sentence once, with the number of other files it holds for.
    sources : tuple of (str, str)
        Every file, of calibration runs too, and the SHA-256 of its bytes.
    calibration : Calibrated
    """

    recordings: Recordings
    spectra: tuple[Spectrum, ...]
    notes: tuple[str, ...]
    sources: tuple[tuple[str, str], ...]
    calibration: Calibrated

    @property
    def named_by_files(self) -> bool:
        """Whether every subject is called as its file is."""
        return all(one.subject == who_is(one.source, None).subject for one in self.spectra)

    def _table(self, name: str, columns: Sequence[str]) -> Iterator[bytes]:
        """Each spectrum's values of one kind, by frequency; one spectrum after the other, as rows may be millions."""
        yield csv_bytes([["subject", "repetition", "frequency_hz", *columns]])
        for one in self.spectra:
            values = getattr(one, name)
            if values is not None:
                rows = np.column_stack([one.frequency_hz, values]).tolist()
                yield csv_bytes([one.subject, one.repetition, *map(repr, row)] for row in rows)

    def recipe(self, arguments: Sequence[str]) -> str:
        """The table ``[import]`` of dataset.toml: arguments, sources with their digests, notes."""
        lines = ["[import]", f"arguments = {_toml(list(arguments))}", f"notes = {_toml(list(self.notes))}"]
        for name, digest in self.sources:
            lines += ["", "[[import.sources]]", f"file = {_toml(name)}", f"sha256 = {_toml(digest)}"]
        return "\n".join(lines) + "\n"

    def beside(self) -> dict[str, Content]:
        """Other files of the dataset: coherence, and what is noted of the repetitions; each can be read once."""
        files: dict[str, Content] = {**calibration_files(self.calibration)}
        for file, name, columns in (
            (COHERENCE_FILE, "coherence", ["coherence"]),
            (CALIBRATION_SD_FILE, "calibration_sd", ["calibration_sd_re", "calibration_sd_im"]),
        ):
            if any(getattr(one, name) is not None for one in self.spectra):
                files[file] = self._table(name, columns)
        names = list(dict.fromkeys(name for one in self.spectra for name in _facts(one)))
        if names:
            noted: list[list[object]] = [["subject", "repetition", *names]]
            for one in self.spectra:
                facts = _facts(one)
                noted.append([one.subject, one.repetition, *(facts.get(name, "") for name in names)])
            files[REPETITIONS_FILE] = csv_bytes(noted)
        return files


def import_recordings(
    sources: Sequence[str | os.PathLike[str]], settings: ImportSettings, progress: Progress = lambda *_: None
) -> Imported:
    """Read files of spectra or signals.

    Parameters
    ----------
    sources : sequence of path
        Files and folders.
    settings : ImportSettings
    progress : callable

    Raises
    ------
    InputError
        If anything cannot be used; the message names the file, the row and the remedy.
    """
    runs = settings.calibration.files
    places = [Path(source) for source in sources]
    spectra, notes, files = read_spectra(places, settings, progress, without=runs)
    calibration = calibrated(spectra, settings.calibration, settings)
    notes += calibration.notes
    said = settings.spectra
    believed = {DRIVING_POINT} if settings.driving_point else set()
    believed |= {STOPPED} if settings.stopped_sweeps else set()
    believed |= {HERTZ} if said.frequency_unit is not None else set()
    believed |= {SIGN} if settings.calibration.known_loads else set()
    quieter, told = moderated(calibration.spectra)
    notes += told
    subjects, kept, told = assemble(quieter, believed)
    notes += told
    negative = sum(int(np.sum(one.z.real < 0)) for one in kept) / sum(one.z.size for one in kept)
    if negative >= _NEGATIVE:
        notes.append(f"Re z is below zero at {negative:.1%} of the points; 'bayes-impedance check' looks for the cause")
    recordings = Recordings(
        title=settings.title or "imported recordings",
        unit=kept[0].unit,
        network=settings.network,
        source=settings.source or ", ".join(source.name for source in places[:5]),
        licence=settings.licence,
        subjects=tuple(subjects),
        warnings=tuple(_merged(notes)),
        calibration=calibration.left,
        calibration_map=calibration.map_left,
        place=DRIVING_POINT if settings.driving_point else None,
        quantity=IMPEDANCE if said.form == IMPEDANCE else None,
        frequency_unit=HERTZ if HERTZ in believed else None,
    )
    return Imported(
        recordings=recordings,
        spectra=tuple(kept),
        notes=recordings.warnings,
        sources=tuple((str(file), _digest(file)) for file in (*files, *calibration.files)),
        calibration=replace(calibration, spectra=tuple(kept)),
    )


def _facts(one: Spectrum) -> dict[str, object]:
    facts: dict[str, object] = dict(one.facts)
    if one.degrees_of_freedom is not None:
        facts["noise_degrees_of_freedom"] = f"{one.degrees_of_freedom:g}"
    return facts


def _merged(notes: Sequence[str]) -> list[str]:
    """Each sentence once; if it holds for several files, it names the first and the number of the others."""
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


def _toml(value: str | list[str]) -> str:
    """A string or list of strings as TOML, of which JSON is nearly a part (see recordings/files.py)."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
