r"""Profile posterior of the body's additions, from the evidence of all people instead of its quadratic expansion.

With the elements free (:mod:`bayes_impedance.diagnosis.fit.normal_equations`) a coefficient's likelihood is quadratic
near the fit only. The posterior of relaxing tissue at the skin, half of which another stiffness can imitate, is a
curved ridge: its damping may be 0.7 or 1.5 times the true one, while the curvature at one point of the ridge says 5 %.
And a time constant held equal in all people, because the recordings are too few to show a difference, gets too small a
standard error.

So the additions to the body are held at values :math:`t`, all other parameters are fitted, and the sum of all people's
evidence (:mod:`bayes_impedance.diagnosis.fit.fitter`) is taken as a function of :math:`t`. Coefficients enter by their
logarithms, shapes as they are. All may differ between people, and a coefficient may be correlated with its first shape:
a person with much damping may also relax slowly. A quadratic through

.. math:: t_0, \quad t_0 \pm 1.3\, s_k, \quad t_0 + s_k + s_l

(s: columns of a root of the covariance) gives the next centre and covariance, until neither moves. Dispersions between
people and those correlations are evaluated on a grid, one after the other, alternating with the centre until both have
converged: the mean depends on the dispersion that is assumed. Then the evidence is interpolated around the centre and
sampled (:mod:`bayes_impedance.diagnosis.fit.interpolated_density`); where the quadratic does not converge, this is done
at once. Each draw gets its own dispersions and correlations, and is shifted with them: the change of the gradient over
one step of the grid gives the shift of the centre, which is taken as proportional to a correlation and to the square of
a dispersion; grid values are weighted with the centre that belongs to them. Additions of the rig follow by regression.

Only for the body: its additions vary between people as the elements do, by assumption. The rig's are the same for all,
and a likelihood in which the elements are free does not depend on what distribution people have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior
from bayes_impedance.diagnosis.fit.extend import extended_start, with_pooling
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.interpolated_density import design, explored, quadratic_through
from bayes_impedance.diagnosis.fit.model import ELEMENT_SD, Addition, Model
from bayes_impedance.diagnosis.fit.refit import Refit

MINIMUM_PERSONS = 10
"""With fewer people a dispersion is hardly determined: from ten people its standard error is 24 %."""

MOST_PARAMETERS = 4
"""By choice: a quadratic in four parameters takes 15 refits, and the number grows with the square of theirs."""

_DISPERSIONS = np.array([0.003, 0.01, 0.03, 0.08, 0.15, 0.22, 0.3, 0.4, 0.55])
_CORRELATIONS = np.array([-0.9, -0.7, -0.45, -0.2, 0.0, 0.2, 0.45, 0.7, 0.9])
"""Grids on which dispersions (the upper one) and correlations are evaluated. By choice: coarse, because each value
costs a refit."""

_SAME_FACTOR, _SAME_CORRELATION = 1.2, 0.3
"""Largest change of a dispersion (factor) and of a correlation after which the centre is not fitted again; about one
step of the grids."""

_STARTS = (0.25, 0.08)
"""Dispersions of a coefficient and of a shape at which the search begins: typical differences between people."""

_ROUNDS, _STEPS = 30, 5
"""Rounds of each refit, which begins near its end, and steps towards the maximum before the ridge counts as curved. By
choice."""

_FEW_DRAWS = 500
"""Draws for centre and covariance of a curved ridge while the dispersions still change: a mean from 500 draws has an
error of 0.04 standard deviations."""

_SMALLEST_SD, _LARGEST_SD = 1e-4, 0.5
"""Limits of the standard deviations that are explored: below the first, differences between refits are convergence
error; above the second, refits diverge."""

_NEAR, _SETTLED_STRETCH = 0.25, 2.0
"""Step of the centre (standard deviations) and change of a variance (factor) below which the maximum
has been found. By choice."""

_STRETCH, _LONGEST = 9.0, 2.0
"""Largest change of a variance (factor), and of the centre (standard deviations), in one step. By choice."""

_TURNS, _REST = 6, 0.5
"""Largest number of alternations between centre and dispersions, and the step of the centre, in standard deviations,
below which they end. By choice."""

_FARTHEST = 3.0
"""Largest shift of a draw with its own dispersion, in standard deviations: the slope is valid near the centre
only."""


def has_surface(addition: Addition) -> bool:
    """Whether an addition is the body's, with one non-negative coefficient, its other parameters being shapes."""
    effect = addition.effect
    if effect.side != "body" or not effect.operation or effect.signed or effect.pooling == "some":
        return False
    return [c.link == "linear" for c in effect.coefficients] == [True] + [False] * (len(effect.coefficients) - 1)


