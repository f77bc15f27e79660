"""Coefficients of effects: units, transforms from unbounded parameters, and grids of the shapes that are scanned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import choice_in, number_in, text_in

LINKS = ("linear", "log", "logit")
UNITS = ("m", "n", "r", "k", "c", "l", "s", "Hz", "")
"""Units of coefficients, see :class:`Coefficient`."""


_EDGE = 1e-9
"""Nearest that a share comes to zero or one. By choice: an exponent so near is that of a spring or a damper, and a fit
that drives it there must be able to begin from it again."""


_LEAST_DECADES = 2.0
"""Least width of a grid of compliances. By choice: a spring's curve has one compliance, but at its resonances, and at
places inside of the network, the motion is up to ten times larger or smaller."""


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Typical sizes in a dataset: they make coefficients dimensionless.

    Attributes
    ----------
    low, middle, high : float
        Angular frequencies of the band in rad/s; the middle one is the geometric mean.
    z_low, z_middle, z_high : float
        Magnitude of the population's curve there.
    unit : str
        Of the impedance.
    """

    low: float
    middle: float
    high: float
    z_low: float
    z_middle: float
    z_high: float
    unit: str


_RANGES: dict[str, dict[str, float]] = {"linear": {}, "log": {"above": 0.0}, "logit": {"above": 0.0, "below": 1.0}}
"""Bounds of the values of each link."""


@dataclass(frozen=True, repr=False)
class Coefficient(Brief):
    """One parameter of an operation.

    Attributes
    ----------
    name : str
        As in ``verdict.json``.
    unit : str
        ``s``, ``Hz`` (the operation takes rad/s) or nothing; ``m``, ``n``, ``r``, ``k``, ``c``, ``l`` stand for the
        unit of a mass, a compliance, a damper, a stiffness, a power law and a semi-inductance in the dataset's unit.
    link : str
        ``linear`` (x = scale u), ``log`` (positive: exp u) or ``logit`` (between 0 and 1).
    grid : tuple of float, or float
        Values of a shape that are scanned, or their number per decade of the band.
    prior_sd : float
        Of a shape's u, around the place in the grid where the score is highest.
    """

    name: str
    unit: str
    link: str = "linear"
    grid: tuple[float, ...] | float = ()
    prior_sd: float = 1.0

    def __post_init__(self) -> None:
        what = f"coefficient '{text_in(self.name, 'the name of a coefficient')}'"
        if not self.name:
            raise InputError("a coefficient has no name; give it one, as it is to stand in the verdict")
        choice_in(self.unit, f"{what}: unit", UNITS)
        choice_in(self.link, f"{what}: link", LINKS)
        number_in(self.prior_sd, f"{what}: prior_sd", above=0)
        if not isinstance(self.grid, tuple):
            number_in(self.grid, f"{what}: grid (values a decade, or a tuple of values)", above=0)
            return
        for value in self.grid:
            number_in(value, f"{what}: a value of the grid", **_RANGES[self.link])

    def value(self, u: npt.ArrayLike, scales: Scales) -> np.ndarray:
        """Value in the unit of the operation from the unbounded parameter."""
        u = np.asarray(u, dtype=float)
        match self.link:
            case "log":
                return np.asarray(np.exp(u))
            case "logit":
                return np.asarray(1 / (1 + np.exp(-u)))
        return self.scale(scales) * u

    def unbounded(self, value: float, scales: Scales) -> float:
        """Inverse of :meth:`value`."""
        match self.link:
            case "log":
                return float(np.log(value))
            case "logit":
                inside = min(max(value, _EDGE), 1 - _EDGE)
                return float(np.log(inside / (1 - inside)))
        return value / self.scale(scales)

    def within_grid(self, u: float, scales: Scales) -> float:
        """The unbounded parameter of a shape, or the nearest one of its grid if it is outside."""
        grid = [self.unbounded(value, scales) for value in self.values(scales)]
        return min(max(u, min(grid)), max(grid)) if grid else u

    def _compliances(self, scales: Scales) -> tuple[float, ...]:
        """From what the port moves per unit of force at one end of the band to that at the other, or more."""
        assert not isinstance(self.grid, tuple)
        ends = np.log10([1 / (scales.z_low * scales.low), 1 / (scales.z_high * scales.high)])
        width = max(float(abs(ends[1] - ends[0])), _LEAST_DECADES)
        n = max(4, round(self.grid * width) + 1)
        return tuple((10 ** (ends.mean() + width * np.linspace(-0.5, 0.5, n))).tolist())

    def scale(self, scales: Scales) -> float:
        """Value of a linear coefficient that changes the impedance by about its magnitude where the effect peaks."""
        s = scales
        return {
            "m": s.z_high / s.high,
            "r": s.z_middle,
            "c": s.z_middle,
            "l": s.z_middle,
            "k": s.z_low * s.low,
            "n": 1 / (s.z_high * s.high),
            "s": 1 / s.high,
            "Hz": s.low,
        }.get(self.unit, 1.0)

    def values(self, scales: Scales) -> tuple[float, ...]:
        """The shape's values that are scanned, in the unit of the operation."""
        if isinstance(self.grid, tuple):
            return tuple(2 * np.pi * g for g in self.grid) if self.unit == "Hz" else self.grid
        if self.unit == "n":
            return self._compliances(scales)
        n = max(4, round(self.grid * np.log10(scales.high / scales.low)) + 1)
        omega = np.geomspace(scales.low, scales.high, n)
        return tuple((1 / omega if self.unit == "s" else omega).tolist())
