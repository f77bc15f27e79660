"""H1, H2 and Hv of random or transient excitation, with coherence and noise, from averaged spectra.

Signals are cut into segments (or are hits already), their means removed, windowed, and transformed. With the averages
Sff, Sxx of force and motion and Sfx = mean(conj(F) X)::

    H1 = Sfx / Sff                   noise on the motion only
    H2 = Sxx / conj(Sfx)             noise on the force only
    Hv = (Sxx - Sff + sqrt((Sff - Sxx)^2 + 4 |Sfx|^2)) / (2 conj(Sfx))    noise of equal size on both, in their units
    c  = |Sfx|^2 / (Sff Sxx)

(Shin & Hammond, Fundamentals of Signal Processing, 2008, section 9.3; the conventions of the package pyFRF.)
The noise of H1 follows from regression of X on F over n independent segments: the residual variance is Sxx (1 - c)
n / (n - 1), so that each of real and imaginary part of H1 has variance |H1|^2 (1 - c) / (2 c (n - 1)) with 2 (n - 1)
degrees of freedom; that of H2 and Hv is the same to first order in 1 - c. Overlapping segments count less: with the
correlation rho_k of the window with itself shifted by k segments, K segments are worth
K / (1 + 2 sum_k (1 - k/K) rho_k^2) independent ones (Welch 1967).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.intake.ratio import ComplexArray, FloatArray, Ratio


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectra:
    """Averaged spectra at all lines of the transform, zero and highest included.

    Attributes
    ----------
    frequency_hz : ndarray of float, shape (F,)
    force, motion : ndarray of float, shape (F,)
        Mean squared magnitude.
    cross : ndarray of complex, shape (F,)
        Mean of conj(force) times motion.
    averages : float
        Number of independent segments.
    """

    frequency_hz: FloatArray
    force: FloatArray
    motion: FloatArray
    cross: ComplexArray
    averages: float

    @property
    def coherence(self) -> FloatArray:
        """Coherence, NaN where there is no signal."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.abs(self.cross) ** 2 / (self.force * self.motion))

    def response(self, estimator: str = "H1") -> ComplexArray:
        """Motion over force by the estimator ``H1``, ``H2`` or ``Hv``, shape (F,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            if estimator == "H1":
                return np.asarray(self.cross / self.force)
            if estimator == "H2":
                return np.asarray(self.motion / self.cross.conj())
            root = np.sqrt((self.force - self.motion) ** 2 + 4 * np.abs(self.cross) ** 2)
            # Two forms of the same number: neither may subtract what is nearly equal.
            small = 2 * self.cross / (root + self.force - self.motion)
            large = (root + self.motion - self.force) / (2 * self.cross.conj())
            return np.asarray(np.where(self.force > self.motion, small, large))


def segments_of(signal: FloatArray, length: int, overlap: float) -> FloatArray:
    """Whole segments of a signal, shape (K, length); what is left at the end is not used."""
    step = max(1, length - round(overlap * length))
    return np.lib.stride_tricks.sliding_window_view(signal, length)[::step]


def averaged_spectra(
    force: FloatArray, motion: FloatArray, rate_hz: float, window: str = "boxcar", overlap: float = 0.0
) -> Spectra:
    """Average the spectra of segments or hits.

    Parameters
    ----------
    force, motion : ndarray of float, shape (K, N)
    rate_hz : float
    window : str
        ``hann``, ``hamming``, ``blackman``, ``flattop`` or ``boxcar``.
    overlap : float
        Share of a segment that the next one shares, from which the number of independent segments follows.
    """
    from scipy.signal import get_window

    count, length = force.shape
    w = get_window(window, length, fftbins=False)
    f, x = (np.fft.rfft((s - s.mean(axis=1, keepdims=True)) * w, axis=1) for s in (force, motion))
    return Spectra(
        frequency_hz=np.arange(length // 2 + 1) * (rate_hz / length),
        force=np.mean(np.abs(f) ** 2, axis=0),
        motion=np.mean(np.abs(x) ** 2, axis=0),
        cross=np.mean(f.conj() * x, axis=0),
        averages=independent_averages(w, count, overlap),
    )


def independent_averages(window: npt.NDArray[np.float64], count: int, overlap: float) -> float:
    """Number of independent segments that overlapping ones are worth (Welch 1967)."""
    length, total = window.size, float(window @ window)
    step = max(1, length - round(overlap * length))
    lost = 0.0
    for k in range(1, count):
        if k * step >= length:
            break
        rho = float(window[k * step :] @ window[: length - k * step]) / total
        lost += 2 * (1 - k / count) * rho**2
    return count / (1 + lost)


def ratio_of(spectra: Spectra, estimator: str = "H1") -> Ratio:
    """Motion over force at all lines above zero, with its noise if there are two averages or more."""
    inside = slice(1, None)
    value, coherence = spectra.response(estimator)[inside], np.clip(spectra.coherence[inside], 0.0, 1.0)
    n = spectra.averages
    noise, degrees = None, None
    if n >= 1.5:  # with fewer the coherence is 1 whatever the noise
        with np.errstate(invalid="ignore", divide="ignore"):
            noise = np.abs(value) * np.sqrt((1 - coherence) / (2 * coherence * (n - 1)))
        degrees = 2 * (n - 1)
    return Ratio(
        frequency_hz=spectra.frequency_hz[inside],
        value=value,
        inverse=True,
        noise_sd=noise,
        degrees_of_freedom=degrees,
        coherence=coherence if noise is not None else None,
        facts={"averages": round(n, 2)},
    )
