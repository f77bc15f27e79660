r"""The likelihood of one person's log elements.

With J recordings of a person, noise of known shape sigma and one unknown scale s,

.. math:: z_{jk} = Z_k(\theta + \delta_j) + \varepsilon_{jk}, \qquad
          \operatorname{Re}\varepsilon_{jk},\ \operatorname{Im}\varepsilon_{jk} \sim N(0, s^2\sigma_{jk}^2),

where theta are the person's log elements, and the deviations :math:`\delta_j` (which sum to zero) are those of
repetition j, since the finger lies differently each time. They are estimated rather than removed by averaging: the mean
of recordings with shifted resonances is not a recording with the mean resonance. The scale has an inverse gamma prior
and is integrated out in closed form,

.. math:: p(z\,|\,\theta) \propto \left(\beta + \tfrac12\chi^2(\theta)\right)^{-(\alpha + N)},
          \qquad \chi^2(\theta) = \sum_{jk} |z_{jk} - Z_k(\theta+\delta_j)|^2/\sigma_{jk}^2,

with N the number of complex values less those used by the deviations. If the network does not fit, the posterior
therefore becomes wider.

Here the deviations are held fixed. That is correct in the search for a mode; for draws of the posterior they are
integrated out, see :mod:`bayes_impedance.person.marginal_likelihood`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numba.core import types

from bayes_impedance.display import Brief
from bayes_impedance.network.kernel import Kernel, backward, compiled, forward, forward_apart, workspace
from bayes_impedance.network.program import PROGRAM, Program
from bayes_impedance.runtime.compiled_functions import by_address, kept_njit

SCALE_SHAPE = 2.0
"""alpha = beta of the inverse gamma prior of the squared noise scale. By choice: centred near one, and wide enough for
a factor of two either way."""

_FREQUENCIES = 104
"""Largest number of frequencies in a block of the normal equations.

With the fingertip's eight elements the derivatives and the residual of a block take 9 x 2 x 104 doubles = 15 kB, which
leaves room for the nodes in a first-level cache of 32 or 48 kB.
"""

_summing: Any = kept_njit(nogil=True, fastmath={"reassoc", "contract"})
"""Decorator of long sums: the compiler may reorder them, and so use vector instructions."""


def information_share(degrees: float) -> float:
    """Fisher's information on a mean from a value of Student t noise, over that from normal noise of its scale."""
    return (degrees + 2) / (degrees + 4) if np.isfinite(degrees) else 1.0


