r"""Whether entries of the catalogue are equivalent to the true effect, in this band and for these people.

The network is fitted to every recording's true curve (``visible_in_world.py``). The residual d is projected on the
directions g of the claimed entries. These are written out by hand in ``forms.py`` (first order in their coefficient,
the shape scanned), orthogonal to the directions of the elements. Of :math:`\lambda = \sum|d|^2` the part

.. math:: \text{shared: } \frac{(\sum_{ij} g\cdot d)^2}{\sum_{ij} g\cdot g}, \qquad
          \text{varying: } \sum_{ij} \frac{(g\cdot d)^2}{g\cdot g}

is explained. Entries that may differ between people are then fitted to every recording's curve together with the
elements, their shapes included: a strong relaxation whose corner differs between persons is not equivalent to itself to
first order. The rest counts as nothing in two cases: it stands out by less than six standard errors, which no test
could detect, and is less than the explained part; or it is below 3 % of :math:`\lambda`, because a projection to first
order leaves as much of a strong effect projected on itself.
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
"""Explained share from which the rest is the error of the first order (module docstring)."""
LEAST_SHARE = 0.5
"""Explained share that is required where the rest is below detection: more than half."""
_SMALL = 1e-3
"""Size of a small entry, in units of its start, at which its change is proportional to it."""
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
    """Change (N, J, F) of the curves of fingers x (N, J, P) by a small amount of an entry, for each of its shapes."""
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
    """Share of the true change that claimed entries explain, and the rest.

    Parameters
    ----------
    experiment : Experiment
    claimed : sequence of (id, place)

    Returns
    -------
    share : float
        Explained share of the visible change.
    left : float
        Largest evidence of the rest, in standard errors.
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
    """A claimed entry with its best shape, and the multiple of its small size that fits best to first order."""

    effect_id: str
    place: str
    values: Mapping[str, float]
    times: float

    @property
    def may_vary(self) -> bool:
        """Whether an entry's parameters differ between people and are all positive."""
        return self.effect_id in _FITTED and self.times > 0


def _fitted_together(experiment: Experiment, x: np.ndarray, found: Sequence[_Size]) -> np.ndarray:
    """Residual (N, J, 2 F) with elements and the entries' parameters free in every recording."""
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
    """Whether the claimed entries cannot be distinguished from the true effects."""
    share, left = left_over(experiment, claimed)
    return bool(claimed) and share > LEAST_SHARE and (share >= SAME_SHARE or left < VISIBLE)
