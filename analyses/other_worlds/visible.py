r"""By how many standard errors an effect can stand out at most.

The claimed network is fitted to every noise-free recording, weighted by that recording's noise, all elements free:

.. math:: \lambda = \sum_{ij} \min_x \sum_f \left|\frac{z_{ijf} - Z(x, f)}{\sigma_{ijf}}\right|^2 .

What is left cannot be taken by any population of elements either, because a population only restricts them. The root of
:math:`\lambda` is the number of standard errors; :data:`VISIBLE` of them are asked for. Effects that act elsewhere:

- hum has a random phase, so that only its power counts: :math:`\lambda/\sqrt{4 n}` with n points near the mains;
- a covariate and a drift over repetitions change the elements themselves. They stand out of the elements' own scatter
  (tau between people, rho between repetitions) with the error v of an estimate from one recording, by its information:
  :math:`b\,s_x \sqrt{N/(\tau'^2 + (\rho^2 + v)/J)}` and :math:`b\sqrt{N\sum_j (j - \bar\jmath)^2/(\rho^2 + v)}`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from drawn_worlds import Experiment, World, chained, conduct, curves, information
from left_out import FIXED, KINDS, Kind
from scipy.optimize import least_squares
from tree_networks import elements

VISIBLE = 6.0
"""Standard errors from which an effect should be found: p = 2e-9, which stays small after a thousand tests."""

ENOUGH = 12
"""People from whom lambda is taken where it only has to be known to a third: with two effects, and for equivalence."""

_STEP = 1e-6


def visibilities(world: World, experiment: Experiment) -> list[float]:
    """Standard errors of each effect; empty where nothing is missing.

    Of two effects each counts by what network and the *other* effect, its parameters free in every recording, leave.
    """
    if len(world.effects) == 1:
        return [_of_one(world, experiment)]
    found = []
    for k, effect in enumerate(world.effects):
        other = world.effects[1 - k]
        claim = Claim(other.kind, other.place, dict(other.values))
        alone = conduct(replace(world, effects=(effect,)))
        found.append(min(standard_errors(world, experiment, [claim]), standard_errors(world, alone)))
    return found


def standard_errors(world: World, experiment: Experiment, claims: Sequence[Claim] = ()) -> float:
    """Root of lambda, taken from the first of :data:`ENOUGH` people for all of them."""
    rest = rest_of_network(world, experiment, claims, ENOUGH)
    return float(np.sqrt(np.sum(rest**2) * world.n_people / rest.shape[0]))


def _of_one(world: World, experiment: Experiment) -> float:
    effect = world.effects[0]
    if effect.kind in ("body.covariate", "body.drift:repetitions"):
        return _of_elements(world, experiment)
    left = np.sum(rest_of_network(world, experiment) ** 2, axis=-1)
    if effect.kind == "rig.mains":
        f, mains = world.frequency_hz, effect.values["frequency"]
        near = sum(int(np.sum(np.abs(f / (h * mains) - 1) < 0.1)) for h in (1, 2, 3))
        return float(left.sum() / np.sqrt(4 * max(near, 1) * left.size))
    return float(np.sqrt(left.sum()))


@dataclass(frozen=True)
class Claim:
    """A kind at a place, with the values from which its parameters are fitted."""

    kind: str
    place: str
    values: Mapping[str, float]


def rest_of_network(
    world: World, experiment: Experiment, claims: Sequence[Claim] = (), people: int | None = None
) -> np.ndarray:
    """What elements and claims leave of the noise-free recordings, over the noise: (N, J, 2 F), real parts first.

    Each recording is fitted from its true elements and again (a person's first) with the shift of the
    one before; the better one counts. `people` limits N.
    """
    n, j, _ = experiment.clean.shape
    n = n if people is None else min(n, people)
    rest = np.empty((n, j, 2 * world.frequency_hz.size))
    shift = np.zeros(0)
    for i in range(n):
        for k in range(j):
            true = experiment.log_elements[i, k]
            starts = [np.r_[true, np.zeros(_count(claims))]]
            if shift.size and k == 0:
                starts.append(np.r_[true, np.zeros(_count(claims))] + shift)
            trials = [fitted(world, claims, start, experiment.clean[i, k], experiment.sd[i, k]) for start in starts]
            x, rest[i, k] = min(trials, key=lambda trial: float(np.sum(trial[1] ** 2)))
            shift = x - starts[0]
    return rest


def _free(claim: Claim) -> list[str]:
    return [name for name, value in claim.values.items() if name not in FIXED and value != 0]


def _count(claims: Sequence[Claim]) -> int:
    return sum(len(_free(claim)) for claim in claims)


def with_claims(world: World, claims: Sequence[Claim], x: np.ndarray) -> np.ndarray:
    """Curves (..., F) of log elements and of the logarithms of the claims' values over their start (..., P + Q)."""
    p = world.centre.size
    changes: dict[str, list[tuple[Kind, dict[str, np.ndarray], np.ndarray]]] = {}
    column = p
    for claim in claims:
        own = {name: np.full((*x.shape[:-1], 1), value) for name, value in claim.values.items()}
        for name in _free(claim):
            own[name] = claim.values[name] * np.exp(x[..., column, None])
            column += 1
        changes.setdefault(claim.place, []).append((KINDS[claim.kind], own, np.array(True)))
    acting = {place: chained(rows) for place, rows in changes.items()}
    return curves(world.network, world.s, x[..., :p], acting)


def fitted(
    world: World, claims: Sequence[Claim], start: np.ndarray, z: np.ndarray, sd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (P + Q,) nearest to one curve z (F,), and the residual over its noise (2 F,)."""

    def white(x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            d = np.nan_to_num((z - with_claims(world, claims, x)) / sd, nan=1e8, posinf=1e8, neginf=-1e8)
        return np.concatenate([d.real, d.imag], axis=-1)

    def jacobian(x: np.ndarray) -> np.ndarray:
        step = _STEP * np.eye(x.size)
        return np.asarray((white(x + step) - white(x - step)).T / (2 * _STEP))

    found = least_squares(
        white, start, jac=jacobian, bounds=(start - 12, start + 12), x_scale=1.0, ftol=1e-10, xtol=1e-10, gtol=1e-10,
        max_nfev=40,
    )  # fmt: skip
    return found.x, found.fun


def _of_elements(world: World, experiment: Experiment) -> float:
    effect = world.effects[0]
    i = elements(world.network).index(effect.place)
    variance = float(np.mean([np.linalg.pinv(information(world, x))[i, i] for x in experiment.log_elements[:, 0]]))
    rho = world.between_repetitions[i] ** 2 + variance
    n, j = world.n_people, world.n_repetitions
    if effect.kind == "body.covariate":
        kept = (1 - effect.strength**2) * world.spread[i] ** 2
        log_x = np.log(experiment.covariates[world.covariates[0]])
        return float(abs(effect.values["slope"]) * log_x.std() * np.sqrt(n / (kept + rho / j)))
    lever = float(np.sum((np.arange(j) - (j - 1) / 2) ** 2))
    return float(abs(effect.values["trend"]) * np.sqrt(n * lever / rho))
