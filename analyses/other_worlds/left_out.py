r"""What a network may leave out: formulas, typical shapes and right names.

Each kind changes the impedance z of a place. Its *size* is the parameter that is drawn by strength; the others are its
shape. A kind of the catalogue has the catalogue's id as its only right name. Kinds ``outside`` have no entry:

- ``outside.free_line``: a mass is a line with a free end, :math:`s m\,\tanh(x)/x`, :math:`x = \sqrt{s^2 m n}`;
- ``outside.squeeze_film``: a film of liquid that is squeezed out between plates,
  :math:`z + r\sum_{k\ \mathrm{odd}} \frac{96}{\pi^4 k^4}\frac{1}{1 + s\tau/k^2}`;
- ``outside.diffusion``: a layer through which something diffuses, :math:`z + r \tanh\sqrt{s\tau}/\sqrt{s\tau}`;
- ``outside.semi_inductance``: eddy currents behind a moving coil, :math:`z + c s^a`, 0.4 < a < 0.8;
- ``outside.echo``: a reflection in the cable or the floor, :math:`z\,(1 + g\,e^{-sT})`;
- ``outside.fractional_zener``: :math:`z + c s^{a-1}/(1 + (s\tau)^a)`; a springpot that ends in a spring;
- ``outside.stiffening``: a spring that is stiffer the further it moves (``drawn_worlds.py`` solves for the amplitude).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

Values = Mapping[str, np.ndarray]
Form = Callable[[np.ndarray, np.ndarray, Values], np.ndarray]
"""s (F,), impedance of the place (..., F) and parameters (..., 1) to the changed impedance."""


@dataclass(frozen=True)
class Setting:
    """What sizes and shapes are drawn by: ends of the band in Hz, and the median of abs(z) at the place."""

    low_hz: float
    high_hz: float
    level: float

    @property
    def middle(self) -> float:
        """Angular frequency in the middle of the band, rad/s."""
        return float(2 * np.pi * np.sqrt(self.low_hz * self.high_hz))

    def inside_hz(self, rng: np.random.Generator, margin: float = 0.2) -> float:
        """A frequency within the band, away from its ends by a part of its logarithm."""
        return float(self.low_hz * (self.high_hz / self.low_hz) ** rng.uniform(margin, 1 - margin))


@dataclass(frozen=True)
class Kind:
    """A kind of missing physics.

    Attributes
    ----------
    id : str
        Of the catalogue, or ``outside...``.
    side : str
    where : {"port", "beside", "spring", "mass", "element"}
        At which places it may stand.
    size : str
        Name of the parameter that is drawn by strength.
    form : function
    start : function
        Parameters of a typical size, from generator and setting.
    signed : bool
        Whether the size is negative as often as positive.
    some : bool
        Whether only some people have it.
    absorbed_by : str
        Kinds of element that would take up all of it at the same place.
    weight : float
        Relative frequency within its group.
    """

    id: str
    side: str
    where: str
    size: str
    form: Form
    start: Callable[[np.random.Generator, Setting], dict[str, float]]
    signed: bool = False
    some: bool = False
    absorbed_by: str = ""
    weight: float = 1.0


def _lag(z: np.ndarray, factor: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A factor for positive x, its inverse for negative."""
    return np.where(x > 0, z * factor, z / factor)


