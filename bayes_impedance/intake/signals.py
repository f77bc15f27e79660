"""Signals to impedance: which estimator a recording gets, and its ratio as z.

Periodic excitation is recognised by its repetition, a hammer by the crest of its force; everything else is noise. What
was chosen is said, and can be given instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.averaged_spectra import averaged_spectra, ratio_of, segments_of
from bayes_impedance.intake.channels import Channel, channel_from, guessed_channels, sampling_rate_of
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.hammer import hits_of, is_overloaded
from bayes_impedance.intake.local_polynomial import NEIGHBOURS, local_polynomial
from bayes_impedance.intake.names import Who
from bayes_impedance.intake.periodic import (
    FEWEST_PERIODS,
    best_linear_approximation,
    excited_lines,
    find_period,
    period_spectra,
    repeats,
    transient_periods,
)
from bayes_impedance.intake.quantities import FORMS, IMPEDANCE_UNIT, si_response
from bayes_impedance.intake.ratio import FloatArray, Ratio
from bayes_impedance.intake.single_sweep import SWEEPS_ONCE, is_single_sweep
from bayes_impedance.intake.spectrum import SAME_FREQUENCY, Spectrum
from bayes_impedance.intake.stepped_sine import FREQUENCY_TOLERANCE, SETTLE, stepped_ratio
from bayes_impedance.recordings.repetitions import MINIMUM_POINTS
from bayes_impedance.runtime.user_table import shown

CREST_OF_A_HAMMER = 10.0
"""Largest force over its root mean square. By choice: of a million samples of noise the largest is five, and a pulse
that lasts a hundredth of its record has ten."""
LARGEST_SAMPLE = 1e12
"""Largest sample of force or motion, in SI units. By choice: far above any measured value, and its square is finite."""
SEGMENTS = 16
"""Segments into which noise is cut by default. By choice: the standard deviation is then known to about a sixth."""


@dataclass(frozen=True, kw_only=True)
class SignalSettings:
    """What is said about signals.

    Attributes
    ----------
    force, motion : str or None
        Channels as in :mod:`.channels`; None to guess them by their units.
    reference : str or None
        Channel of the signal that was sent to the exciter: periodic excitation has its lines.
    excitation : str or None
        ``periodic``, ``noise``, ``hammer`` or ``stepped sine``; None to find out.
    rate_hz : float or None
    estimator : str
        ``H1``, ``H2``, ``Hv`` or ``local polynomial``, of noise and hits.
    window : str or None
        Of noise; hits have none.
    segment_s : float or None
        Length of the segments or of the hits' records.
    overlap : float
    period_s : float or None
    drop : int or None
        Leading periods to leave out (of every step of a stepped sine); None to test for transients (five of each step).
    band_hz : (float, float) or None
        Frequencies to keep.
    negated : bool
    """

    force: str | None = None
    motion: str | None = None
    reference: str | None = None
    excitation: str | None = None
    rate_hz: float | None = None
    estimator: str = "H1"
    window: str | None = None
    segment_s: float | None = None
    overlap: float = 0.5
    period_s: float | None = None
    drop: int | None = None
    band_hz: tuple[float, float] | None = None
    negated: bool = False

    @property
    def given(self) -> bool:
        """Whether channels are named, so that the files hold signals."""
        return self.force is not None or self.motion is not None


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """Force, motion and reference of one recording in SI units."""

    file: str
    force: Channel
    motion: Channel
    rate_hz: float
    reference: FloatArray | None


def record_of(contents: Contents, settings: SignalSettings) -> tuple[Record, list[str]]:
    """Channels of a recording, and what was guessed.

    Raises
    ------
    InputError
        If a channel cannot be used.
    """
    notes = list(contents.notes)
    names = (settings.force, settings.motion)
    if None in names:
        guess = guessed_channels(contents)
        if guess is None:
            raise InputError(
                f"{contents.file}: force and motion are not clear among {', '.join(contents.names[:12])}; name both by "
                "--force NAME[UNIT] and --motion NAME[UNIT]"
            )
        names = (settings.force or guess[0], settings.motion or guess[1])
        notes.append(f"{contents.file}: by their units, force is {shown(names[0])} and motion {shown(names[1])}")
    force = channel_from(contents, str(names[0]), "--force")
    motion = channel_from(contents, str(names[1]), "--motion")
    if force.quantity != "force" or motion.quantity == "force" or force.domain != motion.domain:
        raise InputError(
            f"{contents.file}: {shown(force.name)} is {force.quantity} ({force.domain}) and {shown(motion.name)} "
            f"{motion.quantity} ({motion.domain}), but force and motion, or torque and angle, are needed; correct the "
            "units"
        )
    for channel in (force, motion):
        lost = np.flatnonzero(~np.isfinite(channel.samples))
        if lost.size:
            raise InputError(
                f"{contents.where(int(lost[0]))}: {shown(channel.name)} has no value (and {lost.size - 1} more); cut "
                "the recording there"
            )
        largest = float(np.abs(channel.samples).max())
        if largest > LARGEST_SAMPLE:
            raise InputError(
                f"{contents.file}: {shown(channel.name)} reaches {largest:.3g} in SI units, which cannot be measured; "
                "the file is damaged, or the unit or sensitivity wrong"
            )
        if not np.ptp(channel.samples) > 0:
            raise InputError(f"{contents.file}: {shown(channel.name)} never changes; name another channel")
    rate = sampling_rate_of(contents, force, motion, settings.rate_hz)
    reference = None
    if settings.reference is not None:
        reference = contents.numbers(contents.variable(settings.reference, "--reference"))
    return Record(file=contents.file, force=force, motion=motion, rate_hz=rate, reference=reference), notes


def spectrum_of(records: Sequence[Record], who: Who, settings: SignalSettings) -> tuple[Spectrum, list[str]]:
    """Impedance of the records of one subject and repetition, which are realisations of one excitation, or hits.

    Raises
    ------
    InputError
        If the records do not go together, or hold too little.
    """
    first = records[0]
    for other in records[1:]:
        if (other.rate_hz, other.motion.quantity) != (first.rate_hz, first.motion.quantity):
            raise InputError(
                f"{other.file}: rate or quantity differ from those of {first.file}, but both are of subject "
                f"{shown(who.subject)}, repetition {shown(who.repetition)}; give them different names"
            )
    excitation, period = settings.excitation, None
    notes = []
    if excitation is None:
        period = _found_period(first, surely=True) if settings.period_s is None else None
        excitation = _kind(first, settings, period)
        notes.append(f"{first.file}: the excitation is taken for {excitation}; --excitation says otherwise")
    estimate = {"noise": _noise, "hammer": _hammer, "stepped sine": _stepped}.get(excitation, _noise)
    ratio, told = _periodic(records, settings, period) if excitation == "periodic" else estimate(records, settings)
    notes += [f"{first.file}: {text}" for text in (*told, *ratio.notes)]
    z = _impedance(ratio, first.motion, settings)
    spectrum = Spectrum(
        subject=who.subject,
        repetition=who.repetition,
        frequency_hz=z[0],
        z=z[1],
        unit=IMPEDANCE_UNIT[first.motion.domain],
        source=first.file,
        noise_sd=z[2],
        degrees_of_freedom=ratio.degrees_of_freedom,
        coherence=z[3],
        facts={**who.facts, **ratio.facts},
        frequency_tolerance=FREQUENCY_TOLERANCE if excitation == "stepped sine" else SAME_FREQUENCY,
        samples=first.force.samples.size if len(records) == 1 else None,
    )
    if spectrum.frequency_hz.size < MINIMUM_POINTS:
        raise InputError(
            f"{first.file}: there are {spectrum.frequency_hz.size} usable frequencies, but at least {MINIMUM_POINTS} "
            "are needed; widen --band, or check the channels"
        )
    return spectrum, notes


Points = tuple[FloatArray, np.ndarray, FloatArray | None, FloatArray | None]


def _impedance(ratio: Ratio, motion: Channel, settings: SignalSettings) -> Points:
    """Frequencies, z, noise and coherence inside the band, where all are finite."""
    form = next(
        name for name, (power, inverse) in FORMS.items() if inverse == ratio.inverse and power == motion.order - 1
    )
    response = si_response(form, IMPEDANCE_UNIT[motion.domain])
    z = response.impedance(ratio.frequency_hz, ratio.value)
    z = -z if settings.negated else z
    noise = None if ratio.noise_sd is None else response.noise(z, ratio.value, ratio.noise_sd)
    low, high = settings.band_hz or (0.0, np.inf)
    good = np.isfinite(z) & (z != 0) & (ratio.frequency_hz >= low) & (ratio.frequency_hz <= high)
    if noise is not None:
        good &= np.isfinite(noise)
        # The reader wants noise above zero; a noiseless simulation has its rounding.
        noise = np.maximum(noise, 4 * np.finfo(float).eps * np.abs(z))
    coherence = ratio.coherence
    return (
        ratio.frequency_hz[good],
        z[good],
        None if noise is None else noise[good],
        None if coherence is None else coherence[good],
    )


def _kind(record: Record, settings: SignalSettings, period: int | None) -> str:
    if settings.period_s is not None:
        return "periodic"
    force = record.force.samples - np.median(record.force.samples)
    if np.abs(force).max() > CREST_OF_A_HAMMER * np.sqrt(np.mean(force**2)):
        return "hammer"
    return "noise" if period is None else "periodic"


def _found_period(record: Record, *, surely: bool = False) -> int | None:
    """The period of the reference or force, if there is one; if `surely`, one that is no chance resemblance."""
    signal = record.reference if record.reference is not None else record.force.samples
    period = find_period(signal, signal.size // FEWEST_PERIODS)
    return None if period is not None and surely and not repeats(signal, period) else period


def _periodic(records: Sequence[Record], settings: SignalSettings, period: int | None) -> tuple[Ratio, list[str]]:
    first, notes = records[0], []
    if settings.period_s is None:
        found = _found_period(first) if period is None else period
        if found is None:
            raise InputError(
                f"{first.file}: no period was found in {shown(first.force.name)}; give it in seconds with --period, or "
                "--excitation noise"
            )
        size = found
        notes.append(f"a period of {size} samples ({size / first.rate_hz:g} s) was found")
    else:
        exact = settings.period_s * first.rate_hz
        size = round(exact)
        if size < 2 * MINIMUM_POINTS or abs(exact - size) > 1e-3:
            raise InputError(
                f"{first.file}: a period of {settings.period_s:g} s is {exact:.6g} samples, but must be a whole number "
                f"of at least {2 * MINIMUM_POINTS}; correct --period or --sampling-rate"
            )
    count = min(record.force.samples.size for record in records) // size
    if count < FEWEST_PERIODS:
        raise InputError(
            f"{first.file}: there are {count} whole periods of {size} samples, but at least {FEWEST_PERIODS} are "
            "needed; correct --period, or record longer"
        )
    # The last periods are the settled ones: what is more than whole periods is cut off at the beginning.
    force, motion = (
        np.array([channel.samples[-count * size :].reshape(count, size) for channel in channels])
        for channels in ([r.force for r in records], [r.motion for r in records])
    )
    spectra = period_spectra(force, motion, first.rate_hz)
    tail = replace(spectra, force=spectra.force[:, count // 2 :], motion=spectra.motion[:, count // 2 :])
    basis = tail if tail.periods >= FEWEST_PERIODS else spectra
    lines = excited_lines(basis)
    if first.reference is not None:
        sent = np.abs(np.fft.rfft(first.reference[-count * size :].reshape(count, size).mean(axis=0)))
        sent[0] = sent[-1] = 0.0
        lines = np.flatnonzero(sent > 0.01 * sent.max())
    if not lines.size:
        raise InputError(
            f"{first.file}: no line of the period stands out of the noise; check --period and the channels, or give "
            "--excitation noise"
        )
    drop = settings.drop
    if drop is None:
        both = np.concatenate([spectra.force[:, :, lines], spectra.motion[:, :, lines]])
        drop = transient_periods(both)
        notes += [f"{drop} of {count} periods left out: they had not settled"] if drop else []
    if count - drop < FEWEST_PERIODS:
        raise InputError(
            f"{first.file}: of {count} periods {drop} are left out, but {FEWEST_PERIODS} must remain; correct "
            "--drop-periods"
        )
    settled = replace(spectra, force=spectra.force[:, drop:], motion=spectra.motion[:, drop:])
    notes.append(f"{lines.size} lines are excited, from {spectra.frequency_hz[lines[0]]:g} to "
                 f"{spectra.frequency_hz[lines[-1]]:g} Hz")  # fmt: skip
    return best_linear_approximation(settled, lines), notes


def _stepped(records: Sequence[Record], settings: SignalSettings) -> tuple[Ratio, list[str]]:
    first = records[0]
    if len(records) > 1:
        raise InputError(
            f"{records[1].file}: stepped sines of one subject and repetition must be in one record; name repetitions"
        )
    settle = SETTLE if settings.drop is None else settings.drop
    ratio = stepped_ratio(first.force.samples, first.motion.samples, first.rate_hz, first.reference, settle)
    if ratio is None:
        raise InputError(
            f"{first.file}: no steps of {settle} periods to settle and {FEWEST_PERIODS} or more to average were found; "
            "give --reference, or fewer --drop-periods"
        )
    return ratio, []


def _noise(records: Sequence[Record], settings: SignalSettings) -> tuple[Ratio, list[str]]:
    first = records[0]
    for record in records:
        for channel in (record.force, record.motion):
            if is_overloaded(channel.samples):
                raise InputError(
                    f"{record.file}: {shown(channel.name)} is overloaded (its extreme value stands in neighbouring "
                    "samples); record it again with a larger range"
                )
    if settings.estimator == "local polynomial":
        if len(records) > 1 or first.force.samples.size < 4 * NEIGHBOURS + 8:
            raise InputError(f"{first.file}: the local polynomial method takes one long record; choose H1")
        return local_polynomial(first.force.samples, first.motion.samples, first.rate_hz), []
    total = sum(record.force.samples.size for record in records)
    length = total // SEGMENTS if settings.segment_s is None else round(settings.segment_s * first.rate_hz)
    cut = [
        (
            segments_of(r.force.samples, length, settings.overlap),
            segments_of(r.motion.samples, length, settings.overlap),
        )
        for r in records
        if r.force.samples.size >= length >= 2 * MINIMUM_POINTS
    ]
    if not cut:
        raise InputError(
            f"{first.file}: {total} samples are too few for segments of {length}; give a shorter --segment in seconds"
        )
    force, motion = (np.concatenate([pair[i] for pair in cut]) for i in (0, 1))
    spectra = averaged_spectra(force, motion, first.rate_hz, settings.window or "hann", settings.overlap)
    notes = [f"{len(force)} segments of {length / first.rate_hz:g} s, worth {spectra.averages:.1f} independent ones"]
    notes += [SWEEPS_ONCE] if any(is_single_sweep(r.force.samples) for r in records) else []
    return ratio_of(spectra, settings.estimator), notes


def _hammer(records: Sequence[Record], settings: SignalSettings) -> tuple[Ratio, list[str]]:
    first = records[0]
    length = None if settings.segment_s is None else round(settings.segment_s * first.rate_hz)
    found = [hits_of(record.force.samples, record.motion.samples, length) for record in records]
    size = min(hits.force.shape[1] for hits in found)
    force, motion = (
        np.concatenate(arrays) for arrays in ([h.force[:, :size] for h in found], [h.motion[:, :size] for h in found])
    )
    left_out = {
        "hit twice": sum(h.doubles for h in found),
        "overloaded": sum(h.overloads for h in found),
        "not complete": sum(h.incomplete for h in found),
    }
    told = ", ".join(f"{count} {what}" for what, count in left_out.items() if count)
    if not len(force):
        whole = "a record is taken for one hit: if it holds several, give the length of each in seconds by --segment"
        remedy = whole if length is None else "hit again, or give another --segment"
        raise InputError(f"{first.file}: no hit can be used ({told or 'none was found'}); {remedy}")
    used = f"{len(force)} hits of {size / first.rate_hz:g} s are" if len(force) > 1 else "one hit is"
    notes = [f"{used} used{f'; left out: {told}' if told else ''}"]
    if len(force) == 1:
        notes.append("one hit gives neither coherence nor noise; record several")
    ratio = ratio_of(averaged_spectra(force, motion, first.rate_hz, "boxcar"), settings.estimator)
    return replace(ratio, facts={"hits": float(len(force))}), notes
