r"""Restricted maximum likelihood (REML) of a normal population from quadratic likelihoods of the persons.

The derivative of a person's log marginal likelihood (:mod:`bayes_impedance.diagnosis.heterogeneity.person_likelihoods`)
with respect to the population's mean is the *pull* :math:`u_i = (I + H_iT)^{-1} (b_i - H_i m_i)`. It is :math:`N(0,
W_i)` with the *weight* :math:`W_i = (T + H_i^{-1})^{-1}`, which exists for singular H too. In coordinates in which T is
the identity ("white") they are :math:`L^T u` and :math:`L^T W L = I - (I + L^THL)^{-1}`, free of cancellation, and
every test of the population is a function of them:

* **Means** :math:`m_i = X_i\beta` are generalised least squares, :math:`V = (\sum X^TWX)^{-1}`.
* **Covariance.** T maximises the *restricted* likelihood (beta integrated out), with
  :math:`\partial/\partial T = \tfrac12 G,\ G = \sum (uu^T - W + WXVX^TW)`, plus the weak LKJ(2) prior
  :math:`\ln|R|` of its correlations (:mod:`bayes_impedance.population.parameters` has the same), which weighs about as
  much as two persons without any correlation. Fisher scoring, :math:`I_{ab} = \tfrac12\sum\operatorname{tr}(W E_a W
  E_b)`, in coordinates in which every step is a covariance again (:math:`T \leftarrow L\,e^A L^T`), with a line search:
  the objective never decreases.
* **Few persons.** T is estimated, so the variance of a coefficient is larger than V, and it is compared with Student's
  t of 2 V^2 / var(V) degrees of freedom, with var(V) from the restricted information of T (Kenward and Roger,
  Biometrics 53, 983-997, 1997). That is the ordinary t test with N - K for K regressors if every recording
  determines every element, with fewer degrees of freedom if few persons determine the dispersion.

Each person's likelihood is expanded around an anchor, the mode under the first guess of the population: b and H can be
1e8, while the differences that matter are of order one.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods, data_sd
from bayes_impedance.population.em import DETERMINED_SD
from bayes_impedance.population.em_state import PRIOR_PERSONS

COEFFICIENT_SD = 10.0
"""Standard deviation of the normal prior of every coefficient around the centre. By choice: practically flat, but never
singular."""

_START_DISPERSION = 0.3
"""Standard deviation of the log elements at which the fit starts: a typical difference between people."""

_MAX_ITERATIONS, _MAX_HALVINGS = 60, 12
"""Limits of the iteration, which usually converges earlier, and of the line search, after which only rounding remains.
By choice."""

_LONGEST_STEP = 1.5
"""Largest change of the logarithm of a variance in one step, a factor of 4.5. By choice."""

_CONVERGED = 1e-5
"""Expected remaining gain of log likelihood at which the fit ends. By choice."""

_DAMPING = 1e-4
"""Damping added to the information. By choice: small, because with more, variances that go to zero take many steps."""


class Covariance(Protocol):
    """A covariance T with coordinates phi in which a step of any size gives a valid covariance."""

    @property
    def matrix(self) -> np.ndarray:
        """T, shape (D, D)."""

    def directions(self, factor: np.ndarray) -> np.ndarray:
        """L^-1 (dT/dphi_a) L^-T for the Cholesky factor L of T, shape (A, D, D)."""

    def moved(self, step: np.ndarray) -> Covariance:
        """T after a step (A,) of phi."""

    def penalty(self, factor: np.ndarray) -> tuple[float, np.ndarray]:
        """Log prior density, and twice its derivative with respect to T as L^T (.) L, shape (D, D)."""

    def curvature(self, factor: np.ndarray) -> np.ndarray:
        """Minus the second derivative of the log prior density in the coordinates, shape (A, A)."""


@dataclass(frozen=True)
class FullCovariance:
    """Any covariance, with the prior LKJ(2) for its correlations.

    Attributes
    ----------
    matrix : ndarray, shape (D, D)
    """

    matrix: np.ndarray

    def directions(self, factor: np.ndarray) -> np.ndarray:
        """A basis of the symmetric matrices, orthonormal, shape (D (D + 1) / 2, D, D)."""
        d = factor.shape[0]
        rows, columns = np.tril_indices(d)
        basis = np.zeros((rows.size, d, d))
        basis[np.arange(rows.size), rows, columns] = np.where(rows == columns, 1.0, np.sqrt(0.5))
        return np.asarray(np.maximum(basis, np.swapaxes(basis, 1, 2)))

    def moved(self, step: np.ndarray) -> FullCovariance:
        """L exp(sum of step times directions) L^T."""
        factor = np.linalg.cholesky(self.matrix)
        values, vectors = np.linalg.eigh(np.tensordot(step, self.directions(factor), 1))
        root = factor @ (vectors * np.exp(values / 2))
        return FullCovariance(root @ root.T)

    def penalty(self, factor: np.ndarray) -> tuple[float, np.ndarray]:
        """The logarithm of the determinant of the correlation matrix."""
        variance = np.sum(factor**2, axis=1)
        value = 2 * np.sum(np.log(np.diag(factor))) - np.sum(np.log(variance))
        slope = np.eye(variance.size) - factor.T @ (factor / variance[:, None])
        return 0.5 * PRIOR_PERSONS * float(value), PRIOR_PERSONS * slope

    def curvature(self, factor: np.ndarray) -> np.ndarray:
        """Curvature of that logarithm at a zero step."""
        rows = factor / np.linalg.norm(factor, axis=1, keepdims=True)
        turned = rows @ self.directions(factor)  # (A, D, D)
        along = np.einsum("apq,pq->ap", turned, rows)
        return np.asarray(0.5 * PRIOR_PERSONS * (np.tensordot(turned, turned, ([1, 2], [1, 2])) - along @ along.T))


@dataclass(frozen=True)
class AdditiveCovariance:
    """fixed + sum of variances times parts; the coordinates are relative changes of the variances.

    Attributes
    ----------
    fixed : ndarray, shape (D, D)
    parts : ndarray, shape (A, D, D)
    variances : ndarray, shape (A,)
    """

    fixed: np.ndarray
    parts: np.ndarray
    variances: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """T, shape (D, D)."""
        return np.asarray(self.fixed + np.tensordot(self.variances, self.parts, 1))

    def directions(self, factor: np.ndarray) -> np.ndarray:
        """Whitened parts times variances, shape (A, D, D)."""
        left = np.linalg.solve(factor, self.variances[:, None, None] * self.parts)
        return np.asarray(np.linalg.solve(factor, np.swapaxes(left, 1, 2)))

    def moved(self, step: np.ndarray) -> AdditiveCovariance:
        """Variances times 1 + step: variances of which only a sum is determined stay on its straight ridge."""
        stretched = self.variances * np.maximum(1 + step, np.exp(-_LONGEST_STEP))
        return AdditiveCovariance(self.fixed, self.parts, np.maximum(stretched, 1e-12))

    def penalty(self, factor: np.ndarray) -> tuple[float, np.ndarray]:
        """No penalty."""
        return 0.0, np.zeros_like(factor)

    def curvature(self, factor: np.ndarray) -> np.ndarray:  # noqa: ARG002
        """Zero."""
        return np.zeros((self.variances.size, self.variances.size))


def diagonal_covariance(variances: np.ndarray) -> AdditiveCovariance:
    """Elements that vary independently, with variances (P,)."""
    p = variances.size
    parts = np.eye(p)[:, :, None] * np.eye(p)[:, None, :]
    return AdditiveCovariance(np.zeros((p, p)), parts, variances)


@dataclass(frozen=True, kw_only=True)
class Fit:
    """The population at its restricted maximum, and the white pulls and weights on which all tests are based.

    Attributes
    ----------
    problem : Problem
    structure : Covariance
    factor : ndarray, shape (D, D)
        Cholesky factor L of T.
    coefficients : ndarray, shape (K,)
    variance : ndarray, shape (K, K)
        V, of the coefficients.
    pull : ndarray, shape (N, D)
        L^T u.
    weight : ndarray, shape (N, D, D)
        L^T W L.
    white_design : ndarray, shape (N, D, K)
        L^-1 X.
    objective : float
        Restricted log likelihood and the log prior, up to a constant of the problem.
    """

    problem: Problem
    structure: Covariance
    factor: np.ndarray
    coefficients: np.ndarray
    variance: np.ndarray
    pull: np.ndarray
    weight: np.ndarray
    white_design: np.ndarray
    objective: float

    @property
    def covariance(self) -> np.ndarray:
        """T, shape (D, D)."""
        return self.structure.matrix

    @property
    def determined(self) -> np.ndarray:
        """Which of the D elements the persons together determine, with the others free within the population, (D,)."""
        return data_sd(self.problem.likelihoods, self.covariance) < DETERMINED_SD

    @property
    def means(self) -> np.ndarray:
        """Population mean at each person, shape (N, D)."""
        return np.asarray(self.problem.design @ self.coefficients)

    def scoring(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivative of the objective in the coordinates of T, (A,), and the data's expected information, (A, A)."""
        e = self.structure.directions(self.factor)
        g = self.pull.T @ self.pull - self.weight.sum(axis=0) + self.mean_correction()
        g = g + self.structure.penalty(self.factor)[1]
        return 0.5 * np.tensordot(e, g, ([1, 2], [0, 1])), 0.5 * _traces(self.weight, e)

    def mean_correction(self) -> np.ndarray:
        """Correction of the pulls' squares for the estimated means, sum of L^T W X V X^T W L, shape (D, D)."""
        y = self.weight @ self.white_design
        return np.asarray(np.tensordot(y @ self.variance, y, ([0, 2], [0, 2])))

    def small_sample(self) -> tuple[np.ndarray, np.ndarray]:
        """Variance of each coefficient, allowing for the estimation of T, and its degrees of freedom, both (K,)."""
        e = self.structure.directions(self.factor)
        y = self.weight @ self.white_design  # W X
        ey = e[:, None] @ y  # (A, N, D, K)
        wey = self.weight @ ey
        f = np.tensordot(ey, y, ([1, 2], [0, 1]))  # (A, K, K)
        fv = f @ self.variance
        # Restricted information: tr(P E_a P E_b) / 2 with P = W - W X V X^T W.
        first = np.tensordot(ey, wey @ self.variance, ([1, 2, 3], [1, 2, 3]))
        information = 0.5 * (_traces(self.weight, e) - 2 * first + np.tensordot(fv, fv, ([1, 2], [2, 1])))
        # A variance that the data do not determine (it is zero relative to their noise) has no influence either.
        root = np.linalg.cholesky(0.5 * (information + information.T) + 1e-9 * np.eye(e.shape[0]))
        # dV/dphi_a = V f_a V, divided by the root of the information.
        slope = np.linalg.solve(root, np.einsum("kl,alm,mk->ak", self.variance, f, self.variance))
        half = np.linalg.solve(root, ey.reshape(e.shape[0], -1)).reshape(ey.shape)
        q = np.tensordot(half, self.weight @ half, ([0, 1, 2], [0, 1, 2]))
        f = np.linalg.solve(root, f.reshape(e.shape[0], -1)).reshape(f.shape)
        more = q - np.tensordot(f @ self.variance, f, ([0, 2], [0, 1]))
        variance = np.diag(self.variance)
        larger = variance + 2 * np.maximum(np.diag(self.variance @ more @ self.variance), 0)
        n, d, k = self.white_design.shape
        freedom = 2 * variance**2 / np.maximum(np.sum(slope**2, axis=0), 1e-300)
        return larger, np.clip(freedom, 1.0, max(n - k / d, 1.0))


