"""Periodic excitation: the best linear approximation with noise and nonlinear distortion apart.

Over whole periods the transform has no leakage. At an excited line k the periods p of one realisation give F_p and X_p
of force and motion; g = mean(F) / mean(X) is the maximum-likelihood estimate with noise on both channels, and with the
residual e_p = F_p - g X_p, whose mean is zero::

    var(g) = sum_p |e_p|^2 / (P - 1) / P / |mean(X)|^2

with 2 (P - 1) real degrees of freedom. What does not repeat from period to period is noise; a nonlinear system also
answers periodically where it was not excited, and differently for every random phase of the excitation. So

- from M realisations the scatter of g between them, divided by M, is the variance of the best linear approximation,
  and what exceeds the noise is the stochastic nonlinear distortion;
- from one realisation, lines that the excitation leaves free show the distortion: odd harmonics for odd, even ones for
  even nonlinearities. The level reported is the root mean square of the motion (or force) at the free lines in the
  excited band over that of the noise of its mean: 1 if there is none.

(Pintelon & Schoukens, System Identification, 2nd edition 2012, chapters 2 and 4.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.intake.ratio import ComplexArray, FloatArray, Ratio

FEWEST_PERIODS = 2
"""Fewest periods that are averaged: from one alone the noise cannot be estimated."""
LINE_LEVEL = 0.1
"""Amplitude of an excited line, of the largest one within an octave to either side. By choice: distortion is below a
tenth, or no linear network describes the load; excitations are flatter than that."""
SIGNIFICANT = 4.0
"""Amplitude of an excited line over the noise of the mean. By choice: of ten thousand lines of noise one exceeds it."""
MANY_LINES, GAP = 20, 3.0
"""Lines, and factor between sorted levels. By choice: of twenty lines or more of one excitation, sorted by level,
neighbours differ by less; distortion lies further below."""
ALIKE = 1.2
"""By choice: closer than scatter allows would find multiples of the period, which only costs averages; further would
take a part of the signal for all of it."""
TRANSIENT_LEVEL = 0.001
"""Probability of taking a settled first period for a transient. By choice."""
CHANCE, LARGE = 1e-6, 0.1
"""Probability below which a repetition is no chance, and amplitude over the largest of the lines that are asked. By
choice. Of 2100 records of springs, fingers, masses, dampers and beams under random accelerations 1204 have a force that
resembles itself at some lag; the least likely has 2.3e-6. Of 300 multisines with noise 295 repeat, and two of the
others had been given a wrong period."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PeriodSpectra:
    """Spectra of the periods of M realisations.

    Attributes
    ----------
    frequency_hz : ndarray of float, shape (F,)
        All lines, zero included.
    force, motion : ndarray of complex, shape (M, P, F)
    """

    frequency_hz: FloatArray
    force: ComplexArray
    motion: ComplexArray

    @property
    def periods(self) -> int:
        """Number of periods of each realisation."""
        return int(self.force.shape[1])


