r"""Standard deviations of few degrees of freedom, moderated by their neighbours over frequency.

A variance of five periods has d = 8 degrees of freedom, and is wrong by a factor of two in a tenth of the points. A
likelihood that takes it as exact gives most weight to the points whose noise happens to be underestimated. Of
intervals of 90 % of three elements at 30 frequencies 81 % held the truth (d = 4: 72 %), and with the variances below
88 % (87 %), at a root mean square error that is 15 % (26 %) smaller.

The variance of each point is combined with that of its neighbours as by Smyth (2004): with the neighbours' mean of
:math:`\ln s^2`, corrected for the mean of :math:`\ln \chi^2_d`, as the logarithm of :math:`s_0^2`,

.. math:: \tilde s^2 = \frac{d\,s^2 + d_0\,s_0^2}{d + d_0}, \qquad
          \operatorname{var} \ln s^2 = \psi'(d/2) + \psi'(d_0/2) .

How alike neighbours are is in the recordings: :math:`d_0` follows from how much more the :math:`\ln s^2` differ from
their neighbours' mean than :math:`\chi^2_d` does, over all recordings of equal d. It is small where noise changes from
point to point, as with hum, and at most what eight neighbours know, :math:`\psi'(d_0/2) = \psi'(d/2) / 8`. Variances
are compared relative to the squared magnitude, or as they are, whichever is the smoother. Those that are smoother than
:math:`\chi^2_d` allows have been smoothed by somebody else, and remain.

References
----------
G. K. Smyth, Linear models and empirical Bayes methods for assessing differential expression in microarray experiments,
Statistical Applications in Genetics and Molecular Biology 3 (2004), article 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from bayes_impedance.intake.spectrum import FloatArray, Spectrum

MANY_DEGREES = 200.0
"""Degrees of freedom from which a standard deviation is taken as it is: it is known to 5 %."""
NEIGHBOURS = 4
"""Neighbours on each side. By choice: few enough that noise is nearly the same, and eight times the knowledge."""
FEWEST_POINTS = 4 * NEIGHBOURS + 2
"""Fewest frequencies of a recording. By choice: twice the window."""
SMOOTHED = 0.5
"""Share of the variance of ln chi-square below which neighbours are too alike to have d degrees of freedom each: the
standard deviations have been smoothed already, and are left as they are. By choice."""
_LEAST, _MOST = 1e-3, 1e5
"""Smallest and largest d0 that is computed; below, neighbours say nothing."""


def moderated(spectra: Sequence[Spectrum]) -> tuple[list[Spectrum], list[str]]:
    """The recordings with moderated noise, and a remark if any was.

    Parameters
    ----------
    spectra : sequence of Spectrum
        Those without noise, without its degrees of freedom, or with many, remain as they are.
    """
    result = list(spectra)
    groups: dict[float, list[int]] = {}
    for i, one in enumerate(spectra):
        if one.noise_sd is not None and one.degrees_of_freedom is not None and one.z.size >= FEWEST_POINTS:
            groups.setdefault(float(one.degrees_of_freedom), []).append(i)
    told = []
    for degrees, members in groups.items():
        if not 0 < degrees < MANY_DEGREES:
            continue
        parts = [_apart([spectra[i] for i in members], power) for power in (2.0, 0.0)]
        power, (smooth, difference) = min(zip((2.0, 0.0), parts, strict=True), key=lambda p: _mean_square(p[1][1]))
        window = 2 * NEIGHBOURS + 1
        spread, chance = _mean_square(difference) * window / (window - 1), float(polygamma(1, degrees / 2))
        if spread < SMOOTHED * chance:
            continue
        most = _degrees_of(chance / (2 * NEIGHBOURS), _MOST)
        added = _degrees_of(spread - chance, most)
        correction = float(digamma(degrees / 2) - np.log(degrees / 2))
        for i, level in zip(members, smooth, strict=True):
            one, own = spectra[i], spectra[i].noise_sd
            assert own is not None  # of the group
            around = np.exp(level - correction) * np.abs(one.z) ** power
            variance = (degrees * own**2 + added * around) / (degrees + added)
            result[i] = replace(one, noise_sd=np.sqrt(variance), degrees_of_freedom=degrees + added)
        told.append(
            f"noise_sd of {degrees:g} degrees of freedom was moderated by its neighbours over frequency, which adds "
            f"{added:.3g} ({len(members)} recording{'s' if len(members) > 1 else ''})"
        )
    return result, told


def _apart(spectra: Sequence[Spectrum], power: float) -> tuple[list[FloatArray], list[FloatArray]]:
    """Neighbours' mean of ln(s^2 / abs(z)^power) of each recording (F,), and each point's difference from it."""
    smooth, difference = [], []
    window = np.full(2 * NEIGHBOURS + 1, 1.0 / (2 * NEIGHBOURS + 1))
    for one in spectra:
        assert one.noise_sd is not None  # of the group
        level = np.log(one.noise_sd**2) - power * np.log(np.abs(one.z))
        mean = np.convolve(np.pad(level, NEIGHBOURS, "reflect"), window, "valid")
        smooth.append(mean)
        difference.append(level - mean)
    return smooth, difference


def _mean_square(parts: Sequence[FloatArray]) -> float:
    return float(np.mean(np.concatenate(parts) ** 2))


def _degrees_of(excess: float, most: float) -> float:
    """Degrees of freedom d0 with trigamma(d0 / 2) = excess, at most `most`."""
    if excess <= polygamma(1, most / 2):
        return most
    if excess >= polygamma(1, _LEAST / 2):
        return 0.0
    return float(brentq(lambda d: float(polygamma(1, d / 2)) - excess, _LEAST, most))