@dataclass(frozen=True)
class Problem:
    """Likelihoods and design, each person's likelihood expanded around an anchor.

    Attributes
    ----------
    likelihoods : PersonLikelihoods
        Likelihoods of theta less some centre, so that coefficients are of order one.
    design : ndarray, shape (N, D, K)
        The mean of person i is design[i] @ coefficients.
    anchor : ndarray, shape (N, D)
    linear : ndarray, shape (N, D)
        Gradient of the log likelihood at the anchor.
    """

    likelihoods: PersonLikelihoods
    design: np.ndarray
    anchor: np.ndarray
    linear: np.ndarray = field(repr=False)

    @classmethod
    def of(cls, likelihoods: PersonLikelihoods, design: np.ndarray, covariance: np.ndarray) -> Problem:
        """Problem with the modes of each person under N(0, covariance) as anchors."""
        precision = np.linalg.inv(covariance)
        anchor = np.linalg.solve(likelihoods.information + precision, likelihoods.linear[..., None])[..., 0]
        return cls(likelihoods, design, anchor, likelihoods.around(anchor).linear)

    def fit(self, structure: Covariance) -> Fit:
        """The quantities of a :class:`Fit` at a given covariance."""
        factor = np.linalg.cholesky(structure.matrix)
        inner = np.eye(factor.shape[0]) + factor.T @ self.likelihoods.information @ factor
        shrink = np.linalg.inv(inner)
        shrink = 0.5 * (shrink + np.swapaxes(shrink, 1, 2))
        weight = np.eye(factor.shape[0]) - shrink
        white = self.linear @ factor
        at_anchor = np.einsum("nde,ne->nd", shrink, white)
        anchor = np.linalg.solve(factor, self.anchor.T).T
        way = np.einsum("nde,ne->nd", weight, anchor)
        x = np.linalg.solve(factor, self.design)
        y = weight @ x
        normal = np.tensordot(x, y, ([0, 1], [0, 1])) + np.eye(x.shape[2]) / COEFFICIENT_SD**2
        right = np.tensordot(at_anchor + way, x, ([0, 1], [0, 1]))
        variance = np.linalg.inv(normal)
        coefficients = variance @ right
        objective = (
            0.5 * float(np.sum((white - 2 * anchor) * at_anchor - anchor * way) - np.sum(np.linalg.slogdet(inner)[1]))
            + 0.5 * float(right @ coefficients - np.linalg.slogdet(normal)[1])
            + structure.penalty(factor)[0]
        )
        pull = at_anchor + way - y @ coefficients
        return Fit(
            problem=self,
            structure=structure,
            factor=factor,
            coefficients=coefficients,
            variance=variance,
            pull=pull,
            weight=weight,
            white_design=x,
            objective=objective,
        )


