r"""The truth of an experiment in the virtual world, as scoring needs it, with the largest evidence of each effect.

The network is fitted to every recording's true curve with the effect (no noise, but weights by the noise); the residual
is the part that no elements can reproduce (``nearest.py``). Force and creep over the session change
the elements themselves and are compared with their scatter; hum adds power.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from forms import same_places
from nearest import bands, nearest, size, tangent_basis, white
from nearest_entry import true_parameters
from people import ELEMENTS, NETWORK, impedance
from world.experiment import Experiment
from world.kind import Kind
from world.kinds import KINDS
from world.tissue import hertz_exponents


def imitated(experiment: Experiment, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Elements (N, J, P) of the network's curves nearest to curves z (N, J, F), and the residual (N, J, 2 F)."""
    f, x = experiment.plan.frequency_hz, experiment.fingers.log_elements
    # The rig's reading of the lumped finger differs from the finger by the compliance of the sensor.
    return nearest(x, z - experiment.without + impedance(x, f), f, experiment.sd)


def truth_of(experiment: Experiment) -> dict[str, Any]:
    """The verdict of a perfect diagnosis; serialisable as JSON.

    Returns
    -------
    dict
        ``kinds, group, mismatch, detectable, visible, effects`` (one truth for each effect in the terms of
        ``scoring.score``, with ``answers`` and its own ``visible``), ``conditions`` and sizes.
    """
    plan = experiment.plan
    kinds = [KINDS[name] for name in plan.kinds]
    _, variance = tangent_basis(experiment.fingers.log_elements, plan.frequency_hz, experiment.sd)
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
    own = true_parameters(experiment, kind, k)
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
            name: {"value": value, "unit": unit, "signs": {"n3": -1, "r3": 1}}
            if name == "slope"
            else {"value": value, "unit": unit}
            for name, (value, unit) in own.items()
        },
        "also": {},
        "bands_hz": bands(plan.frequency_hz, size(change, members)),
        "visible": _visible(experiment, kind, k, rest, variance),
        "visible_bands_hz": bands(plan.frequency_hz, size(rest, members)),
        "subjects": "all" if members.all() else [n for n, m in zip(names, members, strict=True) if m],
        "covariate": "contact_force_n" if kind.special == "covariate" else None,
        "network": NETWORK,
    }


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
