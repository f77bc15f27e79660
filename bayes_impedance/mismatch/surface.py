r"""The posterior of what is missing in the body, from everybody's evidence and not from a quadratic expansion of it.

With the elements free (:mod:`bayes_impedance.mismatch.equations`) a coefficient's likelihood is quadratic near the fit
only. Tissue that relaxes at the skin, of which another stiffness imitates one half, lies on a bent ridge: its damping
may be 0.7 or 1.5 of what it is, and the curvature in one point of the ridge says 5 %. And people who are given the same
time constant, because the recordings are too few to show that they differ, determine it too well.

So the additions to the body are held at values :math:`t`, everything else is fitted, and the sum of everybody's
evidence (:mod:`bayes_impedance.mismatch.refit`) is looked at as a function of :math:`t`: coefficients by their
logarithms, shapes as they are, all of them free to differ between people. A quadratic through

.. math:: t_0, \quad t_0 \pm 1.3\, s_k, \quad t_0 + s_k + s_l

(s: columns of a root of the covariance) gives the next centre and covariance, until neither moves. Dispersions between
people are weighed on a grid, one after the other, in turn with the centre until both rest: people who may differ more
look like others in the mean. Then the evidence is interpolated around the centre and drawn from
(:mod:`bayes_impedance.mismatch.surrogate`), as it is at once where no quadratic comes to rest. Each draw is moved with
a dispersion of its own: where a dispersion changes by one step of the grid, the gradient tells by how much the centre
follows, which is taken to be proportional to the square of the dispersion; and a dispersion is weighed with the centre
that belongs to it. What the rig adds follows by regression.

Only for the body: its additions vary between people as the elements do, by assumption. The rig's are the same for all,
and a likelihood in which the elements are free does not depend on what distribution people have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.mismatch.coefficients import CoefficientPosterior
from bayes_impedance.mismatch.confirm import extended_start
from bayes_impedance.mismatch.finalists import with_pooling
from bayes_impedance.mismatch.model import ELEMENT_SD, Addition, Model
from bayes_impedance.mismatch.refit import Refit, Refitter
from bayes_impedance.mismatch.surrogate import design, explored, quadratic_through

FEWEST = 10
"""Fewer people say too little about what they differ by."""

MOST_PARAMETERS = 4
"""A quadratic in more of them takes too many refits."""

_DISPERSIONS = np.array([0.003, 0.01, 0.03, 0.08, 0.15, 0.22, 0.3, 0.4, 0.55])
_STARTS = (0.25, 0.08)  # of a coefficient and of a shape
_ROUNDS, _STEPS = 30, 5
_FEW_DRAWS = 500
_SMALLEST_SD, _LARGEST_SD = 1e-4, 0.5
_NEAR = 0.25  # of a standard deviation: the centre rests
_STRETCH = 9.0  # largest change of a variance in one step
_LONGEST = 2.0
_TURNS, _REST = 6, 0.5  # between centre and dispersions, and of a standard deviation
_FARTHEST = 3.0
_SETTLED_STRETCH = 2.0


def has_surface(addition: Addition) -> bool:
    """Whether an addition is the body's, with one coefficient that cannot be negative and shapes besides."""
    effect = addition.effect
    if effect.side != "body" or not effect.operation or effect.signed or effect.pooling == "some":
        return False
    return [c.link == "linear" for c in effect.coefficients] == [True] + [False] * (len(effect.coefficients) - 1)