def period_spectra(force: FloatArray, motion: FloatArray, rate_hz: float) -> PeriodSpectra:
    """Spectra of whole periods, of signals of shape (M, P, N)."""
    n = force.shape[-1]
    return PeriodSpectra(
        frequency_hz=np.arange(n // 2 + 1) * (rate_hz / n),
        force=np.fft.rfft(force, axis=-1) / n,
        motion=np.fft.rfft(motion, axis=-1) / n,
    )


def transient_periods(spectra: ComplexArray) -> int:
    """Number of leading periods that differ from the later half by more than its scatter.

    Parameters
    ----------
    spectra : ndarray of complex, shape (C, P, F)
        Of all channels at the excited lines.

    Notes
    -----
    Channels are scaled to equal noise. The squared distance of a period from the mean of the later half, summed over
    lines, is compared with the variance within that half by an F test, with the degrees of freedom of sums of unequal
    variances (Satterthwaite).
    """
    from scipy.stats import f as f_distribution

    periods = spectra.shape[1]
    tail = spectra[:, periods // 2 :]
    count = tail.shape[1]
    if count < FEWEST_PERIODS:
        return 0
    variance = tail.var(axis=1, ddof=1)
    total = variance.sum(axis=1, keepdims=True)
    weight = np.divide(1.0, total, out=np.zeros_like(total), where=total > 0)
    variance, mean = variance * weight, tail.mean(axis=1)
    within = variance.sum()
    effective = 2 * within**2 / np.sum(variance**2) if within > 0 else 1.0
    dropped = 0
    for p in range(periods // 2):
        distance = np.sum(np.abs(spectra[:, p] - mean) ** 2 * weight)
        statistic = distance / within / (1 + 1 / count) if within > 0 else 0.0
        if f_distribution.sf(statistic, effective, effective * (count - 1)) * (periods // 2) > TRANSIENT_LEVEL:
            break
        dropped = p + 1
    return dropped


def excited_lines(spectra: PeriodSpectra) -> np.ndarray:
    """Indices of the lines that the excitation holds, by the significance and level of force and motion.

    Of many significant lines (:data:`MANY_LINES`) the sorted levels of the force have a gap between excitation and
    distortion, if there is any; without a gap of a factor :data:`GAP`, and of few lines, a line is excited that has
    :data:`LINE_LEVEL` of the largest one within an octave, in force or motion.
    """
    strong = np.zeros(spectra.frequency_hz.size, dtype=bool)
    clear = np.ones(spectra.frequency_hz.size, dtype=bool)
    levels = []
    for channel in (spectra.force, spectra.motion):
        amplitude = np.sqrt(np.mean(np.abs(channel.mean(axis=1)) ** 2, axis=0))
        noise = np.sqrt(np.mean(channel.var(axis=1, ddof=1), axis=0) / spectra.periods)
        clear &= amplitude > SIGNIFICANT * noise
        # Rounding makes lines of a noiseless simulation significant; they are far below those of its excitation.
        clear &= amplitude > 1e-10 * amplitude[1:].max(initial=0.0)
        strong |= amplitude >= LINE_LEVEL * _octave_maximum(amplitude)
        levels.append(amplitude)
    clear[0] = False
    clear[-1] = False  # at half of the sampling rate the phase is not known
    significant = np.flatnonzero(clear)
    if significant.size >= MANY_LINES:
        order = significant[np.argsort(levels[0][significant])]
        steps = levels[0][order[1:]] / levels[0][order[:-1]]
        if steps.max() >= GAP:
            return np.sort(order[int(np.argmax(steps)) + 1 :])
    return np.flatnonzero(strong & clear)


def _octave_maximum(amplitude: FloatArray) -> FloatArray:
    """Largest amplitude from half to twice of every line, zero hertz left out."""
    largest = np.zeros_like(amplitude)
    for k in range(1, amplitude.size):
        largest[k] = amplitude[max(1, k // 2) : 2 * k + 1].max()
    return largest


def best_linear_approximation(spectra: PeriodSpectra, lines: np.ndarray) -> Ratio:
    """Force over motion at the excited lines, with noise, and distortion as far as the excitation shows it.

    Parameters
    ----------
    spectra : PeriodSpectra
        Of two periods or more, settled.
    lines : ndarray of int, shape (K,)
        Excited lines, ascending.
    """
    f, x = spectra.force[:, :, lines], spectra.motion[:, :, lines]
    realisations, periods = f.shape[:2]
    g = f.mean(axis=1) / x.mean(axis=1)
    residual = f - g[:, None] * x
    scatter = np.sum(np.abs(residual) ** 2, axis=1) / (periods - 1)
    noise = np.mean(scatter / periods / np.abs(x.mean(axis=1)) ** 2, axis=0) / realisations
    variance, degrees = noise, 2.0 * (periods - 1) * realisations
    facts = {"periods": float(periods), "realisations": float(realisations)}
    notes: tuple[str, ...] = ()
    if realisations > 1:
        total = np.var(g, axis=0, ddof=1) / realisations
        share = np.sqrt(np.mean(total / np.abs(g.mean(axis=0)) ** 2) / np.mean(noise / np.abs(g.mean(axis=0)) ** 2))
        facts["scatter_of_realisations_over_noise"] = float(share)
        notes = (f"{realisations} realisations scatter {share:.3g} times as much as the noise explains",)
        variance, degrees = total, 2.0 * (realisations - 1)
    free = distortion(spectra, lines)
    facts |= free
    if free:
        told = ", ".join(f"{name.replace('_', ' ')} {value:.3g}" for name, value in free.items())
        notes += (f"level at free lines over noise: {told} (1 if there is no nonlinear distortion)",)
    return Ratio(
        frequency_hz=spectra.frequency_hz[lines],
        value=g.mean(axis=0),
        inverse=False,
        noise_sd=np.sqrt(variance / 2),
        degrees_of_freedom=degrees,
        facts=facts,
        notes=notes,
    )


def distortion(spectra: PeriodSpectra, lines: np.ndarray) -> dict[str, float]:
    """Level at free odd and even lines in the band of the excited ones over the noise of the mean, of motion and force.

    Returns
    -------
    dict of str to float
        ``odd_distortion_of_motion`` and so on; only of kinds of lines that the excitation leaves free, and only if it
        excites nothing but odd lines: else a free line is not known to be free of even combinations of all orders.
    """
    if not np.all(lines % 2 == 1):
        return {}
    # A free line of the excitation's design may be the first or last of its band: one spacing beyond belongs to it.
    spacing = int(np.median(np.diff(lines))) - 1 if lines.size > 1 else 0
    between = np.arange(max(1, lines[0] - spacing), min(lines[-1] + spacing, spectra.frequency_hz.size - 1) + 1)
    free = np.setdiff1d(between, lines)
    found = {}
    for name, channel in (("motion", spectra.motion), ("force", spectra.force)):
        for kind, chosen in (("odd", free[free % 2 == 1]), ("even", free[free % 2 == 0])):
            if chosen.size:
                level = np.mean(np.abs(channel[:, :, chosen].mean(axis=1)) ** 2)
                noise = np.mean(channel[:, :, chosen].var(axis=1, ddof=1)) / spectra.periods
                if noise > 0:
                    found[f"{kind}_distortion_of_{name}"] = float(np.sqrt(level / noise))
    return found


def find_period(signal: FloatArray, largest: int) -> int | None:
    """Period in samples of a signal that repeats, up to noise; None if it does not.

    The smallest lag at which the mean squared difference of the signal from itself is within :data:`ALIKE` of the
    smallest one at any lag up to `largest`, and below half of the variance of unrelated samples.
    """
    x = signal - signal.mean()
    n = x.size
    size = 1 << (2 * n - 1).bit_length()
    transform = np.fft.rfft(x, size)
    product = np.fft.irfft(np.abs(transform) ** 2, size)[: largest + 1]
    square = np.concatenate([[0.0], np.cumsum(x**2)])
    lags = np.arange(largest + 1)
    overlap = n - lags
    energy = (square[overlap] - square[0]) + (square[n] - square[lags])
    difference = (energy - 2 * product) / overlap
    # At small lags every smooth signal resembles itself: begin where it no longer does.
    unlike = np.flatnonzero(difference > energy / overlap / 2)
    if not unlike.size:
        return None
    rest = difference[unlike[0] :]
    best = float(rest.min())
    if best > 0.5 * float((energy / overlap)[unlike[0] + int(np.argmin(rest))]):
        return None
    # The minimum of the first valley of the difference that is as deep as any.
    limit = max(ALIKE * best, 1e-12 * float(x @ x) / n)
    first = unlike[0] + int(np.argmax(rest <= limit))
    last = first
    while last < largest and difference[last + 1] <= difference[last]:
        last += 1
    return int(last)


def repeats(signal: FloatArray, period: int) -> bool:
    r"""Whether the periods of a signal are more alike than those of noise, which may resemble itself at some lag.

    The force of a spring under noise of its acceleration is nearly all in the lowest lines, and there is a lag at which
    so few resemble themselves. At a line of noise :math:`F = P |\overline{X}|^2 / s^2` of P periods has the
    distribution F(2, 2 (P - 1)), and :math:`-\ln p = (P - 1) \ln(1 + F / (P - 1))` is exponential; its sum over the
    lines above :data:`LARGE` of the largest one is a gamma variable.

    Parameters
    ----------
    signal : ndarray of float, shape (N,)
    period : int
        In samples.
    """
    from scipy.stats import gamma

    count = signal.size // period
    if count < FEWEST_PERIODS:
        return False
    lines = np.fft.rfft(signal[-count * period :].reshape(count, period), axis=1)[:, 1:-1]
    if count >= 2 * FEWEST_PERIODS:  # the later half has settled
        lines = lines[count // 2 :]
    level = np.sqrt(np.mean(np.abs(lines) ** 2, axis=0))
    asked = lines[:, level >= LARGE * level.max(initial=0.0)]
    periods, size = asked.shape
    mean, scatter = np.abs(asked.mean(axis=0)) ** 2, asked.var(axis=0, ddof=1)
    ratio = periods * mean / np.maximum(scatter, np.finfo(float).eps * mean + np.finfo(float).tiny)
    surprise = np.sum((periods - 1) * np.log1p(ratio / (periods - 1)))
    return bool(size and gamma.sf(surprise, size) < CHANCE)