def _highpass(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    return _lag(z, s / (s + 2 * np.pi * np.abs(p["corner"])), p["corner"])


def _lowpass(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    return _lag(z, 1 / (1 + s * np.abs(p["time_constant"])), p["time_constant"])


def _resonator(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    w0 = 2 * np.pi * p["frequency"]
    spring_and_damper = p["mass"] * (w0**2 / s + 2 * p["damping_ratio"] * w0)
    return z + 1 / (1 / (s * p["mass"]) + 1 / spring_and_damper)


def _line(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    x = np.sqrt(s * p["mass"] / z)
    return z * x / np.tanh(x)


def _drift(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    w, law = np.abs(s), p["time_law"]
    low, high = w.min(), w.max()
    return z * np.exp(p["change"] * (1 - (w / low) ** -law) / (1 - (high / low) ** -law))


def _reflex(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    return z + p["stiffness"] * np.exp(-s * p["latency"]) / (s * (1 + s / (2 * np.pi * p["corner"])))


def _layer(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    return 1 / (1 / z + s * p["compliance"] / (1 + s * p["time_constant"]))


def _free_line(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    x = np.sqrt(s * z * p["compliance"])
    return z * np.tanh(x) / x


def _squeeze_film(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    film = sum(96 / np.pi**4 / k**4 / (1 + s * p["time_constant"] / k**2) for k in range(1, 40, 2))
    return z + p["damping"] * film


def _diffusion(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    x = np.sqrt(s * p["time_constant"])
    return z + p["damping"] * np.tanh(x) / x


def _fractional_zener(s: np.ndarray, z: np.ndarray, p: Values) -> np.ndarray:
    a = p["exponent"]
    return z + p["coefficient"] * s ** (a - 1) / (1 + (s * p["time_constant"]) ** a)


def _resonance_start(rng: np.random.Generator, at: Setting) -> dict[str, float]:
    ratio = float(np.exp(rng.uniform(np.log(0.04), np.log(0.4))))
    return {"mass": at.level / at.middle, "frequency": at.inside_hz(rng), "damping_ratio": ratio}


def _time(rng: np.random.Generator, at: Setting) -> float:
    return 1 / (2 * np.pi * at.inside_hz(rng))


KINDS = {
    kind.id + (":element" if kind.id == "body.springpot" and kind.where == "spring" else ""): kind
    for kind in (
        Kind(
            "rig.mass", "rig", "port", "mass", lambda s, z, p: z + s * p["mass"],
            lambda _, at: {"mass": at.level / at.middle}, signed=True, absorbed_by="m",
        ),
        Kind(
            "rig.damping", "rig", "port", "damping", lambda s, z, p: z + p["damping"] + 0 * s,
            lambda _, at: {"damping": at.level}, signed=True, absorbed_by="r",
        ),
        Kind(
            "rig.stiffness", "rig", "port", "stiffness", lambda s, z, p: z + p["stiffness"] / s,
            lambda _, at: {"stiffness": at.level * at.middle}, signed=True, absorbed_by="n",
        ),
        Kind(
            "rig.delay", "rig", "port", "delay", lambda s, z, p: z * np.exp(-s * p["delay"]),
            lambda _, at: {"delay": 1 / (2 * np.pi * at.high_hz)}, signed=True,
        ),
        Kind("rig.highpass", "rig", "port", "corner", _highpass, lambda _, at: {"corner": at.low_hz}, signed=True),
        Kind(
            "rig.lowpass", "rig", "port", "time_constant", _lowpass,
            lambda _, at: {"time_constant": 1 / (2 * np.pi * at.high_hz)}, signed=True,
        ),
        Kind(
            "rig.series_compliance", "rig", "port", "compliance", lambda s, z, p: 1 / (1 / z + s * p["compliance"]),
            lambda _, at: {"compliance": 1 / (at.level * at.middle)},
        ),
        Kind("rig.resonance", "rig", "port", "mass", _resonator, _resonance_start),
        Kind(
            "body.mass", "body", "beside", "mass", lambda s, z, p: z + s * p["mass"],
            lambda _, at: {"mass": at.level / at.middle}, absorbed_by="m",
        ),
        Kind(
            "body.springpot", "body", "spring", "exponent",
            lambda s, z, p: z * (s / p["middle"]) ** p["exponent"],
            lambda _, at: {"exponent": 0.1, "middle": at.middle},
        ),
        Kind(
            "body.springpot", "body", "beside", "coefficient",
            lambda s, z, p: z + p["coefficient"] * s ** (p["exponent"] - 1),
            lambda rng, at: _beside_power(at, float(rng.uniform(0.2, 0.8))),
        ),
        Kind(
            "body.hysteresis", "body", "spring", "loss_factor", lambda s, z, p: z * (1 + 1j * p["loss_factor"]) + 0 * s,
            lambda _rng, _at: {"loss_factor": 0.1},
        ),
        Kind(
            "body.relaxation", "body", "beside", "damping",
            lambda s, z, p: z + p["damping"] / (1 + s * p["time_constant"]),
            lambda rng, at: {"damping": at.level, "time_constant": _time(rng, at)},
        ),
        Kind("body.resonator", "body", "beside", "mass", _resonator, _resonance_start),
        Kind("body.line", "body", "spring_group", "mass", _line, lambda _, at: {"mass": at.level / at.middle}),
        Kind(
            "body.bypass", "body", "port", "damping", lambda s, z, p: z + p["damping"] + p["stiffness"] / s,
            lambda rng, at: {"damping": at.level, "stiffness": at.level / _time(rng, at)}, absorbed_by="nr",
        ),
        Kind(
            "body.reflex", "body", "beside", "stiffness", _reflex,
            lambda rng, at: {
                "stiffness": at.level * at.middle,
                "latency": float(rng.choice([0.029, 0.051]) * np.exp(0.1 * rng.normal())),
                "corner": float(rng.uniform(4, 15)),
            },
        ),
        Kind(
            "body.drift", "body", "element", "change", _drift,
            lambda rng, _at: {"change": 0.1, "time_law": float(rng.choice([0.05, 1.0]))}, signed=True,
        ),
        Kind(
            "body.subgroup", "body", "port", "compliance", _layer,
            lambda rng, at: {"compliance": 1 / (at.level * at.middle), "time_constant": _time(rng, at)}, some=True,
        ),
        Kind(
            "outside.free_line", "body", "mass", "compliance", _free_line,
            lambda _, at: {"compliance": 1 / (at.level * at.middle)},
        ),
        Kind(
            "outside.squeeze_film", "body", "beside", "damping", _squeeze_film,
            lambda rng, at: {"damping": at.level, "time_constant": _time(rng, at)},
        ),
        Kind(
            "outside.diffusion", "body", "beside", "damping", _diffusion,
            lambda rng, at: {"damping": at.level, "time_constant": _time(rng, at)},
        ),
        Kind(
            "outside.semi_inductance", "rig", "port", "coefficient",
            lambda s, z, p: z + p["coefficient"] * s ** p["exponent"],
            lambda rng, at: (lambda a: {"coefficient": at.level / at.middle**a, "exponent": a})(rng.uniform(0.4, 0.8)),
        ),
        Kind(
            "outside.echo", "rig", "port", "gain", lambda s, z, p: z * (1 + p["gain"] * np.exp(-s * p["time"])),
            lambda rng, at: {"gain": 0.1, "time": 1 / at.inside_hz(rng, 0.35)},
        ),
        Kind(
            "outside.fractional_zener", "body", "beside", "coefficient",
            _fractional_zener,
            lambda rng, at: _beside_power(at, float(rng.uniform(0.3, 0.8))) | {"time_constant": _time(rng, at)},
        ),
    )
}  # fmt: skip
"""Every kind that is a change of a place's impedance."""


def _beside_power(at: Setting, exponent: float) -> dict[str, float]:
    return {"coefficient": at.level * at.middle ** (1 - exponent), "exponent": exponent}


ELSEWHERE = {
    "rig.mains": "rig",
    "body.covariate": "body",
    "body.drift:repetitions": "body",
    "outside.stiffening": "body",
}
"""Kinds with another way to act, and their sides (``drawn_worlds.py``)."""

FIXED = ("middle",)
"""Parameters that are constants of the formula: the same for everybody."""
