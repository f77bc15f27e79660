r"""Posterior mode of one person's log elements, and the curvature there.

Levenberg-Marquardt on the exact objective, the likelihood of :mod:`bayes_impedance.person.likelihood` under a normal
prior :math:`N(m, \Lambda^{-1})`. Locally the likelihood is that of Gaussian noise with weight
:math:`w = (\alpha+N)/(\beta+\chi^2/2)`, which gives the curvature :math:`A = w J^TJ/\sigma^2 + \Lambda`. If the
network does not fit, the residuals stay large, this Gauss-Newton curvature is inaccurate and convergence is slow. After
a fixed number of steps the second derivative is therefore taken from differences of the exact gradient.

Converged means that the Newton decrement :math:`g^T A^{-1} g`, the squared distance to the mode in posterior standard
deviations, is below 1e-6. Several starts guard against local minima: the residuals of an unconverged
fit could be mistaken for an effect that the model lacks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.network.kernel import Kernel, compiled, workspace
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, all_repetitions, chi_square, log_likelihood
from bayes_impedance.person.small_matrices import ROUNDING, solved

__all__ = ["DECREMENT_LIMIT", "Likelihood", "Mode", "all_modes", "find_mode", "log_likelihood", "mode_at"]

DECREMENT_LIMIT = 1e-6
"""Newton decrement below which a mode counts as converged. By choice: its square root, a thousandth of a posterior
standard deviation, is the remaining distance."""

MAX_ITERATIONS = 100
"""Most steps from each start. By choice: more cost time; convergence is judged by the decrement alone."""

_GAUSS_NEWTON_ITERATIONS = 15
"""Steps before the exact second derivative is used. By choice: it costs several gradients a
step, and where the network fits, fewer steps than these suffice."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """Mode of one person's posterior and its curvature.

    Attributes
    ----------
    theta : ndarray, shape (P,)
        Log elements at the mode.
    objective : float
        Negative log posterior density at the mode, up to a constant.
    precision : ndarray, shape (P, P)
        Curvature including the prior's. It can be inverted (:data:`ROUNDING`).
    information : ndarray, shape (P, P)
        Curvature of the likelihood alone, in units of the inferred noise.
    scale : float
        Noise scale s at the mode: 1 when the network fits to within the noise.
    decrement : float
        Squared distance to the mode in posterior standard deviations.
    apart : float
        Largest difference in a log element from where the first of several starts ended: zero if the mode was reached
        from there.
    """

    theta: np.ndarray
    objective: float
    precision: np.ndarray
    information: np.ndarray
    scale: float
    decrement: float
    apart: float = 0.0

    @property
    def converged(self) -> bool:
        """Whether the decrement is below :data:`DECREMENT_LIMIT`."""
        return bool(self.decrement < DECREMENT_LIMIT)


@compiled
def _gradient(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
) -> np.ndarray:
    chi, gradient, _ = all_repetitions(program, theta, deviations, omega, z, weight)
    result: np.ndarray = exponent / (beta + 0.5 * chi) * gradient + prior_precision @ (theta - prior_mean)
    return result


@compiled
def _hessian(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
) -> np.ndarray:
    """Second derivative of the objective by central differences of its exact gradient."""
    n = theta.size
    result = np.empty((n, n))
    for p in range(n):
        shift = np.zeros(n)
        shift[p] = 1e-4
        args = (deviations, omega, z, weight, exponent, beta, prior_mean, prior_precision)
        ahead = _gradient(program, theta + shift, *args)
        behind = _gradient(program, theta - shift, *args)
        for q in range(n):
            result[p, q] = (ahead[q] - behind[q]) / 2e-4
    return 0.5 * (result + result.T)


@compiled
def _minimise(
    program: Program,
    starts: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    max_iterations: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg-Marquardt from every start: end points (S, P), objectives (S,), decrements (S,)."""
    sums, outputs = workspace(program, omega)
    ends = starts.copy()
    objectives = np.full(starts.shape[0], np.inf)
    decrements = np.full(starts.shape[0], np.inf)
    n_elements = starts.shape[1]
    for i in range(starts.shape[0]):
        theta = starts[i].copy()
        damping = 1e-2
        chi, gradient, information = all_repetitions(program, theta, deviations, omega, z, weight)
        offset = theta - prior_mean
        objective = exponent * np.log(beta + 0.5 * chi) + 0.5 * offset @ (prior_precision @ offset)
        if not np.isfinite(objective):
            continue
        for iteration in range(max_iterations):
            w = exponent / (beta + 0.5 * chi)
            g = w * gradient + prior_precision @ (theta - prior_mean)
            curvature = w * information + prior_precision
            diagonal = np.diag(curvature).copy()
            if iteration >= _GAUSS_NEWTON_ITERATIONS:
                exact = _hessian(
                    program, theta, deviations, omega, z, weight, exponent, beta, prior_mean, prior_precision
                )
                lowest = np.linalg.eigvalsh(exact)[0]
                if lowest > 0.0:
                    curvature = exact
            if not (np.all(np.isfinite(curvature)) and np.all(np.isfinite(g))):  # beside a pole that nothing damps
                break
            solvable = curvature.copy()
            for p in range(n_elements):
                solvable[p, p] += ROUNDING * diagonal[p]
            decrements[i] = g @ solved(solvable, g)
            if decrements[i] < 1e-9:
                break
            accepted = False
            for _attempt in range(12):
                damped = curvature.copy()
                for p in range(n_elements):
                    damped[p, p] += damping * diagonal[p]
                step = -solved(damped, g)
                longest = np.abs(step).max()
                if longest > 2.0:  # more than a factor of e^2 at once leaves the region where the tangent means much
                    step *= 2.0 / longest
                trial = theta + step
                trial_chi = chi_square(program, trial, deviations, omega, z, weight, sums, outputs)
                offset = trial - prior_mean
                value = exponent * np.log(beta + 0.5 * trial_chi) + 0.5 * offset @ (prior_precision @ offset)
                if value <= objective:
                    accepted = True
                    break
                damping = min(damping * 5.0, 1e8)
            if not accepted:
                break
            damping = max(damping / 5.0, 1e-9)
            theta = trial
            objective = value
            chi, gradient, information = all_repetitions(program, theta, deviations, omega, z, weight)
        for p in range(n_elements):
            ends[i, p] = theta[p]
        objectives[i] = objective
    return ends, objectives, decrements


