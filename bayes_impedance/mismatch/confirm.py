r"""From candidates to an explanation: full refits, forward selection, a backward pass.

The best candidates of the screening are refitted with the whole population, each as a shared and as a varying
coefficient, and the one with the largest evidence is kept,

.. math:: E = \sum_i \ell_i - \tfrac{k}{2}\ln N_\text{rec},

with :math:`\ell_i` everybody's evidence (:mod:`bayes_impedance.mismatch.refit`), k the number of population parameters
that were added and :math:`N_\text{rec}` the number of recordings. Then everything is looked at again with it in place,
until no candidate is significant after correction for all that were tried, and what the last additions have made
superfluous is taken out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.mismatch.effects import Effect, registered
from bayes_impedance.mismatch.equations import Population
from bayes_impedance.mismatch.members import members
from bayes_impedance.mismatch.model import Addition, Model, build
from bayes_impedance.mismatch.refit import Refit, Refitter
from bayes_impedance.mismatch.screen import Candidate, Screening
from bayes_impedance.network import parse

ALPHA = 0.01
"""Family-wise error of one screening."""

SHORTLIST = 8
LEAST_GAIN = 3.0
"""Smallest gain of evidence, in natural logarithms, for which something is kept."""

_LEAST_SHARE = 0.4
_PLACES_EACH, _BY_SPREAD = 2, 2
_CLEARLY_VARIES = -10.0  # logarithm of a p-value
_SURE = 12.0  # chi-square of one person's own best shape
_FIRST_ROUNDS, _MORE_ROUNDS = 8, 22
_FAR_BEHIND = 40.0


@dataclass(frozen=True)
class Trial:
    """A refit of one candidate.

    Attributes
    ----------
    candidate : Candidate
    pooling : str
    fit : Refit
    gain : float
        Of evidence over the model without it, less the price of its parameters.
    physical : bool
        Whether the fitted coefficient has a sign that the effect can have.
    """

    candidate: Candidate
    pooling: str
    fit: Refit
    gain: float
    physical: bool

    @property
    def effect(self) -> Effect:
        """The candidate's effect."""
        return self.candidate.effect


def best_shapes(screening: Screening, physical_only: bool = True, by_spread: bool = False) -> list[int]:
    """For every effect and place the index of the best shape, best first.

    Parameters
    ----------
    screening : Screening
    physical_only : bool
        Only coefficients with a sign that their effect can have.
    by_spread : bool
        Rank effects of the body by how much their coefficients differ between people, in place of their common score.
    """
    strength = np.abs(np.nan_to_num(screening.z))
    if by_spread:
        body = np.array([c.effect.side == "body" for c in screening.candidates], dtype=bool)
        strength = np.where(body, -screening.log_p_spread, 0.0)
    if physical_only:
        strength = np.where(screening.physical, strength, 0.0)
    best: dict[tuple[str, str, str], int] = {}
    for k in np.argsort(-strength, kind="stable"):
        c = screening.candidates[k]
        if strength[k] > 0:
            best.setdefault((c.effect.id, c.effect.form, c.place), int(k))
    return list(best.values())


def shortlist(screening: Screening, n: int = SHORTLIST) -> list[int]:
    """Candidates worth a refit.

    The best that explain much of what the best one explains, each effect at two places at most, and the two whose
    coefficients differ most between people: a resonance that lies elsewhere in everybody has no common score.
    """
    order = best_shapes(screening)
    strength = np.abs(screening.z)
    chosen: list[int] = []
    places: dict[Effect, int] = {}
    for k in order:
        effect = screening.candidates[k].effect
        if strength[k] < _LEAST_SHARE * strength[order[0]] or len(chosen) == n:
            break
        if places.get(effect, 0) < _PLACES_EACH:
            places[effect] = places.get(effect, 0) + 1
            chosen.append(k)
    for k in best_shapes(screening, by_spread=True):
        if len(chosen) >= n + _BY_SPREAD or screening.log_p_spread[k] > _CLEARLY_VARIES:
            break
        if screening.candidates[k].effect not in places:
            places[screening.candidates[k].effect] = 1
            chosen.append(k)
    return chosen


def try_candidate(
    refitter: Refitter,
    fit: Refit,
    candidate: Candidate,
    size: float,
    poolings: Sequence[str],
    rounds: int = 30,
    begin: Refit | None = None,
) -> list[Trial]:
    """Refit the model with one candidate added.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Without it.
    candidate : Candidate
    size : float
        One-step estimate of the coefficient: a branch cannot begin at nothing.
    poolings : sequence of str
    rounds : int
    begin : Refit, optional
        Of the model without it: where the refits begin, if not at `fit`.
    """
    # The coefficient is linear: at zero the larger model is the smaller one, and the elements follow from there.
    model = extended(fit.model, candidate, "shared", size)
    grown = refitter.fit(model, *extended_start(begin or fit, model), rounds)
    trials = [Trial(candidate, "shared", grown, gain(grown, fit), is_physical(grown))]
    for pooling in poolings:
        if pooling != "shared":
            model = extended(fit.model, candidate, pooling, size)
            grown = refitter.fit(model, *extended_start(trials[-1].fit, model), rounds)
            trials.append(Trial(candidate, pooling, grown, gain(grown, fit), is_physical(grown)))
    return [t for t in trials if t.pooling in poolings]


