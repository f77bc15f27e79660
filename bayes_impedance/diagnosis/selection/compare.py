r"""The one criterion: whether explanation A of the recordings is better than explanation B.

The log evidence of a fitted model is the sum over all people (:mod:`bayes_impedance.diagnosis.fit.fitter`), less half
the logarithm of the number of recordings for each of the k population parameters (means and shared parameters), with
the dispersions of the additions integrated over their prior:

.. math:: \ln E = \sum_i \ell_i(\tau_0) - \tfrac{k}{2}\ln N_\text{rec}
          + \ln\int p(\tau)\,\frac{L(\tau)}{L(\tau_0)}\,d\tau .

:math:`\ell_i` is computed with the dispersions held at :math:`\tau_0`; L is the likelihood of the dispersions with each
person's coefficients integrated out (:mod:`bayes_impedance.diagnosis.fit.normal_equations`).

**Shared or varying** coefficients are compared under one prior. The dispersion between people is

.. math:: \ln\tau \sim N(\ln 0.35, (\ln 2)^2)

relative to a coefficient's mean, or in the logarithm of a shape; for effects of the rig :math:`\tau = 0`. A coefficient
that can be absent in some people may instead be zero in them (:mod:`bayes_impedance.diagnosis.fit.spike_slab`): the
better of the two counts. An explanation that has been measured counts by a refit in which it is zero in them, if that
is more (:mod:`bayes_impedance.diagnosis.fit.of_members`).

A is better than B if the difference exceeds :data:`LEAST_GAIN` and :data:`SCATTERS` times its standard error over
people: a gain in one person only is a local optimum of that person and not physics. People whose recordings are more
precise, or who have more of an effect, gain more, and a few of them can be most of the sum and of its standard error: a
resonator was 1823 ahead of a film of fluid, with an error of 920 over 70 people. So the same sum with everybody's
difference clipped may exceed its standard errors instead, if it exceeds :data:`LEAST_GAIN` as well: a hundredth in
everybody is no agreement about the 33 of one person. Clipped at :data:`CLIPPED` times the median of its absolute value
it shows what most people agree about; where few have an effect most people agree about nothing, and it is clipped at
the fourth largest. Four people who gain the same, and nobody else, are the fewest that exceed two standard errors; four
of whom some gain far more are no less. A second layer in ten of 52 people, of whom the first gained 826, three 303 to
66 and four 62 to 20, was taken for one person's.

**Which of two** explanations it is, once one of them is certain, is decided by less. If the better one is right, and
the curves of the two are :math:`s_i` apart in person i, in units of the noise, the difference of log likelihood is
normal there, with mean :math:`s_i^2/2` and variance :math:`s_i^2`, and the sum D over people has the variance 2 D. What
people scatter by beyond that comes from what neither explanation describes, or from people in other valleys. As in
composite likelihoods (Varin, Reid and Firth 2011) the sum is divided by the ratio of its variance over people to that,

.. math:: \kappa = \max\left(1,\ \frac{\mathrm{se}^2}{2 D}\right),

before it is compared with :data:`LEAST_GAIN`, which is D > :math:`\sqrt{3/2}` standard errors. In 149
visible cases of ``analyses/other_worlds`` with one effect (seeds 1 to 8) the truth was at most 5 behind the first name
of an undecided entry (once 20, with a person in another valley), but names 8 to 25 behind, with 0.8 to 1.9 standard
errors, made entries of five and six. Of 27 such cases of a fresh seed the rule excluded the truth in none.

Both fits must have converged; the caller ensures it (:mod:`bayes_impedance.diagnosis.selection.finalists`). Where
physics is still missing in both, the difference is first divided by the number of points that count as one
(:mod:`bayes_impedance.diagnosis.selection.misfit`).
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from scipy.special import logsumexp

from bayes_impedance.diagnosis.fit.additions_step import central_values
from bayes_impedance.diagnosis.fit.extend import with_pooling
from bayes_impedance.diagnosis.fit.model import TYPICAL_DISPERSION, Model
from bayes_impedance.diagnosis.fit.normal_equations import log_densities, quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import members

LEAST_GAIN = 3.0
"""Difference of log evidence that decides: odds of 20 to 1."""

SCATTERS = 2.0
"""Standard errors over people that the difference must exceed: 2.3 % by chance."""

CLIPPED = 3.0
"""Largest difference that a person counts with in the second sum, in medians of the absolute differences. By choice:
normal differences lie within 4.4 of them, 96 % within 3."""

_FEWEST_EQUAL = int(SCATTERS**2)
"""People of equal gain, with none in the others, whose sum exceeds its standard errors: that of k in N people is
sqrt(k / (1 - k/N)) of them."""

FEWEST_TO_VARY = 3
"""With fewer people a dispersion cannot be estimated, and all coefficients are shared."""

FEWEST_PEOPLE = 10
"""With fewer people neither a standard error over people nor membership (who has an effect) can be estimated, and
five folds would hold less than two people each."""

_SPREAD_OF_DISPERSIONS = np.log(2.0)
"""Prior standard deviation of a log dispersion: dispersions are known within a factor of two. By choice."""

_GRID = np.linspace(-4.0, 4.0, 65)
"""Grid of a log dispersion, in standard deviations of its prior. Steps of 9 % resolve the standard error of a
dispersion of 100 people, about 7 %; beyond four standard deviations lies 6e-5 of the prior."""

_SWEEPS = 3
"""Sweeps over the dispersions, each integrated with the others at their maxima. In 248 integrals of 46 concealed
populations the third sweep changed 2 % by more than 0.1 (at most by 1.2), a fourth none by more than 0.06."""


_known: WeakKeyDictionary[Refit, float] = WeakKeyDictionary()
"""Log evidences already computed, kept as long as their fits: one fit is compared with many."""


@dataclass(frozen=True)
class Comparison:
    """How much better one explanation is than another.

    Attributes
    ----------
    difference : float
        Of log evidence (natural logarithm).
    standard_error : float
        Over people; 0 if there are too few.
    dependence : float
        Number of points that count as one, because structure remains in the residuals.
    typical : float
        Sum of the clipped differences over its standard error (:func:`typical_gain`).
    """

    difference: float
    standard_error: float
    dependence: float = 1.0
    typical: float = 0.0

    @property
    def decided(self) -> bool:
        """Whether the first is better, by both limits."""
        enough = self.difference / self.dependence > LEAST_GAIN
        return bool(enough and (self.difference > SCATTERS * self.standard_error or self.typical > SCATTERS))

    @property
    def separated(self) -> bool:
        """Whether the second is excluded if one of the two is right."""
        if self.decided or self.dependence > 1.0:
            return self.decided
        ratio = 0.5 * self.standard_error**2 / self.difference if self.difference > 0 else np.inf
        return bool(self.difference / max(1.0, ratio) > LEAST_GAIN)


def compare(one: Refit, other: Refit, dependence: float = 1.0) -> Comparison:
    """Compare two explanations of the same recordings.

    Parameters
    ----------
    one, other : Refit
        Of the same people.
    dependence : float
        Number of points that count as one.
    """
    own = one.evidence - other.evidence
    n = own.size
    difference = log_evidence(one) - log_evidence(other)
    if n < FEWEST_PEOPLE:
        return Comparison(difference, 0.0, dependence)
    return Comparison(difference, _error_of_sum(own), dependence, typical_gain(own))


def _error_of_sum(own: np.ndarray) -> float:
    return float(np.sqrt(own.size) * own.std(ddof=1))


def typical_gain(own: np.ndarray, of_most: bool = False) -> float:
    """Sum of the clipped differences, in its standard errors; at most zero if it does not exceed the least gain.

    Clipped so that it shows what most people agree about, or what four do.
    """
    size = np.sort(np.abs(own))
    limit = CLIPPED * float(np.median(size))
    if not of_most:
        limit = max(limit, float(size[-min(_FEWEST_EQUAL, size.size)]))
    clipped = np.clip(own, -limit, limit)
    total, error = float(clipped.sum()), _error_of_sum(clipped)
    if not error > 0 or 0 < total <= LEAST_GAIN:
        return 0.0
    return total / error


def log_evidence(fit: Refit) -> float:
    """Log evidence of a fitted model, the additions' dispersions integrated out, as in the module's docstring."""
    if fit not in _known:
        model = fit.model
        total = float(np.sum(fit.evidence)) - 0.5 * len(model.parameters) * float(np.log(len(fit.u)))
        _known[fit] = total + sum(_of_distribution(fit, i) for i in range(len(model.additions)))
    return _known[fit]


def differs(fit: Refit, addition: int) -> bool:
    """Whether an addition may differ between people: those of the body always may."""
    item = fit.model.additions[addition]
    if len(fit.data) < FEWEST_TO_VARY:
        return False
    return item.pooling != "shared" or item.effect.side == "body"


def _of_distribution(fit: Refit, addition: int) -> float:
    """Gain of log evidence from integrating over an addition's distribution between people."""
    if not differs(fit, addition):
        return 0.0
    spread = _dispersions_integrated(fit, addition)
    item = fit.model.additions[addition]
    if addition == fit.mixed:
        return spread - 0.5 * float(np.log(len(fit.u)))
    if item.pooling == "shared" or not item.effect.operation or len(fit.data) < FEWEST_PEOPLE:
        return spread
    who = members(fit, addition)
    absent_in_some = who.gain - 0.5 * float(np.log(len(fit.u)))  # penalty for the fraction of people who have it
    return spread + max(absent_in_some, 0.0) * who.only_some


