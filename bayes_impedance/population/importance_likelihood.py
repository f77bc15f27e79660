r"""The likelihood of population parameters, with each person's elements integrated out by importance sampling.

**Between persons.** Let :math:`\bar\theta_i` be the mean of a person's log elements over J repetitions. Given the
population its distribution is :math:`N(\mu_i, T_J)` with :math:`T_J = \Sigma + \operatorname{diag}(\rho^2)/J`. With
the draws of :mod:`bayes_impedance.person.importance_draws`

.. math:: p(z_i\,|\,\mu, T) \approx \frac1K \sum_k \frac{L_i(\theta_{ik})}{q_i(\theta_{ik})}\,
          N(\theta_{ik}; \mu_i, T_J) .

The same draws serve every call, so the estimate is a smooth function of the population parameters. The variance of its
logarithm, about 1/(effective draws) - 1/K per person, is summed and reported. In coordinates u in which the reference
population is a standard normal the log density is a quadratic polynomial in u, and a set of population parameters is
one row of coefficients of its monomials. All walkers times all draws is then one matrix product (in single precision:
the coordinates are of order one, and the rounding, 1e-6 per draw, is far below the Monte-Carlo error). Only u is kept,
a fifth of the numbers; the monomials of a few persons are computed when they are needed, for all walkers at once.

Where parameters are the same for everybody, monomials in them are further columns of the coefficients, and each
person's draws are moved (:mod:`bayes_impedance.population.shared_draws`), which changes the other coefficients
(:mod:`bayes_impedance.population.shears`).

The contrasts between repetitions have a closed form at each person's mode
(:mod:`bayes_impedance.population.contrasts`); monomials in functions of rho are further columns, by which a draw away
from the mode differs (:mod:`bayes_impedance.population.moved_dispersions`).

A population with heavier tails (:mod:`bayes_impedance.population.heavy_tails`) or of two groups
(:mod:`bayes_impedance.population.two_components`) is a mixture of normal ones. Its weights of the same draws are the
sums of theirs, a chunk of populations at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy

import numpy as np

from bayes_impedance.network.kernel import compiled
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.exponentials import log_sums, sums_of_exponentials
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.shapes import normal_parts
from bayes_impedance.population.shared_draws import Moved, Sharing, monomials, stacked
from bayes_impedance.population.shears import sheared_coefficients

_BLOCK = 4
"""Persons per matrix product. By choice: W x 4 x K single-precision numbers stay in the processor's cache."""


_CHUNK = 2**21
"""Most log weights of the normal populations of mixtures at once, 8 MB in single precision. By choice: memory, and
about the size of a processor's cache."""