@dataclass(frozen=True, kw_only=True, repr=False)
class Likelihood(Brief):
    """Data of one person, ready for the compiled functions.

    Attributes
    ----------
    omega : ndarray, shape (F,)
        Angular frequency in rad/s.
    z : ndarray, shape (J, 2, F)
        Real and imaginary part of the recordings.
    weight : ndarray, shape (J, F)
        1/sigma^2 of each of the two parts.
    deviations : ndarray, shape (J, P)
        Log elements of each repetition less the person's; columns sum to zero.
    count : float
        Number N of complex values that inform theta and the noise scale.
    values : float
        Number of all complex values, J times that of the recordings' frequencies; of noise with tails the share of it
        that they are worth.
    rest : float
        Chi-square that no theta changes, to be added to that of `z`: not zero where `z` sums up more frequencies
        (:mod:`bayes_impedance.person.condensed`).
    degrees : float
        Degrees of freedom of the noise (:mod:`bayes_impedance.person.heavy_noise`); infinite if it is normal.
    plain : ndarray, shape (J, F), or None
        1/sigma^2 where `weight` holds weights of the points besides.
    """

    omega: np.ndarray
    z: np.ndarray
    weight: np.ndarray
    deviations: np.ndarray
    count: float
    values: float
    rest: float = 0.0
    degrees: float = np.inf
    plain: np.ndarray | None = None

    @classmethod
    def make(cls, frequency_hz: np.ndarray, z: np.ndarray, noise_sd: np.ndarray, deviations: np.ndarray) -> Likelihood:
        """From complex recordings of shape (J, F) and the standard deviation of the noise, same shape."""
        parts = np.ascontiguousarray(np.stack([z.real, z.imag], axis=1))
        count = z.size - 0.5 * (z.shape[0] - 1) * deviations.shape[1]
        weight = np.ascontiguousarray(np.broadcast_to(noise_sd, z.shape) ** -2.0)
        return cls(
            omega=2 * np.pi * np.ascontiguousarray(frequency_hz),
            z=parts,
            weight=weight,
            deviations=deviations,
            count=max(count, 1.0),
            values=z.size,
        )

    @property
    def beta(self) -> float:
        """The beta of the inverse gamma prior, and what of chi-square no theta changes."""
        return SCALE_SHAPE + 0.5 * self.rest

    def thinned(self, n: int) -> Likelihood:
        """The data at about n of the frequencies, evenly spread: for decisions that need no precision."""
        f = self.omega.size
        return self.at(np.unique(np.linspace(0, f - 1, min(n, f)).round().astype(int)))

    def at(self, points: np.ndarray) -> Likelihood:
        """The data at some of the frequencies, given by their indices (integer) or as a mask."""
        omega, z, weight = (np.ascontiguousarray(a[..., points]) for a in (self.omega, self.z, self.weight))
        lost = (self.omega.size - omega.size) * len(z) * information_share(self.degrees)
        return replace(
            self,
            omega=omega,
            z=z,
            weight=weight,
            count=max(self.count - lost, 1.0),
            values=max(self.values - lost, 1),
            plain=None if self.plain is None else self.plain[..., points],
        )

    def recording(self, j: int, n_parameters: int) -> Likelihood:
        """One of the recordings alone, without a deviation from the person's parameters."""
        n = len(self.z)
        nothing = np.zeros((1, n_parameters))
        return replace(
            self, z=self.z[[j]], weight=self.weight[[j]], deviations=nothing, count=self.count / n,
            values=self.values / n, plain=None if self.plain is None else self.plain[[j]],
        )  # fmt: skip

    def moved(self, deviations: np.ndarray) -> Likelihood:
        """The same data with other deviations of the repetitions."""
        return replace(self, deviations=np.ascontiguousarray(deviations))


@compiled
def chi_square(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
) -> float:
    """Chi-square of all repetitions; `sums` and `outputs` are a workspace."""
    total = 0.0
    for j in range(z.shape[0]):
        forward_apart(program, theta + deviations[j], omega, sums, outputs)
        total += _weighted_square(outputs, program.node_parent.size - 1, z, weight, j)
    return total


@_summing
def _weighted_square(outputs: np.ndarray, node: int, z: np.ndarray, weight: np.ndarray, j: int) -> float:
    """Weighted square of the difference between a node's output and recording j."""
    total = 0.0
    for f in range(weight.shape[1]):
        real, imag = outputs[node, 0, f] - z[j, 0, f], outputs[node, 1, f] - z[j, 1, f]
        total += weight[j, f] * (real * real + imag * imag)
    return total


@_summing
def _three_dots(rows: np.ndarray, p: int, q: int, r: int, s: int) -> tuple[float, float, float]:
    """Products of row p with rows q, r and s: three at a time, since reading costs more than multiplying."""
    with_q, with_r, with_s = 0.0, 0.0, 0.0
    for f in range(rows.shape[1]):
        value = rows[p, f]
        with_q += value * rows[q, f]
        with_r += value * rows[r, f]
        with_s += value * rows[s, f]
    return with_q, with_r, with_s


