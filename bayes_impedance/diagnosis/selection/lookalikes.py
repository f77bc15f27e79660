r"""Effects that look like the leading one at its place, fitted from where the leader ended.

Two effects may be almost the same curve in the band: a squeeze film and one relaxation, a reflex that responds to a
stretch and one that responds to its velocity. Whether the recordings separate them is known only after both fits have
converged. The scan ranks effects by the residuals of the fit *without* them, and may miss the lookalike there; a refit
from its own start may end in another optimum. So the refit starts from the leader's elements, from those of the
leader's shapes that have the same name, and with coefficients that change the impedance as the leader does: with
:math:`\Delta` the leader's change and J the derivative by the lookalike's coefficient at zero,

.. math:: x = \frac{\sum \operatorname{Re}(\bar J \Delta)/|z|^2}{\sum |J|^2/|z|^2} .

The same law on the other side, such as a resonance of the rig for a further joint of the body, is the same curve in
each person; only whether people differ tells the two apart. It is always compared: the one score of a resonance of the
rig was small where the network had lost elements, so that it was not tried, and a joint that is the same in everybody
was named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended_start, has_shapes, rebuilt, starts_of
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.trial import poolings_for

_ALIKE = 0.8
"""Cosine of two signatures from which effects look alike: what one leaves of the other is then 0.6 of it. By choice."""

_LARGEST = 10.0
"""Largest size at which a coefficient begins, in units of what changes the impedance by its magnitude. By choice: where
the place is hardly felt, a derivative of nearly zero gave 1e5, of which the exponential has no value."""

MOST = 2
"""Lookalikes that are fitted, the most alike first. By choice: each costs as much as another candidate."""


def lookalikes(screening: Screening, leader: Candidate) -> list[Candidate]:
    """Other effects at the leader's place whose signatures are like its own, each with its most similar shape.

    Those of the leader's side, and its counterpart on the other one, last.
    """
    at_place = [k for k, c in enumerate(screening.candidates) if c.place == leader.place]
    own = [k for k in at_place if screening.candidates[k].effect == leader.effect]
    if not own:
        return []
    likeness = np.abs(np.nan_to_num(screening.cosine[:, own])).max(axis=1)
    best: dict[tuple[str, str], int] = {}
    counterpart: list[int] = []
    for k in sorted(at_place, key=lambda k: -likeness[k]):
        effect = screening.candidates[k].effect
        if effect == leader.effect or not effect.operation or not likeness[k] > _ALIKE:
            continue
        if effect.side == leader.effect.side:
            best.setdefault((effect.id, effect.form), k)
        elif effect.form == leader.effect.form and not counterpart:
            counterpart.append(k)
    return [screening.candidates[k] for k in (*list(best.values())[:MOST], *counterpart)]


def from_the_leader(refitter: Refitter, leader: Refit, candidate: Candidate, rounds: int) -> Refit:
    """Refit with a lookalike in place of the leading addition, which is the last one.

    Parameters
    ----------
    refitter : Refitter
    leader : Refit
    candidate : Candidate
        The lookalike.
    rounds : int
    """
    old = leader.model
    last = len(old.additions) - 1
    pooling = old.additions[last].pooling
    if candidate.effect.side != old.additions[last].effect.side:
        pooling = poolings_for(candidate.effect, len(refitter.data))[0]
    if pooling == "free" and not has_shapes(candidate.effect):
        pooling = "varying"
    addition = Addition.of(candidate, pooling)
    starts = [*starts_of(old)[:last], _shape(old, candidate)]
    model = build(old.network, [*old.additions[:last], addition], old.scales, starts)
    u, population = extended_start(leader, model)
    theirs = dict(zip(_names(old, last), old.columns(last), strict=True))
    for name, column in zip(_names(model, last)[1:], model.columns(last)[1:], strict=True):
        if name in theirs:
            u[:, column] = leader.u[:, theirs[name]]
            if model.shared[column]:
                u[:, column] = u[:, column].mean()
    first = model.columns(last)[0]
    u[:, first] = _sizes(leader, model, u, first)
    mu, varying = population.mu.copy(), np.flatnonzero(~model.shared)
    for column in model.columns(last):
        if not model.shared[column]:
            mu[int(np.flatnonzero(varying == column)[0])] = u[:, column].mean()
    return refitter.fit(model, u, replace(population, mu=mu), rounds)


def _names(model: Model, addition: int) -> Sequence[str]:
    """What each parameter of an addition is called in its operation."""
    return [c.name for c in model.additions[addition].effect.coefficients]


def _shape(old: Model, candidate: Candidate) -> dict[str, float]:
    """The lookalike's shapes, those of the leader where they have the same name."""
    leading = starts_of(old)[-1]
    return {name: leading.get(name, value) for name, value in candidate.shape.items()}


def _sizes(leader: Refit, model: Model, u: np.ndarray, column: int) -> np.ndarray:
    """The lookalike's coefficient in every recording, (M,): each person's own, or one for all if it is shared."""
    plain = rebuilt(leader.model, leader.model.additions[:-1], list(range(len(leader.model.additions) - 1)))
    kept = [leader.model.kernel.elements.index(name) for name in plain.kernel.elements]
    up, down = np.zeros(len(u)), np.zeros(len(u))
    without = u.copy()
    without[:, column] = 0.0
    for i, data in enumerate(leader.data):
        rows, frequency = leader.owner == i, data.omega / (2 * np.pi)
        z = leader.model.kernel.impedance(leader.u[rows], frequency)
        change = z - plain.kernel.impedance(leader.u[np.ix_(rows, kept)], frequency)
        slope = model.kernel.derivative(without[rows], frequency)[1][:, column]
        up[rows] = np.sum((slope.conj() * change).real / np.abs(z) ** 2)
        down[rows] = np.sum(np.abs(slope / z) ** 2)
    if model.shared[column]:
        up, down = np.full(len(u), up.sum()), np.full(len(u), down.sum())
    return np.clip(up / np.maximum(down, 1e-300), -_LARGEST, _LARGEST)
