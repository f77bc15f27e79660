"""The six forms in which a driving point is measured, and their conversion to impedance z = F/v.

With exp(+jwt), displacement x, velocity v = jw x and acceleration a = jw v of the point at which the force F acts:

===================  =====  ==============  =================================
form                 h      unit            z
===================  =====  ==============  =================================
dynamic stiffness    F/x    N/m             h / jw
impedance            F/v    N s/m           h
apparent mass        F/a    kg              h jw
receptance           x/F    m/N             1 / (jw h)
mobility             v/F    m/(N s)         1 / h
accelerance          a/F    1/kg            jw / h
===================  =====  ==============  =================================

The same with torque and angle (N m/rad, N m s/rad, kg m^2 and inverses); electrical impedance and admittance, acoustic
and specific acoustic impedance are impedances and mobilities too. To first order in the noise, z is an analytic
function of h, so circular noise of standard deviation sd in each of real and imaginary part stays circular, with
sd |dz/dh|: sd |z/h| for all six.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.intake.unit_notation import Dimension, readings, unit_in
from bayes_impedance.runtime.user_table import shown

FloatArray = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]

FORMS: dict[str, tuple[int, bool]] = {
    "dynamic stiffness": (-1, False),
    "impedance": (0, False),
    "apparent mass": (1, False),
    "receptance": (-1, True),
    "mobility": (0, True),
    "accelerance": (1, True),
}
"""Power of jw in z, and whether z is the reciprocal of what was measured."""

SYNONYMS = {
    "apparent stiffness": "dynamic stiffness",
    "mechanical impedance": "impedance",
    "dynamic mass": "apparent mass",
    "effective mass": "apparent mass",
    "compliance": "receptance",
    "dynamic compliance": "receptance",
    "dynamic flexibility": "receptance",
    "admittance": "mobility",
    "inertance": "accelerance",
}

_SI_OF_FORM = {
    "N s/m": ("N/m", "N s/m", "kg", "m/N", "m/(N s)", "m/s^2/N"),
    "N m s/rad": ("N m/rad", "N m s/rad", "kg m^2", "rad/(N m)", "rad/(N m s)", "rad/s^2/(N m)"),
    "ohm": ("", "ohm", "", "", "S", ""),
    "Pa s/m3": ("", "Pa s/m^3", "", "", "m^3/(Pa s)", ""),
    "Pa s/m": ("", "Pa s/m", "", "", "m/(Pa s)", ""),
}


def _table() -> dict[Dimension, tuple[str, str]]:
    table: dict[Dimension, tuple[str, str]] = {}
    for impedance_unit, units in _SI_OF_FORM.items():
        for form, unit in zip(FORMS, units, strict=True):
            if unit:
                table[readings(unit)[0].dimension] = (form, impedance_unit)
    return table


_RESPONSES = _table()
"""Form and unit of z of every dimension that a measured ratio can have; no two of them coincide."""

MOTIONS = {"displacement": 0, "velocity": 1, "acceleration": 2, "angle": 0, "angular velocity": 1}
MOTIONS |= {"angular acceleration": 2, "charge": 0, "current": 1, "volume velocity": 1}
"""Number of time derivatives of displacement (or angle, or charge)."""

_CHANNELS: dict[str, tuple[str, str]] = {
    "N": ("force", "translation"),
    "m": ("displacement", "translation"),
    "m/s": ("velocity", "translation"),
    "m/s^2": ("acceleration", "translation"),
    "N m": ("force", "rotation"),
    "rad": ("angle", "rotation"),
    "rad/s": ("angular velocity", "rotation"),
    "rad/s^2": ("angular acceleration", "rotation"),
    "V": ("force", "electrical"),
    "A": ("current", "electrical"),
}
_CHANNEL_OF = {readings(unit)[0].dimension: quantity for unit, quantity in _CHANNELS.items()}
IMPEDANCE_UNIT = {"translation": "N s/m", "rotation": "N m s/rad", "electrical": "ohm"}

_FREQUENCY = {"rad/s": 1 / (2 * np.pi), "rpm": 1 / 60, "1/min": 1 / 60, "cpm": 1 / 60, "rad s-1": 1 / (2 * np.pi)}


@dataclass(frozen=True, kw_only=True)
class Response:
    """What a measured ratio is.

    Attributes
    ----------
    form : str
        One of :data:`FORMS`.
    factor : float
        Multiply the measured numbers by it to get SI.
    unit : str
        SI unit of the impedance, as in a dataset.
    """

    form: str
    factor: float
    unit: str

    def impedance(self, frequency_hz: FloatArray, measured: ComplexArray) -> ComplexArray:
        """Impedance of a measured ratio.

        Parameters
        ----------
        frequency_hz : ndarray of float, shape (F,)
            Above zero.
        measured : ndarray of complex, shape (F,)
            In the measured unit; infinite impedances result where it is zero in the three inverse forms.

        Returns
        -------
        ndarray of complex, shape (F,)
            z in `unit`.
        """
        power, inverse = FORMS[self.form]
        with np.errstate(all="ignore"):
            h = self.factor * np.asarray(measured, dtype=np.complex128)
            s = (2j * np.pi * frequency_hz) ** power
        with np.errstate(all="ignore"):  # what is not finite is left out
            return np.asarray(s / h if inverse else s * h)

    def noise(self, z: ComplexArray, measured: ComplexArray, sd: FloatArray) -> FloatArray:
        """Standard deviation of each part of z, from that of each part of the measured ratio (shapes (F,))."""
        with np.errstate(all="ignore"):
            return np.asarray(sd * np.abs(z) / np.abs(measured))


def form_named(text: str, where: str) -> str:
    """A form by its name or a synonym, with spaces, hyphens or underscores.

    Raises
    ------
    InputError
        If there is no such form.
    """
    name = " ".join(text.lower().replace("_", " ").replace("-", " ").split())
    name = SYNONYMS.get(name, name)
    if name not in FORMS:
        raise InputError(f"{where}: form {shown(text)} is unknown; write one of {', '.join(FORMS)}")
    return name


def response_of(unit: str, where: str, form: str | None = None) -> Response:
    """What a ratio in a unit is.

    Parameters
    ----------
    unit : str
        For instance ``m/s^2/N``, ``mm/s/N``, ``g/lbf``, ``N s/m``, ``N m/rad``, ``Ohm``.
    where : str
        Place, for messages.
    form : str, optional
        The form that the unit must belong to.

    Raises
    ------
    InputError
        If the unit is none of a driving point, or belongs to another form.
    """
    expected = {d: name for d, (name, _) in _RESPONSES.items() if form is None or name == form}
    found = unit_in(unit, expected)
    if found is not None:
        name, impedance_unit = _RESPONSES[found.dimension]
        return Response(form=name, factor=found.factor, unit=impedance_unit)
    other = unit_in(unit, {d: name for d, (name, _) in _RESPONSES.items()})
    if other is not None:
        raise InputError(
            f"{where}: unit {shown(unit)} is that of {_RESPONSES[other.dimension][0]}, not of {form}; correct one of "
            "the two"
        )
    raise InputError(
        f"{where}: unit {shown(unit)} is none of a driving point; write for instance "
        + ", ".join(f'"{u}" ({f})' for u, f in zip(_SI_OF_FORM["N s/m"], FORMS, strict=True))
    )


def is_response_unit(unit: str) -> bool:
    """Whether a text is a unit of one of the six forms."""
    return unit_in(unit, {d: name for d, (name, _) in _RESPONSES.items()}) is not None


def si_response(form: str, unit: str = "N s/m") -> Response:
    """A form in SI units; `unit` is that of the impedance."""
    return Response(form=form, factor=1.0, unit=unit)


def hertz_factor(unit: str) -> float | None:
    """Factor from a unit of frequency (Hz, kHz, rad/s, rpm, ...) to Hz; None if it is none."""
    text = unit.strip().replace(" ", "") if unit.strip() != "rad s-1" else unit.strip()
    if text in _FREQUENCY:
        return float(_FREQUENCY[text])
    found = unit_in(text, {(0, 0, -1, 0): "frequency"})
    return None if found is None or "rad" in text else found.factor


def radian_factor(unit: str) -> float | None:
    """Factor from a unit of angle to radian; None if it is none."""
    if not unit.strip() or unit.strip() == "1":
        return None
    found = unit_in(unit, {(0, 0, 0, 0): "angle"})
    return None if found is None else found.factor


def channel_of(unit: str) -> tuple[str, str, float] | None:
    """Quantity, domain and factor to SI of a channel in a unit; None if it is no force and no motion."""
    found = unit_in(unit, {d: quantity for d, (quantity, _) in _CHANNEL_OF.items()})
    if found is None or unit.strip() == "1":
        return None
    quantity, domain = _CHANNEL_OF[found.dimension]
    return quantity, domain, found.factor


def channel_of_dimension(dimension: Dimension) -> tuple[str, str] | None:
    """Quantity and domain of a channel with a dimension; None if it is no force and no motion."""
    return _CHANNEL_OF.get(dimension)
