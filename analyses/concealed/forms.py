r"""The concealed effects, one formula each: what was left out, where, and for whom.

An effect changes the impedance at one place, z_p -> form(s, z_p, p). For an average person the parameters p are
``start`` times ``size ** power``. One number, the size, scales the effect and keeps its shape (its corner, its
resonance). Where an effect varies, each parameter is log-normal between persons with the log sd ``spread``,
independently of the others and of the elements.

=====================  ==============================================================================================
id                     form
=====================  ==============================================================================================
rig.mass               z + s m, of either sign: subtracted too little or too much
rig.damping            z + r
rig.stiffness          z + k/s
rig.delay              z exp(-s tau)
rig.highpass           z s/(s + wc)
rig.lowpass            z/(1 + s/wc)
rig.series_compliance  1/(1/z + s n)
rig.resonance          z + 1/(1/(s m) + 1/(r + k/s)), k = m w0^2, r = 2 zeta m w0
rig.mains              z + a exp(j phi) within 1 % of the first ten harmonics of 50 Hz, phi uniform
body.springpot         z_p + c s^(a-1)
body.hysteresis        z_p (1 + j eta), z_p a spring
body.relaxation        z_p + 1/(1/r + s n)
body.resonator         z_p + 1/(1/(s m) + 1/(r + 1/(s n)))
body.mass              z + s m
body.line              z_p x coth x, x^2 = s M/z_p
body.bypass            z + r + 1/(s n)
body.reflex            z_p + k exp(-s T)/s/(1 + s/wc), wc = 2 pi 8 Hz
body.covariate         ln n3 - b ln F, ln r3 + b ln F with the contact force F
body.subgroup          1/(1/z + 1/(r + 1/(s n))) for 30 % of the people
body.drift             ln x + b (repetition - 1), for everybody
body.drift.sweep       z_p exp(b q), q the part of the sweep's time that has passed: of the octaves or of the periods
body.correlation       nothing: the elements are strongly correlated
none                   nothing
=====================  ==============================================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

PARAMETERS: dict[str, dict[str, tuple[str, str]]] = {
    "rig.mass": {"mass": ("mass", "kg")},
    "rig.damping": {"damping": ("damping", "N s/m")},
    "rig.stiffness": {"stiffness": ("stiffness", "N/m")},
    "rig.delay": {"delay": ("delay", "s")},
    "rig.highpass": {"corner": ("corner_hz", "Hz")},
    "rig.lowpass": {"corner": ("corner_hz", "Hz")},
    "rig.series_compliance": {"compliance": ("compliance", "m/N")},
    "rig.resonance": {"mass": ("mass", "kg"), "frequency": ("frequency_hz", "Hz"), "ratio": ("damping_ratio", "1")},
    "rig.mains": {"amplitude": ("amplitude", "N s/m")},
    "body.springpot": {"coefficient": ("coefficient", "N s^a/m"), "exponent": ("exponent", "1")},
    "body.hysteresis": {"loss": ("loss_factor", "1")},
    "body.relaxation": {"damping": ("damping", "N s/m"), "compliance": ("compliance", "m/N")},
    "body.resonator": {
        "mass": ("mass", "kg"),
        "compliance": ("compliance", "m/N"),
        "damping": ("damping", "N s/m"),
    },
    "body.mass": {"mass": ("mass", "kg")},
    "body.line": {"mass": ("mass", "kg")},
    "body.bypass": {"damping": ("damping", "N s/m"), "compliance": ("compliance", "m/N")},
    "body.reflex": {"stiffness": ("stiffness", "N/m"), "latency": ("latency", "s")},
    "body.covariate": {"slope": ("slope", "1")},
    "body.subgroup": {
        "fraction": ("fraction", "1"),
        "damping": ("damping", "N s/m"),
        "compliance": ("compliance", "m/N"),
    },
    "body.drift": {"trend": ("trend", "1/repetition")},
    "body.drift.sweep": {"change": ("change", "1")},
    "body.correlation": {},
    "none": {},
}
"""For each effect: name used here -> (name in a verdict, unit). If a verdict's names change, change this and
:func:`equivalents`."""

HARMONICS_HZ = 50.0 * np.arange(1, 11)
"""The first ten harmonics of European mains."""
REFLEX_CORNER_HZ = 8.0
"""Activation of a muscle as a low-pass of first order."""
FRACTION = 0.3
"""Share of people in a subgroup: 6 of 20, so that even small datasets have some."""

Values = dict[str, float]
Form = Callable[[np.ndarray, np.ndarray, Mapping[str, np.ndarray]], np.ndarray]
Start = Callable[[np.random.Generator, str], Values]


@dataclass(frozen=True)
class Effect:
    """How an effect is made.

    Attributes
    ----------
    places : tuple of str
        Where it may be concealed; they take turns with the seed.
    pooling : str
        ``shared``, ``varying``, ``some`` or ``none``.
    start : callable (rng, place) -> dict
        Parameters at size 1: their shape is drawn at random.
    power : mapping of str to float
        Parameter = start * size ** power; the power is 0 where it is not named.
    spread : mapping of str to float
        Log sd between persons; 0 where it is not named.
    form : callable or None
        None for effects that do not act on the curve of one place.
    """

    places: tuple[str, ...]
    pooling: str
    start: Start
    power: Mapping[str, float] = field(default_factory=dict)
    spread: Mapping[str, float] = field(default_factory=dict)
    form: Form | None = None

    def values(self, start: Mapping[str, float], size: float) -> Values:
        """Parameters of somebody average at a size."""
        return {name: value * size ** self.power.get(name, 0.0) for name, value in start.items()}


def _constant(**values: float) -> Start:
    return lambda _rng, _place: dict(values)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _branch(s: np.ndarray, mass: np.ndarray, damping: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """A mass that hangs on a spring and damper: mobilities add."""
    return np.asarray(1 / (1 / (s * mass) + 1 / (damping + stiffness / s)))


def _fixture(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    w0 = 2 * np.pi * p["frequency"]
    return z + _branch(s, p["mass"], 2 * p["ratio"] * w0 * p["mass"], p["mass"] * w0**2)


def _line(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    # x coth x is even in x: which of the two roots is taken does not matter.
    x = np.sqrt(s * p["mass"] / z)
    return z * x / np.tanh(x)


def _reflex(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    lag = np.exp(-s * p["latency"]) / (1 + s / (2 * np.pi * p.get("corner", REFLEX_CORNER_HZ)))
    return z + p["stiffness"] * lag / s


def _signed_mass(rng: np.random.Generator, _place: str) -> Values:
    return {"mass": float(rng.choice([-1.0, 1.0])) * 1e-5}


def _start_resonance(rng: np.random.Generator, _place: str) -> Values:
    return {"mass": 1e-4, "frequency": _log_uniform(rng, 400, 1600), "ratio": 0.05}


def _start_springpot(rng: np.random.Generator, _place: str) -> Values:
    return {"coefficient": 10.0, "exponent": float(rng.uniform(0.3, 0.5))}


def _start_relaxation(rng: np.random.Generator, place: str) -> Values:
    # The corner lies where the place dominates the port's impedance: tissue below, skin above some hundred hertz.
    low, high, damping = (20.0, 80.0, 0.3) if place == "tissue" else (500.0, 2000.0, 5.0)
    return {"damping": damping, "compliance": 1 / (2 * np.pi * _log_uniform(rng, low, high) * damping)}


def _start_resonator(rng: np.random.Generator, _place: str) -> Values:
    mass, w0 = 1e-3, 2 * np.pi * _log_uniform(rng, 60, 300)
    return {"mass": mass, "compliance": 1 / (mass * w0**2), "damping": 2 * 0.15 * mass * w0}


def _start_layer(rng: np.random.Generator, _place: str) -> Values:
    damping = 1e3
    return {"damping": damping, "compliance": 1 / (2 * np.pi * _log_uniform(rng, 150, 600) * damping)}


def _layer(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    return 1 / (1 / z + 1 / (p["damping"] + 1 / (s * p["compliance"])))


def _start_sweep(rng: np.random.Generator, _place: str) -> Values:
    return {"change": float(rng.choice([-1.0, 1.0])) * 0.1, "same_periods": float(rng.integers(2))}


def _sweep(s: np.ndarray, z: np.ndarray, p: Mapping[str, np.ndarray]) -> np.ndarray:
    w = s.imag
    octaves = np.log(w / w.min()) / np.log(w.max() / w.min())
    periods = (1 / w.min() - 1 / w) / (1 / w.min() - 1 / w.max())
    return z * np.exp(p["change"] * np.where(p["same_periods"] > 0.5, periods, octaves))


EFFECTS: dict[str, Effect] = {
    "rig.mass": Effect(("port",), "shared", _signed_mass, {"mass": 1}, form=lambda s, z, p: z + s * p["mass"]),
    "rig.damping": Effect(
        ("port",), "shared", _constant(damping=0.1), {"damping": 1}, form=lambda _s, z, p: z + p["damping"]
    ),
    "rig.stiffness": Effect(
        ("port",), "shared", _constant(stiffness=30.0), {"stiffness": 1}, form=lambda s, z, p: z + p["stiffness"] / s
    ),
    "rig.delay": Effect(
        ("port",), "shared", _constant(delay=1e-6), {"delay": 1}, form=lambda s, z, p: z * np.exp(-s * p["delay"])
    ),
    "rig.highpass": Effect(
        ("port",),
        "shared",
        _constant(corner=0.1),
        {"corner": 1},
        form=lambda s, z, p: z * s / (s + 2 * np.pi * p["corner"]),
    ),
    "rig.lowpass": Effect(
        ("port",),
        "shared",
        _constant(corner=1e5),
        {"corner": -1},
        form=lambda s, z, p: z / (1 + s / (2 * np.pi * p["corner"])),
    ),
    "rig.series_compliance": Effect(
        ("port",),
        "shared",
        _constant(compliance=1e-7),
        {"compliance": 1},
        form=lambda s, z, p: 1 / (1 / z + s * p["compliance"]),
    ),
    "rig.resonance": Effect(("port",), "shared", _start_resonance, {"mass": 1}, form=_fixture),
    "rig.mains": Effect(("port",), "shared", _constant()),
    "body.springpot": Effect(
        ("skin", "tissue"),
        "varying",
        _start_springpot,
        {"coefficient": 1},
        {"coefficient": 0.35},
        lambda s, z, p: z + p["coefficient"] * s ** (p["exponent"] - 1),
    ),
    "body.hysteresis": Effect(
        ("n1", "n3"),
        "varying",
        _constant(loss=0.1),
        {"loss": 1},
        {"loss": 0.3},
        lambda _s, z, p: z * (1 + 1j * p["loss"]),
    ),
    "body.relaxation": Effect(
        ("tissue", "skin"),
        "varying",
        _start_relaxation,
        {"damping": 1, "compliance": -1},
        {"damping": 0.25, "compliance": 0.25},
        lambda s, z, p: z + 1 / (1 / p["damping"] + s * p["compliance"]),
    ),
    "body.resonator": Effect(
        ("tissue",),
        "varying",
        _start_resonator,
        {"mass": 1, "compliance": -1, "damping": 1},
        {"mass": 0.2, "compliance": 0.2, "damping": 0.2},
        lambda s, z, p: z + _branch(s, p["mass"], p["damping"], 1 / p["compliance"]),
    ),
    "body.mass": Effect(
        ("port",), "varying", _constant(mass=1e-5), {"mass": 1}, {"mass": 0.4}, lambda s, z, p: z + s * p["mass"]
    ),
    "body.line": Effect(("skin", "tissue"), "varying", _constant(mass=1e-4), {"mass": 1}, {"mass": 0.3}, form=_line),
    "body.bypass": Effect(
        ("port",),
        "varying",
        _constant(damping=0.1, compliance=1 / (2 * np.pi * 50 * 0.1)),
        {"damping": 1, "compliance": -1},
        {"damping": 0.35, "compliance": 0.35},
        lambda s, z, p: z + p["damping"] + 1 / (s * p["compliance"]),
    ),
    "body.reflex": Effect(
        ("limb",),
        "varying",
        _constant(stiffness=30.0, latency=0.029),
        {"stiffness": 1},
        {"stiffness": 0.35},
        _reflex,
    ),
    "body.covariate": Effect(("skin",), "shared", _constant()),
    "body.subgroup": Effect(
        ("port",),
        "some",
        _start_layer,
        {"damping": -1, "compliance": 1},
        {"damping": 0.2, "compliance": 0.2},
        _layer,
    ),
    "body.drift": Effect(("n1", "n3", "r1"), "shared", _constant()),
    "body.drift.sweep": Effect(("n3", "r3", "n1"), "varying", _start_sweep, {"change": 1}, {"change": 0.2}, _sweep),
    "body.correlation": Effect(("port",), "none", _constant()),
    "none": Effect(("port",), "none", _constant()),
}

VERDICT_ID = {"body.drift.sweep": "body.drift"}
"""Id in a verdict, where an effect has several forms here."""

NOTHING = ("none", "body.correlation")
"""Effects that conceal nothing: the right answer is "nothing missing"."""


def equivalents(effect_id: str, v: Mapping[str, float]) -> dict[str, tuple[float, str]]:
    """Equivalent numbers of an effect's parameters: name in a verdict to (value, unit).

    Medians of products of log-normal numbers are products of their medians, so these are medians too.
    """
    match effect_id:
        case "rig.lowpass":
            return {"time_constant": (1 / (2 * np.pi * v["corner"]), "s")}
        case "body.relaxation" | "body.subgroup":
            return {"time_constant": (v["damping"] * v["compliance"], "s")}
        case "body.resonator":
            return {
                "frequency_hz": (1 / (2 * np.pi * np.sqrt(v["mass"] * v["compliance"])), "Hz"),
                "damping_ratio": (v["damping"] / 2 * np.sqrt(v["compliance"] / v["mass"]), "1"),
            }
        case "rig.resonance":
            w0 = 2 * np.pi * v["frequency"]
            return {
                "damping": (2 * v["ratio"] * w0 * v["mass"], "N s/m"),
                "compliance": (1 / (v["mass"] * w0**2), "m/N"),
            }
        case "body.bypass":
            return {"stiffness": (1 / v["compliance"], "N/m")}
        case "body.reflex":
            return {"corner_hz": (REFLEX_CORNER_HZ, "Hz")}
    return {}


_SAME_PARALLEL = (("tissue", "m2", "r1", "n1", "limb"), ("skin", "n3", "r3"), ("n2|r2", "n2", "r2"))
_SAME_SERIES = (("port", "skin", "tissue"), ("limb", "m1", "n2|r2"))
_BESIDE = ("body.springpot", "body.relaxation", "body.resonator", "body.reflex")


def same_places(effect_id: str, place: str) -> tuple[str, ...]:
    """Places at which the effect gives an equivalent network; the given place is the first.

    An addition beside one part of a parallel group is beside all of them, and a layer in series with the port is in
    series with skin and tissue. A change *of* an element (hysteresis, drift) has no equivalent place. A covariate at a
    group may be named by any of the elements that follow it.
    """
    groups: tuple[tuple[str, ...], ...] = ()
    if effect_id in _BESIDE:
        groups = _SAME_PARALLEL
    elif effect_id in ("body.subgroup", "rig.series_compliance"):
        groups = _SAME_SERIES
    elif effect_id == "body.covariate":
        groups = (("skin", "n3", "r3"),)
    same = next((group for group in groups if place in group), ())
    return (place, *(other for other in same if other != place))