def extended(model: Model, candidate: Candidate, pooling: str, size: float) -> Model:
    """The model with one addition more."""
    effect = candidate.effect
    addition = Addition(effect, candidate.place, pooling)
    shape = candidate.shape
    if not effect.operation:  # as a whole: masses and dampers with its size, compliances against it
        factor = max(size, 1e-12) if effect.connection == "beside" else 1 / max(size, 1e-12)
        shape = {e: v / factor if e[0] == "n" else v * factor for e, v in shape.items()}
    return build(model.network, [*model.additions, addition], model.scales, [*starts_of(model), shape])


def starts_of(model: Model) -> list[dict[str, float]]:
    """For every addition what :func:`~bayes_impedance.mismatch.model.build` needs to make it again."""
    return [dict(zip(names_of(a.effect), shape_values(model, i), strict=True)) for i, a in enumerate(model.additions)]


def names_of(effect: Effect) -> list[str]:
    """Names of an effect's parameters: of its operation, or the elements of its branch."""
    return [c.name for c in effect.coefficients] if effect.operation else list(parse(effect.branch).elements)


def shape_values(model: Model, addition: int) -> list[float]:
    """Centres of an addition's shapes in the operation's unit, or the start values of its elements."""
    effect = model.additions[addition].effect
    own = [p for p in model.parameters if p.addition == addition]
    if not effect.operation:
        return [float(np.exp(p.start)) for p in own]
    return [float(c.value(p.centre, model.scales)) for c, p in zip(effect.coefficients, own, strict=True)]


def extended_start(fit: Refit, model: Model) -> tuple[np.ndarray, Population]:
    """Where the refit of a larger model begins: where the smaller one ended, new parameters at their centres."""
    old, new = fit.model, model
    position = {name: i for i, name in enumerate(old.kernel.elements)}
    begin = {name: p.start for name, p in zip(new.kernel.elements[new.n_elements :], new.parameters, strict=True)}
    u = np.empty((fit.u.shape[0], len(new.kernel.elements)))
    for i, name in enumerate(new.kernel.elements):
        u[:, i] = fit.u[:, position[name]] if name in position else begin[name]
    varying_old = [n for n, s in zip(old.kernel.elements, old.shared, strict=True) if not s]
    varying_new = [n for n, s in zip(new.kernel.elements, new.shared, strict=True) if not s]
    n = len(varying_new)
    mu, covariance, rho = np.empty(n), np.zeros((n, n)), np.full(n, 1e-3)
    for i, name in enumerate(varying_new):
        if name in varying_old:
            k = varying_old.index(name)
            mu[i], rho[i] = fit.population.mu[k], fit.population.rho[k]
            for j, other in enumerate(varying_new):
                if other in varying_old:
                    covariance[i, j] = fit.population.covariance[k, varying_old.index(other)]
        else:
            mu[i] = u[:, new.kernel.elements.index(name)].mean()
            covariance[i, i] = 1.0  # set from the mean when the fit begins
    return u, Population(mu, covariance, rho)


def gain(grown: Refit, fit: Refit) -> float:
    """Evidence gained, less the price of the population parameters that were added."""
    return float(np.sum(grown.evidence) - np.sum(fit.evidence)) - price(grown.model, fit) + price(fit.model, fit)


def price(model: Model, fit: Refit) -> float:
    """Half the logarithm of the number of recordings for every parameter of the population that was added."""
    count = sum(1 if p.shared else 2 for p in model.parameters)
    return 0.5 * count * float(np.log(len(fit.u)))


def is_physical(fit: Refit) -> bool:
    """Whether every coefficient has a sign that its effect can have, and is absent in some if that is the claim."""
    for i, addition in enumerate(fit.model.additions):
        effect = addition.effect
        if effect.signed or not effect.operation:
            continue
        if effect.pooling == "some" and not members(fit, i).only_some:
            return False
        linear = [c for c, k in zip(fit.model.columns(i), effect.coefficients, strict=True) if k.link == "linear"]
        values = fit.u[:, linear].mean(axis=0)
        if values[0] <= 0 and not (effect.operation == "bypass" and values.max() > 0):
            return False
        if effect.operation == "bypass" and values.min() < -0.1 * abs(values).max():
            return False
    return True


def has_shapes(effect: Effect) -> bool:
    """Whether an effect has shapes that could differ between people."""
    return any(c.link != "linear" for c in effect.coefficients[1:])


