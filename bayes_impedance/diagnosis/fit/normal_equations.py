r"""Quadratic expansion of each person's likelihood in the additions' parameters, with the elements left free.

With the elements of every recording free, person i's log likelihood of the additions' parameters y (shared ones and the
person's own coefficients c) is quadratic, :math:`h_i\cdot y - \tfrac12 y^TD_iy`: coefficients act linearly. Between
people :math:`c_i \sim N(\mu, \operatorname{diag}\tau^2)`, and with :math:`a = (\varphi, \mu)`,
:math:`W_i = T(1 + D_{cc}T)^{-1}`, :math:`q_i = (h_i - D_ia)_c`,

.. math:: \ell_i(a, \tau) = h_i\cdot a - \tfrac12 a^TD_ia + \tfrac12 q_i^TW_iq_i - \tfrac12\ln|1 + D_{cc}T| .

The sum is quadratic in a; its maximum gives the shared parameters and the means.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.network.kernel import compiled
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, equations_apart
from bayes_impedance.person.small_matrices import ROUNDING
from bayes_impedance.runtime.broadcast import Lent

_FREEDOM = 5.0
"""Prior width of the elements in standard deviations of the population. By choice: practically free where the band
determines them, and bounded where it does not."""

_SMALL_PIECE, _LARGE_PIECE = 4_000, 25_000
"""Smallest and largest piece of work, in points (recordings times frequencies). Below the first, a third of a
millisecond, threads do not pay. Above the second, two milliseconds, load balancing would suffer."""

_FEW_PIECES, _MOST_PIECES = 4, 64
"""Number of pieces for few people, enough for the threads of a small machine, and for many: each task has an overhead
of milliseconds on a cluster. By choice."""


@dataclass(frozen=True)
class Population:
    """Population parameters of the V varying parameters.

    Attributes
    ----------
    mu : ndarray, shape (V,)
        Means.
    covariance : ndarray, shape (V, V)
        Between people.
    rho : ndarray, shape (V,)
        Standard deviations between repetitions.
    """

    mu: np.ndarray
    covariance: np.ndarray
    rho: np.ndarray


@dataclass(frozen=True)
class Equations:
    """Chi-square (M,), gradient (M, P) and information (M, P, P) of all M recordings."""

    chi: np.ndarray
    gradient: np.ndarray
    information: np.ndarray

    def only(self, rows: np.ndarray) -> Equations:
        """Those of some recordings (bool, shape (M,))."""
        return Equations(self.chi[rows], self.gradient[rows], self.information[rows])

    def with_rows(self, rows: np.ndarray, other: Equations) -> Equations:
        """A copy with some recordings (bool, shape (M,)) taken from `other`."""
        return Equations(
            np.where(rows, other.chi, self.chi),
            np.where(rows[:, None], other.gradient, self.gradient),
            np.where(rows[:, None, None], other.information, self.information),
        )


def owners(data: Sequence[Likelihood]) -> np.ndarray:
    """Person of every recording, shape (M,)."""
    return np.repeat(np.arange(len(data)), [d.z.shape[0] for d in data])


def weights(data: Sequence[Likelihood], chi: np.ndarray) -> np.ndarray:
    """1/scale^2 of each person's noise from the recordings' chi-squares, shape (N,)."""
    return weights_of(owners(data), counts(data), chi)


def weights_of(owner: np.ndarray, numbers: np.ndarray, chi: np.ndarray) -> np.ndarray:
    """The same from each recording's person (M,) and each person's number of complex values (N,)."""
    total = np.bincount(owner, chi, minlength=numbers.size)
    return np.asarray((SCALE_SHAPE + numbers) / (SCALE_SHAPE + 0.5 * total))


def counts(data: Sequence[Likelihood]) -> np.ndarray:
    """Number of complex values of each person, shape (N,)."""
    return np.array([d.z.shape[0] * d.omega.size for d in data], dtype=float)


@dataclass(frozen=True)
class Stack:
    """All recordings, ordered by frequency grid, in a few long pieces of about equal work.

    Pieces are lent (:class:`~bayes_impedance.runtime.broadcast.Lent`), so that the data are sent to workers only once.

    Attributes
    ----------
    owner : ndarray, shape (M,)
        Person of every recording.
    pieces : tuple of (rows, Lent)
        Numbers (R,) of the recordings in a piece, and their data: a tuple of (omega, z, weight) with shapes (F,),
        (R', 2, F) and (R', F), in the order of the rows.
    rest : ndarray, shape (M,), optional
        What is to be added to each recording's chi-square, where the pieces hold recordings that are summed up
        (:mod:`.few_frequencies`).
    silent : ndarray of bool, shape (M, P), optional
        Which coefficients a recording does not feel, because its person lacks the effect.
    """

    owner: np.ndarray
    pieces: tuple[tuple[np.ndarray, Lent], ...]
    rest: np.ndarray | None = None
    silent: np.ndarray | None = None

    def felt(self, u: np.ndarray) -> np.ndarray:
        """Parameters (M, P) that the recordings feel: coefficients of zero where a person lacks the effect."""
        return u if self.silent is None else np.where(self.silent, 0.0, u)

    @classmethod
    def of(cls, data: Sequence[Likelihood]) -> Stack:
        """Stack of all people's data."""
        owner = owners(data)
        people: dict[bytes, list[int]] = {}
        for i, d in enumerate(data):
            people.setdefault(d.omega.tobytes(), []).append(i)
        groups = []
        for own in people.values():
            z = np.ascontiguousarray(np.concatenate([data[i].z for i in own]))
            weight = np.ascontiguousarray(np.concatenate([data[i].weight for i in own]))
            groups.append((data[own[0]].omega, z, weight))
        rows = np.concatenate([np.flatnonzero(owner == i) for own in people.values() for i in own])
        edges = np.r_[0, np.cumsum([len(z) for _, z, _ in groups])]
        points = sum(weight.size for _, _, weight in groups)
        few = min(_FEW_PIECES, 1 + points // _SMALL_PIECE)
        n = min(int(np.clip(points // _LARGE_PIECE, few, _MOST_PIECES)), len(rows))
        pieces = []
        for piece in np.array_split(np.arange(len(rows)), n):
            blocks = []
            for (omega, z, weight), begin, end in zip(groups, edges[:-1], edges[1:], strict=True):
                inside = slice(max(piece[0] - begin, 0), max(min(piece[-1] + 1, end) - begin, 0))
                if inside.start < inside.stop:
                    blocks.append((omega, z[inside], weight[inside]))
            pieces.append((rows[piece], Lent(tuple(blocks))))
        return cls(owner, tuple(pieces))


@compiled
def _recordings(
    program: Program, u: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n, p = chosen.size, u.shape[1]
    chi, gradient, information = np.empty(n), np.empty((n, p)), np.empty((n, p, p))
    for k in range(n):
        j = chosen[k]
        chi[k], own, curvature = equations_apart(program, u[k], omega, z[j], weight[j])
        for a in range(p):
            gradient[k, a] = own[a]
            for b in range(p):
                information[k, a, b] = curvature[a, b]
    return chi, gradient, information


def at_many(
    model: Model, u: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chi-square (K,), gradient (K, P) and information (K, P, P) of one recording at many u (K, P).

    The recording z is a pair of real and imaginary part, shape (2, F), and has weights (F,).
    """
    return _recordings(model.kernel.program, u, omega, z[None], weight[None], np.zeros(len(u), dtype=np.int64))  # type: ignore[no-any-return]


def _piece(
    blocks: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], task: tuple[Program, np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Chi-square, gradient and information of the chosen recordings of a piece, u in their order."""
    program, u, chosen = task
    found, begin = [], 0
    for omega, z, weight in blocks:
        own = (chosen >= begin) & (chosen < begin + len(z))
        if own.any():
            found.append(_recordings(program, u[own], omega, z, weight, chosen[own] - begin))
        begin += len(z)
    if len(found) == 1:
        return found[0]  # type: ignore[no-any-return]
    chi, gradient, information = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return chi, gradient, information


def equations_at(
    model: Model,
    stack: Stack,
    u: np.ndarray,
    executor: Executor,
    people: np.ndarray | None = None,
    known: Equations | None = None,
) -> Equations:
    """Chi-square, gradient and information of every recording at u (M, P).

    Only those of some people (bool, shape (N,)) are computed if the others' are known.
    """
    m, p = u.shape
    u = stack.felt(u)
    if known is None or people is None:
        result, wanted = Equations(np.empty(m), np.empty((m, p)), np.empty((m, p, p))), np.ones(m, dtype=bool)
    else:
        result = Equations(known.chi.copy(), known.gradient.copy(), known.information.copy())
        wanted = people[stack.owner]
    where, tasks = [], []
    for rows, lent in stack.pieces:
        chosen = np.flatnonzero(wanted[rows])
        if chosen.size:
            where.append(rows[chosen])
            tasks.append((lent, (model.kernel.program, u[rows[chosen]], chosen)))
    for rows, found in zip(where, Lent.ask(executor, _piece, tasks), strict=True):
        result.chi[rows], result.gradient[rows], result.information[rows] = found
        if stack.rest is not None:
            result.chi[rows] = np.maximum(result.chi[rows] + stack.rest[rows], 0.0)
    if stack.silent is not None:
        result.gradient[stack.silent] = 0.0
        result.information[stack.silent] = 0.0
        np.swapaxes(result.information, 1, 2)[stack.silent] = 0.0
    return result


def quadratic(
    model: Model, data: Sequence[Likelihood], u: np.ndarray, equations: Equations, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each person's h (N, A) and D (N, A, A), and the elements' response to y in every recording, (M, E, A).

    Elements have a prior width of five standard deviations of the population's `covariance`: one that the band does not
    determine would diverge otherwise.
    """
    e, a = slice(0, model.n_elements), slice(model.n_elements, None)
    owner = owners(data)
    w = weights(data, equations.chi)[owner]
    information = w[:, None, None] * equations.information
    gradient = w[:, None] * equations.gradient
    inside = information[:, e, e].copy()
    inside += np.linalg.inv(covariance[e, e]) / _FREEDOM**2
    inside[:, np.arange(model.n_elements), np.arange(model.n_elements)] *= 1 + ROUNDING
    cross = information[:, e, a]
    solved = np.linalg.solve(inside, np.concatenate([cross, gradient[:, e, None]], axis=2))
    response, step = -solved[..., :-1], solved[..., -1]
    d = information[:, a, a] + np.einsum("mea,meb->mab", cross, response)
    s = -gradient[:, a] + np.einsum("mea,me->ma", cross, step)
    h = s + np.einsum("mab,mb->ma", d, u[:, a])
    n = len(data)
    return sums(h, owner, n), sums(0.5 * (d + np.swapaxes(d, 1, 2)), owner, n), response


@dataclass(frozen=True)
class MarginalDensity:
    """The likelihood of a = (phi, mu) with each person's coefficients integrated out.

    Attributes
    ----------
    log_density : float
        With a integrated out as well, up to a constant.
    mean : ndarray, shape (A,)
    precision : ndarray, shape (A, A)
        Both with the prior of a.
    """

    log_density: float
    mean: np.ndarray
    precision: np.ndarray


def marginal(model: Model, h: np.ndarray, d: np.ndarray, tau: np.ndarray) -> MarginalDensity:
    """Integrate each person's coefficients out.

    Parameters
    ----------
    model : Model
    h, d : ndarray, shapes (N, A) and (N, A, A)
        From :func:`quadratic`.
    tau : ndarray, shape (A,)
        Standard deviations between people; ignored for shared parameters.
    """
    log_density, mean, precision = _marginal(model, h, d, tau[None])
    return MarginalDensity(float(log_density[0]), mean[0], 0.5 * (precision[0] + precision[0].T))


def log_densities(
    model: Model, h: np.ndarray, d: np.ndarray, tau: np.ndarray, around: np.ndarray | None = None
) -> np.ndarray:
    """Log densities of :func:`marginal` for many dispersions, tau of shape (G, A); shape (G,).

    If central values (A,) are given, around which h and d expand the likelihood, those of shapes are held there. Where
    a shape and a coefficient change the curve nearly alike, the expansion does not say where they go with another
    dispersion (:mod:`.shape_force`).
    """
    return _marginal(model, h, d, tau, around)[0]


def _marginal(
    model: Model, h: np.ndarray, d: np.ndarray, tau: np.ndarray, around: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log densities (G,), means (G, A) and precisions (G, A, A) of a for dispersions of shape (G, A).

    They are computed around the mean that everybody's being the same would have, whatever the dispersions are: around
    zero, the log likelihood of a parameter that is a thousand million standard deviations from it, such as the
    frequency of a resonance without damping, is 1e18, of which a double knows hundreds. If shapes are held `around` the
    fit, means and precisions are those of the others, (G, C) and (G, C, C).
    """
    varying = np.flatnonzero(~model.shared[model.n_elements :])
    free = np.array([around is None or p.is_coefficient for p in model.parameters])
    inside = np.ix_(free, free)
    prior_sd = np.array([p.prior_sd for p in model.parameters])[free]
    centre = np.array([p.centre for p in model.parameters])[free]
    # Two additions that are the same curve, one of them the same for all, differ by less than rounding.
    firm = np.ones((prior_sd.size, prior_sd.size)) + np.diag(np.full(prior_sd.size, ROUNDING))
    prior = np.diag(prior_sd**-2.0)
    whole, force = d.sum(axis=0), h.sum(axis=0)
    reference = np.zeros(free.size) if around is None else np.where(free, 0.0, around)
    left = (force - whole @ reference)[free] + centre / prior_sd**2
    reference[free] = np.linalg.solve((whole[inside] + prior) * firm, left)
    there = h - np.einsum("nab,b->na", d, reference)
    precision, right, value = _integrated(*(np.ascontiguousarray(a) for a in (d, there, varying, tau)))
    precision = (precision[:, free][:, :, free] + prior) * firm
    right = right[:, free] + (centre - reference[free]) / prior_sd**2
    mean = np.linalg.solve(precision, right[..., None])[..., 0]
    value += 0.5 * np.sum(right * mean, axis=1) - 0.5 * np.linalg.slogdet(precision)[1]
    return value, reference[free] + mean, precision


@compiled
def _integrated(
    d: np.ndarray, h: np.ndarray, varying: np.ndarray, tau: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    r"""Sums over people of D - D_c W D_c^T, of h - D_c W h_c, and of h_c W h_c / 2 - ln|1 + D_cc T| / 2.

    One coefficient is integrated out after the other: with d its column and D its diagonal element of what is left,
    :math:`D \to D - d d^T \tau^2 / (1 + D\tau^2)`. Those with the same dispersion everywhere on the grid come first,
    once for the whole grid.
    """
    n_grid, n, size = tau.shape[0], h.shape[0], h.shape[1]
    precision, right, value = np.zeros((n_grid, size, size)), np.zeros((n_grid, size)), np.zeros(n_grid)
    common, left, row = np.empty((size, size + 1)), np.empty((size, size + 1)), np.empty(size + 1)
    changes = np.array([np.any(tau[:, a] != tau[0, a]) for a in varying])
    same, others = varying[~changes], varying[changes]
    for i in range(n):
        common[:, :size], common[:, size] = d[i], h[i]
        known = 0.0
        for a in same:
            known += _without(common, row, a, tau[0, a])
        for g in range(n_grid):
            left[:] = common
            value[g] += known
            for a in others:
                value[g] += _without(left, row, a, tau[g, a])
            for b in range(size):
                for c in range(size):
                    precision[g, b, c] += left[b, c]
                right[g, b] += left[b, size]
    return precision, right, value


@compiled
def _without(left: np.ndarray, row: np.ndarray, a: int, tau: float) -> float:
    """Integrate a coefficient out of a person's D and h, side by side (A, A + 1), in place; what it adds to the log."""
    size = left.shape[0]
    row[:] = left[a]
    shrunk = 1 / (1 + tau**2 * row[a])
    for b in range(size):
        factor = tau**2 * shrunk * row[b]
        for c in range(size + 1):
            left[b, c] -= factor * row[c]
    for c in range(size):
        left[a, c] = left[c, a] = shrunk * row[c]
    left[a, size] = shrunk * row[size]
    return 0.5 * tau**2 * shrunk * row[size] ** 2 + 0.5 * np.log(shrunk)  # type: ignore[no-any-return]


def sums(values: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Sums over the recordings of each person, who has at least one: (M, ...) to (N, ...), person by person."""
    return np.asarray(np.add.reduceat(values, np.searchsorted(owner, np.arange(n)), axis=0))
