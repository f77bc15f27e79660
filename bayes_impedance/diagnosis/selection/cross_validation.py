r"""Cross-validation of an explanation: on people, and on frequencies of the same people, that were held out.

**People** are divided at random into folds. Population, shared parameters and mean coefficients are estimated without a
fold, and the evidence of the people in it is computed under that population, their own elements integrated out.

**Frequencies.** The band is divided into blocks. All parameters are estimated without a block, and

.. math:: \ln p(z_\text{block} \mid z_\text{rest}) = \ell_i(\text{all}) - \ell_i(\text{rest})

under that population is each person's predictive density of the block, summed over blocks. With the block, elements
begin where they are without it and where they were with all parameters free, and the better end counts: in a motor's
recordings a block was 22 nats less likely with a damper that had stayed where the band without the block had left it.

Both are differences between two models, person by person; the standard error of their sum is
:math:`\sqrt{N}` times the standard deviation of these differences.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.folds import FOLDS, person_folds
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, SCATTERS
from bayes_impedance.person.likelihood import Likelihood

BLOCKS = 8
"""Blocks of the band. By choice: a block of a three-decade sweep is then 0.4 decades, wider than a resonance."""

_ROUNDS = 40
"""Largest number of rounds of a refit without a fold or a block. By choice: it begins near its end, but one that is
left before it is at rest says that a block was foretold which was not."""

_known: WeakKeyDictionary[Refitter, WeakKeyDictionary[Refit, dict[int, np.ndarray]]] = WeakKeyDictionary()
"""Evidences of held-out people that are computed already, by the seed of the folds, as long as refitter and fit live:
several explanations are compared with one fit, and with each other."""


@dataclass(frozen=True)
class HeldOut:
    """Expected log predictive density gained, elpd, with standard errors.

    Attributes
    ----------
    people, people_se : float or None
        None where there are too few people for folds.
    blocks, blocks_se : float or None
        None if no frequencies were held out.
    described : str
        What was held out.
    """

    people: float | None
    people_se: float | None
    blocks: float | None
    blocks_se: float | None
    described: str


def held_out(refitter: Refitter, before: Refit, after: Refit, seed: int, blocks: bool = True) -> HeldOut:
    """Compare two fitted models on held-out data.

    Parameters
    ----------
    refitter : Refitter
        With all people.
    before, after : Refit
    seed : int
        Of the random division into folds.
    blocks : bool
        Whether frequencies are held out too; with too few people for folds they always are.
    """
    n = len(refitter.data)
    folds = n >= FEWEST_PEOPLE
    people = people_se = None
    if folds:
        difference = _people(refitter, after, seed) - _people(refitter, before, seed)
        people, people_se = float(difference.sum()), _se(difference)
    if folds and not blocks:
        return HeldOut(people, people_se, None, None, f"{FOLDS} subject folds")
    difference_blocks = block_gains(refitter, before, after).sum(axis=1)
    described = f"{FOLDS} subject folds, {BLOCKS} frequency blocks" if folds else f"{BLOCKS} frequency blocks"
    return HeldOut(people, people_se, float(difference_blocks.sum()), _se(difference_blocks), described)


def people_gain(refitter: Refitter, before: Refit, after: Refit, seed: int) -> tuple[float, float | None]:
    """Gain on held-out people alone, with its standard error."""
    difference = _people(refitter, after, seed) - _people(refitter, before, seed)
    return float(difference.sum()), _se(difference)


def clearly_gains(gain: float, standard_error: float | None) -> bool:
    """Whether a gain on held-out people exceeds :data:`~.compare.SCATTERS` of its standard errors."""
    return gain > SCATTERS * (standard_error or 0.0)


def block_gains(refitter: Refitter, before: Refit, after: Refit) -> np.ndarray:
    """Gain of log predictive density of each person and each block of frequencies that was held out, (N, BLOCKS)."""
    return np.asarray(_blocks(refitter, after) - _blocks(refitter, before))


def _se(difference: np.ndarray) -> float | None:
    if difference.size < 2:
        return None
    return float(np.sqrt(difference.size) * difference.std(ddof=1))


def _people(refitter: Refitter, fit: Refit, seed: int) -> np.ndarray:
    """Evidence of each person under a population that was estimated without that person's fold, shape (N,)."""
    known = _known.setdefault(refitter, WeakKeyDictionary()).setdefault(fit, {})
    if seed not in known:
        known[seed] = _people_of(refitter, fit, person_folds(len(refitter.data), seed))
    return known[seed]


def _people_of(refitter: Refitter, fit: Refit, fold: np.ndarray) -> np.ndarray:
    result = np.empty(fold.size)
    for k in np.unique(fold):
        inside, outside = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        rows = np.isin(refitter.owner, outside)
        trained = refitter.subset(outside).fit(fit.model, fit.u[rows], fit.population, _ROUNDS)
        result[inside] = _under(refitter.subset(inside), fit, trained, fit.u[~rows])
    return result


def _blocks(refitter: Refitter, fit: Refit) -> np.ndarray:
    """Log predictive density of each person's blocks, shape (N, BLOCKS)."""
    density = np.zeros((len(refitter.data), BLOCKS))
    low = np.log(min(d.omega[0] for d in refitter.data))
    high = np.log(max(d.omega[-1] for d in refitter.data))
    edges = np.linspace(low, high + 1e-9, BLOCKS + 1)
    for k in range(BLOCKS):
        kept = [_without(d, edges[k], edges[k + 1]) for d in refitter.data]
        rest = Refitter(kept, refitter.executor, refitter.one_person)
        trained = rest.fit(fit.model, fit.u, fit.population, _ROUNDS)
        with_it = (_under(refitter, fit, trained, u) for u in (trained.u, fit.u))
        density[:, k] = np.maximum(*with_it) - trained.evidence
    return density


def _under(refitter: Refitter, fit: Refit, trained: Refit, u: np.ndarray) -> np.ndarray:
    """Evidence of people under a population and shared parameters that were estimated from others, shape (N,)."""
    start = u.copy()
    start[:, fit.model.shared] = trained.shared_value
    population: Population = trained.population
    return refitter.fit(fit.model, start, population, _ROUNDS, hold_population=True, hold_additions=True).evidence


def _without(d: Likelihood, low: float, high: float) -> Likelihood:
    """A person's data without a block of frequencies; complete if fewer than three points would remain."""
    keep = ~((np.log(d.omega) >= low) & (np.log(d.omega) < high))
    if keep.sum() < 3:
        keep[:] = True
    return d.at(keep)