def from_evidence(refitter: Refitter, fit: Refit, posterior: CoefficientPosterior, seed: int) -> CoefficientPosterior:
    """The posterior with the body's additions drawn from everybody's evidence.

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
        The same one where there are too few people, or nothing or too much of the body's.
    """
    surface = _Surface.of(refitter, fit)
    if surface is None:
        return posterior
    old = np.where(surface.linear, np.log(np.maximum(posterior.central, 1e-9)), posterior.central)[:, surface.columns]
    centre, root = surface.base_values(), _root(np.atleast_2d(np.cov(old.T)))
    surface, weights, _ = surface.with_dispersions(centre)
    best = centre
    for turn in range(_TURNS):
        peak = surface.maximum(centre, root)
        bent = peak is None  # or without an end
        if peak is None:
            draws = explored(surface.value, centre, root, seed, _FEW_DRAWS).draws
            peak = draws.mean(axis=0), _root(np.atleast_2d(np.cov(draws.T)))
        step, (best, root) = peak[0] - best, peak
        surface, weights, moved = surface.with_dispersions(best)
        length = float(np.linalg.norm(np.linalg.solve(root, step)))
        if (not moved and length < _REST) or (bent and turn >= 1):
            break
        # Where the dispersions follow the centre, both creep along a ridge in ever smaller steps of one direction.
        centre = best + step * min(1.0, _LONGEST / max(length, 1e-12)) * (not bent)
    rng = np.random.default_rng(seed)
    n_draws, size = posterior.central.shape
    last = explored(surface.value, best, root, seed, n_draws)
    drawn = last.draws
    best, root = drawn.mean(axis=0), _root(np.atleast_2d(np.cov(drawn.T)))
    slopes = surface.follows(best, root)
    spreads = []
    for k, column in enumerate(surface.columns):
        apart = _DISPERSIONS**2 - surface.fit.model.parameters[column].dispersion ** 2
        shift = np.clip(np.outer(apart, slopes[k]), -_FARTHEST, _FARTHEST)  # in standard deviations
        weight = weights[k] * np.exp(0.5 * np.sum(shift**2, axis=1))
        chosen = rng.choice(_DISPERSIONS.size, n_draws, p=weight / weight.sum())
        drawn += shift[chosen] @ root.T
        spreads.append(_DISPERSIONS[chosen])
    central, relative = posterior.central.copy(), posterior.relative_dispersion.copy()
    others = [k for k in range(size) if k not in surface.columns]
    if others:
        apart = central[:, others] - central[:, others].mean(axis=0)
        slope = np.linalg.lstsq(old - old.mean(axis=0), apart, rcond=1e-6)[0]
        central[:, others] += (drawn - old) @ slope
    shared = surface.shared_coefficients(fit.model)
    for k, (column, spread) in enumerate(zip(surface.columns, spreads, strict=True)):
        if surface.linear[column]:
            # A coefficient that is said to be the same for all is what it is for somebody in the middle.
            median = np.exp(drawn[:, k] - 0.5 * np.log1p(spread**2))
            central[:, column] = median if column in shared else np.exp(drawn[:, k])
        else:
            central[:, column] = drawn[:, k]
        if relative[:, column].any():
            relative[:, column] = spread
    return CoefficientPosterior(central, relative, np.atleast_2d(np.cov(central.T)), last.rests)


