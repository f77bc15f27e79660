r"""The truth of an experiment in the virtual world, as a score needs it, and by how much each effect can stand out.

The network is fitted to every recording's true curve with the effect, without noise but weighted by it; the rest d,

.. math:: \lambda = \sum_{ij} \min_x \left|\frac{z'_{ij} - z_\text{network}(x)}{\sigma_{ij}}\right|^2 = \sum|d|^2,

is what no elements can imitate, and its root the largest number of standard errors by which an effect of known shape
can stand out when the elements of every recording are free. To first order that is the projection of
``visibility.py``; a strong effect at the skin moves its elements by half of their size, and then the first order sees
far too much. Force and creep over the session change the elements themselves and stand out of their scatter; hum adds
power.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from forms import same_places
from people import BETWEEN_PERSONS, ELEMENTS, NETWORK, impedance
from world.experiment import Experiment
from world.kind import Kind
from world.kinds import KINDS
from world.tissue import hertz_exponents

_STEP = 1e-5
_ROUNDS = 25


def white(values: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Real parts, then imaginary parts along the last axis, over the noise."""
    return np.concatenate([values.real / sd, values.imag / sd], axis=-1)


def tangent_basis(experiment: Experiment, log_elements: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the elements can do to the whitened curves, as an orthonormal basis, and the error of each element.

    Parameters
    ----------
    experiment : Experiment
    log_elements : ndarray, shape (N, J, P)

    Returns
    -------
    basis : ndarray, shape (N, J, 2 F, P)
    variance : ndarray, shape (N, J, P)
        Of one estimate of each log element from one recording.
    """
    basis, r = np.linalg.qr(_tangent(experiment, log_elements))
    return basis, np.sum(np.linalg.inv(r) ** 2, axis=-1)


def imitated(experiment: Experiment, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The network fitted to curves without noise, by Levenberg and Marquardt from the true elements.

    Parameters
    ----------
    experiment : Experiment
    z : ndarray, complex, shape (N, J, F)

    Returns
    -------
    log_elements : ndarray, shape (N, J, P)
    rest : ndarray, shape (N, J, 2 F)
        What is left over the noise.
    """
    f, x = experiment.plan.frequency_hz, experiment.fingers.log_elements
    damping = np.full(x.shape[:2], 1e-3)
    # The rig's own reading of the lumped finger, which differs from it by what the stiff sensor does.
    target = z - experiment.without + impedance(x, f)
    rest = white(target - impedance(x, f), experiment.sd)
    for _ in range(_ROUNDS):
        a = _tangent(experiment, x)
        normal, right = np.swapaxes(a, -1, -2) @ a, np.einsum("ijfp,ijf->ijp", a, rest)
        diagonal = np.einsum("ijpp->ijp", normal)[..., None, :] * np.eye(x.shape[-1])
        step = np.linalg.solve(normal + damping[..., None, None] * diagonal, right[..., None])[..., 0]
        trial = x + np.clip(step, -1.0, 1.0)
        new = white(target - impedance(trial, f), experiment.sd)
        better = np.sum(new**2, axis=-1) < np.sum(rest**2, axis=-1)
        x, rest = np.where(better[..., None], trial, x), np.where(better[..., None], new, rest)
        damping = np.where(better, damping / 5, damping * 5)
    return x, rest


def _tangent(experiment: Experiment, x: np.ndarray) -> np.ndarray:
    """Derivative of the whitened curves by the log elements, shape (N, J, 2 F, P)."""
    f = experiment.plan.frequency_hz
    columns = [
        white((impedance(x + step, f) - impedance(x - step, f)) / (2 * _STEP), experiment.sd)
        for step in _STEP * np.eye(len(ELEMENTS))
    ]
    return np.stack(columns, axis=-1)


def outside(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """What the elements cannot absorb of whitened curves (N, J, 2 F)."""
    return np.asarray(values - np.einsum("ijfp,ijp->ijf", basis, np.einsum("ijfp,ijf->ijp", basis, values)))


def truth_of(experiment: Experiment) -> dict[str, Any]:
    """What a perfect diagnosis would say; ready for JSON.

    Returns
    -------
    dict
        ``kinds, group, mismatch, detectable, visible, effects`` (one truth for each effect in the terms of
        ``scoring.score``, with ``answers`` and its own ``visible``), ``conditions`` and sizes.
    """
    plan = experiment.plan
    kinds = [KINDS[name] for name in plan.kinds]
    _, variance = tangent_basis(experiment, experiment.fingers.log_elements)
    effects = [_effect(experiment, kind, k, variance) for k, kind in enumerate(kinds) if kind.answers]
    visible = max((effect["visible"] for effect in effects), default=0.0)
    return {
        "kinds": list(plan.kinds),
        "group": "pair" if len(kinds) > 1 else kinds[0].group,
        "mismatch": bool(effects),
        "strengths": list(plan.strengths),
        "visible": visible,
        "effects": effects,
        "seed": plan.seed,
        "subjects": plan.n_subjects,
        "points": plan.n_points,
        "values": [dict(v) for v in experiment.values],
        "conditions": {k: list(v) if isinstance(v, tuple) else v for k, v in vars(plan.conditions).items()},
    }


def _effect(experiment: Experiment, kind: Kind, k: int, variance: np.ndarray) -> dict[str, Any]:
    plan, sd = experiment.plan, experiment.sd
    change = white(experiment.alone[k] - experiment.without, sd)
    _, rest = imitated(experiment, experiment.alone[k])
    members = experiment.fingers.members if kind.pooling == "some" else np.ones(plan.n_subjects, dtype=bool)
    names = [f"P{i + 1:03d}" for i in range(plan.n_subjects)]
    own = kind.reported(experiment.values[k])
    signed = {"change": -1.0}  # creep softens: the logarithm of the impedance falls
    place = str(kind.place)
    return {
        "id": kind.answers[0],
        "answers": list(kind.answers),
        "mismatch": True,
        "place": place,
        "places": list(same_places(kind.answers[0], place)),
        "side": kind.side,
        "pooling": kind.pooling,
        "parameters": {
            name: {"value": signed.get(name, 1.0) * value, "unit": unit, "signs": {"n3": -1, "r3": 1}}
            if name == "slope"
            else {"value": signed.get(name, 1.0) * value, "unit": unit}
            for name, (value, unit) in own.items()
        },
        "also": {},
        "bands_hz": bands(plan.frequency_hz, _size(change, members)),
        "visible": _visible(experiment, kind, k, rest, variance),
        "visible_bands_hz": bands(plan.frequency_hz, _size(rest, members)),
        "subjects": "all" if members.all() else [n for n, m in zip(names, members, strict=True) if m],
        "covariate": "contact_force_n" if kind.special == "covariate" else None,
        "network": NETWORK,
    }


def _size(values: np.ndarray, members: np.ndarray) -> np.ndarray:
    n = values.shape[-1] // 2
    return np.asarray(np.sqrt(np.mean((values[..., :n] ** 2 + values[..., n:] ** 2)[members], axis=(0, 1))))


def _visible(experiment: Experiment, kind: Kind, k: int, rest: np.ndarray, variance: np.ndarray) -> float:
    """Standard errors by which an effect can stand out at most."""
    plan, population = experiment.plan, experiment.population
    total = float(np.sqrt(np.sum(rest**2)))
    if kind.special == "hum":
        n = rest.shape[-1] // 2
        power = np.sort(np.sum(rest[..., :n] ** 2 + rest[..., n:] ** 2, axis=(0, 1)))[::-1]
        points = np.arange(1, n + 1) * plan.n_subjects * plan.n_repetitions
        return float(np.max(np.cumsum(power) / np.sqrt(4 * points)))  # over however many of the worst points
    if kind.special == "covariate":
        best, force_sd = 0.0, experiment.values[k]["force_sd"]
        for name, exponent in hertz_exponents().items():
            i = ELEMENTS.index(name)
            explained = (exponent * force_sd) ** 2
            scatter = (population.between_repetitions[i] ** 2 + variance[..., i].mean(axis=1)) / plan.n_repetitions
            left = population.between_persons[i] ** 2 - explained + scatter
            best = max(best, float(np.sqrt(explained * np.sum(1 / left))))
        return best
    if kind.special == "creep.session":
        i, j = ELEMENTS.index(str(kind.place)), plan.n_repetitions
        step = experiment.values[k]["change"] / (j - 1)
        lever = np.sum((np.arange(j) - (j - 1) / 2) ** 2)
        scatter = population.between_repetitions[i] ** 2 + variance[..., i].mean(axis=1)
        return max(total, float(step * np.sqrt(lever * np.sum(1 / scatter))))
    return total


def bands(frequency_hz: np.ndarray, size: np.ndarray) -> list[list[float]]:
    """Intervals in which the size (F,) exceeds half of its maximum; each point reaches halfway to its neighbours."""
    middle = np.sqrt(frequency_hz[1:] * frequency_hz[:-1])
    edges = np.concatenate([frequency_hz[:1], middle, frequency_hz[-1:]])
    inside = np.concatenate([[False], size > 0.5 * size.max(), [False]]).astype(int)
    starts, ends = np.flatnonzero(np.diff(inside) == 1), np.flatnonzero(np.diff(inside) == -1)
    return [[float(edges[a]), float(edges[b])] for a, b in zip(starts, ends, strict=True)]


def relative_strength(name: str, deviation: float) -> float:
    """A change of a log element over its standard deviation between persons."""
    return deviation / BETWEEN_PERSONS[name]
