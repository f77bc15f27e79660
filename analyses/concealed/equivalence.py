r"""Whether entries of the catalogue are truly the same as what was at work, in this band and for these people.

The network is fitted to every recording's true curve (``visible_in_world.py``). What is left, d, is projected on the
directions g of the claimed entries, written out by hand in ``forms.py`` (first order in their coefficient, the shape
scanned) and without what the elements can imitate,

.. math:: \text{shared: } \frac{(\sum_{ij} g\cdot d)^2}{\sum_{ij} g\cdot g}, \qquad
          \text{varying: } \sum_{ij} \frac{(g\cdot d)^2}{g\cdot g}

of :math:`\lambda = \sum|d|^2` is explained. Where the claimed entries may differ between people, they are then fitted
to every recording's curve together with the elements, shapes and all: to first order a strong relaxation whose corner
differs from person to person would not be the same as itself. What is left counts as nothing if it stands out by less
than six standard errors, which nobody could see, and is less than what is explained; or if it is below 3 % of
:math:`\lambda`, which a projection to first order cannot resolve: of strong effects it leaves as much under their own
name.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from forms import EFFECTS, Effect
from nearest import fitted, outside, tangent_basis, white
from people import Change, impedance
from scoring import VISIBLE
from visible_in_world import imitated
from world.experiment import Experiment

SAME_SHARE = 0.97
LEAST_SHARE = 0.5
_SMALL = 1e-3
_SHAPES: Mapping[str, Mapping[str, Sequence[float]]] = {
    "body.springpot": {"exponent": (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)},
    "body.reflex": {"latency": (0.025, 0.029, 0.034, 0.04, 0.051, 0.06)},
    "rig.resonance": {"frequency": tuple(np.geomspace(10, 8000, 40)), "ratio": (0.05, 0.15, 0.5)},
}
_FITTED = ("body.springpot", "body.relaxation", "body.resonator", "body.mass", "body.line", "body.bypass")
_CORNERS = tuple(np.geomspace(2, 20000, 25))


def directions(
    experiment: Experiment, x: np.ndarray, effect_id: str, place: str
) -> Iterator[tuple[Mapping[str, float], np.ndarray]]:
    """A little of an entry, and its complex change (N, J, F) of a finger x (N, J, P), for each of its shapes."""
    f = experiment.plan.frequency_hz
    names = {"body.drift": "body.drift.sweep"}
    effect = EFFECTS.get(names.get(effect_id, effect_id))
    if effect is None or effect.form is None:
        return
    base = impedance(x, f)
    for values in _values(effect, effect_id, place):

        def change(s: np.ndarray, z: np.ndarray, values: Mapping[str, float] = values) -> np.ndarray:
            assert effect.form is not None
            return effect.form(s, z, {k: np.asarray(v) for k, v in values.items()})

        yield values, impedance(x, f, {place: change}) - base


def _values(effect: Effect, effect_id: str, place: str) -> Iterator[dict[str, float]]:
    start = effect.start(np.random.default_rng(1), place if place in ("skin", "tissue") else "skin")
    small = effect.values(start, _SMALL)
    if effect_id in ("body.relaxation", "body.subgroup"):
        for corner in _CORNERS:
            yield small | {"compliance": 1 / (2 * np.pi * corner * small["damping"])}
    elif effect_id == "body.resonator":
        for corner in np.geomspace(10, 8000, 40):
            for ratio in (0.05, 0.15, 0.5):
                w0, mass = 2 * np.pi * corner, small["mass"]
                yield {"mass": mass, "compliance": 1 / (mass * w0**2), "damping": 2 * ratio * mass * w0}
    elif effect_id == "body.bypass":
        for ratio in np.geomspace(1, 1e5, 11):
            yield {"damping": 1e-4, "compliance": 1 / (1e-4 * ratio)}
    elif effect_id == "body.drift":
        for law in (0.0, 1.0):
            yield small | {"same_periods": law}
    else:
        grids = _SHAPES.get(effect_id, {})
        rows = [small]
        for name, grid in grids.items():
            rows = [row | {name: value} for row in rows for value in grid]
        yield from rows


def left_over(experiment: Experiment, claimed: Sequence[tuple[str, str]]) -> tuple[float, float]:
    """What claimed entries leave of the true change.

    Parameters
    ----------
    experiment : Experiment
    claimed : sequence of (id, place)

    Returns
    -------
    share : float
        Of the visible change, explained.
    left : float
        Standard errors by which the rest could stand out at most.
    """
    x, rest = imitated(experiment, experiment.clean)
    basis, _ = tangent_basis(x, experiment.plan.frequency_hz, experiment.sd)
    total = float(np.sum(rest**2))
    if total == 0.0:
        return 0.0, 0.0
    found: list[_Size] = []
    for effect_id, place in claimed:
        best, explained, size = 0.0, np.zeros_like(rest), None
        shared = EFFECTS[effect_id].pooling == "shared" if effect_id in EFFECTS else False
        try:
            candidates = list(directions(experiment, x, effect_id, place))
        except ValueError:  # a place that the hand-written network does not name
            candidates = []
        for values, change in candidates:
            g = outside(white(change, experiment.sd), basis)
            cross, own = np.sum(g * rest, axis=-1), np.sum(g**2, axis=-1)
            sizes = np.full_like(own, cross.sum() / own.sum()) if shared else cross / own
            gain = float(np.sum(2 * sizes * cross - sizes**2 * own))
            if gain > best:
                best, explained = gain, sizes[..., None] * g
                size = _Size(effect_id, place, values, float(np.median(sizes)))
        rest = rest - explained
        if size is not None:
            found.append(size)
    left = float(np.sum(rest**2))
    if len(found) == len(claimed) and all(s.may_vary for s in found):
        left = min(left, float(np.sum(_fitted_together(experiment, x, found) ** 2)))
    return 1 - left / total, float(np.sqrt(left))


@dataclass(frozen=True)
class _Size:
    """A claimed entry with its best shape, and how many times its small size the change is, to first order."""

    effect_id: str
    place: str
    values: Mapping[str, float]
    times: float

    @property
    def may_vary(self) -> bool:
        """Whether it is an entry whose parameters differ between people, all of them positive numbers."""
        return self.effect_id in _FITTED and self.times > 0


def _fitted_together(experiment: Experiment, x: np.ndarray, found: Sequence[_Size]) -> np.ndarray:
    """What is left (N, J, 2 F) if elements and parameters of the claimed entries are free for every recording."""
    f, p = experiment.plan.frequency_hz, x.shape[-1]
    effects = [EFFECTS[s.effect_id] for s in found]
    starts = [e.values(s.values, s.times) for e, s in zip(effects, found, strict=True)]
    names = [[n for n, v in start.items() if v > 0] for start in starts]

    def curve(unknown: np.ndarray) -> np.ndarray:
        changes: dict[str, Change] = {}
        column = p
        for s, effect, own in zip(found, effects, names, strict=True):
            values = {n: np.exp(unknown[..., column + i, None]) for i, n in enumerate(own)}
            column += len(own)
            changes[s.place] = _chained(changes.get(s.place), effect, values)
        return impedance(unknown[..., :p], f, changes)

    logs = np.log([start[n] for start, own in zip(starts, names, strict=True) for n in own])
    start = np.concatenate([x, np.broadcast_to(logs, (*x.shape[:-1], logs.size))], axis=-1)
    target = experiment.clean - experiment.without + impedance(experiment.fingers.log_elements, f)
    return fitted(curve, start, target, experiment.sd)[1]


def _chained(first: Change | None, effect: Effect, values: Mapping[str, np.ndarray]) -> Change:
    def change(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        assert effect.form is not None  # of all in _FITTED
        return effect.form(s, z if first is None else first(s, z), values)

    return change


def same(experiment: Experiment, claimed: Sequence[tuple[str, str]]) -> bool:
    """Whether nobody could tell the claimed entries from what was at work."""
    share, left = left_over(experiment, claimed)
    return bool(claimed) and share > LEAST_SHARE and (share >= SAME_SHARE or left < VISIBLE)
