"""All kinds of effects of the world; ``kind.py`` defines what a kind is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from world.kind import Kind, OnRig, Own, Reported, Values, between, fixed, on_rig, reported_as, sign
from world.tissue import (
    causal_hysteresis,
    fractional_zener,
    layer_on_rigid_base,
    poroelastic,
    relaxation_spectrum,
)


def _of_rig(name: str, start: Callable[[np.random.Generator], Values], act: OnRig, reported: Reported) -> Kind:
    return Kind(name, "catalogue", (name,), "port", "rig", "shared", start, {"size": 1}, {}, None, act, "", reported)


def _maxwell(s: np.ndarray, damping: np.ndarray | float, time: np.ndarray | float) -> np.ndarray:
    return np.asarray(damping / (1 + s * time))


def _joint(s: np.ndarray, p: Own) -> np.ndarray:
    return np.asarray(1 / (1 / (s * p["mass"]) + 1 / (p["damping"] + 1 / (s * p["compliance"]))))


def _start_joint(rng: np.random.Generator) -> Values:
    mass, w0 = 1e-3, 2 * np.pi * between(rng, 60, 300)
    return {"mass": mass, "compliance": 1 / (mass * w0**2), "damping": 2 * 0.15 * mass * w0}


def _start_layer(rng: np.random.Generator) -> Values:
    return {"stiffness": 3e5, "time": 1 / (2 * np.pi * between(rng, 150, 600))}


def _layer(s: np.ndarray, z: np.ndarray, p: Own) -> np.ndarray:
    """A callus: a Kelvin-Voigt layer in front of everything."""
    return np.asarray(1 / (1 / z + s / (p["stiffness"] * (1 + s * p["time"]))))


def _muscle(s: np.ndarray, z: np.ndarray, p: Own) -> np.ndarray:
    """Stretch reflex: latency, activation (8 Hz) and calcium (60 Hz) in a row."""
    lag = np.exp(-s * p["latency"]) / ((1 + s / (2 * np.pi * 8)) * (1 + s / (2 * np.pi * 60)))
    return np.asarray(z + p["stiffness"] * lag / s)


def _two_branches(s: np.ndarray, z: np.ndarray, p: Own) -> np.ndarray:
    slow, fast = _maxwell(s, p["slow"], p["slow_time"]), _maxwell(s, p["fast"], p["fast_time"])
    return np.asarray(z + slow + fast)


def _corner_between(low: float) -> Callable[[np.random.Generator], Values]:
    return lambda rng: {"damping": 1.0, "time": 1 / (2 * np.pi * between(rng, low, 4 * low))}


_ALL = [
    _of_rig(
        "rig.mass",
        lambda rng: {"size": sign(rng) * 1e-5},
        on_rig(added_mass="size"),
        lambda v: {"mass": (v["size"], "kg")},
    ),
    _of_rig("rig.damping", fixed(size=0.1), on_rig(added_damping="size"), lambda v: {"damping": (v["size"], "N s/m")}),
    _of_rig(
        "rig.delay",
        lambda rng: {"size": sign(rng) * 1e-6},
        on_rig(skew_s="size"),
        lambda v: {"delay": (v["size"], "s")},
    ),
    _of_rig(
        "rig.highpass",
        fixed(size=0.1),
        lambda rig, v: replace(rig, highpass_hz=(rig.highpass_hz[1] + v["size"], rig.highpass_hz[1])),
        # Far above both corners only their difference has an effect.
        lambda v: {"corner_hz": (v["size"], "Hz")},
    ),
    _of_rig(
        "rig.lowpass",
        fixed(size=1e-6),
        lambda rig, v: replace(
            rig, lowpass_hz=(1 / (1 / rig.lowpass_hz[1] + 2 * np.pi * v["size"]), rig.lowpass_hz[1])
        ),
        lambda v: {"time_constant": (v["size"], "s")},
    ),
    _of_rig(
        "rig.series_compliance",
        fixed(size=1e-7),
        on_rig(adhesive_compliance="size"),
        lambda v: {"compliance": (v["size"], "m/N")},
    ),
    _of_rig(
        "rig.resonance",
        lambda rng: {"size": 1e-4, "frequency": between(rng, 400, 1600)},
        lambda rig, v: replace(rig, mode=(v["size"], v["frequency"], 0.05)),
        lambda v: {"mass": (v["size"], "kg"), "frequency_hz": (v["frequency"], "Hz"), "damping_ratio": (0.05, "1")},
    ),
    Kind(
        "rig.mains",
        "catalogue",
        ("rig.mains",),
        "port",
        "rig",
        "shared",
        fixed(hum_n=1e-4),
        {"hum_n": 1},
        special="hum",
    ),
    *(
        Kind(
            f"body.springpot.{place}",
            "catalogue",
            ("body.springpot",),
            place,
            "body",
            "varying",
            lambda rng: {"coefficient": 10.0, "exponent": float(rng.uniform(0.3, 0.5))},
            {"coefficient": 1},
            {"coefficient": 0.35},
            lambda s, z, p: z + relaxation_spectrum(s, p["coefficient"], p["exponent"]),
            reported=reported_as(coefficient="N s^a/m", exponent="1"),
        )
        for place in ("skin", "tissue")
    ),
    Kind(
        "body.hysteresis",
        "catalogue",
        # A causal loss that is flat over frequency is k s^(2 eta/pi) to first order, which is a springpot.
        ("body.springpot", "body.hysteresis"),
        "n3",
        "body",
        "varying",
        fixed(loss=0.1),
        {"loss": 1},
        {"loss": 0.3},
        lambda s, z, p: z * causal_hysteresis(s, p["loss"], 2 * np.pi * 1e-2),
    ),
    *(
        Kind(
            f"body.relaxation.{place}",
            "catalogue",
            ("body.relaxation",),
            place,
            "body",
            "varying",
            _corner_between(low),
            {"damping": 1},
            {"damping": 0.25, "time": 0.25},
            lambda s, z, p: z + _maxwell(s, p["damping"], p["time"]),
            reported=lambda v: {"damping": (v["damping"], "N s/m"), "time_constant": (v["time"], "s")},
        )
        for place, low in (("tissue", 20.0), ("skin", 500.0))
    ),
    Kind(
        "body.resonator",
        "catalogue",
        ("body.resonator",),
        "tissue",
        "body",
        "varying",
        _start_joint,
        {"mass": 1, "compliance": -1, "damping": 1},
        {"mass": 0.2, "compliance": 0.2, "damping": 0.2},
        lambda s, z, p: z + _joint(s, p),
        reported=lambda v: {
            "mass": (v["mass"], "kg"),
            "frequency_hz": (1 / (2 * np.pi * np.sqrt(v["mass"] * v["compliance"])), "Hz"),
            "damping_ratio": (v["damping"] / 2 * np.sqrt(v["compliance"] / v["mass"]), "1"),
        },
    ),
    Kind(
        "body.mass",
        "catalogue",
        ("body.mass",),
        "port",
        "body",
        "varying",
        fixed(mass=1e-5),
        {"mass": 1},
        {"mass": 0.4},
        lambda s, z, p: z + s * p["mass"],
        reported=reported_as(mass="kg"),
    ),
    Kind(
        "body.line",
        "catalogue",
        ("body.line",),
        "skin",
        "body",
        "varying",
        fixed(mass=1e-4),
        {"mass": 1},
        {"mass": 0.3},
        lambda s, z, p: layer_on_rigid_base(s, p["mass"], z),
        reported=reported_as(mass="kg"),
    ),
    Kind(
        "body.bypass",
        "catalogue",
        ("body.bypass",),
        "port",
        "body",
        "varying",
        fixed(damping=0.1, stiffness=30.0),
        {"damping": 1, "stiffness": 1},
        {"damping": 0.35, "stiffness": 0.35},
        lambda s, z, p: z + p["damping"] + p["stiffness"] / s,
        reported=reported_as(damping="N s/m", stiffness="N/m"),
    ),
    Kind(
        "body.reflex",
        "catalogue",
        ("body.reflex",),
        "limb",
        "body",
        "varying",
        lambda rng: {"stiffness": 30.0, "latency": float(rng.choice([0.029, 0.051]))},
        {"stiffness": 1},
        {"stiffness": 0.35},
        _muscle,
        reported=reported_as(stiffness="N/m"),
    ),
    Kind(
        "body.subgroup",
        "catalogue",
        ("body.subgroup",),
        "port",
        "body",
        "some",
        _start_layer,
        {"stiffness": -1},
        {"stiffness": 0.2, "time": 0.2},
        _layer,
        reported=lambda v: {"compliance": (1 / v["stiffness"], "m/N"), "time_constant": (v["time"], "s")},
    ),
    Kind(
        "body.covariate",
        "catalogue",
        ("body.covariate",),
        "skin",
        "body",
        "shared",
        fixed(),
        special="covariate",
        reported=lambda v: {"slope": (v["exponent"], "1")},
    ),
    Kind("body.drift.session", "catalogue", ("body.drift",), "n1", "body", "shared", fixed(), special="creep.session"),
    Kind(
        "body.drift.sweep",
        "catalogue",
        ("body.drift",),
        "n1",
        "body",
        "varying",
        fixed(change=0.1),
        {"change": 1},
        {"change": 0.2},
        special="creep.sweep",
        reported=reported_as(change="1"),
    ),
    # Physics that no entry has.
    Kind(
        "outside.two_relaxations",
        "outside",
        ("unknown",),
        "tissue",
        "body",
        "varying",
        lambda rng: {
            "slow": 2.0,
            "slow_time": 1 / (2 * np.pi * between(rng, 8, 16)),
            "fast": 1.0,
            "fast_time": 1 / (2 * np.pi * between(rng, 150, 400)),
        },
        {"slow": 1, "fast": 1},
        {"slow": 0.25, "fast": 0.25},
        _two_branches,
    ),
    Kind(
        "outside.fractional_zener",
        "outside",
        ("unknown",),
        "tissue",
        "body",
        "varying",
        lambda rng: {
            "coefficient": 30.0,
            "compliance": 1 / (2 * np.pi * between(rng, 20, 100)) ** 0.6 / 30.0,
            "exponent": 0.6,
        },
        {"coefficient": 1, "compliance": -1},
        {"coefficient": 0.3, "compliance": 0.3},
        lambda s, z, p: z + fractional_zener(s, p["compliance"], p["coefficient"], float(p["exponent"])),
    ),
    Kind(
        "outside.poroelastic",
        "outside",
        ("unknown",),
        "tissue",
        "body",
        "varying",
        lambda rng: {"stiffness": 1e3, "time": 1 / (2 * np.pi * between(rng, 2, 20))},
        {"stiffness": 1},
        {"stiffness": 0.3, "time": 0.2},
        lambda s, z, p: z + poroelastic(s, p["stiffness"], p["time"]),
    ),
    Kind(
        "outside.pad",
        "outside",
        ("unknown",),
        "port",
        "rig",
        "shared",
        lambda rng: {"mass": 2e-5, "compliance": 2e-7, "loss": float(rng.uniform(0.2, 0.6))},
        {"mass": 1, "compliance": 1},
        rig=lambda rig, v: replace(rig, pad=(v["mass"], v["compliance"], v["loss"])),
    ),
    Kind(
        "outside.friction",
        "outside",
        ("unknown",),
        "tissue",
        "body",
        "varying",
        lambda rng: {"stiffness": 1e3, "breakaway_m": between(rng, 1e-6, 1e-5)},
        {"stiffness": 1},
        {"stiffness": 0.3},
        special="friction",
    ),
    Kind(
        "outside.crosstalk",
        "outside",
        ("unknown",),
        "port",
        "rig",
        "shared",
        lambda rng: {"leak": 0.05, "frequency": between(rng, 150, 1500), "ratio": 0.3},
        {"leak": 1},
        special="crosstalk",
    ),
    # Effects that such recordings cannot show.
    Kind("trap.gain", "trap", (), None, None, None, lambda rng: {"gain": sign(rng) * float(rng.uniform(0.05, 0.15))}),
    Kind("trap.centre", "trap", (), None, None, None, fixed(shift=0.3), special="centre"),
    *(
        Kind(
            f"trap.{what}",
            "trap",
            (),
            place,
            "body",
            "varying",
            fixed(size=1.0),
            {"size": 1},
            {"size": 0.3},
            form,
        )
        for what, place, form in (
            ("spring", "tissue", lambda s, z, p: z + p["size"] / s),
            ("mass", "tissue", lambda s, z, p: z + s * p["size"]),
            ("damper", "tissue", lambda _s, z, p: z + p["size"]),
        )
    ),
    Kind(
        "trap.port_stiffness",
        "trap",
        (),
        "port",
        "rig",
        "shared",
        fixed(size=10.0),
        {"size": 1},
        rig=on_rig(added_stiffness="size"),
    ),
    Kind("nothing", "nothing", (), None, None, None, fixed()),
    Kind("nothing.correlated", "nothing", (), None, None, None, fixed(), special="correlation"),
]

KINDS: dict[str, Kind] = {kind.name: kind for kind in _ALL}

PAIRS = (
    ("rig.delay", "body.springpot.skin"),
    ("rig.highpass", "body.mass"),
    ("rig.mass", "body.resonator"),
    ("rig.resonance", "body.relaxation.skin"),
    ("body.reflex", "rig.series_compliance"),
    ("rig.highpass", "body.line"),
)
"""Pairs of effects whose bands differ at least in part."""
