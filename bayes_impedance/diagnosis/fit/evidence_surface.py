r"""Log density of the additions' central values: the evidence of everybody's recordings, and its maximum.

A fit moves the additions to the maximum of a quadratic expansion (:mod:`.normal_equations`) around everybody's
parameters with the elements left free, which adds up what each person's recordings say by themselves. Where they
determine coefficient, shape and elements only together, along a curved ridge, each person's own optimum is off along
it, all to the same side; and as the sum is far better determined than any of its parts, it is off by many standard
deviations: a power law beside a second path by five, where the evidence was 9 units below that of the truth.

The evidence of the recordings, with everybody's parameters integrated out under the population (:mod:`.fitter`), has no
such bias. With the additions' central values a held, and the population of the elements at its best,

.. math:: L(a) = \sum_i \ell_i(a) + \ln p(a) .

Standard deviations of coefficients between people are held, not their ratios to the mean as in a fit: with these, N
people whose coefficients are known would tell their mean as if its logarithm were known to
:math:`r / \sqrt{N (1 + 2r^2)}`, because a ratio r that is held says what the mean is.

The axes of the expansion's covariance are followed one after the other to where a parabola through three points of L
has its maximum, until nothing is gained any more. A resonance of the rig was 2.3 units below its maximum, and was
called a resonator of the body, which was 0.6 below.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.additions_step import central_values, following
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.extend import with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit

_ROUNDS = 30
"""Largest number of rounds of a fit with held additions. By choice: it begins where the next point's ended."""

_SWEEPS, GAIN = 3, 0.3
"""Largest number of times that all axes are followed, and gain of log evidence that ends them. By choice: the centre is
then within a standard deviation of the last one."""

_LONGEST, _SHORTEST = 4.0, 0.2
"""Longest step along an axis, in standard deviations of the expansion, and shortest that is worth a fit. By choice: a
parabola through three points one apart is not to be trusted beyond, and the second changes L by 0.02."""

SMALLEST = 1e-6
"""Absolute value of a coefficient below which it is as good as zero. By choice: far less than can be told."""


def climbed(refitter: Refitter, fit: Refit, seed: int) -> Refit:
    """The fit where its evidence is largest, or as it is if that is larger already.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    seed : int
    """
    if not fit.model.parameters:
        return fit
    surface = EvidenceSurface(refitter, fit, seed)
    surface.climb()
    return surface.fit


class EvidenceSurface:
    """A log density of some coordinates, and where the search for its maximum has come to: here L(a).

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Of a model with additions.
    seed : int

    Attributes
    ----------
    centre : ndarray, shape (D,)
        Central values of the additions.
    fit : Refit
        There.
    value : float
        Log density there.
    """

    def __init__(self, refitter: Refitter, fit: Refit, seed: int) -> None:
        self.refitter, self.seed = refitter, seed
        self.prior_sd = np.array([p.prior_sd for p in fit.model.parameters])
        self.prior_centre = np.array([p.centre for p in fit.model.parameters])
        self.centre, self.fit = central_values(fit), fit
        self.value = self.log_density(fit, self.centre)

    def at(self, start: Refit, there: np.ndarray) -> tuple[Refit, float]:
        """The fit at coordinates (D,), from another one, and the log density."""
        return self.held(start, there, _as_wide(start.model, central_values(start), there))

    def held(self, start: Refit, a: np.ndarray, model: Model) -> tuple[Refit, float]:
        """The fit of a model with the additions' central values at a (A,), from another one, and L."""
        fit = following(start, a - central_values(start))
        fit = self.refitter.fit(model, fit.u, fit.population, _ROUNDS, hold_additions=True)
        return fit, self.log_density(fit, a)

    def log_density(self, fit: Refit, a: np.ndarray) -> float:
        """L(a)."""
        value = float(fit.evidence.sum() - 0.5 * np.sum(((a - self.prior_centre) / self.prior_sd) ** 2))
        return value if np.isfinite(value) else -np.inf

    def axes(self) -> np.ndarray:
        """Axes (D, D) of the quadratic expansion there: columns of one standard deviation, longest first."""
        covariance = coefficient_posterior(self.fit, self.seed, 1).covariance
        sd = np.sqrt(np.diag(covariance))
        size, axes = np.linalg.eigh(covariance / np.outer(sd, sd))
        length = np.sqrt(np.maximum(size, np.finfo(float).tiny))
        return np.asarray((sd[:, None] * axes * length)[:, ::-1])

    def move(self, fit: Refit, centre: np.ndarray, value: float) -> None:
        """Go to another place."""
        self.fit, self.centre, self.value = fit, centre, value

    def climb(self) -> None:
        """Go to where the log density is largest."""
        for _ in range(_SWEEPS):
            before, begin = self.value, self.centre
            for axis in self.axes().T:
                self._follow(axis)
            if self.value - before < GAIN:
                break
            self._follow(self.centre - begin)  # along a ridge that no axis follows

    def _follow(self, axis: np.ndarray) -> None:
        """Go along an axis (D,) to the maximum of the parabola through three points, or to the best point."""
        there = [(t, *self.at(self.fit, self.centre + t * axis)) for t in (1.0, -1.0)]
        t, fit, value = max(*there, (0.0, self.fit, self.value), key=lambda point: point[2])
        if all(np.isfinite(point[2]) for point in there):
            slope, bend = 0.5 * (there[0][2] - there[1][2]), there[0][2] + there[1][2] - 2 * self.value
            best = float(np.clip(-slope / bend, -_LONGEST, _LONGEST)) if bend < 0 else _LONGEST * t
            if abs(best - t) > _SHORTEST:
                point = (best, *self.at(fit, self.centre + best * axis))
                t, fit, value = max(point, (t, fit, value), key=lambda point: point[2])
        if value > self.value:
            self.move(fit, self.centre + t * axis, value)


def _as_wide(model: Model, before: np.ndarray, after: np.ndarray) -> Model:
    """The model with the same standard deviations between people, after a change of the central values (A,)."""
    ratio = np.maximum(np.abs(before), SMALLEST) / np.maximum(np.abs(after), SMALLEST)
    for i, addition in enumerate(model.additions):
        columns = [c - model.n_elements for c in model.columns(i)]
        own = dispersions_of(model, i)
        wide = [
            d * float(ratio[c]) if model.parameters[c].is_coefficient else d for c, d in zip(columns, own, strict=False)
        ]
        if addition.pooling != "shared" and wide != own:
            model = with_pooling(model, i, addition.pooling, wide)
    return model


def dispersions_of(model: Model, addition: int) -> list[float]:
    """Dispersions of an addition's parameters; elements of a branch have one."""
    own = [p.dispersion for p in model.parameters if p.addition == addition]
    return own if model.additions[addition].effect.operation else own[:1]