def from_evidence(refitter: Refitter, fit: Refit, posterior: CoefficientPosterior, seed: int) -> CoefficientPosterior:
    """The posterior with the body's additions drawn from the evidence of all people.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    posterior : CoefficientPosterior
        Of that fit, from the quadratic expansion: where the search begins.
    seed : int

    Returns
    -------
    CoefficientPosterior
        `posterior` itself if there are too few people, no addition of the body, or too many of them.
    """
    surface = _Surface.of(refitter, fit)
    if surface is None:
        return posterior
    old = np.where(surface.linear, np.log(np.maximum(posterior.central, 1e-9)), posterior.central)[:, surface.columns]
    centre, root = surface.base_values(), _root(np.atleast_2d(np.cov(old.T)))
    surface, weights, _ = surface.with_covariances(centre)
    best = centre
    for turn in range(_TURNS):
        peak = surface.maximum(centre, root)
        bent = peak is None  # or unbounded
        if peak is None:
            draws = explored(surface.value, centre, root, seed, _FEW_DRAWS).draws
            peak = draws.mean(axis=0), _root(np.atleast_2d(np.cov(draws.T)))
        step, (best, root) = peak[0] - best, peak
        surface, weights, moved = surface.with_covariances(best)
        length = float(np.linalg.norm(np.linalg.solve(root, step)))
        if (not moved and length < _REST) or (bent and turn >= 1):
            break
        # Where dispersions follow the centre, both creep along a ridge in ever smaller steps: extrapolate the last one.
        centre = best + step * min(1.0, _LONGEST / max(length, 1e-12)) * (not bent)
    rng = np.random.default_rng(seed)
    n_draws, size = posterior.central.shape
    last = explored(surface.value, best, root, seed, n_draws)
    drawn = last.draws
    best, root = drawn.mean(axis=0), _root(np.atleast_2d(np.cov(drawn.T)))
    slopes = surface.follows(best, root)
    spreads = []
    for weighed, at_centre, slope in zip(surface.weighed, weights, slopes, strict=True):
        apart = weighed.abscissa(weighed.grid) - weighed.abscissa(weighed.now(surface.fit.model))
        shift = np.clip(np.outer(apart, slope), -_FARTHEST, _FARTHEST)  # in standard deviations
        weight = at_centre * np.exp(0.5 * np.sum(shift**2, axis=1))
        chosen = rng.choice(weighed.grid.size, n_draws, p=weight / weight.sum())
        drawn += shift[chosen] @ root.T
        if not weighed.correlates:
            spreads.append(weighed.grid[chosen])
    central, relative = posterior.central.copy(), posterior.relative_dispersion.copy()
    others = [k for k in range(size) if k not in surface.columns]
    if others:
        apart = central[:, others] - central[:, others].mean(axis=0)
        along = np.linalg.lstsq(old - old.mean(axis=0), apart, rcond=1e-6)[0]
        central[:, others] += (drawn - old) @ along
    shared = surface.shared_coefficients(fit.model)
    for k, (column, spread) in enumerate(zip(surface.columns, spreads, strict=True)):
        if surface.linear[column]:
            # For a shared coefficient report the median person's value.
            median = np.exp(drawn[:, k] - 0.5 * np.log1p(spread**2))
            central[:, column] = median if column in shared else np.exp(drawn[:, k])
        else:
            central[:, column] = drawn[:, k]
        if relative[:, column].any():
            relative[:, column] = spread
    return CoefficientPosterior(central, relative, np.atleast_2d(np.cov(central.T)), last.rests)


