"""Force and motion among the channels of a recording: name, unit, sensitivity and sign.

A channel is written ``NAME``, ``NAME[UNIT]`` or ``NAME@SENSITIVITY``, with a minus in front if it counts the other way:
``force[N]``, ``-ch2@10.2 mV/g``, ``channel 1@22.4 mV/N`` (volts per newton) or ``ch1@50 N/V`` (newtons per volt; which
of the two it is follows from the unit). With a sensitivity the samples are in volts, or in the unit that is written.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.quantities import MOTIONS, channel_of, channel_of_dimension
from bayes_impedance.intake.ratio import FloatArray
from bayes_impedance.intake.unit_notation import Dimension, Unit, readings
from bayes_impedance.runtime.user_table import shown

_SENSITIVITY = re.compile(r"\s*([+-]?[\d.]+(?:[eE][+-]?\d+)?)\s*(.+)")
_TIME_NAMES = re.compile(r"t|time|zeit|temps|timesec|times|timedomain|xvalue")
STEADY = 1e-3
"""Largest relative deviation of a sampling step from the mean step. By choice: times written with few digits stay
within it, and what is sampled unevenly does not."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """Samples of one quantity.

    Attributes
    ----------
    name : str
    samples : ndarray of float, shape (N,)
        In SI units.
    quantity : str
        ``force`` or one of :data:`bayes_impedance.intake.quantities.MOTIONS`.
    domain : str
        ``translation``, ``rotation`` or ``electrical``.
    rate_hz : float or None
    """

    name: str
    samples: FloatArray
    quantity: str
    domain: str
    rate_hz: float | None

    @property
    def order(self) -> int:
        """Number of time derivatives, of a motion."""
        return MOTIONS[self.quantity]


def channel_from(contents: Contents, text: str, option: str) -> Channel:
    """A channel as an option writes it.

    Raises
    ------
    InputError
        If there is no such variable, or its unit is missing, or that of another kind of quantity.
    """
    name, _, sensitivity = text.rpartition("@") if "@" in text and text not in contents.names else (text, "", "")
    name, unit = name.strip(), ""
    known = {n.casefold() for n in contents.names}
    match = None if name.casefold() in known else re.fullmatch(r"(.+?)\s*\[([^\[\]]*)\]", name)
    if match:
        name, unit = match[1].strip(), match[2].strip()
    negated = name.startswith("-") and name.casefold() not in known
    variable = contents.variable(name[1:].strip() if negated else name, option)
    where = f"{contents.file}: {option} {shown(text)}"
    if sensitivity:
        quantity, domain, factor = _calibrated(sensitivity, unit or variable.unit, where)
    else:
        unit = unit or variable.unit or unit_in_name(variable.name)
        found = channel_of(unit) if unit else None
        if found is None:
            problem = f"unit {shown(unit)} is neither of a force nor of a motion" if unit else "has no unit"
            raise InputError(f"{where}: {problem}; write it behind the name, e.g. {name}[N] or {name}[m/s^2]")
        quantity, domain, factor = found
    with np.errstate(over="ignore", invalid="ignore"):
        samples = contents.numbers(variable) * (-factor if negated else factor)
    return Channel(name=variable.name, samples=samples, quantity=quantity, domain=domain, rate_hz=variable.rate_hz)


def guessed_channels(contents: Contents) -> tuple[str, str] | None:
    """Names of the force and the motion, if by their units there is exactly one of each."""
    forces: list[str] = []
    motions: list[str] = []
    for variable in contents.variables:
        found = channel_of(variable.unit or unit_in_name(variable.name) or "?")
        if found is not None and found[1] != "electrical" and not variable.is_text:
            (forces if found[0] == "force" else motions).append(variable.name)
    return (forces[0], motions[0]) if len(forces) == len(motions) == 1 else None


def unit_in_name(name: str) -> str:
    """Unit in brackets at the end of a name, or behind a slash or comma; empty if there is none."""
    for pattern in (r".+?\s*[\(\[]([^()\[\]]+)[\)\]]", r"[^/]+/\s*(.+)", r".+?,\s*(.+)"):
        match = re.fullmatch(pattern, name.strip())
        if match and channel_of(match[1]):
            return match[1]
    return ""


def sampling_rate_of(contents: Contents, force: Channel, motion: Channel, given: float | None) -> float:
    """Sampling rate of both channels in Hz: given, of the file, or of a column of times.

    Raises
    ------
    InputError
        If it is unknown, differs between the channels, or the sampling is not even.
    """
    if force.samples.size != motion.samples.size:
        raise InputError(
            f"{contents.file}: {shown(force.name)} has {force.samples.size} samples, but {shown(motion.name)} "
            f"{motion.samples.size}; give channels of one recording"
        )
    if given is not None:
        return given
    if force.rate_hz is not None and motion.rate_hz is not None:
        if abs(force.rate_hz / motion.rate_hz - 1) > 1e-9:
            raise InputError(
                f"{contents.file}: {shown(force.name)} was sampled at {force.rate_hz:g} Hz, but {shown(motion.name)} "
                f"at {motion.rate_hz:g} Hz; resample one of them"
            )
        return force.rate_hz
    times = [v for v in contents.variables if _is_time(v) and v.values.size == force.samples.size]
    if len(times) != 1:
        raise InputError(
            f"{contents.file}: the sampling rate is not known; give it in hertz with --sampling-rate, or name a column "
            "time"
        )
    t = contents.numbers(times[0]) * _seconds(times[0])
    step = (t[-1] - t[0]) / (t.size - 1)
    uneven = np.flatnonzero(np.abs(np.diff(t) - step) > max(STEADY * abs(step), 1e-12 * np.abs(t).max()) + _rounding(t))
    if step <= 0 or uneven.size:
        row = int(uneven[0]) + 1 if uneven.size else 0
        raise InputError(
            f"{contents.where(row)}: the times are not even steps upwards; resample the signals, or give "
            "--sampling-rate if the times are wrong"
        )
    return float(1 / step)


def _rounding(t: FloatArray) -> float:
    """Half a unit of the last digit with which times seem to be written, twice."""
    steps = np.unique(np.round(np.diff(t[: min(t.size, 200)]), 12))
    return float(np.max(steps) - np.min(steps)) / 2 if steps.size <= 3 else 0.0


def _seconds(variable: Variable) -> float:
    match = re.search(r"[\[\(/_]\s*(ms|us|µs)\s*[\]\)]?$", variable.name)
    unit = variable.unit or (match[1] if match else "s")
    return {"ms": 1e-3, "us": 1e-6, "µs": 1e-6}.get(unit, 1.0)


def _is_time(variable: Variable) -> bool:
    if channel_of(variable.unit or unit_in_name(variable.name) or "?"):
        return False  # T [N m] is a torque
    stem = re.sub(r"[\[\(/].*$|_(s|ms|us)$", "", variable.name.strip().lower())
    return _TIME_NAMES.fullmatch(re.sub(r"[\s_]", "", stem)) is not None and not variable.is_text


def _calibrated(sensitivity: str, unit: str, where: str) -> tuple[str, str, float]:
    """Quantity, domain and factor to SI of samples in `unit`, else volts, else parts of full scale."""
    match = _SENSITIVITY.fullmatch(sensitivity)
    value = float(match[1]) if match and match[1].count(".") <= 1 and match[1] not in (".", "+.", "-.") else 0.0
    found = []
    if match and value != 0.0:
        for raw in readings(unit) if unit else (*readings("V"), *readings("1")):
            for one in readings(match[2]):
                found += _quantities(raw, one, value)
            if found:
                return found[0]
    raise InputError(
        f"{where}: the sensitivity {shown(sensitivity.strip())} does not lead to a force or a motion; write e.g. "
        '"22.4 mV/N", "10.2 mV/g" or "50 N/V"'
    )


def _quantities(raw: Unit, one: Unit, value: float) -> list[tuple[str, str, float]]:
    found = []
    for sign in (-1, 1):
        dimension: Dimension = tuple(a + sign * b for a, b in zip(raw.dimension, one.dimension, strict=True))  # type: ignore[assignment]
        quantity = channel_of_dimension(dimension)
        if quantity is not None and quantity[1] != "electrical":
            factor = raw.factor * (value * one.factor) ** sign
            found.append((*quantity, factor))
    return found
