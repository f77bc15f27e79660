"""Calibration of recordings: runs with known loads are read, the rig found, and the recordings corrected by it.

With an unloaded run alone, z - z0 (the paper's way); with more known loads the two-port of the rig: smooth over
frequency (:mod:`.smooth_rig`) if that describes the runs, else at each frequency (:mod:`.two_port`). Noise of a run
that belongs to one recording is part of that recording's noise. The error of a run that corrects all of them is common
to all, and is written beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.assembly import nearest_index
from bayes_impedance.intake.common_error import common_error
from bayes_impedance.intake.known_loads import OPEN, KnownLoad
from bayes_impedance.intake.reading import ReadingSettings, read_spectra
from bayes_impedance.intake.smooth_rig import LARGEST_MISFIT, SmoothRig, smooth_rig
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray, Spectrum
from bayes_impedance.intake.two_port import TwoPort, smoothed_noise, two_port, undetermined
from bayes_impedance.recordings.calibration import CommonError
from bayes_impedance.recordings.calibration_map import CalibrationMap
from bayes_impedance.recordings.repetitions import MINIMUM_COMMON, MINIMUM_POINTS

SMOOTH, EACH = "smooth", "each frequency"


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """How recordings are calibrated.

    Attributes
    ----------
    unloaded : tuple of Path
        Runs without a load.
    known_loads : tuple of KnownLoad
    rig : str or None
        ``smooth`` or ``each frequency``; None for the first if it describes the runs.
    """

    unloaded: tuple[Path, ...] = ()
    known_loads: tuple[KnownLoad, ...] = ()
    rig: str | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """Of all runs."""
        return (*self.unloaded, *(load.file for load in self.known_loads))


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibrated:
    """Corrected recordings.

    Attributes
    ----------
    spectra : tuple of Spectrum
    notes : tuple of str
    files : tuple of Path
        Of the runs.
    rig : SmoothRig or None
    two_port : TwoPort or None
        At the frequencies of the runs; None if every recording has its own run.
    left : CommonError or None
        What remains uncertain in all recordings, where a rig of few parameters describes it.
    map_left : CalibrationMap or None
        The same where the map of each frequency was used.
    """

    spectra: tuple[Spectrum, ...]
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    rig: SmoothRig | None = None
    two_port: TwoPort | None = None
    left: CommonError | None = None
    map_left: CalibrationMap | None = None


def calibrated(
    spectra: Sequence[Spectrum], settings: CalibrationSettings, reading: ReadingSettings
) -> Calibrated:  # fmt: skip
    """Recordings corrected for the rig.

    Parameters
    ----------
    spectra : sequence of Spectrum
    settings : CalibrationSettings
    reading : ReadingSettings
        How the runs are read: as the recordings.

    Raises
    ------
    InputError
        If a run cannot be used, or does not go with the recordings.
    """
    if settings.rig is not None and not settings.known_loads:
        raise InputError("--rig says how known loads are used, but there is none; give --known-load")
    if not settings.files or not spectra:
        return Calibrated(spectra=tuple(spectra))
    reading = replace(reading, any_name=True)
    loads: list[KnownLoad] = []
    runs: list[Spectrum] = []
    notes: list[str] = []
    files: list[Path] = []
    for load in (*(KnownLoad(name=OPEN, file=file) for file in settings.unloaded), *settings.known_loads):
        found, told, read = read_spectra([load.file], reading)
        _check_units(load, found, spectra[0])
        notes += told
        files += read
        runs += found
        loads += [load] * len(found)
    own = _own_runs(spectra, runs) if not settings.known_loads and len(runs) > 1 else None
    if own is not None:
        subtracted = [_with_own_run(one, run) for one, run in zip(spectra, own, strict=True)]
        notes += [f"every recording has its own unloaded run, which is subtracted; {undetermined(1, True)}"]
        if any(run.noise_sd is None for run in runs):
            notes += ["the noise of unloaded runs is not known of all, and is no part of noise_sd there"]
        return Calibrated(spectra=tuple(subtracted), notes=tuple(notes), files=tuple(files))
    rig, each, told = _rig(loads, runs, settings.rig)
    map_at = rig.at if rig is not None else None
    corrected = [_corrected(one, each, map_at) for one in spectra]
    reduced = [one for one, new in zip(spectra, corrected, strict=True) if new.z.size < one.z.size]
    if reduced:
        told.append(f"{reduced[0].source}: frequencies that the calibration does not have were left out")
    left = None if rig is None else common_error(rig, corrected)
    map_left = each.recorded if rig is None and each.covariance is not None else None
    told += _said_of_error(corrected, left, map_left)
    return Calibrated(
        spectra=tuple(corrected),
        notes=(*notes, *told),
        files=tuple(files),
        rig=rig,
        two_port=each if rig is None else rig.at(each.frequency_hz),
        left=left,
        map_left=map_left,
    )


def _check_units(load: KnownLoad, runs: Sequence[Spectrum], recording: Spectrum) -> None:
    for run in runs:
        if run.unit != recording.unit:
            raise InputError(
                f"{run.source}: this run is in {run.unit}, but {recording.source} in {recording.unit}; use runs of "
                "the same kind"
            )
        if load.unit not in ("", run.unit):
            raise InputError(
                f"--known-load {load.name}: its impedance is in {load.unit}, but that of {run.source} in {run.unit}; "
                "correct one of the two"
            )


def _rig(
    loads: Sequence[KnownLoad], runs: Sequence[Spectrum], wanted: str | None
) -> tuple[SmoothRig | None, TwoPort, list[str]]:
    """The rig, the map at each frequency of the runs, and what is to be said."""
    frequency, index = _common(runs)
    known = np.array([load.impedance(frequency) for load in loads])
    measured = np.array([run.z[i] for run, i in zip(runs, index, strict=True)])
    noises = [
        smoothed_noise(frequency, run.noise_sd[i], run.degrees_of_freedom)
        for run, i in zip(runs, index, strict=True)
        if run.noise_sd is not None
    ]
    noise = np.array(noises) if len(noises) == len(runs) else None
    _require_differences(loads, runs, measured)
    n_different = len({load.same_as for load in loads})
    unloaded = any(load.name == OPEN for load in loads)
    each = two_port(frequency, known, measured, noise, n_different)
    told = []
    if noise is None:
        told.append(
            "the noise of the calibration runs is not known, so neither is the error that it leaves in z; record "
            "several periods or averages of each"
        )
    if n_different == 1:
        if wanted == SMOOTH:
            raise InputError("--rig smooth needs runs with two different known loads, but there is one; add another")
        return None, each, [*told, undetermined(1, unloaded)]
    rig = None if wanted == EACH else smooth_rig(frequency, known, measured, noise)
    if wanted == SMOOTH and rig is None:
        raise InputError(
            "--rig smooth: no gain, delay, seismic mass and mount describe the runs; check loads and signs, or use "
            "--rig 'each frequency'"
        )
    if rig is not None and (wanted == SMOOTH or (rig.misfit is not None and rig.misfit <= LARGEST_MISFIT)):
        return rig, each, [*told, _said(rig)]
    if wanted is None:
        reason = (
            "without their noise that cannot be tested"
            if noise is None
            else "no fit was found"
            if rig is None
            else f"their misfit is {rig.misfit:.3g} times what noise explains"
        )
        told.append(f"gain, delay, seismic mass and mount are not used for the rig ({reason}); each frequency is taken")
    open_still = undetermined(n_different, unloaded)
    return None, each, [*told, *([open_still] if open_still else [])]


def _require_differences(loads: Sequence[KnownLoad], runs: Sequence[Spectrum], measured: ComplexArray) -> None:
    """Refuse a file that is given for two loads: no map turns different loads into the same measured values."""
    for j in range(len(runs)):
        for i in range(j):
            if loads[i].same_as != loads[j].same_as and np.array_equal(measured[i], measured[j]):
                raise InputError(
                    f"{runs[j].source}: its values are those of {runs[i].source}, although the loads ({loads[i].name} "
                    f"and {loads[j].name}) differ; check the files of --known-load"
                )


def _said(rig: SmoothRig) -> str:
    g, d, m, r, k, n = (f"{value:.4g} ± {sd:.1g}" for value, sd in zip(rig.values, rig.sds, strict=True))
    mount = (
        f"compliance of the mount {n} m/N"
        if rig.mount_is_seen
        else f"the mount's compliance cannot be told from zero ({n} m/N)"
    )
    fits = "" if rig.misfit is None else f"; misfit {rig.misfit:.2f} times what noise explains"
    return f"rig: gain {g}, delay {d} s, seismic mass {m} kg, damper {r} N s/m, stiffness {k} N/m, {mount}{fits}"


def _said_of_error(
    corrected: Sequence[Spectrum], left: CommonError | None, map_left: CalibrationMap | None
) -> list[str]:
    """Size of the error that the calibration leaves in all recordings."""
    relative = [
        np.sqrt(np.mean(one.calibration_sd**2, axis=1)) / np.abs(one.z)
        for one in corrected
        if one.calibration_sd is not None
    ]
    if not relative:
        return []
    middle, largest = np.median(np.concatenate(relative)), max(float(one.max()) for one in relative)
    known = (
        "and fits carry it on, at each frequency as parameters of the rig that are the same for everybody"
        if map_left is not None
        else "and fits do not know of it"
        if left is None
        else f"and fits estimate {100 * left.share:.3g} % of its variance as a gain, a delay, a mass, a damper and a "
        "stiffness around the network that are the same for everybody"
    )
    return [
        f"the runs' noise leaves an error common to all recordings (standard deviation {100 * middle:.2g} % of |z|, at "
        f"most {100 * largest:.2g} %): it is written to calibration_sd.csv, {known}"
    ]


def _common(runs: Sequence[Spectrum]) -> tuple[FloatArray, list[np.ndarray]]:
    """Frequencies that all runs have, and where."""
    frequency = runs[0].frequency_hz
    tolerance = max(run.frequency_tolerance for run in runs)
    for run in runs[1:]:
        frequency = frequency[_near(run.frequency_hz, frequency, tolerance)]
    if frequency.size < max(MINIMUM_POINTS, MINIMUM_COMMON * max(run.frequency_hz.size for run in runs)):
        raise InputError(
            f"{runs[-1].source}: only {frequency.size} frequencies are in all calibration runs; record them at the "
            "same frequencies"
        )
    return frequency, [nearest_index(run.frequency_hz, frequency) for run in runs]


def _near(grid: FloatArray, wanted: FloatArray, tolerance: float) -> np.ndarray:
    return np.asarray(np.abs(grid[nearest_index(grid, wanted)] - wanted) <= tolerance * wanted)


def _corrected(one: Spectrum, each: TwoPort, map_at: Callable[[FloatArray], TwoPort] | None) -> Spectrum:
    f, tolerance = one.frequency_hz, one.frequency_tolerance
    if map_at is None:
        kept = _near(each.frequency_hz, f, tolerance)
    else:
        kept = (f >= each.frequency_hz[0] * (1 - tolerance)) & (f <= each.frequency_hz[-1] * (1 + tolerance))
    if np.count_nonzero(kept) < max(MINIMUM_POINTS, MINIMUM_COMMON * f.size):
        raise InputError(
            f"{one.source}: of its {f.size} frequencies only {np.count_nonzero(kept)} are in the calibration; record "
            "the runs at the frequencies of the recordings"
        )
    one = _part(one, kept)
    if map_at is None:
        at = nearest_index(each.frequency_hz, one.frequency_hz)
        covariance = None if each.covariance is None else each.covariance[at]
        rig = TwoPort(
            frequency_hz=one.frequency_hz, a=each.a[at], b=each.b[at], c=each.c[at], covariance=covariance
        )  # fmt: skip
    else:
        rig = map_at(one.frequency_hz)
    z = rig.load(one.z)
    noise = None if one.noise_sd is None else one.noise_sd * rig.noise_factor(one.z)
    _require_finite(one, z)
    return replace(one, z=z, noise_sd=noise, calibration_sd=rig.common_sd(one.z))


def _require_finite(one: Spectrum, z: np.ndarray) -> None:
    wrong = ~np.isfinite(z) | (z == 0)
    if wrong.any():
        raise InputError(
            f"{one.source}: with this calibration z is zero or infinite at {one.frequency_hz[wrong][0]:g} Hz; a "
            "calibration run must not be the recording itself, so check the files"
        )


def _part(one: Spectrum, kept: np.ndarray) -> Spectrum:
    noise = None if one.noise_sd is None else one.noise_sd[kept]
    coherence = None if one.coherence is None else one.coherence[kept]
    return replace(one, frequency_hz=one.frequency_hz[kept], z=one.z[kept], noise_sd=noise, coherence=coherence)


def _own_runs(spectra: Sequence[Spectrum], runs: Sequence[Spectrum]) -> list[Spectrum] | None:
    """The run of the same subject and repetition for each recording; None unless every recording has just one."""
    by_name = {(run.subject, run.repetition): run for run in runs}
    names = [(one.subject, one.repetition) for one in spectra]
    if len(by_name) < len(runs) or len(set(names)) < len(names) or not by_name.keys() >= set(names):
        return None
    return [by_name[name] for name in names]


def _with_own_run(one: Spectrum, run: Spectrum) -> Spectrum:
    index = nearest_index(run.frequency_hz, one.frequency_hz)
    kept = _near(run.frequency_hz, one.frequency_hz, max(one.frequency_tolerance, run.frequency_tolerance))
    if np.count_nonzero(kept) < max(MINIMUM_POINTS, MINIMUM_COMMON * one.z.size):
        raise InputError(f"{run.source}: has too few of the frequencies of {one.source}; record both at the same ones")
    part = _part(one, kept)
    z = part.z - run.z[index][kept]
    _require_finite(part, z)
    noise = part.noise_sd
    if noise is not None and run.noise_sd is not None:
        noise = np.hypot(noise, run.noise_sd[index][kept])
    return replace(part, z=z, noise_sd=noise)
