"""Whether what a verdict claims is the same curve in the band as what is true.

The claimed network with the claimed entries, all parameters free in every recording (more than any claim could ask
for), is fitted to noise-free recordings. It is the same curve if less than six standard errors are left, or less than
3 % of what the network alone leaves: a claim that explains 97 % has the shape of the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from drawn_worlds import World, conduct
from left_out import KINDS
from visible import VISIBLE, Claim, standard_errors

SMALL_SHARE = 0.03


def claims_of(world: World, verdict: Mapping[str, Any]) -> list[Claim] | None:
    """Claims that this world can compute; None if there is another one among them."""
    found = []
    middle = float(2 * np.pi * np.sqrt(world.frequency_hz[0] * world.frequency_hz[-1]))
    for entry in verdict["physics"]:
        name = entry["id"]
        if name == "body.springpot" and "becomes" in str(entry.get("formula")):
            name += ":element"
        if name not in KINDS or entry.get("pooling") == "some":
            return None
        values = {k: v["median"] for k, v in entry["parameters"].items() if v.get("median")}
        wanted = _parameters(name)
        if not wanted <= set(values):
            return None
        own = {k: float(values[k]) for k in wanted}
        found.append(Claim(name, entry["place"], own | ({"middle": middle} if name.endswith(":element") else {})))
    return found


def _parameters(name: str) -> set[str]:
    return {
        "rig.mass": {"mass"},
        "rig.damping": {"damping"},
        "rig.stiffness": {"stiffness"},
        "rig.delay": {"delay"},
        "rig.highpass": {"corner"},
        "rig.lowpass": {"time_constant"},
        "rig.series_compliance": {"compliance"},
        "rig.resonance": {"mass", "frequency", "damping_ratio"},
        "body.mass": {"mass"},
        "body.springpot:element": {"exponent"},
        "body.springpot": {"coefficient", "exponent"},
        "body.hysteresis": {"loss_factor"},
        "body.relaxation": {"damping", "time_constant"},
        "body.resonator": {"mass", "frequency", "damping_ratio"},
        "body.line": {"mass"},
        "body.bypass": {"damping", "stiffness"},
        "body.reflex": {"stiffness", "latency", "corner"},
        "body.drift": {"change", "time_law"},
    }.get(name, {"not known"})


def same_curve(world: World, verdict: Mapping[str, Any]) -> bool:
    """As in the module's docstring; False if a claim has no formula here."""
    claims = claims_of(world, verdict)
    if not claims:
        return False
    experiment = conduct(world)
    left, before = standard_errors(world, experiment, claims), standard_errors(world, experiment)
    return left < VISIBLE or left**2 < SMALL_SHARE * before**2