def fit_normal_population(likelihoods: PersonLikelihoods, design: np.ndarray, start: Covariance) -> Fit:
    """Maximise the restricted likelihood.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
        Of theta less some centre, so that coefficients are of order one.
    design : ndarray, shape (N, D, K)
        The mean of person i is design[i] @ coefficients.
    start : Covariance
        Start value; its class defines the structure of the covariance.

    Returns
    -------
    Fit
    """
    problem = Problem.of(likelihoods, design, start.matrix)
    fit = problem.fit(start)
    for _ in range(_MAX_ITERATIONS):
        gradient, information = fit.scoring()
        information = information + fit.structure.curvature(fit.factor) + _DAMPING * np.eye(gradient.size)
        step = np.linalg.solve(information, gradient)
        if gradient @ step < _CONVERGED:
            break
        clipped = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
        if gradient @ clipped <= 0:  # not upwards any more
            clipped = step * (_LONGEST_STEP / float(np.abs(step).max()))
        step = clipped
        for _ in range(_MAX_HALVINGS):
            with suppress(np.linalg.LinAlgError):  # singular by rounding, where elements vary nearly together
                trial = problem.fit(fit.structure.moved(step))
                if trial.objective > fit.objective:
                    break
            step = step / 2
        else:
            break
        gain, fit = trial.objective - fit.objective, trial
        if gain < _CONVERGED:
            break
    return fit