def own_shapes(
    refitter: Refitter, fit: Refit, screening: Screening, k: int, rounds: int = 30, begin: Refit | None = None
) -> Trial:
    """Refit with shapes that differ between people, everybody beginning at the best of the own scores over the grid.

    A resonance that lies elsewhere in everybody is invisible to a search from a common start.
    """
    chosen = screening.candidates[k]
    effect = chosen.effect
    same = [i for i, c in enumerate(screening.candidates) if c.effect == effect and c.place == chosen.place]
    b, m = screening.score[:, same], screening.information[:, same]
    strength = np.where(b > 0, b**2 / np.maximum(m, 1e-300), 0.0)
    own = np.argmax(strength, axis=1)
    sure = strength.max(axis=1) > _SURE
    model = extended(fit.model, chosen, "free", float(screening.size[k]))
    u, population = extended_start(begin or fit, model)
    scales, columns = model.scales, model.columns(len(model.additions) - 1)
    mu = population.mu.copy()
    rows = np.arange(len(own))
    people = np.flatnonzero(sure) if sure.sum() > 2 else rows
    size = float(np.sum(b[people, own[people]]) / np.sum(m[people, own[people]]))
    varying = np.flatnonzero(~model.shared)
    for coefficient, column in zip(effect.coefficients, columns, strict=True):
        if coefficient.link == "linear":
            values = np.full(len(own), size / coefficient.scale(scales))
        else:
            shapes = [coefficient.unbounded(screening.candidates[i].shape[coefficient.name], scales) for i in same]
            values = np.array(shapes)[own]
            values = np.where(sure, values, np.median(values[people]))
        u[:, column] = values[fit.owner]
        mu[int(np.flatnonzero(varying == column)[0])] = values.mean()
    grown = refitter.fit(model, u, replace(population, mu=mu), rounds)
    return Trial(chosen, "free", grown, gain(grown, fit), is_physical(grown))


def try_shortlist(refitter: Refitter, fit: Refit, screening: Screening, begin: Refit | None = None) -> list[Trial]:
    """Refit the shortlist, and the best of it at the places that the list had no room for.

    The refits begin at `fit`, or where they are told to.
    """
    trials: list[Trial] = []
    for k in shortlist(screening):
        candidate = screening.candidates[k]
        poolings = poolings_for(candidate, len(refitter.data))
        trials += try_candidate(refitter, fit, candidate, float(screening.size[k]), poolings, _FIRST_ROUNDS, begin)
        if "varying" in poolings and has_shapes(candidate.effect) and screening.log_p_spread[k] < _CLEARLY_VARIES:
            trials.append(own_shapes(refitter, fit, screening, k, _FIRST_ROUNDS, begin))
    trials = _continued(refitter, fit, trials)
    possible = [t for t in trials if t.physical and np.isfinite(t.gain)]
    if not possible:
        return trials
    leader = max(possible, key=lambda t: t.gain)
    for k in best_shapes(screening):
        other = screening.candidates[k]
        tried = {(t.candidate.place, t.pooling) for t in trials if t.effect == leader.effect}
        if other.effect == leader.effect and (other.place, leader.pooling) not in tried:
            if leader.pooling == "free":
                trials.append(own_shapes(refitter, fit, screening, k, begin=begin))
            else:
                size = float(screening.size[k])
                trials.append(try_candidate(refitter, fit, other, size, (leader.pooling,), begin=begin)[-1])
    return trials


def _continued(refitter: Refitter, fit: Refit, trials: list[Trial]) -> list[Trial]:
    """The trials that are not far behind after their first rounds, with more rounds; the others as they are."""
    gains = [t.gain for t in trials if np.isfinite(t.gain) and t.physical]
    if not gains:
        return trials
    enough = max(gains) - max(_FAR_BEHIND, (1 - _LEAST_SHARE) * max(gains))
    result = []
    for trial in trials:
        if trial.gain > enough and not trial.fit.settled:
            grown = refitter.fit(trial.fit.model, trial.fit.u, trial.fit.population, _MORE_ROUNDS)
            trial = replace(trial, fit=grown, gain=gain(grown, fit), physical=is_physical(grown))
        result.append(trial)
    return result


def poolings_for(candidate: Candidate, n_people: int) -> tuple[str, ...]:
    """How a coefficient may be spread over people: the rig's is the same for all, the body's may differ.

    Where rig and body have the same effect at the same place, being the same for all makes it the rig's.
    """
    effect = candidate.effect
    if n_people < 3 or effect.side == "rig":
        return ("shared",)
    if effect.pooling == "some":
        return ("varying",)
    twin = candidate.place == "port" and any(
        other.side == "rig" and other.operation == effect.operation and other.coefficients == effect.coefficients
        for other in registered()
    )
    return ("varying",) if twin else ("shared", "varying")
