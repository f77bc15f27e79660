r"""Coefficient equations: the coefficients of a network's rational impedance as polynomials in its elements.

Every coefficient of numerator and denominator of a series-parallel network is a sum of products of elements, each
element at most to the first power once the denominators of 1/n are cleared. For eq. 4 for instance

.. math:: b_5 = m_1 m_2 n_1 n_2 n_3 r_3, \quad \dots \quad b_0 = 1, \quad a_1 = n_1 + n_3, \quad a_0 = 0 .

The network's own reduction to polynomials is run once on symbols in place of numbers, so that the equations of any
network follow without hand derivation. A rational function fixes its coefficients up to one common factor. Mapping it
onto the network therefore means :math:`c_k(x) = \lambda\,\hat c_k` for all k: for eq. 4 eleven equations, ten of them
once the factor is gone, for eight elements. The system is overdetermined: a rational function has an exact network only
if it also satisfies the surplus equations. This is why mappings fail, not a surplus of unknowns.

**All real solutions** are searched, negative elements included, because they show what an exact match would require.
With :math:`x_p = \sigma_p e^{\theta_p}`, every pattern of signs gets Gauss-Newton searches from random starts in
:math:`\theta`, many at once as one array. The residual of coefficient k is the logarithm of its ratio to the target
if all signs are positive; otherwise a ratio may pass through zero, and :math:`\operatorname{arsinh}` replaces the
logarithm.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from bayes_impedance.classical.levenberg_marquardt import START_SPREAD, minimise_many
from bayes_impedance.display import Brief
from bayes_impedance.network.notation import Network
from bayes_impedance.network.rational import TransferFunction

_MAX_SIGNED_ELEMENTS = 10
"""Above this many elements only positive solutions are searched. By choice: there are 2^n sign patterns."""

_POSITIVE_STARTS, _SIGNED_STARTS, _ITERATIONS = 200, 8, 80
"""Starts with positive elements, starts for each pattern of signs, and steps from each. By choice: positive
solutions matter most, and there are up to 2^10 patterns of signs."""

_EXACT, _SAME = 1e-7, 1e-4
"""Largest relative error of a coefficient in a solution, and relative difference of elements up to which two solutions
are one. By choice: the first well above rounding of products of ten elements, the second above what the first leaves
open in the elements."""


class _Symbolic:
    """A polynomial in the elements with integer coefficients, with the arithmetic that the network's algebra needs.

    Terms are keyed by the sorted names of their factors; the constant term's key is empty.
    """

    def __init__(self, terms: Mapping[tuple[str, ...], int]) -> None:
        self.terms = {factors: count for factors, count in terms.items() if count}

    def __add__(self, other: _Symbolic | int) -> _Symbolic:
        terms = dict(self.terms)
        for factors, count in other.terms.items() if isinstance(other, _Symbolic) else [((), other)]:
            terms[factors] = terms.get(factors, 0) + count
        return _Symbolic(terms)

    def __mul__(self, other: _Symbolic | int) -> _Symbolic:
        terms: dict[tuple[str, ...], int] = {}
        for g, b in other.terms.items() if isinstance(other, _Symbolic) else [((), other)]:
            for f, a in self.terms.items():
                factors = tuple(sorted(f + g))
                terms[factors] = terms.get(factors, 0) + a * b
        return _Symbolic(terms)

    __radd__, __rmul__ = __add__, __mul__

    def __eq__(self, other: object) -> bool:
        return isinstance(other, int) and self.terms == ({(): other} if other else {})

    __hash__ = None  # type: ignore[assignment]


@dataclass(frozen=True, repr=False)
class CoefficientEquations(Brief):
    """Coefficients of a network's impedance as polynomials in its elements.

    Attributes
    ----------
    elements : tuple of str
        P of them.
    names : tuple of str
        Names of the C coefficients that are not zero by structure: ``b5`` ... of the numerator, ``a5`` ... of the
        denominator.
    monomials : tuple of ndarray of int, shape (T, P)
        For each coefficient, the powers of the elements in each of its terms.
    counts : tuple of ndarray of int, shape (T,)
        How often each term occurs.
    """

    elements: tuple[str, ...]
    names: tuple[str, ...]
    monomials: tuple[np.ndarray, ...]
    counts: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, network: Network) -> CoefficientEquations:
        """The equations of a network."""
        elements = network.elements
        symbols = {e: _Symbolic({(e,): 1}) for e in elements}
        names, monomials, counts = [], [], []
        for letter, polynomial in zip("ba", network.transfer_function(symbols).ascending, strict=True):
            for power in reversed(range(len(polynomial))):
                coefficient = polynomial[power]
                if coefficient == 0:
                    continue
                terms = coefficient.terms if isinstance(coefficient, _Symbolic) else {(): coefficient}
                names.append(f"{letter}{power}")
                monomials.append(np.array([[factors.count(e) for e in elements] for factors in terms]))
                counts.append(np.array(list(terms.values())))
        return cls(elements, tuple(names), tuple(monomials), tuple(counts))

    def text(self) -> tuple[str, ...]:
        """The equations in readable notation, one for each coefficient."""
        lines = []
        for name, powers, counts in zip(self.names, self.monomials, self.counts, strict=True):
            terms = []
            for row, count in sorted(zip(powers.tolist(), counts.tolist(), strict=True), reverse=True):
                factors = [e if p == 1 else f"{e}^{p}" for e, p in zip(self.elements, row, strict=True) if p]
                terms.append(" ".join(([str(count)] if count > 1 or not factors else []) + factors))
            lines.append(f"{name} = {' + '.join(terms)}")
        return tuple(lines)

    def evaluate(self, log_size: np.ndarray, sign: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients and their derivatives with respect to the logarithms of the elements' sizes.

        Parameters
        ----------
        log_size, sign : ndarray, shape (S, P)

        Returns
        -------
        value : ndarray, shape (S, C)
        slope : ndarray, shape (S, C, P)
        """
        value = np.empty((log_size.shape[0], len(self.names)))
        slope = np.empty((*value.shape, log_size.shape[1]))
        negative = (sign < 0).astype(int)
        for k, (powers, counts) in enumerate(zip(self.monomials, self.counts, strict=True)):
            terms = counts * (1 - 2 * ((negative @ powers.T) % 2)) * np.exp(log_size @ powers.T)
            value[:, k] = terms.sum(axis=1)
            slope[:, k] = terms @ powers
        return value, slope

    def wanted(self, transfer: TransferFunction) -> tuple[np.ndarray, tuple[str, ...]]:
        """Coefficients of a rational function in this order, (C,), and those that are zero in the network by structure.

        The latter are given as text, name and value.
        """
        given = {
            f"{letter}{power}": float(np.real(coefficient))
            for letter, polynomial in zip("ba", transfer.ascending, strict=True)
            for power, coefficient in enumerate(polynomial)
        }
        surplus = tuple(f"{n} = {v:.4g}" for n, v in given.items() if v != 0 and n not in self.names)
        return np.array([given.get(name, 0.0) for name in self.names]), surplus