@dataclass(frozen=True)
class _Surface:
    """Evidence as a function of the body's additions.

    Attributes
    ----------
    refitter : Refitter
    fit : Refit
        Of the model in which all that is the body's differs between people.
    columns : list of int
        Of the body's parameters, among those of the additions.
    linear : ndarray of bool, shape (A,)
        Which of the additions' parameters are coefficients of the body: they have a logarithm.
    """

    refitter: Refitter
    fit: Refit
    columns: list[int]
    linear: np.ndarray

    @classmethod
    def of(cls, refitter: Refitter, fit: Refit) -> _Surface | None:
        """Of a fit; None if there is nothing or too much of the body's, or too few people."""
        model, columns = fit.model, list[int]()
        for i, addition in enumerate(fit.model.additions):
            if has_surface(addition):
                shapes = len(addition.effect.coefficients) - 1
                model = with_pooling(model, i, "free", [_STARTS[0], *[_STARTS[1]] * shapes])
                columns += [c - model.n_elements for c in model.columns(i)]
        linear = np.zeros(len(model.parameters), dtype=bool)
        linear[columns] = [model.parameters[c].is_coefficient for c in columns]
        if not 0 < len(columns) <= MOST_PARAMETERS or len(refitter.data) < FEWEST:
            return None
        if min((fit.u[:, model.n_elements + c].mean() for c in np.flatnonzero(linear)), default=1.0) <= 0:
            return None
        again = refitter.fit(model, *extended_start(fit, model), _ROUNDS, hold_additions=True)
        return cls(refitter, again, columns, linear)

    @property
    def _positions(self) -> list[int]:
        """Of the columns among the varying parameters."""
        model = self.fit.model
        varying = np.flatnonzero(~model.shared)
        return [int(np.searchsorted(varying, model.n_elements + c)) for c in self.columns]

    def base_values(self) -> np.ndarray:
        """Where the fit is."""
        mean = self.fit.population.mu[self._positions]
        return np.where(self.linear[self.columns], np.log(np.maximum(mean, 1e-9)), mean)

    def at(self, values: np.ndarray, fit: Refit | None = None) -> Refit:
        """Everything else fitted with the additions held at `values`."""
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
        """Centre and root of the covariance of a normal distribution in place of the posterior; None if not found."""
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

    def with_dispersions(self, centre: np.ndarray) -> tuple[_Surface, dict[int, np.ndarray], bool]:
        """With the dispersions most likely at a centre; their distributions over the grid; if one moved much."""
        fit, weights, moved = self.at(centre), dict[int, np.ndarray](), False
        for k, column in enumerate(self.columns):
            heights, fits = [], []
            for dispersion in _DISPERSIONS:
                model = _with_dispersion(fit.model, column, float(dispersion))
                fits.append(self.refitter.fit(model, fit.u, fit.population, _ROUNDS, hold_additions=True))
                heights.append(float(fits[-1].evidence.sum()) - 0.5 * dispersion**2)
            weight = np.exp(np.array(heights) - max(heights)) * np.gradient(_DISPERSIONS)
            weights[k] = weight / weight.sum()
            best = int(np.argmax(weights[k]))
            moved |= abs(np.log(_DISPERSIONS[best] / fit.model.parameters[column].dispersion)) > np.log(1.2)
            fit = fits[best]
        return replace(self, fit=fit), weights, moved

    def follows(self, centre: np.ndarray, root: np.ndarray) -> np.ndarray:
        """By how much the centre moves with the square of each dispersion, in standard deviations: (A, A)."""
        slopes = np.zeros((centre.size, centre.size))
        for k, column in enumerate(self.columns):
            now = self.fit.model.parameters[column].dispersion
            place = int(np.argmin(np.abs(_DISPERSIONS - now)))
            ends = _DISPERSIONS[[max(place - 1, 0), min(place + 1, _DISPERSIONS.size - 1)]]
            gradients = []
            for dispersion in ends:
                model = _with_dispersion(self.fit.model, column, float(dispersion))
                fit = self.refitter.fit(model, self.fit.u, self.fit.population, _ROUNDS, hold_additions=True)
                there = replace(self, fit=fit)
                heights = [[there.value(centre + sign * root[:, j]) for sign in (-1, 1)] for j in range(centre.size)]
                gradients.append(0.5 * (np.array(heights)[:, 1] - np.array(heights)[:, 0]))
            slopes[k] = (gradients[1] - gradients[0]) / (ends[1] ** 2 - ends[0] ** 2)
        return slopes

    def shared_coefficients(self, model: Model) -> set[int]:
        """Columns of coefficients that a model has as the same for everybody."""
        return {c for c in self.columns if self.linear[c] and model.parameters[c].shared}


def _with_dispersion(model: Model, column: int, dispersion: float) -> Model:
    """The model with another dispersion of one of the additions' parameters."""
    addition = model.parameters[column].addition
    own = [c - model.n_elements for c in model.columns(addition)]
    spreads = [dispersion if c == column else model.parameters[c].dispersion for c in own]
    return with_pooling(model, addition, "free", spreads)


def _root(covariance: np.ndarray) -> np.ndarray:
    """Lower root of a covariance whose standard deviations are kept to what can be explored."""
    sd = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    kept = np.clip(sd, _SMALLEST_SD, _LARGEST_SD) / sd
    covariance = covariance * np.outer(kept, kept)
    return np.linalg.cholesky(covariance + 1e-9 * np.diag(np.diag(covariance)))
