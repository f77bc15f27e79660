"""Datasets in memory: subjects, repetitions, impedances.

z = F/v in SI units with exp(+jwt); sign convention: a passive load has Re z >= 0.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.display import MOST_CURVES, MOST_ROWS, curves, heading, joined, lines, table
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.calibration import CommonError
from bayes_impedance.recordings.calibration_map import CalibrationMap
from bayes_impedance.recordings.csv_table import ComplexArray, FloatArray, has_control_character
from bayes_impedance.runtime.user_table import shown, similar
from bayes_impedance.units import counted

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, eq=False, kw_only=True)
class Subject:
    """One subject's recordings on one frequency grid.

    Attributes
    ----------
    name : str
    frequency_hz : ndarray of float, shape (F,)
        Frequencies in Hz, ascending.
    z : ndarray of complex, shape (J, F)
        Impedance of J repetitions, in the dataset's unit.
    repetitions : tuple of str, length J
        Their names.
    noise_sd : ndarray of float, shape (J, F), or None
        Standard deviation of each of real and imaginary part, in the dataset's unit; None if not given.
    covariates : mapping of str to float
        NaN where a covariate is missing.
    circumstances : mapping of str to ndarray of float, shape (J,)
        What was noted of every repetition; NaN where it is missing.

    Raises
    ------
    ValueError
        If shapes do not agree, frequencies do not ascend from above zero, or a name cannot be written to a CSV file.
    """

    name: str
    frequency_hz: FloatArray
    z: ComplexArray
    repetitions: tuple[str, ...]
    noise_sd: FloatArray | None = None
    covariates: Mapping[str, float] = field(default_factory=dict)
    circumstances: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check shapes, order of frequencies and names."""
        for name in (self.name, *self.repetitions):
            if not name or name != name.strip() or has_control_character(name):
                raise ValueError(f"name {name!r} must not be empty, padded with space or contain control characters")
        if self.frequency_hz.ndim != 1 or self.frequency_hz.size == 0:
            raise ValueError(f"{self.name}: frequency_hz must have shape (F,), not {self.frequency_hz.shape}")
        if not (self.frequency_hz[0] > 0 and np.all(np.diff(self.frequency_hz) > 0)):
            raise ValueError(
                f"{self.name}: frequency_hz must be above zero and ascend: sort it and leave out 0 Hz and doubles"
            )
        shape = (len(self.repetitions), self.frequency_hz.size)
        if not self.repetitions or self.z.shape != shape:
            raise ValueError(f"{self.name}: z has shape {self.z.shape}, but repetitions and frequencies are {shape}")
        if self.noise_sd is not None and self.noise_sd.shape != shape:
            raise ValueError(f"{self.name}: noise_sd has shape {self.noise_sd.shape}, but z has {shape}")
        for name, values in self.circumstances.items():
            if np.shape(values) != shape[:1]:
                raise ValueError(
                    f"{self.name}: {name} has shape {np.shape(values)}, but there are {shape[0]} repetitions"
                )
        if len(set(self.repetitions)) < len(self.repetitions):
            raise ValueError(f"{self.name}: two repetitions have the same name: give each its own")

    def __repr__(self) -> str:
        count, f = len(self.repetitions), self.frequency_hz
        repetitions = f"{count} repetition{'s' if count > 1 else ''}"
        return f"<Subject {self.name}: {repetitions}, {f.size} frequencies from {f[0]:g} to {f[-1]:g} Hz>"

    def _repr_html_(self) -> str:
        columns = ["", *self.covariates]
        values = ["covariates", *self.covariates.values()] if self.covariates else []
        rows = [values] if values else []
        return joined(
            heading(repr(self).strip("<>")),
            *_pictures([(self.frequency_hz, z) for z in self.z], ""),
            table(columns, rows) if rows else "",
        )

    def to_dataframe(self) -> pd.DataFrame:
        """The subject's recordings as a long table, as :meth:`Recordings.to_dataframe` gives it, without units."""
        alone = Recordings(title="", unit="", network=None, source="", licence="", subjects=(self,))
        return alone.to_dataframe().drop(columns="subject")

    @property
    def mean(self) -> ComplexArray:
        """Complex mean over the repetitions, shape (F,)."""
        mean: ComplexArray = self.z.mean(axis=0)
        return mean

    @property
    def digest(self) -> str:
        """Digest of the names of subject and repetitions and of all numbers except the covariates."""
        digest = hashlib.sha256(repr((self.name, self.repetitions)).encode())
        for numbers in (self.frequency_hz, self.z, self.noise_sd):
            digest.update(b"none" if numbers is None else np.ascontiguousarray(numbers).tobytes())
        return digest.hexdigest()

    def at(self, points: np.ndarray) -> Subject:
        """The subject at some of the frequencies, given by indices or a mask."""
        noise = None if self.noise_sd is None else self.noise_sd[:, points]
        return replace(self, frequency_hz=self.frequency_hz[points], z=self.z[:, points], noise_sd=noise)