@dataclass(frozen=True)
class _Weighed:
    """A dispersion, or a correlation of coefficient and first shape, that is evaluated on a grid.

    Attributes
    ----------
    column : int
        Index, among the additions' parameters, of the parameter with this dispersion; for a correlation, of the
        coefficient.
    correlates : bool
        Whether it is a correlation.
    """

    column: int
    correlates: bool

    @property
    def grid(self) -> np.ndarray:
        """Values on the grid."""
        return _CORRELATIONS if self.correlates else _DISPERSIONS

    def now(self, model: Model) -> float:
        """The value in a model."""
        parameter = model.parameters[self.column]
        return model.additions[parameter.addition].correlation if self.correlates else parameter.dispersion

    def held(self, model: Model, value: float) -> Model:
        """The model with this value held."""
        addition = model.parameters[self.column].addition
        own = [c - model.n_elements for c in model.columns(addition)]
        if self.correlates:
            return with_pooling(model, addition, "free", [model.parameters[c].dispersion for c in own], value)
        spreads = [value if c == self.column else model.parameters[c].dispersion for c in own]
        return with_pooling(model, addition, "free", spreads)

    def log_prior(self, value: float) -> float:
        """Half-normal for a dispersion, flat for a correlation."""
        return 0.0 if self.correlates else -0.5 * value**2

    def abscissa(self, value: np.ndarray | float) -> np.ndarray:
        """Abscissa in which the centre's shift is linear: a correlation itself, or the square of a dispersion."""
        return np.asarray(value if self.correlates else np.square(value))

    def differs(self, value: float, other: float) -> bool:
        """Whether two values differ enough for the centre to be fitted again."""
        return (
            abs(value - other) > _SAME_CORRELATION
            if self.correlates
            else abs(np.log(value / other)) > np.log(_SAME_FACTOR)
        )


