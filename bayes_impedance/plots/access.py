"""Access of pictures and pages to a result: arrays without the chain axis, and words for the subjects."""

from __future__ import annotations

import math

import numpy as np

from bayes_impedance.population.natural_scales import LOG_SD
from bayes_impedance.results.result import Result
from bayes_impedance.units import ELECTRICAL_UNIT, Scale, scale_for
from bayes_impedance.units import who as who_of


def variable(result: Result, name: str) -> np.ndarray | None:
    """A variable of any group, or None if the run has none of that name."""
    for group in result.groups.values():
        if name in group:
            return np.asarray(group[name])
    return None


def needed(result: Result, name: str) -> np.ndarray:
    """A variable that every run has.

    Raises
    ------
    KeyError
        If it is missing.
    """
    found = variable(result, name)
    if found is None:
        raise KeyError(name)
    return found


def samples(result: Result, name: str) -> np.ndarray:
    """Draws of all ensembles in one row, shape (S, ...)."""
    values = needed(result, name)
    return values.reshape(-1, *values.shape[2:])


def frequency(result: Result) -> np.ndarray:
    """Grid in Hz, shape (F,)."""
    return np.asarray(result.coords["frequency_hz"], dtype=float)


def observed(result: Result) -> tuple[np.ndarray, np.ndarray]:
    """Magnitude, and phase in degrees, of each subject's mean recording; each (N, F), NaN where there is none."""
    z = needed(result, "observed_re") + 1j * needed(result, "observed_im")
    phase = np.angle(z, deg=True)
    phase[~np.isfinite(z)] = np.nan
    return np.abs(z), phase


def subjects(result: Result) -> list[str]:
    """Names, shape (N,)."""
    return [str(name) for name in result.coords["subject"]]


def identified(result: Result) -> np.ndarray:
    """Which elements the recordings determine, bool, shape (P,)."""
    return np.asarray(needed(result, "identified"), dtype=bool)


def varying(result: Result) -> np.ndarray:
    """Which elements differ between people, bool, shape (P,); the others are the same for all."""
    return np.array([not p.shared for p in result.parameters])


def prior_sds(result: Result) -> np.ndarray:
    """Prior standard deviation of each element on the scale on which it is estimated, shape (P,).

    Results of earlier versions do not hold it: all their priors are those of a log element.
    """
    known = variable(result, "prior_centre_sd")
    return np.full(len(result.elements), LOG_SD) if known is None else np.asarray(known, dtype=float)


def prior_dispersion_sds(result: Result) -> np.ndarray:
    """Scale of the half-normal prior of each element's dispersions, shape (P,); one in results of earlier versions."""
    known = variable(result, "prior_dispersion_sd")
    return np.ones(len(result.elements)) if known is None else np.asarray(known, dtype=float)


def element_scale(result: Result, element: int) -> Scale:
    """Prefix and unit in which an element's value is easy to read."""
    unit = result.element_unit(result.elements[element])
    if not identified(result)[element]:
        return scale_for(math.nan, unit)
    return scale_for(float(np.median(samples(result, "central")[:, element])), unit)


def is_electrical(result: Result) -> bool:
    """Whether the recordings are of an electrical one-port, described by the force-voltage analogy."""
    return str(result.attributes["unit"]) == ELECTRICAL_UNIT


def is_simulated(result: Result) -> bool:
    """Whether the recordings' own description says that they are simulated."""
    return "simulat" in (str(result.attributes.get("source", "")) + str(result.attributes["title"])).lower()


def who(result: Result, number: int = 2) -> str:
    """Word for the subjects: recordings of batteries, for example, are not of people."""
    return who_of(str(result.attributes["unit"]), number)
