r"""True parameters of an entry of the catalogue where the world's physics is richer than its formula.

The difference of two high-passes is not a high-pass, adhesive under a cap is not a compliance alone, activation of a
muscle in two steps is not one low-pass, and creep that slows down is not a power of the period. The true values of such
an entry are those with which it is nearest to the curves without noise,

.. math:: \hat v = \arg\min_v \sum_{ij} \min_x \left|\frac{z'_{ij} - Z_v(x)}{\sigma_{ij}}\right|^2,

with everybody's elements x free and with the drawn differences between people. A gain of the rig cannot be identified,
so it is part of every number with a unit of impedance.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from forms import EFFECTS
from nearest import nearest
from people import impedance
from scipy.optimize import least_squares
from world.experiment import Experiment
from world.kind import Kind

_PEOPLE = 12
"""People over whom an entry is fitted, evenly spaced among all, which bounds the time of the search."""
_GAIN_POWER = {"kg": 1, "N s/m": 1, "N/m": 1, "N s^a/m": 1, "m/N": -1}
"""Power of the rig's gain in a parameter, by its unit."""

_START = {
    "rig.highpass": lambda v: {"corner": v["size"]},
    "rig.lowpass": lambda v: {"corner": 1 / (2 * np.pi * v["size"])},
    "rig.series_compliance": lambda v: {"compliance": v["size"]},
    "body.drift.sweep": lambda v: {"change": -v["change"], "law": 1.0},
    "body.reflex": lambda v: {"stiffness": v["stiffness"], "latency": v["latency"], "corner": 8.0},
}
"""Where the search begins: the world's values in the entry's terms."""


def true_parameters(experiment: Experiment, kind: Kind, k: int) -> dict[str, tuple[float, str]]:
    """Name in a verdict to true value and unit, for the k-th effect of an experiment."""
    own = kind.reported(experiment.values[k])
    if kind.name in _START:
        own |= _nearest_values(experiment, kind, k)
    gain = 1 + experiment.plan.conditions.gain_error
    return {name: (value * gain ** _GAIN_POWER.get(unit, 0), unit) for name, (value, unit) in own.items()}


def _nearest_values(experiment: Experiment, kind: Kind, k: int) -> dict[str, tuple[float, str]]:
    start = _START[kind.name](experiment.values[k])
    names, place = list(start), str(kind.place)
    rows = np.linspace(0, experiment.plan.n_subjects - 1, _PEOPLE).round().astype(int)
    f, sd = experiment.plan.frequency_hz, experiment.sd[rows]
    x = experiment.fingers.log_elements[rows]
    z = (experiment.alone[k] - experiment.without)[rows] + impedance(x, f)
    drawn = {
        name: np.exp(kind.spread[name] * experiment.fingers.coefficients[k, rows, i, None, None])
        for i, name in enumerate(experiment.values[k])
        if name in kind.spread
    }
    form = _sweep if kind.name == "body.drift.sweep" else EFFECTS[kind.name].form
    assert form is not None  # of all in _START

    def rest(log_factor: np.ndarray) -> np.ndarray:
        values = {n: start[n] * np.exp(a) * drawn.get(n, 1.0) for n, a in zip(names, log_factor, strict=True)}

        def change(s: np.ndarray, at: np.ndarray) -> np.ndarray:
            return form(s, at, values)

        return nearest(x, z, f, sd, {place: change})[1].ravel()

    found = least_squares(rest, np.zeros(len(names)), diff_step=1e-2, xtol=1e-5, max_nfev=12).x
    return _named(kind.name, {n: start[n] * float(np.exp(a)) for n, a in zip(names, found, strict=True)})


def _sweep(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    """Changed by exp(b q), q growing with a power of the period: the catalogue's entry, whatever its power."""
    w = s.imag
    passed = (1 - (w / w.min()) ** -p["law"]) / (1 - (w.max() / w.min()) ** -p["law"])
    return np.asarray(z * np.exp(p["change"] * passed))


def _named(entry: str, v: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    match entry:
        case "rig.highpass":
            return {"corner_hz": (v["corner"], "Hz")}
        case "rig.lowpass":
            return {"time_constant": (1 / (2 * np.pi * v["corner"]), "s")}
        case "rig.series_compliance":
            return {"compliance": (v["compliance"], "m/N")}
        case "body.drift.sweep":
            return {"change": (v["change"], "1"), "time_law": (v["law"], "1")}
        case _:
            return {
                "stiffness": (v["stiffness"], "N/m"),
                "latency": (v["latency"], "s"),
                "corner_hz": (v["corner"], "Hz"),
            }
