"""The fingertip network at typical elements, and effects added to its catalogue in tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from experiments import entry

from bayes_impedance.diagnosis.catalogue.effect import (
    Effect,
    Scales,
)
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse

NETWORK = parse(PAPER_NETWORK)
FREQUENCY = np.geomspace(5, 5000, 31)
OMEGA = 2 * np.pi * FREQUENCY
S = 1j * OMEGA
CENTRE = np.log([6.76e-7, 61.4, 7.9e-4, 1.52, 1.15e-3, 0.0517, 4.73e-3, 3.82])
THETA = CENTRE + 0.3 * np.random.default_rng(1).normal(size=(3, 8))
"""Three recordings."""

_SIZES = np.abs(Kernel(NETWORK).impedance(CENTRE, FREQUENCY))[[0, 15, 30]]
SCALES = Scales(
    low=OMEGA[0], middle=OMEGA[15], high=OMEGA[30], z_low=_SIZES[0], z_middle=_SIZES[1], z_high=_SIZES[2], unit="N s/m"
)

NAIL = Effect(
    id="body.nail",
    name="nail",
    side="body",
    pooling="varying",
    branch="m-(n|r)",
    connection="beside",
    places=("port", "groups", "elements"),
    formula="z + 1/(1/(s m) + 1/(r + 1/(s n)))",
    story="The nail rides on its bed. It stays behind at high frequencies.",
    look_for="a bump at the resonance",
    separates="a recording with the nail clamped",
    source="ours",
)
PAD = replace(NAIL, id="body.pad", name="pad", branch="r|m", connection="series", formula="1/(1/z + 1/(r + s m))")
CABLE = replace(NAIL, id="rig.cable", name="cable", side="rig", pooling="shared", branch="n-r", places=("port",))
FOOT = replace(CABLE, id="rig.foot", name="foot", branch="n|r", connection="series")
CREEP = replace(NAIL, id="body.creep", name="creep", branch="r1-p1^a1", formula="z + 1/(1/r + s^(1-a)/p)")
GEL = replace(PAD, id="body.gel", name="gel", branch="p1^0.5", formula="1/(1/z + s^0.5/p)")
RUBBER = replace(
    NAIL, id="body.rubber", name="rubber", branch="m1-hysteretic[e1](n1)", formula="z + m and (1 + j e)/(s n)"
)
BRANCHES = (NAIL, PAD, CABLE, FOOT, CREEP, GEL, RUBBER)


def own_name(entry: object) -> str:
    return f"{entry.id} {getattr(entry, 'operation', 'structure')}"  # type: ignore[attr-defined]


def assert_slope(function: Callable[[float], np.ndarray], slope: np.ndarray, relative: np.ndarray) -> None:
    """Derivative at zero from one side, for what is not smooth there (a filter and its inverse).

    The step changes what stands at the place by no more than 1e-3 of it: `relative` is its change per unit. The error
    is that to the third power, and what is lost to rounding.
    """
    h = 1e-3 / np.abs(relative).max()
    f = [function(k * h) for k in range(4)]
    numeric = (-11 * f[0] + 18 * f[1] - 9 * f[2] + 2 * f[3]) / (6 * h)
    error = np.abs(numeric - slope)
    assert np.all(error <= 1e-6 * np.abs(slope) + 1e-14 * np.abs(f[0]) / h)
    # At most places this is not rounding alone.
    assert np.any(1e-14 * np.abs(f[0]) / h < 1e-3 * np.abs(slope))


BEFORE = (
    Addition(effect=entry("body.relaxation"), place="tissue", pooling="varying"),
    Addition(effect=entry("body.hysteresis"), place="n1", pooling="varying"),
    Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
)