@compiled
def normal_equations(
    program: Program, theta: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """One recording at theta: chi-square, J^T W r with r = Z - z, and J^T W J.

    Parameters
    ----------
    z : ndarray, shape (2, F)
    weight : ndarray, shape (F,)

    Returns
    -------
    chi_square : float
    gradient : ndarray, shape (P,)
    information : ndarray, shape (P, P)
    """
    n_nodes, n_elements = program.node_parent.size, theta.size
    # Blocks of frequencies that fit into the first-level cache. All are equally long: the last is padded with a
    # frequency of weight zero.
    n_blocks = max(1, -(-omega.size // _FREQUENCIES))
    size = max(1, -(-omega.size // n_blocks))
    sums, outputs = workspace(program, omega[:size])
    own, adjoints = np.empty(size), np.zeros((n_nodes + 1, 2, size))
    rows = np.empty((n_elements + 1, 2, size))  # the derivatives and the residual, times the root of the weight
    flat = rows.reshape(n_elements + 1, 2 * size)
    products = np.zeros((n_elements + 1, n_elements + 1))
    for start in range(0, omega.size, size):
        present = min(size, omega.size - start)
        for f in range(present):
            own[f] = omega[start + f]
            adjoints[n_nodes, 0, f] = np.sqrt(weight[start + f])
        for f in range(present, size):
            own[f], adjoints[n_nodes, 0, f] = own[f - 1], 0.0
        for f in range(size):
            sums[n_nodes, 0, f] = 1.0 / own[f]
        forward(program, theta, own, sums, outputs)
        backward(program, theta, own, sums, outputs, adjoints, rows)
        for part in range(2):
            for f in range(present):
                residual = outputs[n_nodes - 1, part, f] - z[part, start + f]
                rows[n_elements, part, f] = residual * adjoints[n_nodes, 0, f]
            rows[n_elements, part, present:] = 0.0
        for p in range(n_elements + 1):
            for q in range(0, p + 1, 3):
                dots = _three_dots(flat, p, q, min(q + 1, n_elements), min(q + 2, n_elements))
                for k in range(min(3, p + 1 - q)):
                    products[p, q + k] += dots[k]
    for p in range(n_elements):
        for q in range(p):
            products[q, p] = products[p, q]
    return products[-1, -1], products[-1, :-1].copy(), products[:-1, :-1].copy()


_LINE, _ROWS = (types.Array(types.float64, n, "C") for n in (1, 2))
equations_apart = by_address(normal_equations, (PROGRAM, _LINE, _LINE, _ROWS, _LINE))
""":func:`normal_equations` for functions that do not take its code into their own."""


@compiled
def all_repetitions(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
) -> tuple[float, np.ndarray, np.ndarray]:
    """Chi-square, gradient and information of all repetitions together."""
    chi, gradient, information = equations_apart(program, theta + deviations[0], omega, z[0], weight[0])
    for j in range(1, z.shape[0]):
        c, g, h = equations_apart(program, theta + deviations[j], omega, z[j], weight[j])
        chi += c
        gradient += g
        information += h
    return chi, gradient, information


@compiled
def _log_likelihoods(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
) -> np.ndarray:
    """Log likelihood with the noise scale integrated out, up to a constant, for parameter sets (S, P): shape (S,)."""
    sums, outputs = workspace(program, omega)
    result = np.empty(theta.shape[0])
    for i in range(theta.shape[0]):
        chi = chi_square(program, theta[i], deviations, omega, z, weight, sums, outputs)
        result[i] = -exponent * np.log(beta + 0.5 * chi)
    return result


def repetition_equations(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradient J^T W r, shape (J, P), and information J^T W J, shape (J, P, P), of every repetition at theta (P,)."""
    d = likelihood
    pairs = [
        normal_equations(kernel.program, theta + d.deviations[j], d.omega, d.z[j], d.weight[j])[1:]
        for j in range(d.z.shape[0])
    ]
    return np.array([g for g, _ in pairs]), np.array([h for _, h in pairs])


def log_likelihood(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> np.ndarray:
    """Log likelihood of a person's log elements, up to a constant.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
    theta : ndarray, shape (S, P)

    Returns
    -------
    ndarray, shape (S,)
        -inf where the network's impedance is not finite.
    """
    d = likelihood
    theta = np.ascontiguousarray(theta)
    exponent = SCALE_SHAPE + d.count
    values = _log_likelihoods(kernel.program, theta, d.deviations, d.omega, d.z, d.weight, exponent, d.beta)
    return np.where(np.isfinite(values), values, -np.inf)