@dataclass(frozen=True, eq=False, kw_only=True)
class Recordings:
    """A dataset.

    Attributes
    ----------
    title, source, licence : str
    unit : str
        SI unit of z.
    network : str or None
        Notation of the network that the dataset specifies.
    subjects : tuple of Subject
        In the order of the file; names differ.
    sha256 : str
        Digest of the uncompressed recordings.csv (of Parquet, of its files' digests), then of subjects.csv,
        repetitions.csv and dataset.toml where present; empty if the recordings were not read from files.
    warnings : tuple of str
        What was changed or left out when reading.
    polar : bool
        Whether the file has magnitude and phase, each of which can be in a wrong unit.
    convention : str or None
        Convention that the file declares; z here is that of exp(+jwt). None if it does not say.
    calibration : CommonError or None
        What a calibration has left uncertain, the same in all recordings, as a rig of few parameters.
    calibration_map : CalibrationMap or None
        The same of a calibration that was made at each frequency for itself.
    place : str or None
        ``driving point`` if that is declared: recordings that look like transfer functions are then believed.
    quantity, frequency_unit : str or None
        ``impedance`` and ``Hz`` if they are declared: recordings that look like others are then believed.

    Raises
    ------
    ValueError
        If two subjects have the same name.
    """

    title: str
    unit: str
    network: str | None
    source: str
    licence: str
    subjects: tuple[Subject, ...]
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    polar: bool = False
    convention: str | None = None
    calibration: CommonError | None = None
    calibration_map: CalibrationMap | None = None
    place: str | None = None
    quantity: str | None = None
    frequency_unit: str | None = None

    def __post_init__(self) -> None:
        """Check that the subjects' names are unique."""
        if len(set(self.names)) < len(self.names):
            raise ValueError("two subjects have the same name: give each its own")

    def __len__(self) -> int:
        """Return the number of subjects."""
        return len(self.subjects)

    def __repr__(self) -> str:
        if not self.subjects:
            return f"<Recordings {self.title!r}: no subject>"
        low = min(float(s.frequency_hz[0]) for s in self.subjects)
        high = max(float(s.frequency_hz[-1]) for s in self.subjects)
        return (
            f"<Recordings {self.title!r}: {counted(len(self), 'subject')}, up to "
            f"{counted(self.repetitions_max, 'repetition')}, {low:g} to {high:g} Hz, in {self.unit}>"
        )

    def _repr_html_(self) -> str:
        shown = self.subjects[:MOST_CURVES]
        rows = [
            (s.name, len(s.repetitions), s.frequency_hz.size, *(s.covariates.get(c) for c in self._covariates))
            for s in self.subjects[:MOST_ROWS]
        ]
        more = len(self) - len(rows)
        return joined(
            heading(repr(self).strip("<>")),
            *_pictures([(s.frequency_hz, s.mean) for s in shown], self.unit),
            lines([f"network: {self.network}"] if self.network else []),
            table(["subject", "repetitions", "frequencies", *self._covariates], rows),
            lines([f"and {more} more"] if more else []),
        )

    @property
    def _covariates(self) -> list[str]:
        return list(dict.fromkeys(name for subject in self.subjects for name in subject.covariates))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the subjects."""
        return tuple(subject.name for subject in self.subjects)

    def in_memory(self) -> Recordings:
        """The recordings with all data in memory; if partitioned by subject, they stay in the files otherwise."""
        return replace(self, subjects=tuple(replace(subject) for subject in self.subjects))

    def to_dataframe(self) -> pd.DataFrame:
        """The recordings as a long table.

        >>> import numpy as np
        >>> from bayes_impedance import FINGERTIP, simulate_recordings
        >>> recordings = simulate_recordings(FINGERTIP, 2, 1, np.array([10.0, 100.0]), seed=1).recordings
        >>> list(recordings.to_dataframe())
        ['subject', 'repetition', 'frequency_hz', 'z_re', 'z_im']
        >>> recordings
        <Recordings 'simulated recordings': 2 subjects, up to 1 repetition, 10 to 100 Hz, in N s/m>

        Returns
        -------
        DataFrame
            One row for each subject, repetition and frequency, in this order. Columns subject, repetition,
            frequency_hz, z_re, z_im and, if any subject has it, noise_sd. ``attrs["units"]`` holds the unit of each
            column of numbers.
        """
        import pandas as pd

        table: dict[str, list[np.ndarray]] = {}
        for subject in self.subjects:
            z, sd, f = subject.z, subject.noise_sd, subject.frequency_hz
            columns = {
                "subject": np.full(z.size, subject.name, dtype=object),
                "repetition": np.repeat(np.array(subject.repetitions, dtype=object), f.size),
                "frequency_hz": np.tile(f, len(z)),
                "z_re": z.real.ravel(),
                "z_im": z.imag.ravel(),
                "noise_sd": np.full(z.size, np.nan) if sd is None else sd.ravel(),
            }
            for name, values in columns.items():
                table.setdefault(name, []).append(values)
        if all(subject.noise_sd is None for subject in self.subjects):
            table.pop("noise_sd", None)
        frame = pd.DataFrame({name: np.concatenate(parts) for name, parts in table.items()})
        units = {"frequency_hz": "Hz", "z_re": self.unit, "z_im": self.unit, "noise_sd": self.unit}
        frame.attrs["units"] = {name: unit for name, unit in units.items() if name in frame}
        return frame

    def subjects_table(self) -> pd.DataFrame:
        """The covariates of all subjects as a table.

        Returns
        -------
        DataFrame
            One row for each subject, whose name is the index; one column for each covariate, NaN where it is missing.
            A covariate's unit is part of its name in the dataset.
        """
        import pandas as pd

        columns = {c: [float(s.covariates.get(c, math.nan)) for s in self.subjects] for c in self._covariates}
        return pd.DataFrame(columns, index=pd.Index(self.names, name="subject", dtype=object))

    @property
    def repetitions_max(self) -> int:
        """Largest number of repetitions of a subject."""
        return max((len(subject.repetitions) for subject in self.subjects), default=0)

    def select(self, names: Iterable[str]) -> Recordings:
        """Return the recordings of some subjects, in the order of the names; the digest remains that of the files.

        Raises
        ------
        InputError
            If a name is unknown or given twice.
        """
        chosen = (names,) if isinstance(names, str) else tuple(names)
        known = {subject.name: subject for subject in self.subjects}
        for name in chosen:
            if name not in known:
                guess = similar(name, known)
                hint = f'did you mean "{guess}"?' if guess else f"there are {', '.join(list(known)[:10])}"
                raise InputError(
                    f'subject "{name}" is not among the {counted(len(self), "subject")} of {self.title}; {hint}'
                )
            if chosen.count(name) > 1:
                raise InputError(f'subject "{name}" is selected twice; name it once')
        return replace(self, subjects=tuple(known[name] for name in chosen))


def require_recordings(recordings: object) -> None:
    """Refuse what are no recordings, such as the path of a dataset.

    Raises
    ------
    InputError
    """
    if not isinstance(recordings, Recordings):
        raise InputError(
            f"recordings are {shown(recordings) if isinstance(recordings, str) else type(recordings).__name__}, but "
            "must be Recordings: read a dataset with read_recordings(path)"
        )


def _pictures(recorded: list[tuple[FloatArray, ComplexArray]], unit: str) -> tuple[str, str]:
    """Magnitude and phase of curves, as small pictures."""
    x = [f.tolist() for f, _ in recorded]
    magnitude = curves(x, [np.abs(z).tolist() for _, z in recorded], f"|z|{f' in {unit}' if unit else ''} over Hz")
    phase = [np.angle(z, deg=True).tolist() for _, z in recorded]
    return magnitude, curves(x, phase, "phase in degrees over Hz", logarithmic=False)