def centred_fit(
    likelihoods: PersonLikelihoods, start: np.ndarray | None = None, diagonal: bool = False
) -> tuple[np.ndarray, Fit]:
    """Fit one mean and a covariance.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
    start : ndarray, shape (P, P), optional
        Start value of the covariance.
    diagonal : bool
        Elements vary independently.

    Returns
    -------
    centre : ndarray, shape (P,)
        The mean.
    fit : Fit
        Of theta less the centre: its coefficients are zero but for rounding.
    """
    p = len(likelihoods.elements)
    covariance = np.eye(p) * _START_DISPERSION**2 if start is None else start
    structure: Covariance = diagonal_covariance(np.diag(covariance)) if diagonal else FullCovariance(covariance)
    centre = np.zeros(p)
    # The prior of the mean is around the centre, and rounding is least there: recentre first, and last.
    for rounds in range(4):
        around = likelihoods.around(centre)
        design = np.broadcast_to(np.eye(p), (len(around), p, p))
        if rounds == 2:
            structure = fit_normal_population(around, design, structure).structure
        fit = Problem.of(around, design, covariance).fit(structure)
        centre = centre + fit.coefficients
    return centre - fit.coefficients, fit


def _traces(weight: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Sum over persons of tr(W E_a W E_b), shape (A, A)."""
    product = weight[:, None] @ directions  # (N, A, D, D)
    n, a, d, _ = product.shape
    left = np.moveaxis(product, 1, 0).reshape(a, n * d * d)
    right = np.moveaxis(np.swapaxes(product, 2, 3), 1, 0).reshape(a, n * d * d)
    return np.asarray(left @ right.T)