@dataclass(frozen=True)
class _Surface:
    """Evidence as a function of the body's additions.

    Attributes
    ----------
    refitter : Refitter
    fit : Refit
        Of the model in which all parameters of the body's additions differ between people.
    columns : list of int
        Of the body's parameters, among those of the additions.
    linear : ndarray of bool, shape (A,)
        Which of the additions' parameters are coefficients of the body, which enter by their logarithm.
    """

    refitter: Refitter
    fit: Refit
    columns: list[int]
    linear: np.ndarray

    @classmethod
    def of(cls, refitter: Refitter, fit: Refit) -> _Surface | None:
        """Of a fit; None without additions of the body, with too many parameters in them, or with too few people."""
        model, columns = fit.model, list[int]()
        for i, addition in enumerate(fit.model.additions):
            if has_surface(addition):
                shapes = len(addition.effect.coefficients) - 1
                model = with_pooling(model, i, "free", [_STARTS[0], *[_STARTS[1]] * shapes])
                columns += [c - model.n_elements for c in model.columns(i)]
        linear = np.zeros(len(model.parameters), dtype=bool)
        linear[columns] = [model.parameters[c].is_coefficient for c in columns]
        if not 0 < len(columns) <= MOST_PARAMETERS or len(refitter.data) < MINIMUM_PERSONS:
            return None
        if min((fit.u[:, model.n_elements + c].mean() for c in np.flatnonzero(linear)), default=1.0) <= 0:
            return None
        again = refitter.fit(model, *extended_start(fit, model), _ROUNDS, hold_additions=True)
        return cls(refitter, again, columns, linear)

    @property
    def _positions(self) -> list[int]:
        """Indices of the columns among the varying parameters."""
        model = self.fit.model
        varying = np.flatnonzero(~model.shared)
        return [int(np.searchsorted(varying, model.n_elements + c)) for c in self.columns]

    def base_values(self) -> np.ndarray:
        """Values of the fit (A,): logarithms of coefficients, shapes as they are."""
        mean = self.fit.population.mu[self._positions]
        return np.where(self.linear[self.columns], np.log(np.maximum(mean, 1e-9)), mean)

    def at(self, values: np.ndarray, fit: Refit | None = None) -> Refit:
        """Fit of all other parameters with the additions held at `values` (A,)."""
        fit = fit or self.fit
        linear, first = self.linear[self.columns], fit.model.n_elements
        mu, u = fit.population.mu.copy(), fit.u.copy()
        before = mu[self._positions]
        after = np.where(linear, np.exp(values), values)
        mu[self._positions] = after
        for column, is_linear, old, new in zip(self.columns, linear, before, after, strict=True):
            own = u[:, first + column]
            u[:, first + column] = own * (new / old) if is_linear else own + (new - old)
        population = replace(fit.population, mu=mu)
        return self.refitter.fit(fit.model, u, population, _ROUNDS, hold_additions=True)

    def value(self, values: np.ndarray) -> float:
        """Log posterior density up to a constant; the prior of a coefficient's logarithm is that of an element's."""
        prior = 0.0
        for column, value in zip(self.columns, values, strict=True):
            p = self.fit.model.parameters[column]
            centre, sd = (0.0, ELEMENT_SD) if self.linear[column] else (p.centre, p.prior_sd)
            prior -= 0.5 * ((value - centre) / sd) ** 2
        return float(self.at(values).evidence.sum()) + prior

    def maximum(self, centre: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        """Normal approximation of the posterior: mean and root of the covariance; None if it does not converge."""
        points, heights = list[np.ndarray](), list[float]()
        for _ in range(_STEPS):
            for offset in design(centre.size):
                points.append(centre + root @ offset)
                heights.append(self.value(points[-1]))
            x = np.linalg.solve(root, (np.array(points) - centre).T).T
            _, gradient, curvature = quadratic_through(x, np.array(heights))
            values, vectors = np.linalg.eigh(curvature)
            bent = np.clip(values, 1 / _STRETCH, _STRETCH)
            step = vectors @ ((vectors.T @ gradient) / bent)
            length = float(np.linalg.norm(step))
            centre = centre + root @ step * min(1.0, _LONGEST / max(length, 1e-12))
            turned = root @ (vectors / np.sqrt(bent))
            root = _root(turned @ turned.T)
            if length < _NEAR and values.min() > 1 / _SETTLED_STRETCH and values.max() < _SETTLED_STRETCH:
                return centre, root
        return None

    @property
    def weighed(self) -> list[_Weighed]:
        """Everything evaluated on a grid: the dispersions of all columns first, then correlations."""
        parameters = self.fit.model.parameters
        found = [_Weighed(c, False) for c in self.columns]
        for c in self.columns:
            if self.linear[c] and len(self.fit.model.columns(parameters[c].addition)) > 1:
                found.append(_Weighed(c, True))
        return found

    def with_covariances(self, centre: np.ndarray) -> tuple[_Surface, list[np.ndarray], bool]:
        """Surface with the most probable dispersions and correlations at a centre; their grid weights; if any moved."""
        fit, weights, moved = self.at(centre), list[np.ndarray](), False
        for weighed in self.weighed:
            heights, fits = [], []
            for value in weighed.grid:
                model = weighed.held(fit.model, float(value))
                fits.append(self.refitter.fit(model, fit.u, fit.population, _ROUNDS, hold_additions=True))
                heights.append(float(fits[-1].evidence.sum()) + weighed.log_prior(float(value)))
            weight = np.exp(np.array(heights) - max(heights)) * np.gradient(weighed.grid)
            weights.append(weight / weight.sum())
            best = int(np.argmax(weights[-1]))
            moved |= weighed.differs(float(weighed.grid[best]), weighed.now(fit.model))
            fit = fits[best]
        return replace(self, fit=fit), weights, moved

    def follows(self, centre: np.ndarray, root: np.ndarray) -> list[np.ndarray]:
        """Shift of the centre (A,), in standard deviations, per unit of the abscissa of each quantity on a grid."""
        slopes = []
        for weighed in self.weighed:
            grid = weighed.grid
            place = int(np.argmin(np.abs(grid - weighed.now(self.fit.model))))
            ends = grid[[max(place - 1, 0), min(place + 1, grid.size - 1)]]
            gradients = []
            for value in ends:
                model = weighed.held(self.fit.model, float(value))
                fit = self.refitter.fit(model, self.fit.u, self.fit.population, _ROUNDS, hold_additions=True)
                there = replace(self, fit=fit)
                heights = [[there.value(centre + sign * root[:, j]) for sign in (-1, 1)] for j in range(centre.size)]
                gradients.append(0.5 * (np.array(heights)[:, 1] - np.array(heights)[:, 0]))
            low, high = weighed.abscissa(ends)
            slopes.append((gradients[1] - gradients[0]) / (high - low))
        return slopes

    def shared_coefficients(self, model: Model) -> set[int]:
        """Columns of the coefficients that are shared in a model."""
        return {c for c in self.columns if self.linear[c] and model.parameters[c].shared}


def _root(covariance: np.ndarray) -> np.ndarray:
    """Lower Cholesky root of a covariance, its standard deviations limited to the range that can be explored."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    kept = np.clip(sd, _SMALLEST_SD, _LARGEST_SD) / sd
    covariance = covariance * np.outer(kept, kept)
    return np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)))