def all_modes(
    kernel: Kernel,
    likelihood: Likelihood,
    starts: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    max_iterations: int = MAX_ITERATIONS,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Levenberg-Marquardt from every start, shape (S, P): end points (S, P), objectives (S,), decrements (S,)."""
    d = likelihood
    ends, objectives, decrements = _minimise(
        kernel.program,
        np.ascontiguousarray(starts),
        d.deviations,
        d.omega,
        d.z,
        d.weight,
        SCALE_SHAPE + d.count,
        d.beta,
        np.ascontiguousarray(prior_mean),
        np.ascontiguousarray(prior_precision),
        max_iterations,
    )
    return ends, objectives, decrements


def find_mode(
    kernel: Kernel, likelihood: Likelihood, starts: np.ndarray, prior_mean: np.ndarray, prior_precision: np.ndarray
) -> Mode:
    """The highest mode reached from any start, under a normal prior.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    starts : ndarray, shape (S, P)
        Among equal modes the first start is preferred, so that exchangeable parts of a network keep their order.
    prior_mean : ndarray, shape (P,)
    prior_precision : ndarray, shape (P, P)

    Returns
    -------
    Mode
        Check ``converged``; no error is raised, because a single person may be corrected in a later round.
    """
    ends, objectives, decrements = all_modes(kernel, likelihood, starts, prior_mean, prior_precision)
    best = int(np.argmax(objectives <= objectives.min() + 1e-3))
    mode = mode_at(kernel, likelihood, ends[best], prior_mean, prior_precision, float(decrements[best]))
    return replace(mode, apart=float(np.abs(ends[best] - ends[0]).max()))


def mode_at(
    kernel: Kernel,
    likelihood: Likelihood,
    theta: np.ndarray,
    prior_mean: np.ndarray,
    prior_precision: np.ndarray,
    decrement: float,
) -> Mode:
    """Curvature and scale of the posterior at theta, which is assumed to be its mode."""
    d = likelihood
    chi, _, information = all_repetitions(kernel.program, theta, d.deviations, d.omega, d.z, d.weight)
    exponent = SCALE_SHAPE + d.count
    w = exponent / (d.beta + 0.5 * chi)
    offset = theta - prior_mean
    objective = exponent * np.log(d.beta + 0.5 * chi) + 0.5 * offset @ prior_precision @ offset
    scale = float(np.sqrt((d.beta + 0.5 * chi) / exponent))  # inf, and no error, where chi is
    precision = w * information + prior_precision
    np.fill_diagonal(precision, (1 + ROUNDING) * precision.diagonal())
    return Mode(
        theta=theta,
        objective=float(objective),
        precision=precision,
        information=w * information,
        scale=scale,
        decrement=decrement,
    )