_IMPOSSIBLE = -1e30
"""Log ratio of draws that the recordings exclude, beside a pole: minus infinity times a weight of zero is no number."""


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
    span : DispersionRange, optional
        Of the dispersions between repetitions, if draws change with them.
    responses : sequence of ndarray, shape (M, K)
        How each person's draws change.
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
        span: DispersionRange | None = None,
        responses: Sequence[np.ndarray] = (),
    ) -> None:
        self.n_draws, n_elements = draws[0].theta.shape
        self.repetitions, self.covariates, self.contrasts = repetitions, covariates, contrasts
        self.reference_means = reference_means
        self.sharing, self.span = sharing, span
        self.path, self.shears, self.missed = stacked(moved)
        same = bool(np.all(reference_means == reference_means[0]))
        self._same_means = not covariates.shape[1] and same and sharing is None
        self.reference_factor = np.linalg.cholesky(reference_covariance)
        self.whitening = np.linalg.inv(self.reference_factor)
        self._means_in_u = reference_means @ self.whitening.T
        self._path_in_u = np.moveaxis(self.path @ self.whitening.T, 0, 1) if moved else np.empty((0, 0, 0))
        self.shears_in_u = self.whitening @ self.shears @ self.reference_factor if moved else self.shears
        self.pairs = np.tril_indices(n_elements)
        # Twice the entry, except on the diagonal: coefficients of the monomials u_p u_q, p >= q.
        self._multiplicity = np.where(self.pairs[0] == self.pairs[1], 1.0, 2.0)
        self._thinned: dict[int, ImportanceLikelihood] = {1: self}
        self.blocks: list[tuple[int, np.ndarray, np.ndarray]] = []  # repetitions, persons, coordinates (c, B K)
        for j in np.unique(repetitions):
            group = np.flatnonzero(repetitions == j)
            for persons in np.split(group, range(_BLOCK, group.size, _BLOCK)):
                own = [self._coordinates(draws[i], reference_means[i]) for i in persons]
                if sharing is not None:
                    pairs = zip(own, persons, strict=True)
                    own = [np.vstack([rows, moved[i].coefficients.astype(np.float32)]) for rows, i in pairs]
                if span is not None:
                    pairs = zip(own, persons, strict=True)
                    own = [np.vstack([rows, responses[i].astype(np.float32)]) for rows, i in pairs]
                self.blocks.append((int(j), persons, np.concatenate(own, axis=1)))

    def thinned(self, n_draws: int) -> ImportanceLikelihood:
        """The same from about `n_draws` of each person's draws, evenly spread: rougher, and faster in proportion."""
        stride = max(self.n_draws // n_draws, 1)
        if stride not in self._thinned:
            self._thinned[stride] = self._every(stride)
        return self._thinned[stride]

    def _every(self, stride: int) -> ImportanceLikelihood:
        other = copy(self)
        other._thinned = {1: other}
        other.n_draws = len(range(0, self.n_draws, stride))
        other.blocks = [
            (j, persons, np.ascontiguousarray(f.reshape(len(f), persons.size, -1)[:, :, ::stride]).reshape(len(f), -1))
            for j, persons, f in self.blocks
        ]
        return other

    @property
    def nbytes(self) -> int:
        """Memory in bytes, nearly all of it for the draws."""
        arrays = [own for _, _, own in self.blocks] + [c.information for c in self.contrasts]
        return sum(array.nbytes for array in arrays)

    def _coordinates(self, draws: Draws, mean: np.ndarray) -> np.ndarray:
        """Coordinates u of a person's draws and the logarithms of their ratios, (P + 1, K) in single precision."""
        u = self.whitening @ (draws.theta - mean).T
        log_ratio = np.maximum(draws.log_ratio - draws.log_ratio.max(), _IMPOSSIBLE)
        return np.vstack([u, log_ratio]).astype(np.float32)

    def draws_of(self, persons: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Log elements (n, S, P) of draws of some persons (n,), from their coordinates u (n, S, P)."""
        return np.asarray(self.reference_means[persons, None] + u @ self.reference_factor.T)

    def monomials(self, own: np.ndarray, result: np.ndarray) -> np.ndarray:
        """Products of the coordinates u, and all rows of a block (c, n) after them: (m, n).

        They are written into `result` if it has that shape: computing them takes less time than fetching several times
        as many numbers from memory would.
        """
        p, n_squares = self.whitening.shape[0], self.pairs[0].size
        shape = n_squares + len(own), own.shape[1]
        if result.shape != shape:
            result = np.empty(shape, dtype=np.float32)
        _multiply_rows(own, p, result)
        result[n_squares:] = own
        return result

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
        if parameters.mixed and not effective:
            for persons, rows, values, offsets in self._by_node(parameters):
                peaks, sums, _ = sums_of_exponentials(values)
                of_nodes = np.log(sums / self.n_draws) + peaks + offsets
                of_nodes = of_nodes.reshape(rows.stop - rows.start, -1, persons.size)
                result[rows, persons] = np.logaddexp.reduce(of_nodes, axis=1)
            return result, np.empty((0, 0))
        counts = np.empty((n_sets, n_persons)) if effective else np.empty((0, 0))
        for persons, values, constants in self.exponents(parameters):
            peaks, sums, squares = sums_of_exponentials(values)
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
        if parameters.mixed:
            yield from self._exponents_of_mixtures(parameters)
            return
        values = np.empty((0, 0, 0), dtype=np.float32)
        for persons, features, coefficients, constants in self._by_block(parameters):
            values = self._products(coefficients, features, persons.size, values)
            yield persons, values, constants

    def _by_block(
        self, parameters: PopulationParameters
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Block by block: the persons, their monomials, coefficients and constants of W normal populations.

        The monomials are overwritten by those of the next block.
        """
        moving = self.moving(parameters)
        features = np.empty((0, 0), dtype=np.float32)
        for j in np.unique(self.repetitions):
            group = np.flatnonzero(self.repetitions == j)
            coefficients, constants = self._coefficients(parameters, int(j), group, moving)
            begin = 0
            for repetitions, persons, own in self.blocks:
                if repetitions != j:
                    continue
                features = self.monomials(own, features)
                rows = slice(begin, begin + persons.size)
                begin = rows.stop
                if self._same_means:
                    yield persons, features, coefficients[0], constants
                else:
                    yield persons, features, coefficients[rows], constants[:, rows]

    def _products(
        self, coefficients: np.ndarray, features: np.ndarray, n_persons: int, values: np.ndarray
    ) -> np.ndarray:
        """Log weights (W, B, K), written into `values` if that has the same shape."""
        shape = coefficients.shape[-2], n_persons, self.n_draws
        if values.shape != shape:  # allocating an array for every product would take longer than the product
            values = np.empty(shape, dtype=np.float32)
        if coefficients.ndim == 2:  # the same for every person: one product
            with np.errstate(over="ignore", invalid="ignore"):  # as below
                np.matmul(coefficients, features, out=values.reshape(shape[0], -1))
        else:
            own = features.reshape(features.shape[0], n_persons, self.n_draws)
            for n in range(n_persons):  # if a dispersion vanishes it overflows, and is refused later
                with np.errstate(over="ignore", invalid="ignore"):
                    np.matmul(coefficients[n], own[:, n], out=values[:, n])
        return values

    def _by_node(self, parameters: PopulationParameters) -> Iterator[tuple[np.ndarray, slice, np.ndarray, np.ndarray]]:
        """Weights of the normal populations of W mixtures of G each, by blocks of persons and chunks of mixtures.

        Yields the persons (B,), the mixtures of a chunk as a slice, the log weights of the draws under each normal
        population, (w G, B, K), and what is to be added to them, (w G, B). Log weights are overwritten by the next.
        """
        parts, log_weight = normal_parts(parameters)
        n_sets, n_nodes = log_weight.shape
        at_once = max(1, _CHUNK // (n_nodes * _BLOCK * self.n_draws))
        values = np.empty((0, 0, 0), dtype=np.float32)
        for persons, features, coefficients, constants in self._by_block(parts):
            offsets = log_weight.reshape(-1, 1) + np.broadcast_to(constants, (n_sets * n_nodes, persons.size))
            for start in range(0, n_sets, at_once):
                rows = slice(start, min(start + at_once, n_sets))
                nodes = slice(rows.start * n_nodes, rows.stop * n_nodes)
                values = self._products(coefficients[..., nodes, :], features, persons.size, values)
                yield persons, rows, values, offsets[nodes]

    def _exponents_of_mixtures(
        self, parameters: PopulationParameters
    ) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """As :meth:`exponents`, of mixtures: logarithms of sums over their normal populations."""
        n_sets = len(parameters.mu)
        whole = np.empty((0, 0, 0), dtype=np.float32)
        for persons, rows, values, offsets in self._by_node(parameters):
            shape = n_sets, persons.size, self.n_draws
            if whole.shape != shape:
                whole = np.empty(shape, dtype=np.float32)
            own = values.reshape(rows.stop - rows.start, -1, persons.size, self.n_draws)
            log_sums(own, offsets.reshape(len(own), -1, persons.size).astype(np.float32), whole[rows])
            if rows.stop == n_sets:
                yield persons, whole, np.zeros((n_sets, persons.size))

    def population_in_reference(
        self, parameters: PopulationParameters, repetitions: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Precision in the coordinates u, (W, P, P), and half its log determinant up to a constant, (W,)."""
        covariance = parameters.covariance
        p = np.arange(covariance.shape[-1])
        covariance[:, p, p] += parameters.between_repetitions**2 / repetitions
        inverse_factor = np.linalg.inv(np.linalg.cholesky(covariance))
        whitened = inverse_factor @ self.reference_factor
        log_determinant = np.sum(np.log(np.diagonal(inverse_factor, axis1=-2, axis2=-1)), axis=-1)
        return np.swapaxes(whitened, -1, -2) @ whitened, log_determinant

    def _coefficients(
        self, parameters: PopulationParameters, repetitions: int, persons: np.ndarray, moving: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of some persons' monomials, (n, W, m), and constants (W, n); n = 1 if they share them."""
        precision, log_determinant = self.population_in_reference(parameters, repetitions)
        v = self.means_in_reference(parameters, persons, moving)
        linear = v @ precision
        constants = log_determinant[:, None] - 0.5 * np.sum(v * linear, axis=2)
        n_squares, n_linear = self.pairs[0].size, v.shape[2]
        squares = precision[:, self.pairs[0], self.pairs[1]]
        if moving.size:
            t = np.ascontiguousarray(moving[:, : self.shears.shape[1]])
            squares, linear, volume = sheared_coefficients(precision, linear, t, self.shears_in_u[persons], *self.pairs)
            constants = constants + volume
        of_dispersions = [] if self.span is None else [self.span.terms(parameters.between_repetitions)]
        rest = np.concatenate([np.ones((len(moving), 1)), moving, *of_dispersions], axis=1)
        coefficients = np.empty((v.shape[1], len(v), n_squares + n_linear + rest.shape[1]), dtype=np.float32)
        with np.errstate(over="ignore", invalid="ignore"):  # as above: a vanishing dispersion is refused later
            coefficients[..., :n_squares] = -0.5 * self._multiplicity * squares
            coefficients[..., n_squares : n_squares + n_linear] = np.swapaxes(linear, 0, 1)
            coefficients[..., n_squares + n_linear :] = rest
        return coefficients, constants

    def moving(self, parameters: PopulationParameters) -> np.ndarray:
        """Monomials in the parameters that are the same for everybody, (W, M); M = 0 without such."""
        if self.sharing is None or parameters.shared is None:
            return np.empty((len(parameters.mu), 0))
        return monomials(self.sharing.standardised(parameters.shared))

    def means_in_reference(
        self, parameters: PopulationParameters, persons: np.ndarray, moving: np.ndarray
    ) -> np.ndarray:
        """Population means less the persons' paths, in the coordinates u: (W, n, P), or (W, 1, P) if all agree."""
        v = (parameters.mu @ self.whitening.T)[:, None, :]
        if self._same_means:
            return np.asarray(v - self._means_in_u[:1])
        v = v - self._means_in_u[persons]
        if self.covariates.shape[1]:
            v += np.einsum("wpq,nq->wnp", self.whitening @ parameters.slopes, self.covariates[persons])
        if moving.size:
            path = self._path_in_u[:, persons]
            v -= (moving @ path.reshape(len(path), -1)).reshape(v.shape)
        return np.asarray(v)


@compiled
def _multiply_rows(rows: np.ndarray, n: int, result: np.ndarray) -> None:
    """Write the products of the first n rows, each with those before it and itself, into the first rows of `result`."""
    m = 0
    for p in range(n):
        for q in range(p + 1):
            a, b, out = rows[p], rows[q], result[m]
            for k in range(a.size):
                out[k] = a[k] * b[k]
            m += 1
