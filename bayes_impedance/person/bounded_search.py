r"""Search for modes by a bounded error: that of the reflection coefficient with respect to the recording's magnitude.

Near a pole or a zero of low damping the relative error is unbounded: a model whose resonance is one point off is wrong
there by a factor of a thousand, and the sum of squares of :mod:`bayes_impedance.person.mode` has a barrier between
neighbouring points, which the resonance must cross. For a passive z the reflection coefficient is bounded,

.. math:: \Gamma(z) = \frac{z - z_0}{z + z_0}, \qquad |\Gamma| \le 1 \text{ where } \operatorname{Re} z \ge 0, \qquad
          \frac{d\Gamma}{dz} = \frac{2 z_0}{(z + z_0)^2},

with :math:`z_0 = |z_k|` of the recording at each point, so that poles and zeros of model and recording count alike.
Noise of standard deviation sigma makes an error :math:`2 z_0 \sigma / |z_k + z_0|^2` of Gamma. Near the recording the
error is the relative one, so the optimum that is found is a start for the exact objective.

Of two hundred random starts for the lossless ``m1-n1-(m2|n2)`` 19 lead to the best mode by this error, and none by the
relative one; where resonances are damped both are alike (measured for 18 persons of six networks). All starts take
their steps together.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.person.mode import MAX_ITERATIONS, all_modes

GROSS = 1.5
"""Noise scale above which an optimum is not taken for the global one. By choice: persons of one
population differ by less, and in the first fits the noise that is assumed is several times that of most recordings."""

STEPS = 15
"""Steps from each start. By choice, for time: with 40, in twice the time, 57 of 600 starts reached the best mode of
three persons without damping, with 15 only 33."""

_ATTEMPTS = 3
"""Dampings that are tried in a step. By choice: a start that gets worse in all of them waits for the next step."""

_LONGEST = 2.0
"""Largest change of a log element in one step, as in :mod:`bayes_impedance.person.mode`."""


def modes_from(
    kernel: Kernel,
    likelihood: Likelihood,
    starts: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray]:
    """End points (S, P) of :func:`~bayes_impedance.person.mode.all_modes`, and their objectives (S,).

    If none of them describes the recordings to within :data:`GROSS` times their noise, the bounded search is tried
    from each start as well.
    """
    arguments = (prior_mean, prior_precision, max_iterations)
    ends, objectives, _ = all_modes(kernel, likelihood, starts, *arguments)
    exponent = SCALE_SHAPE + likelihood.count
    if np.min(objectives) < exponent * np.log(exponent * GROSS**2):
        return ends, objectives
    nearer = bounded_search(kernel, likelihood, starts, prior_mean, prior_precision)
    others, values, _ = all_modes(kernel, likelihood, nearer, *arguments)
    better = values < objectives
    return np.where(better[:, None], others, ends), np.where(better, values, objectives)


def bounded_search(
    kernel: Kernel,
    likelihood: Likelihood,
    starts: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    steps: int = STEPS,
) -> np.ndarray:
    """Damped Gauss-Newton steps on the reflection coefficient of a person's first recording, from every start.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        Of one person. Repetitions have the optimum in common, but for their deviations; one is enough for a start.
    starts : ndarray, shape (S, P)
        Log elements.
    prior_mean : ndarray, shape (P,)
    prior_precision : ndarray, shape (P, P)
    steps : int

    Returns
    -------
    ndarray, shape (S, P)
        Starts for :func:`bayes_impedance.person.mode.all_modes`; no optimum is claimed.
    """
    frequency_hz = likelihood.omega / (2 * np.pi)
    z = likelihood.z[0, 0] + 1j * likelihood.z[0, 1]
    deviation, weight = likelihood.deviations[0], likelihood.weight[0]
    z0 = np.maximum(np.abs(z), np.finfo(float).tiny)
    root = np.sqrt(weight) * np.abs(z + z0) ** 2 / (2 * z0)  # 1/sd of the reflection coefficient
    exponent = SCALE_SHAPE + z.size

    def errors(there: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            gamma = (there - z0) / (there + z0)
        # At a pole gamma is one; z0 < 0 of an active model has no bound, and is held at the size of a gross error.
        gamma = np.where(np.isfinite(gamma), gamma, 1.0)
        gamma = gamma / np.maximum(np.abs(gamma) / 2, 1.0)
        return np.asarray((gamma - (z - z0) / (z + z0)) * root)

    def objective(r: np.ndarray, u: np.ndarray) -> np.ndarray:
        chi = np.sum(np.abs(r) ** 2, axis=1)
        offset = u - prior_mean
        prior = 0.5 * np.einsum("sp,pq,sq->s", offset, prior_precision, offset)
        return np.asarray(exponent * np.log(SCALE_SHAPE + 0.5 * chi) + prior)

    u, damping = starts.copy(), np.full(len(starts), 1e-2)
    best = objective(errors(kernel.impedance(u + deviation, frequency_hz)), u)
    eye = np.eye(u.shape[1])
    for _ in range(steps):
        there, slope = kernel.derivative(u + deviation, frequency_hz)
        r = errors(there)
        with np.errstate(all="ignore"):
            turned = slope * (2 * z0 / (there + z0) ** 2 * root)[:, None]
        turned = np.nan_to_num(turned, nan=0.0, posinf=0.0, neginf=0.0)
        flat, rows = np.concatenate([r.real, r.imag], axis=1), np.concatenate([turned.real, turned.imag], axis=2)
        w = exponent / (SCALE_SHAPE + 0.5 * np.sum(flat**2, axis=1))
        curvature = w[:, None, None] * (rows @ np.swapaxes(rows, 1, 2)) + prior_precision
        gradient = w[:, None] * (rows @ flat[..., None])[..., 0] + (u - prior_mean) @ prior_precision
        diagonal = np.einsum("spp->sp", curvature)[:, :, None] * eye
        waiting = np.isfinite(best)
        for _ in range(_ATTEMPTS):
            step = -np.linalg.solve(curvature + damping[:, None, None] * diagonal, gradient[..., None])[..., 0]
            step *= np.minimum(1.0, _LONGEST / np.maximum(np.abs(step).max(axis=1, keepdims=True), 1e-12))
            trial = u + step
            value = objective(errors(kernel.impedance(trial + deviation, frequency_hz)), trial)
            better = waiting & (value <= best)
            u[better], best[better] = trial[better], value[better]
            damping[better] = np.maximum(damping[better] / 5, 1e-9)
            waiting &= ~better
            damping[waiting] = np.minimum(5 * damping[waiting], 1e8)
            if not waiting.any():
                break
    return u
