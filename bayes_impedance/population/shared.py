r"""Parameters that are the same for everybody, in the point estimate of the population.

Some parameters differ between people (theta, one for each), others are the same for all: those of the rig, marked
``*`` in the network. Given their values phi, everything else is as without them: each person's mode, the population's
mean and covariance. A step of phi needs each person's share of its gradient and of its curvature. With the person's
log elements theta, the deviations :math:`\delta_j` of the repetitions (which sum to zero) and multipliers for that sum,
the Gauss-Newton curvature of the negative log posterior is, for H_j the information of repetition j,

.. math::
    K = \begin{pmatrix} T^{-1} + \sum_j H_j & H_1 & \cdots & 0 \\ H_1 & H_1 + R^{-1} & & I \\ \vdots & & \ddots \\
    0 & I & & 0\end{pmatrix}, \qquad
    B = \begin{pmatrix} \sum_j H_{j,\phi} \\ H_{1,\phi} \\ \vdots \\ 0 \end{pmatrix}, \qquad
    D = \sum_j H_{j,\phi\phi} - B^T K^{-1} B .

The population's mean :math:`\mu` follows a step too, and often far, as when skins are taken to be softer the longer a
delay is. It is therefore eliminated with the same equations: as further columns of B, :math:`-T^{-1}` in the rows of
theta, and :math:`T^{-1}` in place of :math:`H_{\phi\phi}`. At the person's mode the gradient with respect to theta and
the deviations vanishes, and after an M step so does the sum over persons of that with respect to the mean. A step of
:math:`(\phi, \mu)` is then :math:`(\sum_i D_i + \Lambda)^{-1} (\sum_i g_i, 0)`, and the block of :math:`\phi` in that
inverse is its approximate posterior covariance. The person follows by the **response** :math:`-K^{-1} B`: the first
rows for theta, the others for the repetitions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import Likelihood, log_likelihood, repetition_equations

_LONGEST = 1.0
"""Longest step of a shared parameter, on the scale of u: a factor e of a log, a unit of a signed scale. By choice:
farther away the tangent means little."""


@dataclass(frozen=True)
class Pooling:
    """Which parameters differ between persons, and which are the same for all.

    Attributes
    ----------
    kernel : Kernel
        Of the network with all P parameters.
    names : tuple of str
        The S parameters that are the same for all.
    """

    kernel: Kernel
    names: tuple[str, ...] = ()

    @classmethod
    def of(cls, kernel: Kernel) -> Pooling:
        """As the network says."""
        return cls(kernel, tuple(p.name for p in kernel.parameters if p.shared))

    @cached_property
    def shared(self) -> np.ndarray:
        """Positions of the shared parameters, shape (S,)."""
        return np.array([self.kernel.elements.index(name) for name in self.names], dtype=int)

    @cached_property
    def varying(self) -> np.ndarray:
        """Positions of the others, shape (V,)."""
        return np.setdiff1d(np.arange(len(self.kernel.elements)), self.shared)

    def at(self, phi: np.ndarray) -> Kernel:
        """The kernel of the varying parameters, with the shared ones at phi (S,)."""
        return self.kernel.holding(dict(zip(self.names, phi.tolist(), strict=True))) if self.names else self.kernel

    def whole(self, theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
        """All parameters, shape (..., P), of varying ones (..., V) and shared ones, (S,) or (..., S)."""
        if not self.names:
            return theta
        result = np.empty((*theta.shape[:-1], len(self.kernel.elements)))
        result[..., self.varying], result[..., self.shared] = theta, phi
        return result


@dataclass(frozen=True)
class SharedEquations:
    """One person's part in the equations of the shared parameters.

    Attributes
    ----------
    curvature : ndarray, shape (S + V, S + V)
        D, of the shared parameters and of the population's mean, with the person's own parameters following.
    gradient : ndarray, shape (S,)
        Of the log likelihood in the shared parameters: upward.
    response : ndarray, shape (V, S + V)
        Derivative of the person's log elements with respect to the shared parameters and the mean.
    drift : ndarray, shape (J, V, S + V)
        The same of the deviations of the repetitions.
    """

    curvature: np.ndarray
    gradient: np.ndarray
    response: np.ndarray
    drift: np.ndarray


def shared_equations(
    pooling: Pooling,
    phi: np.ndarray,
    precision: np.ndarray,
    rho: np.ndarray,
    likelihood: Likelihood,
    theta: np.ndarray,
    scale: float,
    deviations: np.ndarray,
) -> SharedEquations:
    """A person's equations at log elements, as the mode.

    Parameters
    ----------
    pooling : Pooling
    phi : ndarray, shape (S,)
    precision : ndarray, shape (V, V)
        Inverse covariance of the population.
    rho : ndarray, shape (V,)
        Dispersion between repetitions.
    likelihood : Likelihood
    theta : ndarray, shape (V,)
    scale : float
        Of the noise.
    deviations : ndarray, shape (J, V)
        Of the repetitions.
    """
    s, v = pooling.shared, pooling.varying
    here = likelihood.moved(pooling.whole(deviations, np.zeros(s.size)))
    gradient, information = repetition_equations(pooling.kernel, here, pooling.whole(theta, phi))
    w = scale**-2
    g, h = w * gradient, w * information
    own, mixed = h[:, v[:, None], v], h[:, v[:, None], s]
    n, size = len(h), v.size
    blocks = 1 if n == 1 else n + 2
    k, b = np.zeros((blocks * size, blocks * size)), np.zeros((blocks * size, s.size + size))
    k[:size, :size] = precision + own.sum(axis=0)
    b[:size] = np.hstack([mixed.sum(axis=0), -precision])
    inverse_square = np.diag(np.maximum(rho, 1e-3) ** -2.0)
    for j in range(n if n > 1 else 0):
        rows = slice((j + 1) * size, (j + 2) * size)
        k[:size, rows] = k[rows, :size] = own[j]
        k[rows, rows] = own[j] + inverse_square
        k[rows, -size:] = k[-size:, rows] = np.eye(size)
        b[rows, : s.size] = mixed[j]
    response = -np.linalg.solve(k, b)
    curvature = b.T @ response
    curvature[: s.size, : s.size] += h[:, s[:, None], s].sum(axis=0)
    curvature[s.size :, s.size :] += precision
    drift = response[size:-size].reshape(n, size, -1) if n > 1 else np.zeros((1, size, s.size + size))
    return SharedEquations(
        0.5 * (curvature + curvature.T), -g[:, s].sum(axis=0), response[:size], np.ascontiguousarray(drift)
    )


@dataclass(frozen=True)
class Placed:
    """A person's log elements and the deviations of the repetitions.

    Attributes
    ----------
    theta : ndarray, shape (V,)
    deviations : ndarray, shape (J, V)
    """

    theta: np.ndarray
    deviations: np.ndarray

    def following(self, equations: SharedEquations, step: np.ndarray) -> Placed:
        """Moved along with a step (S + V,) of the shared parameters and the mean."""
        return Placed(self.theta + equations.response @ step, self.deviations + equations.drift @ step)


def objective(
    kernel: Kernel, precision: np.ndarray, rho: np.ndarray, likelihood: Likelihood, place: Placed, mean: np.ndarray
) -> float:
    """Negative log posterior density of a person's log elements and deviations, up to a constant.

    Parameters
    ----------
    kernel : Kernel
        Of the varying parameters, at some values of the shared ones.
    precision : ndarray, shape (V, V)
    rho : ndarray, shape (V,)
    likelihood : Likelihood
    place : Placed
    mean : ndarray, shape (V,)
        Population mean for this person.
    """
    value = -float(log_likelihood(kernel, likelihood.moved(place.deviations), place.theta[None])[0])
    offset = place.theta - mean
    value += 0.5 * float(offset @ precision @ offset)
    if len(place.deviations) > 1:
        value += 0.5 * float(np.sum((place.deviations / np.maximum(rho, 1e-3)) ** 2))
    return value


def summed(equations: Sequence[SharedEquations]) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (S + V, S + V) and gradient (S,) of some persons together."""
    return np.sum([e.curvature for e in equations], axis=0), np.sum([e.gradient for e in equations], axis=0)


def step_of(curvature: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """A step of the shared parameters and the mean, shape (S + V,), not longer than is sensible.

    Parameters
    ----------
    curvature : ndarray, shape (S + V, S + V)
    gradient : ndarray, shape (S,)
    """
    step = np.linalg.solve(curvature, np.concatenate([gradient, np.zeros(len(curvature) - gradient.size)]))
    return np.asarray(step / max(1.0, np.abs(step).max() / _LONGEST))
