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
relative one; where resonances are damped both are alike (measured for 18 persons of six networks).

**Broad resonances first.** A bounded error has no barrier, but where resonances do not overlap it is flat. For a
passive z and constant :math:`z_0` the reflection coefficient is analytic and bounded in the right half-plane. Its
values at :math:`s = \omega(\zeta + j)`, where every resonance has a damping ratio of :math:`\zeta` more, then follow
from those at real frequencies by Poisson's integral

.. math:: \Gamma(\sigma + j\omega) = \frac1\pi \int \frac{\sigma\,\Gamma(j\omega')}{(\omega - \omega')^2 + \sigma^2}
          \,d\omega' , \qquad \sigma = \zeta\omega .

A network of elements is evaluated at these s directly (:func:`~bayes_impedance.network.kernel.workspace`). The search
follows the recording from a damping in which neighbouring resonances overlap down to its own; frequencies beyond the
band count as those within. Of 96 random starts for each of eight people with ``(m1-n1-(n2|m2))|r1|(r2-n3)`` the bounded
error alone led to the best mode from none, with dampings from 2 to 57 (median 46); with ``(m1-n1-r1)|n2|(m2-n3)`` from
at most 2, and from 0 to 46 (median 34).
"""

from __future__ import annotations

import math

import numpy as np

from bayes_impedance.network.kernel import Kernel, backward_apart, compiled, forward_apart, workspace
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.person.mode import MAX_ITERATIONS, all_modes
from bayes_impedance.person.small_matrices import solved

GROSS = 1.5
"""Noise scale above which an optimum is not taken for the global one. By choice: persons of one
population differ by less, and in the first fits the noise that is assumed is several times that of most recordings."""

DAMPINGS = (0.3, 0.1, 0.03)
"""Damping ratios that are added one after the other before none is. By choice: with 0.3 resonances a third apart
overlap; the last resolves what 64 points in two decades show."""

_DAMPED_STEPS, _DAMPED_POINTS = 8, 512
"""Steps from each start with each of them, and most frequencies. By choice: the place is only where the next begins,
and a damping ratio of 0.03 needs no more in two decades; the integral takes time and memory with their square."""

STEPS = 15
"""Steps from each start. By choice, for time: with 40, in twice the time, 57 of 600 starts reached the best mode of
three persons without damping, with 15 only 33."""

_ATTEMPTS = 3
"""Dampings that are tried in a step. By choice: a start that gets worse in all of them goes on with the last."""

_STAGES = ((4, 32), (15, 4), (40, 1))
"""Largest numbers of steps of the exact search, and how many of the ends go on: 4 steps from all starts, 15 from the
best of these, as many as make no use of the exact second derivative, and 40 from the few best. With the 40 for all
ends of the first stage, twelve times as long, the optimum was lower by at most 0.2 in 140 searches of a battery's
recordings."""

_SAME = 1e-3
"""Differences of objectives below which ends are the same optimum, of which one goes on. By choice: a hundredth of what
decides anything. Under a wrong model most of the four ends of the second stage are the same."""

_LONGEST = 2.0
"""Largest change of a log element in one step, as in :mod:`bayes_impedance.person.mode`."""


@compiled
def _error(outputs: np.ndarray, z0: np.ndarray, measured: np.ndarray, root: np.ndarray, error: np.ndarray) -> float:
    """Weighted errors of the reflection coefficient after :func:`forward`, into `error` (2, F); their sum of squares.

    Parameters
    ----------
    outputs : ndarray, shape (N + 1, 2, F)
    z0, root : ndarray, shape (F,)
    measured : ndarray, shape (2, F)
        The recording's reflection coefficient.
    """
    last, total = outputs.shape[0] - 2, 0.0
    for f in range(z0.size):
        x, y = outputs[last, 0, f], outputs[last, 1, f]
        behind, ahead = x - z0[f], x + z0[f]
        scale = 1.0 / (ahead * ahead + y * y)
        real, imag = (behind * ahead + y * y) * scale, 2.0 * z0[f] * y * scale
        if not (math.isfinite(real) and math.isfinite(imag)):  # at a pole gamma is one
            real, imag = 1.0, 0.0
        # An active model has no bound, and is held at the size of a gross error.
        held = 1.0 / max(0.5 * math.sqrt(real * real + imag * imag), 1.0)
        error[0, f] = (real * held - measured[0, f]) * root[f]
        error[1, f] = (imag * held - measured[1, f]) * root[f]
        total += error[0, f] * error[0, f] + error[1, f] * error[1, f]
    return total


@compiled
def _slopes_of_error(outputs: np.ndarray, z0: np.ndarray, root: np.ndarray, adjoint: np.ndarray) -> None:
    """Derivative of the weighted error with respect to z, into `adjoint` (2, F), where :func:`backward` begins."""
    last = outputs.shape[0] - 2
    for f in range(z0.size):
        ahead, y = outputs[last, 0, f] + z0[f], outputs[last, 1, f]
        scale = 1.0 / (ahead * ahead + y * y)
        size = 2.0 * z0[f] * root[f] * scale * scale
        adjoint[0, f] = size * (ahead * ahead - y * y)
        adjoint[1, f] = -2.0 * size * ahead * y


@compiled
def _search(
    program: Program,
    starts: np.ndarray,
    omega: np.ndarray,
    z0: np.ndarray,
    measured: np.ndarray,
    root: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    steps: int,
    zeta: float,
) -> np.ndarray:
    """Damped Gauss-Newton steps from every start (S, P); where they ended, same shape."""
    n_nodes, n_elements = program.node_parent.size, starts.shape[1]
    sums, outputs = workspace(program, omega, zeta)
    adjoints = np.empty((n_nodes + 1, 2, omega.size))
    rows = np.empty((n_elements, 2, omega.size))
    error = np.empty((2, omega.size))
    exponent = SCALE_SHAPE + omega.size
    ends = starts.copy()
    for i in range(starts.shape[0]):
        u, damping = starts[i].copy(), 1e-2
        forward_apart(program, u, omega, sums, outputs)
        chi = _error(outputs, z0, measured, root, error)
        offset = u - prior_mean
        best = exponent * math.log(SCALE_SHAPE + 0.5 * chi) + 0.5 * offset @ (prior_precision @ offset)
        moved = True
        for _ in range(steps):
            if not math.isfinite(best):
                break
            if moved:
                forward_apart(program, u, omega, sums, outputs)
                chi = _error(outputs, z0, measured, root, error)
                _slopes_of_error(outputs, z0, root, adjoints[n_nodes])
                backward_apart(program, u, omega, sums, outputs, adjoints, rows)
                flat = rows.reshape(n_elements, 2 * omega.size)
                for p in range(n_elements):
                    for f in range(flat.shape[1]):
                        if not math.isfinite(flat[p, f]):
                            flat[p, f] = 0.0
                w = exponent / (SCALE_SHAPE + 0.5 * chi)
                curvature = w * (flat @ flat.T) + prior_precision
                gradient = w * (flat @ error.reshape(2 * omega.size)) + prior_precision @ (u - prior_mean)
            moved = False
            for _attempt in range(_ATTEMPTS):
                damped = curvature.copy()
                for p in range(n_elements):
                    damped[p, p] += damping * curvature[p, p]
                step = -solved(damped, gradient)
                step *= min(1.0, _LONGEST / max(np.abs(step).max(), 1e-12))
                trial = u + step
                forward_apart(program, trial, omega, sums, outputs)
                chi = _error(outputs, z0, measured, root, error)
                offset = trial - prior_mean
                value = exponent * math.log(SCALE_SHAPE + 0.5 * chi) + 0.5 * offset @ (prior_precision @ offset)
                if value <= best:
                    u, best, moved = trial, value, True
                    damping = max(damping / 5.0, 1e-9)
                    break
                damping = min(5.0 * damping, 1e8)
        for p in range(n_elements):
            ends[i, p] = u[p]
    return ends


def gross(likelihood: Likelihood) -> float:
    """Objective of a mode that leaves :data:`GROSS` times the noise."""
    exponent = SCALE_SHAPE + likelihood.count
    return exponent * math.log(exponent * GROSS**2)


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
    if np.min(objectives) < gross(likelihood):
        return ends, objectives
    nearer = bounded_search(kernel, likelihood, starts, prior_mean, prior_precision)
    others, values, _ = all_modes(kernel, likelihood, nearer, *arguments)
    better = values < objectives
    return np.where(better[:, None], others, ends), np.where(better, values, objectives)


def best_mode(
    kernel: Kernel,
    likelihood: Likelihood,
    starts: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    stages: int = len(_STAGES),
) -> tuple[np.ndarray, float]:
    """The best of the modes that are reached from any of the starts (S, P), in stages: place (P,) and objective.

    Few steps are made from all starts, more from the best of these ends, and all from the very best; after two stages
    the place is near a mode.
    """
    ends = starts
    for steps, kept in _STAGES[:stages]:
        ends, values, _ = all_modes(kernel, likelihood, ends, prior_mean, prior_precision, steps)
        order = np.argsort(values, kind="stable")
        values = np.nan_to_num(values[order])  # inf where the network has no value
        apart = np.diff(values, prepend=-np.inf) > _SAME
        ends, values = ends[order[apart][:kept]], values[apart][:kept]
    return np.asarray(ends[0]), float(values[0])


def best_end(
    kernel: Kernel, likelihood: Likelihood, starts: np.ndarray, prior_mean: np.ndarray, prior_precision: np.ndarray
) -> np.ndarray:
    """Place (P,) near the best mode that is reached from any of the starts (S, P), from which a fit may begin.

    If that leaves more than :data:`GROSS` times the noise, the bounded search is tried as well.
    """
    arguments = (prior_mean, prior_precision)
    place, value = best_mode(kernel, likelihood, starts, *arguments, stages=2)
    if value < gross(likelihood):
        return place
    nearer = bounded_search(kernel, likelihood, starts, *arguments)
    other, less = best_mode(kernel, likelihood, nearer, *arguments, stages=2)
    return other if less < value else place


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
    deviation, few = likelihood.deviations[0], likelihood.thinned(_DAMPED_POINTS)
    damped = few.omega.size > 1 and not kernel.program.node_code.any()
    stages = [(few, zeta, _DAMPED_STEPS) for zeta in DAMPINGS if damped]
    ends = starts + deviation
    for data, zeta, most in [*stages, (likelihood, 0.0, steps)]:
        z0, target, root = _reflected(data)
        if zeta > 0:
            target = _smoothed(data.omega, data.z[0, 0] + 1j * data.z[0, 1], z0, zeta)
        ends = _search(
            kernel.program,
            np.ascontiguousarray(ends),
            data.omega,
            z0,
            np.array([target.real, target.imag]),
            root,
            prior_mean + deviation,
            np.ascontiguousarray(prior_precision),
            most,
            zeta,
        )
    return np.asarray(ends - deviation)


def _smoothed(omega: np.ndarray, z: np.ndarray, z0: np.ndarray, zeta: float) -> np.ndarray:
    """Reflection coefficient at omega (j + zeta) with respect to z0, each (F,): Poisson's integral over the band."""
    gamma = (z - z0[:, None]) / (z + z0[:, None])
    sigma = zeta * omega[:, None]
    width = np.gradient(omega) * sigma
    above, below = (width / ((omega[:, None] - sign * omega) ** 2 + sigma**2) for sign in (1, -1))
    total = np.sum(above * gamma + below * gamma.conj(), axis=1)
    return np.asarray(total / np.sum(above + below, axis=1))


def bounded_errors(kernel: Kernel, likelihood: Likelihood, places: np.ndarray) -> np.ndarray:
    """Weighted squares (S,) of the bounded error of a person's first recording at places (S, P)."""
    z0, measured, root = _reflected(likelihood)
    z = kernel.impedance(places + likelihood.deviations[0], likelihood.omega / (2 * np.pi))
    with np.errstate(invalid="ignore", divide="ignore"):  # at a pole gamma is one
        gamma = np.where(np.isfinite(z), (z - z0) / (z + z0), 1.0)
    gamma /= np.maximum(0.5 * np.abs(gamma), 1.0)  # as in the search
    return np.asarray(np.sum(np.abs((gamma - measured) * root) ** 2, axis=-1))


def _reflected(likelihood: Likelihood) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Reference impedance, reflection coefficient of a person's first recording, and one over its sd; each (F,)."""
    z = likelihood.z[0, 0] + 1j * likelihood.z[0, 1]
    z0 = np.maximum(np.abs(z), np.finfo(float).tiny)
    root = np.sqrt(likelihood.weight[0]) * np.abs(z + z0) ** 2 / (2 * z0)
    return z0, (z - z0) / (z + z0), root