@dataclass(frozen=True, repr=False)
class ExactSolution(Brief):
    """Elements with which the network is the rational function, coefficient for coefficient.

    Attributes
    ----------
    values : dict of str to float
        Signed.
    positive : bool
        Whether all values are positive, so that the network can be built.
    isolated : bool
        False if elements can change without changing the impedance: the solution is one of a continuum.
    largest_error : float
        Largest relative error of a coefficient.
    """

    values: dict[str, float]
    positive: bool
    isolated: bool
    largest_error: float


def exact_solutions(
    equations: CoefficientEquations, transfer: TransferFunction, log_start: np.ndarray, seed: int = 1
) -> tuple[ExactSolution, ...]:
    """All real solutions of the coefficient equations that random starts find, positive ones first.

    Parameters
    ----------
    equations : CoefficientEquations
    transfer : TransferFunction
    log_start : ndarray, shape (P,)
        Logarithms of likely sizes of the elements; starts are spread around them by factors of about e^2.
    seed : int

    Returns
    -------
    tuple of ExactSolution
        Empty if the function has a coefficient that the network cannot have, or lacks one that it must have.
    """
    wanted, surplus = equations.wanted(transfer)
    if surplus or np.any(wanted == 0):
        return ()
    rng = np.random.default_rng(seed)
    n = len(equations.elements)
    found: list[tuple[np.ndarray, np.ndarray]] = []
    for signs in _patterns(n):
        n_starts = _POSITIVE_STARTS if np.all(signs > 0) else _SIGNED_STARTS * len(signs)
        start = log_start + rng.normal(0, START_SPREAD, (n_starts, n))
        sign = signs[rng.integers(len(signs), size=n_starts)] if len(signs) > 1 else np.repeat(signs, n_starts, axis=0)
        found.extend(zip(*_search(equations, wanted, start, sign), strict=True))
    solutions: list[ExactSolution] = []
    for theta, sign in found:
        solution = _described(equations, wanted, theta, sign)
        if solution.largest_error < _EXACT and not any(_same(solution, known) for known in solutions):
            solutions.append(solution)
    return tuple(sorted(solutions, key=lambda s: not s.positive))


