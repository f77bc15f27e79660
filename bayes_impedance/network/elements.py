r"""The three kinds of element of a mechanical one-port.

With velocity ``v`` and force ``F`` as phasors of :math:`e^{+j\omega t}` and :math:`s = j\omega`, Newton, Hooke and
a linear damper give

.. math:: z_m = s\,m, \qquad z_n = \frac{1}{s\,n}, \qquad z_r = r,

where the compliance is :math:`n = 1/k`. All three are monomials, :math:`z = x^{\pm 1} s^{p}` with
:math:`p \in \{1, -1, 0\}`, so on a logarithmic scale :math:`\theta = \ln x` the derivative is the impedance itself:

.. math:: \frac{\partial z}{\partial \theta} = \pm z .

The package therefore uses the logarithms of the elements throughout: the elements are always positive, the
derivatives need no further computation, and "20 % between persons" means the same for a mass and for a compliance.

By the force-voltage analogy (V = F, I = v) the same formulas apply to electrical recordings: m is an inductance, n a
capacitance, r a resistance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.units import unit_of


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A kind of element: mass, compliance or damper.

    Attributes
    ----------
    letter : str
        First letter of the names of such elements: ``m``, ``n`` or ``r``.
    name : str
        Name of the kind.
    exponent : int
        +1 if the impedance is proportional to the value, -1 if it is inversely proportional (a compliance).
    power : int
        Power of s in the impedance.
    story : str
        One sentence of explanation for the report.
    source : str
        Where the formula is from.
    """

    letter: str
    name: str
    exponent: int
    power: int
    story: str
    source: str

    def impedance(self, s: npt.ArrayLike, value: npt.ArrayLike) -> np.ndarray:
        """Impedance at complex frequency s.

        Parameters
        ----------
        s : array_like, complex
            Complex frequency in rad/s.
        value : array_like
            Value of the element in its unit; broadcast against `s`.

        Returns
        -------
        ndarray
            z in the impedance's unit.
        """
        s, value = np.asarray(s), np.asarray(value)
        s = s.astype(float) if s.dtype.kind == "i" else s  # numpy's integers have no negative powers
        return np.asarray(s**self.power * (value if self.exponent > 0 else 1.0 / value))

    def value_at(self, magnitude: float, frequency_hz: float) -> float:
        """Value whose impedance has the given magnitude at the given frequency: a scale for priors and starts."""
        log_value = (np.log(magnitude) - self.power * np.log(2 * np.pi * frequency_hz)) / self.exponent
        return float(np.exp(log_value))

    def unit(self, impedance_unit: str) -> str:
        """Unit of the element's value, given the unit of the impedance."""
        return unit_of(self.letter, impedance_unit)


_ANALOGIES = "Olson 1943; Hixson 2002"
"""Of all three kinds: their impedances in mechanics, acoustics and circuits."""

MASS = Kind(
    letter="m",
    name="mass",
    exponent=+1,
    power=+1,
    story="Inertia: force proportional to acceleration.",
    source=_ANALOGIES,
)
COMPLIANCE = Kind(
    letter="n",
    name="compliance",
    exponent=-1,
    power=-1,
    story="Elasticity: displacement per force (1/stiffness).",
    source=_ANALOGIES,
)
DAMPER = Kind(
    letter="r",
    name="damper",
    exponent=+1,
    power=0,
    story="Viscous loss: force proportional to velocity.",
    source=_ANALOGIES,
)

KINDS: dict[str, Kind] = {kind.letter: kind for kind in (MASS, COMPLIANCE, DAMPER)}


def kind_of(element: str) -> Kind:
    """Kind of the element with this name.

    Raises
    ------
    InputError
        If the first letter is not that of a kind.
    """
    kind = KINDS.get(element[:1])
    if kind is None:
        raise InputError(
            f"element '{element}' is of no known kind: its first letter must be m (mass), n (compliance) or r (damper)"
        )
    return kind


def band_scale(element: str, magnitude: float, frequency_hz: float) -> float:
    """Logarithm of the value at which an element's impedance equals the data's magnitude inside the band.

    This is the centre of the default, scale-free prior, which is independent of the unit and of the body part.
    """
    return float(np.log(kind_of(element).value_at(magnitude, frequency_hz)))