def _dispersions_integrated(fit: Refit, addition: int) -> float:
    """Logarithm of the integral of L(tau) / L(tau_0) over the prior of an addition's dispersions.

    The shapes' central values are held at the fit's. Where a shape trades with a coefficient, the expansion would
    follow the ridge with the coefficient's dispersion, to where it does not hold: a relaxation with its corner far
    below the band had 23 units for a coefficient of nearly zero and another time constant, and led the spring that was
    there by as much.
    """
    pooling = fit.model.additions[addition].pooling
    model = with_pooling(fit.model, addition, "varying") if pooling == "shared" else fit.model
    h, d, _ = quadratic(model, fit.data, fit.u, fit.equations, fit.population.covariance)
    unit = _units(fit, model)
    columns = [c - model.n_elements for c in model.columns(addition)]
    columns = [c for c in columns if not model.parameters[c].shared]
    held = unit * [0.0 if p.shared else p.dispersion for p in model.parameters]
    if pooling == "shared":
        held[columns] = 0.0

    here = central_values(fit)
    start = float(log_densities(model, h, d, held[None], here)[0])
    prior = -0.5 * _GRID**2 - logsumexp(-0.5 * _GRID**2)
    nodes = TYPICAL_DISPERSION * np.exp(_SPREAD_OF_DISPERSIONS * _GRID)
    tau, total = held.copy(), 0.0
    tau[columns] = TYPICAL_DISPERSION * unit[columns]
    for _ in range(_SWEEPS if len(columns) > 1 else 1):
        total = 0.0
        for c in columns:
            grid = np.tile(tau, (nodes.size, 1))
            grid[:, c] = nodes * unit[c]
            values = log_densities(model, h, d, grid, here)
            best = int(np.argmax(values + prior))
            tau[c] = nodes[best] * unit[c]
            total += float(logsumexp(values + prior)) - float(values[best])
    return total + float(log_densities(model, h, d, tau[None], here)[0]) - start


def _units(fit: Refit, model: Model) -> np.ndarray:
    """Unit of each dispersion, shape (A,): a coefficient's mean; 1 for shapes and elements, which are logarithms."""
    size = np.abs(fit.u[:, model.n_elements :].mean(axis=0))
    pairs = zip(size, model.parameters, strict=True)
    return np.array([max(s, 1e-12) if p.is_coefficient else 1.0 for s, p in pairs])