def _same(a: ExactSolution, b: ExactSolution) -> bool:
    """Whether two solutions are equal, or belong to one continuum."""
    if a.positive and b.positive and not (a.isolated or b.isolated):
        return True
    return np.allclose(list(a.values.values()), list(b.values.values()), rtol=_SAME, atol=0)


def _patterns(n: int) -> list[np.ndarray]:
    """The positive pattern, then all the others together."""
    positive = np.ones((1, n))
    if n > _MAX_SIGNED_ELEMENTS:
        return [positive]
    others = np.array(list(product((1.0, -1.0), repeat=n)))[1:]
    return [positive, others]


def _search(
    equations: CoefficientEquations, wanted: np.ndarray, start: np.ndarray, sign: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt on all starts at once, (S, P); returns end points near an exact solution, and their signs."""
    theta = np.hstack([start, np.zeros((start.shape[0], 1))])
    value, _ = equations.evaluate(start, sign)
    ratio = value / wanted
    # The common factor starts at the value on which most coefficients agree, and keeps that sign.
    factor_sign = np.where(np.median(np.sign(ratio), axis=1) < 0, -1.0, 1.0)
    theta[:, -1] = -np.mean(np.log(np.abs(ratio) + 1e-300), axis=1)
    all_positive = bool(np.all(sign > 0) and np.all(wanted > 0))
    theta, cost = minimise_many(
        lambda at: _residual(equations, wanted, at, sign, factor_sign, all_positive), theta, _ITERATIONS
    )
    near = cost < 1e-12
    return theta[near, :-1], sign[near]


def _residual(
    equations: CoefficientEquations,
    wanted: np.ndarray,
    theta: np.ndarray,
    sign: np.ndarray,
    factor_sign: np.ndarray,
    all_positive: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (S, C) and their derivatives (S, C, P + 1); the last is with respect to the common factor."""
    value, slope = equations.evaluate(theta[:, :-1], sign)
    factor = factor_sign * np.exp(theta[:, -1])
    ratio = value * factor[:, None] / wanted
    slope = np.concatenate([slope * (factor[:, None] / wanted)[..., None], ratio[..., None]], axis=2)
    if all_positive:
        residual, inner = np.log(ratio), 1 / ratio
    else:
        residual, inner = np.arcsinh(ratio) - np.arcsinh(1.0), 1 / np.sqrt(1 + ratio**2)
    return residual, slope * inner[..., None]


def _described(
    equations: CoefficientEquations, wanted: np.ndarray, theta: np.ndarray, sign: np.ndarray
) -> ExactSolution:
    value, slope = equations.evaluate(theta[None], sign[None])
    ratio = value[0] / wanted
    ratio /= np.median(ratio)
    singular = np.linalg.svd(log_sensitivity(value[0], slope[0]), compute_uv=False)
    return ExactSolution(
        dict(zip(equations.elements, (sign * np.exp(theta)).tolist(), strict=True)),
        bool(np.all(sign > 0)),
        bool(singular[-1] > 1e-9 * singular[0]),
        float(np.max(np.abs(ratio - 1))),
    )


def log_sensitivity(value: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Relative sensitivity of each coefficient to each element, (C, P), with the common factor removed."""
    elasticity = slope / value[:, None]
    return np.asarray(elasticity - elasticity.mean(axis=0))
