r"""A kind of effect in the world: its action, its size, and the right answers.

For an average person parameters are ``start`` times ``size ** power``; where an effect differs between people each is
log-normal with the log sd ``spread``. ``answers`` are the right ids, the proper name first. For physics without an
entry in the catalogue this is ``unknown``; which entries are equivalent in the band is computed (``equivalence.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from world.rig import Rig

Values = dict[str, float]
Own = Mapping[str, np.ndarray | float]
Body = Callable[[np.ndarray, np.ndarray, Own], np.ndarray]
OnRig = Callable[[Rig, Mapping[str, float]], Rig]
Reported = Callable[[Mapping[str, float]], dict[str, tuple[float, str]]]

GROUPS = ("catalogue", "outside", "trap", "nothing")
SPECIAL = ("", "covariate", "creep.session", "creep.sweep", "hum", "friction", "crosstalk", "centre", "correlation")


@dataclass(frozen=True)
class Kind:
    """A kind of effect.

    Attributes
    ----------
    name : str
    group : str
        Of :data:`GROUPS`. Traps cannot be identified from such recordings: the right answer is that nothing is missing.
    answers : tuple of str
        Ids that a verdict may truly give; empty for nothing and traps.
    place, side, pooling : str or None
        Place in the network, rig or body, and ``shared``, ``varying`` or ``some``.
    start : callable (rng) -> dict
        Parameters at size 1.
    power, spread : mapping of str to float
        See the module's docstring.
    body : callable (s, z, own) -> z, or None
        Changed impedance at the place; parameters have shape (N, 1, 1) where they differ between people.
    rig : callable (rig, values) -> Rig, or None
    special : str
        Of :data:`SPECIAL`: effects neither at one place nor of the rig alone, implemented in ``experiment.py``.
    reported : callable
        Values by their names in a verdict: name to (value, unit).
    """

    name: str
    group: str
    answers: tuple[str, ...]
    place: str | None
    side: str | None
    pooling: str | None
    start: Callable[[np.random.Generator], Values]
    power: Mapping[str, float] = field(default_factory=dict)
    spread: Mapping[str, float] = field(default_factory=dict)
    body: Body | None = None
    rig: OnRig | None = None
    special: str = ""
    reported: Reported = lambda _values: {}

    def values(self, start: Mapping[str, float], size: float) -> Values:
        """Parameters of somebody average at a size."""
        return {name: value * size ** self.power.get(name, 0.0) for name, value in start.items()}


def fixed(**values: float) -> Callable[[np.random.Generator], Values]:
    return lambda _rng: dict(values)


def between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def reported_as(**units: str) -> Reported:
    """Parameters that a verdict calls by the same name."""
    return lambda values: {name: (values[name], unit) for name, unit in units.items()}


def on_rig(**fields: str) -> OnRig:
    """Put values into fields of the rig."""

    def act(rig: Rig, v: Mapping[str, float]) -> Rig:
        values: dict[str, Any] = {name: v[value] for name, value in fields.items()}
        return replace(rig, **values)

    return act
