"""The only person of a dataset, or the only specimen: fits begin from many starts, with what was added in the network.

With one person there is no population to begin around. An effect whose fit begins where the network without it has left
the elements stays in that network's valley: a springpot beside the tissue gained 630 nats with a skin that was two
hundred times too compliant, and 873 with the right one; a relaxation 545 and 552. What is left of a wrong valley looks
like further missing physics. So the person is searched with the effect in the network, from random starts and with one
element changed at a time, as the network alone was.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.person.mode import all_modes

if TYPE_CHECKING:
    from bayes_impedance.diagnosis.fit.fitter import Refitter

_ANYWHERE, _SPREAD = 64, 2.5
"""Random starts, and the standard deviation of their log elements. The second is that of a network's own search, the
first by choice: two thirds of its starts, as single elements are changed besides."""

_CHANGES = (-4.0, -2.0, 2.0, 4.0)
"""Changes of one log element from where the fit is: 2 as in the network's own search, and twice that by choice, because
a wrong model has left elements farther off (6 in the springpot above)."""

_APART, _VALLEYS = 0.3, 8
"""Difference of a log element from which two ends are in different valleys, that of common solutions of a network; and
largest number of valleys that are tried, by choice."""

_FIRST_STEPS, _STEPS, _BEST = 4, 40, 32
"""Largest numbers of steps from all starts and from the best, and number of these: as for people who are searched
alone."""

_ROUNDS = 15
"""Rounds of a fit from a start with the additions held: as for the starts of people in a population."""

_BEST_ENDS = 3
"""Best ends that are fitted with the additions free. By choice: while these are held, a right valley may lie a little
behind."""

BETTER = 0.2
"""Difference of log evidence from which another end replaces the fit of a person, the only one or one of many. By
choice: less may be the same optimum, approached from elsewhere."""


def settled_alone(refitter: Refitter, fit: Refit, rng: np.random.Generator, rounds: int, hold: bool) -> Refit:
    """The best fit of the only person that is found, or the given one.

    All starts are fitted at once, as so many copies of the person.

    Parameters
    ----------
    refitter : Refitter
        Of one person.
    fit : Refit
    rng : Generator
    rounds : int
        Largest number of searches, each from the best fit so far.
    hold : bool
        Hold the additions.
    """
    for _ in range(rounds):
        starts = _starts(fit, rng)
        copies = refitter.subset(np.zeros(len(starts), dtype=int))
        ends = copies.fit(
            fit.model,
            np.repeat(starts, len(fit.u), axis=0),
            fit.population,
            _ROUNDS,
            hold_population=True,
            hold_additions=True,
        )
        best = np.argsort(-np.nan_to_num(ends.evidence, nan=-np.inf), kind="stable")[:_BEST_ENDS]
        again = [refitter.fit(fit.model, ends.u[ends.owner == k], fit.population, hold_additions=hold) for k in best]
        better = max(again, key=lambda other: float(np.nan_to_num(other.evidence[0], nan=-np.inf)))
        if not better.evidence[0] > fit.evidence[0] + BETTER:
            break
        fit = better
    return fit


def _starts(fit: Refit, rng: np.random.Generator) -> np.ndarray:
    """Starts of the only person's parameters, shape (S, P).

    Where searches of the first recording with all parameters free have ended, one for each valley; and where the fit is
    with one element changed.

    Parameters
    ----------
    fit : Refit
        Of one person.
    rng : Generator
    """
    model, data = fit.model, fit.data[0]
    n, size = model.n_elements, fit.u.shape[1]
    centre, sd = fit.u[0].copy(), np.empty(size)
    own = ~model.shared
    centre[own], sd[own] = fit.population.mu, np.sqrt(np.diag(fit.population.covariance))
    centre[n:], sd[n:] = [p.centre for p in model.parameters], [p.prior_sd for p in model.parameters]
    one = replace(
        data, z=data.z[:1], weight=data.weight[:1], deviations=np.zeros((1, size)), count=data.count / len(data.z)
    )  # fmt: skip
    starts = np.tile(fit.u[0], (_ANYWHERE, 1))
    starts[:, :n] = centre[:n] + _SPREAD * rng.normal(size=(_ANYWHERE, n))
    changed = np.tile(fit.u[0], (n * len(_CHANGES), 1))
    changed[np.arange(len(changed)), np.repeat(np.arange(n), len(_CHANGES))] += np.tile(_CHANGES, n)
    starts = np.concatenate([fit.u[:1], changed, starts])
    precision = np.diag(sd**-2.0)
    near, values, _ = all_modes(model.kernel, one, starts, centre, precision, _FIRST_STEPS)
    best = np.argsort(values, kind="stable")[:_BEST]
    ends, values, _ = all_modes(model.kernel, one, near[best], centre, precision, _STEPS)
    distinct: list[np.ndarray] = []
    for k in np.argsort(values, kind="stable"):
        if np.isfinite(values[k]) and all(np.abs(ends[k, :n] - other[:n]).max() > _APART for other in distinct):
            distinct.append(ends[k])
    return np.concatenate([distinct[:_VALLEYS], changed])
