r"""Element-wise fits: each subject's elements by Levenberg-Marquardt, then their mean or median.

This is the paper's first attempt: each person's curve is fitted with the network, "absolute amplitudes and phases ...
separately", and the mean and the median of every element make the model. With :math:`Z(\theta)` in log elements the
residuals and their derivatives are

.. math::
    |Z| - |z|:\quad \frac{\partial |Z|}{\partial\theta} = |Z| \operatorname{Re}\frac{\partial_\theta Z}{Z}, \qquad
    \arg Z - \arg z:\quad \frac{\partial \arg Z}{\partial\theta} = \operatorname{Im}\frac{\partial_\theta Z}{Z}.

**The phase leaves one scale undetermined.** Multiplying every mass and damper by a factor and dividing every compliance
by it multiplies Z by that factor and leaves all phases as they are. The phase therefore determines the elements up to
one common scale. Here the scale of the start is held (each of its elements meets the recordings' magnitude in
mid-band). :func:`with_magnitude_of` sets the scale afterwards from magnitudes. A magnitude over all frequencies, in
contrast, determines the phase of any driving-point impedance (its logarithm is analytic in the right half plane), so
magnitude fits can have large phase errors only where the network is wrong, the band ends, or elements are averaged one
by one.

A single curve has many local optima. Random starts are used for a few subjects, and the best end points are starts for
all subjects. An element that a curve does not determine diverges without changing Z. It is limited to a factor of a
million from the value at which it matters in the band, so that a mean stays finite, and such elements are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.classical.levenberg_marquardt import START_SPREAD, minimise_many
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.starting_fits import best_distinct, thinned_points
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.results.curve_errors import wrapped_deg

PARTS = ("magnitude", "phase", "complex")

_RANDOM_STARTS = 64
"""Random starts for each of the few subjects searched in full. By choice, as are the next constants: more starts cost
time, and the best end points are tried on all subjects anyway."""

RUNAWAY = float(np.log(1e6))
"""Bound on the distance of a log element from the value at which it matters in the band. By choice: a factor of a
million, so that means stay finite."""

_SEARCHED = 6
"""Number of subjects fitted from random starts, evenly spread over the list. By choice: see above."""

_KEPT = 3
"""Distinct end points of each of these, used as starts for all other subjects. By choice: see above."""

_STEPS = 40
"""Levenberg-Marquardt steps in the search. By choice: enough to rank end points; the best are refined to
convergence."""


@dataclass(frozen=True, repr=False)
class ElementwiseFit(Brief):
    """Elements of all subjects, each fitted to that subject's curve alone.

    Attributes
    ----------
    elements : tuple of str
        P of them.
    log_elements : ndarray, shape (N, P)
        Natural logarithms of the values.
    converged : ndarray of bool, shape (N,)
        Whether the search ended at a minimum.
    stopped : ndarray of bool, shape (N, P)
        Elements that diverged to the bound, because the curve does not determine them.
    """

    elements: tuple[str, ...]
    log_elements: np.ndarray
    converged: np.ndarray
    stopped: np.ndarray

    def mean(self) -> dict[str, float]:
        """Arithmetic mean of every element over people."""
        return dict(zip(self.elements, np.exp(self.log_elements).mean(axis=0).tolist(), strict=True))

    def median(self) -> dict[str, float]:
        """Median of every element over people."""
        return dict(zip(self.elements, np.exp(np.median(self.log_elements, axis=0)).tolist(), strict=True))


def fit_elements(
    recordings: Recordings, network: Network, part: str, *, weighting: str = "none", seed: int = 1
) -> ElementwiseFit:
    """Fit each subject's mean recording by Levenberg-Marquardt.

    Parameters
    ----------
    recordings : Recordings
        N persons.
    network : Network
    part : str
        ``magnitude`` or ``phase`` as in the paper, or ``complex``.
    weighting : str
        ``none``: absolute errors as in the paper; ``relative``: divided by abs(z). Phases have no weight.
    seed : int
        Of the random starts.

    Returns
    -------
    ElementwiseFit

    Raises
    ------
    InputError
        If `part` or `weighting` is unknown, or a subject has fewer data values than elements.
    """
    if part not in PARTS or weighting not in ("none", "relative"):
        raise InputError(
            f"part is '{part}' and weighting is '{weighting}': choose {', '.join(PARTS)}, and none or relative"
        )
    kernel = Kernel(network)
    for subject in recordings.subjects:
        if subject.frequency_hz.size * (1 + (part == "complex")) < len(kernel.elements):
            raise InputError(
                f"subject {subject.name} has {subject.frequency_hz.size} frequencies, too few for "
                f"{len(kernel.elements)} elements: record more or use a smaller network"
            )
    centre = default_prior(kernel, recordings).centre

    def curve(subject: Subject, points: slice | np.ndarray) -> Curve:
        z = subject.mean[points]
        weight = 1 / np.abs(z) if weighting == "relative" else np.ones(z.shape)
        return Curve(kernel, subject.frequency_hz[points], z, part, weight, centre)

    full = [curve(s, slice(None)) for s in recordings.subjects]
    thinned = [curve(s, thinned_points(s.frequency_hz.size)) for s in recordings.subjects]
    spread = np.random.default_rng(seed).normal(0, START_SPREAD, (_RANDOM_STARTS, centre.size))
    searched = np.unique(np.linspace(0, len(full) - 1, _SEARCHED).round().astype(int))
    candidates = np.vstack([_search(thinned[i], np.vstack([centre, centre + spread]), _KEPT) for i in searched])
    found = [f.best(_search(t, candidates, 2)) for f, t in zip(full, thinned, strict=True)]
    theta, converged = np.array([f[0] for f in found]), np.array([f[1] for f in found])
    stopped = np.abs(theta - centre) > RUNAWAY
    return ElementwiseFit(kernel.elements, np.clip(theta, centre - RUNAWAY, centre + RUNAWAY), converged, stopped)


def with_magnitude_of(fit: ElementwiseFit, recordings: Recordings, network: Network) -> ElementwiseFit:
    """The fit with each subject's common scale set so that model and recording have equal geometric mean magnitude.

    Parameters
    ----------
    fit : ElementwiseFit
        A fit of phases.
    recordings : Recordings
        The fitted recordings.
    network : Network
    """
    kernel = Kernel(network)
    direction = _scale_direction(fit.elements)

    def moved(theta: np.ndarray, subject: Subject) -> np.ndarray:
        ratio = np.abs(subject.mean) / np.abs(kernel.impedance(theta, subject.frequency_hz))
        return np.asarray(theta + direction * np.mean(np.log(ratio)))

    theta = np.array([moved(t, s) for t, s in zip(fit.log_elements, recordings.subjects, strict=True)])
    return replace(fit, log_elements=theta)


def _scale_direction(elements: Sequence[str]) -> np.ndarray:
    """Change of the log elements that multiplies Z by e."""
    return np.array([float(kind_of(e).exponent) for e in elements])


class Curve:
    """The least squares problem of one curve.

    Parameters
    ----------
    kernel : Kernel
    frequency_hz : ndarray, shape (F,)
    z : ndarray, complex, shape (F,)
    part : str
        One of :data:`PARTS`.
    weight : ndarray, shape (F,)
        Of the residuals of magnitudes and complex values.
    centre : ndarray, shape (P,)
        Log elements whose common scale a fit of phases keeps.
    """

    def __init__(
        self,
        kernel: Kernel,
        frequency_hz: np.ndarray,
        z: np.ndarray,
        part: str,
        weight: np.ndarray,
        centre: np.ndarray,
    ) -> None:
        self.kernel, self.frequency_hz, self.part = kernel, frequency_hz, part
        self.z, self.magnitude, self.phase_deg = z, np.abs(z), np.angle(z, deg=True)
        self.weight = weight
        self.centre = centre
        self.log_scale = float(np.mean(np.log(np.abs(kernel.impedance(centre, frequency_hz)))))

    def residual(self, theta: np.ndarray) -> np.ndarray:
        """Weighted differences at log elements theta, (..., P) to (..., K)."""
        return self._residual(self.kernel.impedance(theta, self.frequency_hz))

    def _residual(self, model: np.ndarray) -> np.ndarray:
        if self.part == "phase":
            difference = np.radians(wrapped_deg(np.angle(model, deg=True) - self.phase_deg))
            # One more row fixes the scale that phases leave undetermined; it is zero at every optimum.
            scale = np.mean(np.log(np.abs(model)), axis=-1, keepdims=True) - self.log_scale
            return np.concatenate([difference, scale], axis=-1)
        if self.part == "magnitude":
            return np.asarray(self.weight * (np.abs(model) - self.magnitude))
        difference = self.weight * (model - self.z)
        return np.concatenate([difference.real, difference.imag], axis=-1)

    def linearised(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Weighted differences (..., K) and their derivatives (..., K, P)."""
        model, derivative = self.kernel.derivative(theta, self.frequency_hz)
        if self.part == "phase":
            ratio = derivative / model[..., None, :]
            rows = np.concatenate([ratio.imag, ratio.real.mean(axis=-1, keepdims=True)], axis=-1)
        elif self.part == "magnitude":
            rows = self.weight * np.abs(model)[..., None, :] * (derivative / model[..., None, :]).real
        else:
            weighted = self.weight * derivative
            rows = np.concatenate([weighted.real, weighted.imag], axis=-1)
        return self._residual(model), np.ascontiguousarray(np.swapaxes(rows, -1, -2))

    def jacobian(self, theta: np.ndarray) -> np.ndarray:
        """Derivatives of the weighted differences, (..., P) to (..., K, P)."""
        return self.linearised(theta)[1]

    def minimise(self, start: np.ndarray, evaluations: int = 200) -> tuple[np.ndarray, float, bool]:
        """End point, half the sum of squares, and whether it is a minimum."""
        from scipy.optimize import least_squares

        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # far away Z may not be finite
            if not np.all(np.isfinite(self.residual(start))):
                return start, np.inf, False
            done = least_squares(self.residual, start, self.jacobian, method="lm", max_nfev=evaluations)
        return done.x, float(done.cost), bool(done.status > 0)

    def best(self, starts: np.ndarray, evaluations: int = 200) -> tuple[np.ndarray, bool]:
        """Best end point of several starts, (S, P) to (P,), and whether it is a minimum."""
        ends = [self.minimise(start, evaluations) for start in starts]
        theta, _, converged = min(ends, key=lambda end: end[1])
        return theta, converged


def _search(curve: Curve, starts: np.ndarray, n: int) -> np.ndarray:
    """The n best distinct end points; the best is repeated if there are fewer."""
    ends, costs = minimise_many(curve.linearised, starts, _STEPS)
    return best_distinct(ends, costs, n)
