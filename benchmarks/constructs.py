"""Cost of every element and wrapper: impedance and derivative of it alone, relative to a damper alone."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from timing import ratio, seconds_of, spread

from bayes_impedance.network.constructs import CONSTRUCTS, Construct
from bayes_impedance.network.elements import KINDS
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse

_POINTS, _SETS = 401, 64
"""The paper's grid, and sets per call, as a sampler asks for."""

DAMPER = "r1"


def _around_a_damper(construct: Construct, first: str) -> str:
    return f"{construct.word}[{', '.join([first + '2', *(own[0] + '2' for own in construct.letters[1:])])}]({DAMPER})"


NETWORKS = {
    DAMPER: DAMPER,
    **{f"{letter}1": f"{letter}1" for letter in KINDS if f"{letter}1" != DAMPER},
    "r1-n1": "r1-n1",
    "p1^a1": "p1^a1",
    "p1^b1@100": "p1^b1@100",
    "p1^0.5": "p1^0.5",
    **{f"{c.word}[...](r1)": _around_a_damper(c, c.letters[0][0]) for c in CONSTRUCTS.values()},
    **{text: text for c in CONSTRUCTS.values() for first in c.letters[0][1:] for text in [_around_a_damper(c, first)]},
}
"""What is timed, by the name in the table: every element, a group of two for comparison, power laws, every wrapper
around a damper with its first choice of parameter, and with the others."""


def measure() -> dict[str, Any]:
    """Nanoseconds for each frequency, and times those of a damper, of impedance alone and with the derivative."""
    frequency, rng = np.geomspace(5, 5000, _POINTS), np.random.default_rng(1)
    result: dict[str, Any] = {"points": _POINTS, "sets per call": _SETS}
    for what in ("impedance", "derivative"):
        work: dict[str, Callable[[], Any]] = {}
        for name, text in NETWORKS.items():
            kernel = Kernel(parse(text))
            theta = rng.normal(-3, 0.1, (_SETS, len(kernel.elements)))
            work[name] = partial(getattr(kernel, what), theta, frequency)
        seconds = seconds_of(work)
        each = {name: 1e9 * values / (_SETS * _POINTS) for name, values in seconds.items()}
        result[what] = {
            name: {"nanoseconds": spread(values), "times a damper": ratio(values, each[DAMPER])}
            for name, values in each.items()
        }
    return result
