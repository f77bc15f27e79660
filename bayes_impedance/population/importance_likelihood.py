r"""The likelihood of population parameters, with each person's elements integrated out by importance sampling.

**Between persons.** Let :math:`\bar\theta_i` be the mean of a person's log elements over J repetitions. Given the
population its distribution is :math:`N(\mu_i, T_J)` with :math:`T_J = \Sigma + \operatorname{diag}(\rho^2)/J`. With
the draws of :mod:`bayes_impedance.person.importance_draws`

.. math:: p(z_i\,|\,\mu, T) \approx \frac1K \sum_k \frac{L_i(\theta_{ik})}{q_i(\theta_{ik})}\,
          N(\theta_{ik}; \mu_i, T_J) .

The same draws serve every call, so the estimate is a smooth function of the population parameters. The variance of its
logarithm, about 1/(effective draws) - 1/K per person, is summed and reported. In coordinates u in which the reference
population is a standard normal the log density is a quadratic polynomial in u: the draws' monomials are computed once,
and a set of population parameters is one row of coefficients. All walkers times all draws is then one matrix product
(in single precision: the coordinates are of order one, and the rounding, 1e-6 per draw, is far below the Monte-Carlo
error).

Where parameters are the same for everybody, monomials in them are further columns of the coefficients, and each
person's mean is shifted (:mod:`bayes_impedance.population.shared_draws`).

**Between repetitions.** Given a person's mean, the J - 1 orthonormal contrasts d of the deviations
:math:`\delta_{ij}` are N(0, diag rho^2). A repetition differs little from the person's mean, so the log likelihood of d
is taken as quadratic, with gradient b and curvature H at zero deviation; each repetition has its own curvature. The
Gaussian integral has a closed form,

.. math:: \ln p = -\tfrac12 \ln\left|I + D H D\right| + \tfrac12\, b^T D\,(I + D H D)^{-1} D\, b, \qquad D =
          \operatorname{diag}\rho,

which needs no inverse of H and is smooth down to rho = 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayes_impedance.network.kernel import compiled
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.shared_draws import Moved, Sharing, monomials, stacked
from bayes_impedance.runtime.compiled_functions import kept_njit

_BLOCK = 4
"""Persons per matrix product. By choice: W x 4 x K single-precision numbers stay in the processor's cache."""

