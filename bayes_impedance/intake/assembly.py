"""From recordings of single files to a dataset: names of repetitions, common frequencies, one unit.

Files of one person may differ in the last digits of their frequencies, or in a few lines; a dataset has one grid for
each person. Frequencies that agree to a recording's tolerance are one; those that not all repetitions have are left out
with a remark, and if less than half remain the files are refused.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.shorter_files import places_of, remarks_on_short_files
from bayes_impedance.intake.spectrum import FREQUENCY_UNIT, FloatArray, Spectrum
from bayes_impedance.recordings import frequency_scale
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.driving_point import doubts, sentence, verdict_of
from bayes_impedance.recordings.metadata import DRIVING_POINT, HERTZ
from bayes_impedance.recordings.plausibility import OPPOSITE, is_conjugate, is_opposite, is_turned
from bayes_impedance.recordings.repetitions import MINIMUM_COMMON, MINIMUM_POINTS
from bayes_impedance.recordings.shorter_grid import shorter_grids
from bayes_impedance.runtime.user_table import shown
from bayes_impedance.units import HIGHEST_HZ, LARGEST_IMPEDANCE, LOWEST_HZ, SMALLEST_IMPEDANCE

SIGN = "sign"
"""What runs with known loads have found: a wrong sign of the recordings is then an error of these runs."""
STOPPED = "stopped sweeps"
"""What is said of sweeps: files with only the first frequencies of the others are then not cut."""


def assemble(
    spectra: Sequence[Spectrum], believed: Collection[str] = ()
) -> tuple[list[Subject], list[Spectrum], list[str]]:
    """Subjects in the order of their first file, their recordings, and what was changed, in sentences.

    Parameters
    ----------
    spectra : sequence of Spectrum
    believed : collection of str
        What is known of the recordings and is not doubted: ``driving point``, ``Hz``, ``sign``, ``stopped sweeps``.

    Raises
    ------
    InputError
        If units differ, a name is impossible or there twice, a file seems to be cut, repetitions share too few
        frequencies, or most are complex conjugates, of the wrong sign, transfer functions, or at frequencies in another
        unit.
    """
    if not spectra:
        raise InputError("there is no recording in the files; name others")
    for spectrum in spectra:
        if spectrum.unit != spectra[0].unit:
            raise InputError(
                f"{spectrum.source}: its impedance is in {spectrum.unit}, but that of {spectra[0].source} in "
                f"{spectra[0].unit}; import the two kinds into different datasets"
            )
        _check_values(spectrum)
    places = places_of(spectra)
    downwards = {place for place, one in zip(places, spectra, strict=True) if one.downwards}
    short = shorter_grids([(place, one.frequency_hz) for place, one in zip(places, spectra, strict=True)], downwards)
    if short and STOPPED not in believed:
        raise InputError(f"{short[0][0]}: {short[0][1]}, or give --stopped-sweeps if it was stopped there")
    notes = [f"{source}: {what}" for source, what in short] + remarks_on_short_files(spectra)
    people: dict[str, list[Spectrum]] = {}
    for spectrum in spectra:
        people.setdefault(spectrum.subject, []).append(spectrum)
    subjects, kept = [], []
    for own in people.values():
        named = _repetitions(own)
        gridded, told = _on_common_grid(named)
        notes += told
        noise = [one.noise_sd for one in gridded if one.noise_sd is not None]
        if noise and len(noise) < len(gridded):
            notes.append(f"subject {shown(own[0].subject)}: noise is not known of all repetitions, and is left out")
        try:
            subjects.append(
                Subject(
                    name=own[0].subject,
                    frequency_hz=gridded[0].frequency_hz,
                    z=np.array([one.z for one in gridded]),
                    repetitions=tuple(one.repetition for one in gridded),
                    noise_sd=np.array(noise) if len(noise) == len(gridded) else None,
                )
            )
        except ValueError as error:
            raise InputError(f"{own[0].source}: {error}") from None
        kept += _sharing(gridded, subjects[-1])
    notes += _required(spectra, subjects, believed)
    return subjects, kept, notes


def _sharing(spectra: Sequence[Spectrum], subject: Subject) -> list[Spectrum]:
    """The recordings of one subject as parts of its arrays, so that each is in memory once."""
    return [
        replace(
            one,
            frequency_hz=subject.frequency_hz,
            z=subject.z[i],
            noise_sd=one.noise_sd if subject.noise_sd is None else subject.noise_sd[i],
        )
        for i, one in enumerate(spectra)
    ]


def _required(spectra: Sequence[Spectrum], subjects: Sequence[Subject], believed: Collection[str]) -> list[str]:
    """Refuse what is no impedance, or not of these frequencies; remarks on what may be."""
    notes: list[str] = []
    if HERTZ not in believed:
        notes += _required_hertz(spectra, subjects)
    believed_place = DRIVING_POINT in believed
    places = {} if believed_place else {one.name: verdict_of(one.frequency_hz, one.mean) for one in subjects}
    if list(places.values()).count("transfer") > 0.5 * len(subjects):
        raise InputError(
            f"{spectra[0].source}: {sentence(surely=True)}; import those of the force's own place, or give "
            "--driving-point if these are"
        )
    if said := doubts(places):
        notes.append(said)
    conjugate = [one.name for one in subjects if is_conjugate(one)]
    if len(conjugate) > 0.5 * len(subjects):
        raise InputError(
            f"{spectra[0].source}: the phase agrees with the slope of the magnitude only if its sign is reversed: "
            "these seem to be complex conjugates, from the convention exp(-jwt) or an analyser that subtracts phases "
            "the other way; give --conjugated if you have not, or leave it out"
        )
    if conjugate:
        who = f"subject {shown(conjugate[0])}"
        if len(conjugate) > 1:
            who = f"{len(conjugate)} of {len(subjects)} subjects, the first {shown(conjugate[0])}"
        notes.append(
            f"{who}: the phase agrees with the slope of the magnitude only if its sign is reversed; import these alone "
            "with --conjugated, or correct them"
        )
    turned = [one.name for one in subjects if SIGN not in believed and is_turned(one)]
    if len(turned) > 0.5 * len(subjects):
        raise InputError(
            f"{spectra[0].source}: Re z is negative at nearly all frequencies, and the phase is turned by 180 degrees "
            "against that of the magnitude: force or motion is counted the other way; give --negated if you have not, "
            "or leave it out"
        )
    opposite = [one.name for one in subjects if SIGN not in believed and is_opposite(one)]
    if len({*conjugate, *turned, *opposite}) > 0.5 * len(subjects):
        raise InputError(
            f"{spectra[0].source}: {OPPOSITE}; give --conjugated or --negated if you have not, or leave it out"
        )
    return notes


def _required_hertz(spectra: Sequence[Spectrum], subjects: Sequence[Subject]) -> list[str]:
    """Refuse frequencies that seem to be in another unit, or may be if no file says theirs; else the remark."""
    first = spectra[0]
    bands = [frequency_scale.band_of(one.frequency_hz) for one in subjects]
    found = {frequency_scale.seems(band, first.unit) for band in bands}
    other = next(iter(found)) if len(found) == 1 else None
    if other is None:
        return []
    why = frequency_scale.sentence(other, bands[0].low, bands[0].high)
    told = f"{why}; give --frequency-unit {other}, or --frequency-unit {HERTZ} if they are in Hz"
    if other in frequency_scale.SURELY or all(FREQUENCY_UNIT in one.assumed for one in spectra):
        raise InputError(f"{first.source}: {told}")
    return [told]


def _repetitions(own: Sequence[Spectrum]) -> list[Spectrum]:
    """Recordings of one person with names of repetitions that differ; those without a name are numbered."""
    if all(not one.repetition for one in own):
        return [replace(one, repetition=str(i + 1)) for i, one in enumerate(own)]
    named = [one if one.repetition else replace(one, repetition="1") for one in own]
    seen: dict[str, Spectrum] = {}
    for one in named:
        other = seen.setdefault(one.repetition, one)
        if other is not one:
            raise InputError(
                f"{one.source}: subject {shown(one.subject)}, repetition {shown(one.repetition)} is also in "
                f"{other.source}; give them different names, for instance with --subject-from-name"
            )
    return named


def _on_common_grid(own: list[Spectrum]) -> tuple[list[Spectrum], list[str]]:
    grids = [one.frequency_hz for one in own]
    if all(grid.shape == grids[0].shape and np.array_equal(grid, grids[0]) for grid in grids):
        return own, []
    tolerance = max(one.frequency_tolerance for one in own)
    common = grids[0]
    for grid in grids[1:]:
        common = common[np.abs(_nearest(grid, common) - common) <= tolerance * common]
    longest = max(grid.size for grid in grids)
    if common.size < max(MINIMUM_COMMON * longest, MINIMUM_POINTS):
        other = next(one for one in own[1:] if not np.array_equal(one.frequency_hz, grids[0]))
        raise InputError(
            f"{other.source}: of {other.frequency_hz.size} frequencies of subject {shown(other.subject)} only "
            f"{common.size} are in all of its files, e.g. in {own[0].source}; give its repetitions the same "
            "frequencies, or make them different subjects with --subject-from-name"
        )
    told = []
    if common.size < longest:
        told = [
            f"subject {shown(own[0].subject)}: repetitions have different frequencies and were reduced to the "
            f"{common.size} that all have (of up to {longest})"
        ]
    return [_at(one, common) for one in own], told


def _nearest(grid: FloatArray, wanted: FloatArray) -> FloatArray:
    nearest: FloatArray = grid[nearest_index(grid, wanted)]
    return nearest


def nearest_index(grid: FloatArray, wanted: FloatArray) -> np.ndarray:
    """Where an ascending grid (G,) is nearest to each wanted value, shape (N,)."""
    right = np.clip(np.searchsorted(grid, wanted), 1, grid.size - 1) if grid.size > 1 else np.zeros(wanted.size, int)
    left = np.maximum(right - 1, 0)
    return np.where(np.abs(grid[left] - wanted) <= np.abs(grid[right] - wanted), left, right)


def _at(one: Spectrum, common: FloatArray) -> Spectrum:
    index = nearest_index(one.frequency_hz, common)
    parts = [None if array is None else array[index] for array in (one.noise_sd, one.coherence, one.calibration_sd)]
    return replace(
        one, frequency_hz=common, z=one.z[index], noise_sd=parts[0], coherence=parts[1], calibration_sd=parts[2]
    )


def _check_values(one: Spectrum) -> None:
    """Refuse what no dataset can hold, as its reader would."""
    for name, values, low, high in (
        ("frequency", one.frequency_hz, LOWEST_HZ, HIGHEST_HZ),
        ("|z|", np.abs(one.z), SMALLEST_IMPEDANCE, LARGEST_IMPEDANCE),
    ):
        wrong = ~((values >= low) & (values <= high))
        if wrong.any():
            raise InputError(
                f"{one.source}: {name} is {values[wrong][0]:g} (subject {shown(one.subject)}), which cannot be a "
                "measured value; check columns, form and unit"
            )