_summing: Any = kept_njit(nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
"""Decorator that lets the compiler reorder sums, so that it can use vector instructions."""


@dataclass(frozen=True)
class Contrasts:
    """Likelihood of the contrasts between repetitions, for persons with the same number of repetitions.

    With C contrasts of P elements each, the combined index runs over contrasts and, within each, over elements.

    Attributes
    ----------
    information : ndarray, shape (C P, C P, n)
        Negative second derivative of the log likelihood of each of n persons.
    gradient : ndarray, shape (C P, n)
        Gradient of the log likelihood at zero deviation.
    """

    information: np.ndarray
    gradient: np.ndarray

    def log_likelihood(self, rho: np.ndarray) -> np.ndarray:
        """Log likelihood of dispersions between repetitions, shape (W, P), up to a constant: shape (W,)."""
        return np.asarray(_contrast_likelihood(self.information, self.gradient, np.ascontiguousarray(rho)))


@compiled
def _contrast_likelihood(information: np.ndarray, gradient: np.ndarray, rho: np.ndarray) -> np.ndarray:
    size, n = gradient.shape
    n_elements = rho.shape[1]
    result = np.empty(rho.shape[0])
    # Persons are the last, contiguous axis: the compiler handles several of them with one instruction.
    factor = np.empty((size, size, n))
    y = np.empty((size, n))
    for w in range(rho.shape[0]):
        total = 0.0
        for p in range(size):  # Cholesky factor of I + D H D, and y = factor^-1 D b
            scale_p = rho[w, p % n_elements]
            for q in range(p):
                scale = scale_p * rho[w, q % n_elements]
                row, column, entry = factor[p], factor[q], information[p, q]
                target = row[q]
                for i in range(n):
                    target[i] = scale * entry[i]
                for k in range(q):
                    left, right = row[k], column[k]
                    for i in range(n):
                        target[i] -= left[i] * right[i]
                diagonal = column[q]
                for i in range(n):
                    target[i] *= diagonal[i]  # the diagonal holds reciprocals
            pivot, entry, own, slope = factor[p, p], information[p, p], y[p], gradient[p]
            for i in range(n):
                pivot[i] = 1.0 + scale_p * scale_p * entry[i]
                own[i] = scale_p * slope[i]
            for k in range(p):
                left, before = factor[p, k], y[k]
                for i in range(n):
                    pivot[i] -= left[i] * left[i]
                    own[i] -= left[i] * before[i]
            for i in range(n):
                total -= 0.5 * np.log(pivot[i])
                pivot[i] = 1.0 / np.sqrt(pivot[i])
                own[i] *= pivot[i]
                total += 0.5 * own[i] * own[i]
        result[w] = total
    return result


_LOG2_E, _LOWEST = np.float32(1 / np.log(2)), np.float32(-126.0)
"""Factor from natural to binary logarithms, and smallest exponent of a normal single-precision number (IEEE 754)."""
_C0, _C1, _C2 = np.float32(1.00000007), np.float32(0.69314695), np.float32(0.24022122)
_C3, _C4, _C5 = np.float32(0.05550743), np.float32(0.00967546), np.float32(0.0013267)
"""2^r = c0 + c1 r + ... + c5 r^5 for |r| <= 1/2, by least squares of the relative error, which is below 1e-7."""
_HALF, _BIAS, _MANTISSA = np.float32(0.5), np.int32(127), np.int32(23)
"""One half, to round to the nearest integer; bias of the exponent, and bits of the mantissa, of IEEE 754 singles."""
_SIGN, _REST, _LEAST = np.int32(31), np.int32(0x7FFFFFFF), np.int32(-0x80000000)
"""Of 32-bit integers: position of the sign bit, mask of the other bits, and the smallest value."""


@compiled
def _largest(row: np.ndarray) -> np.float32:
    """Largest of single-precision numbers; nan if there is one.

    Floating-point numbers sort like the integers with the same bits, if all bits but the sign are flipped for negative
    numbers. The compiler vectorises comparisons of integers, but not of floats, because of nan.
    """
    bits = row.view(np.int32)
    most = _LEAST
    for k in range(bits.size):
        key = np.int32(bits[k] ^ np.int32(np.int32(bits[k] >> _SIGN) & _REST))
        most = key if key > most else most
    return np.int32(most ^ np.int32(np.int32(most >> _SIGN) & _REST)).view(np.float32)


@_summing
def _exponentials(row: np.ndarray, peak: np.float32) -> tuple[np.float32, np.float32]:
    """Sum of exp(row - peak) and of its squares; terms below 1e-38 are replaced by that value.

    In base two: the integer part of the exponent is written into the exponent bits of the result, and the fractional
    part is evaluated by a polynomial. Unlike a library call this is vectorised, and it needs no temporary array.
    """
    total, squares = np.float32(0), np.float32(0)
    for k in range(row.size):
        y = (row[k] - peak) * _LOG2_E  # the difference first, so that y is never above zero, however large both are
        y = _LOWEST if y < _LOWEST else y
        whole = np.floor(y + _HALF)
        r = y - whole
        value = ((((_C5 * r + _C4) * r + _C3) * r + _C2) * r + _C1) * r + _C0
        value = value * np.int32(np.int32(np.int32(whole) + _BIAS) << _MANTISSA).view(np.float32)
        total += value
        squares += value * value
    return total, squares


@compiled
def _sums(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest of the log weights (W, B, K), sum of exp(value - largest), and sum of its squares; each (W, B)."""
    shape = values.shape[:2]
    peaks, totals, squares = np.empty(shape), np.empty(shape), np.empty(shape)
    for w in range(shape[0]):
        for n in range(shape[1]):
            peak = _largest(values[w, n])
            totals[w, n], squares[w, n] = _exponentials(values[w, n], peak)
            peaks[w, n] = peak
    return peaks, totals, squares


class ImportanceLikelihood:
    """Likelihood of population parameters.

    Parameters
    ----------
    draws : sequence of Draws
        One for each of N persons, all with K draws.
    reference_means : ndarray, shape (N, P)
        Means of the reference population from which the draws were proposed.
    reference_covariance : ndarray, shape (P, P)
    repetitions : ndarray of int, shape (N,)
        Number J of repetitions of each person.
    covariates : ndarray, shape (N, Q)
        Standardised covariates.
    contrasts : sequence of Contrasts
        One for each number of repetitions above one.
    sharing : Sharing, optional
        If there are parameters that are the same for everybody.
    moved : sequence of Moved
        How each person's draws move with them.
    """

    def __init__(
        self,
        draws: Sequence[Draws],
        reference_means: np.ndarray,
        reference_covariance: np.ndarray,
        repetitions: np.ndarray,
        covariates: np.ndarray,
        contrasts: Sequence[Contrasts],
        sharing: Sharing | None = None,
        moved: Sequence[Moved] = (),
    ) -> None:
        self.n_draws, n_elements = draws[0].theta.shape
        self.repetitions, self.covariates, self.contrasts = repetitions, covariates, contrasts
        self.reference_means = reference_means
        self.sharing = sharing
        self.path, self.missed = stacked(moved)
        same = bool(np.all(reference_means == reference_means[0]))
        self._same_means = not covariates.shape[1] and same and sharing is None
        self._factor = np.linalg.cholesky(reference_covariance)
        self._rows, self._columns = np.tril_indices(n_elements)
        # Twice the entry, except on the diagonal: coefficients of the monomials u_p u_q, p >= q.
        self._multiplicity = np.where(self._rows == self._columns, 1.0, 2.0)
        self._blocks: list[tuple[int, np.ndarray, np.ndarray]] = []  # repetitions, persons, features (m, B K)
        for j in np.unique(repetitions):
            group = np.flatnonzero(repetitions == j)
            for persons in np.split(group, range(_BLOCK, group.size, _BLOCK)):
                features = [self._monomials(draws[i], reference_means[i]) for i in persons]
                if sharing is not None:
                    pairs = zip(features, persons, strict=True)
                    features = [np.vstack([own, moved[i].coefficients.astype(np.float32)]) for own, i in pairs]
                self._blocks.append((int(j), persons, np.concatenate(features, axis=1)))

    @property
    def nbytes(self) -> int:
        """Memory in bytes, nearly all of it for the draws."""
        arrays = [features for _, _, features in self._blocks] + [c.information for c in self.contrasts]
        return sum(array.nbytes for array in arrays)

    def _monomials(self, draws: Draws, mean: np.ndarray) -> np.ndarray:
        u = np.linalg.solve(self._factor, (draws.theta - mean).T)
        ratio = draws.log_ratio - draws.log_ratio.max()
        return np.vstack([u[self._rows] * u[self._columns], u, ratio[None]]).astype(np.float32)

    def terms(self, parameters: PopulationParameters, effective: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Each person's log marginal likelihood, without the contrasts.

        Parameters
        ----------
        parameters : PopulationParameters
            W sets.
        effective : bool
            Whether to compute the effective number of draws too.

        Returns
        -------
        log_likelihood : ndarray, shape (W, N)
            Up to a constant for each person.
        effective : ndarray, shape (W, N)
            Effective number of draws; empty if not requested.
        """
        n_sets, n_persons = parameters.mu.shape[0], self.reference_means.shape[0]
        result = np.empty((n_sets, n_persons))
        counts = np.empty((n_sets, n_persons)) if effective else np.empty((0, 0))
        for persons, values, constants in self.exponents(parameters):
            peaks, sums, squares = _sums(values)
            result[:, persons] = np.log(sums / self.n_draws) + peaks + constants
            if effective:
                counts[:, persons] = sums**2 / squares
        return result, counts

    def __call__(self, parameters: PopulationParameters) -> np.ndarray:
        """Log likelihood of W sets of population parameters, shape (W,)."""
        total = self.terms(parameters)[0].sum(axis=1)
        for contrasts in self.contrasts:
            total = total + contrasts.log_likelihood(parameters.between_repetitions)
        return np.asarray(total)

    def variance(self, parameters: PopulationParameters) -> np.ndarray:
        """Monte-Carlo variance of the log likelihood, summed over persons, shape (W,)."""
        effective = self.terms(parameters, effective=True)[1]
        return np.asarray(np.sum(1 / effective - 1 / self.n_draws, axis=1))

    def log_weights(self, parameters: PopulationParameters) -> np.ndarray:
        """Unnormalised log weights of every draw: shape (W, N, K); memory W N K x 4 bytes."""
        n_sets, n_persons = parameters.mu.shape[0], self.reference_means.shape[0]
        result = np.empty((n_sets, n_persons, self.n_draws), dtype=np.float32)
        for persons, values, _ in self.exponents(parameters):
            result[:, persons] = values
        return result

    def exponents(self, parameters: PopulationParameters) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Block by block: the persons (B,), their log weights (W, B, K), and the constants (W, B).

        The log weights are overwritten by those of the next block.
        """
        populations = {j: self._population(parameters, int(j)) for j in np.unique(self.repetitions)}
        shared: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        values = np.empty((0, 0, 0), dtype=np.float32)
        for j, persons, features in self._blocks:
            if j not in shared or not self._same_means:
                shared[j] = self._coefficients(parameters, *populations[j], persons)
            coefficients, constants = shared[j]
            shape = coefficients.shape[0], persons.size, self.n_draws
            if values.shape != shape:  # allocating an array for every product would take longer than the product
                values = np.empty(shape, dtype=np.float32)
            if coefficients.ndim == 2:  # the same for every person: one product
                with np.errstate(over="ignore", invalid="ignore"):  # as below
                    np.matmul(coefficients, features, out=values.reshape(shape[0], -1))
            else:
                own = features.reshape(features.shape[0], persons.size, self.n_draws)
                for n in range(persons.size):  # if a dispersion vanishes it overflows, and is refused later
                    with np.errstate(over="ignore", invalid="ignore"):
                        np.matmul(coefficients[:, n], own[:, n], out=values[:, n])
            yield persons, values, constants

    def _population(self, parameters: PopulationParameters, repetitions: int) -> tuple[np.ndarray, np.ndarray]:
        """Precision in the coordinates u, (W, P, P), and half its log determinant up to a constant, (W,)."""
        covariance = parameters.covariance
        p = np.arange(covariance.shape[-1])
        covariance[:, p, p] += parameters.between_repetitions**2 / repetitions
        inverse_factor = np.linalg.inv(np.linalg.cholesky(covariance))
        whitened = inverse_factor @ self._factor
        log_determinant = np.sum(np.log(np.diagonal(inverse_factor, axis1=-2, axis2=-1)), axis=-1)
        return np.swapaxes(whitened, -1, -2) @ whitened, log_determinant

    def _coefficients(
        self, parameters: PopulationParameters, precision: np.ndarray, log_determinant: np.ndarray, persons: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the monomials, (W, m) if all persons share them or else (W, B, m), and constants (W, B)."""
        shift = parameters.mu[:, None, :] - self.reference_means[persons]
        if self.covariates.shape[1]:
            shift = shift + np.einsum("wpq,nq->wnp", parameters.slopes, self.covariates[persons])
        elif self._same_means or (
            self.sharing is None and np.all(self.reference_means[persons] == self.reference_means[persons[0]])
        ):
            shift = shift[:, :1]
        moving = np.empty((shift.shape[0], 0))
        if self.sharing is not None and parameters.shared is not None:
            t = self.sharing.standardised(parameters.shared)
            moving = monomials(t)
            shift = shift - np.einsum("nmp,wm->wnp", self.path[persons], moving)
        v = np.swapaxes(np.linalg.solve(self._factor, np.swapaxes(shift, -1, -2)), -1, -2)
        linear = v @ precision
        constants = log_determinant[:, None] - 0.5 * np.einsum("wnp,wnp->wn", v, linear)
        quadratic = -0.5 * self._multiplicity * precision[:, self._rows, self._columns]
        own = np.broadcast_to(quadratic[:, None], (*linear.shape[:2], quadratic.shape[1]))
        rest = np.concatenate([np.ones((len(moving), 1)), moving], axis=1)
        rest = np.broadcast_to(rest[:, None], (*linear.shape[:2], rest.shape[1]))
        with np.errstate(over="ignore", invalid="ignore"):  # as above: a vanishing dispersion is refused later
            coefficients = np.concatenate([own, linear, rest], axis=2).astype(np.float32)
        return (coefficients[:, 0] if coefficients.shape[1] == 1 else coefficients), constants
