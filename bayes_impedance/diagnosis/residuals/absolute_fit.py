"""Absolute checks: whether a network describes the recordings at all, and whether the people are distinct.

Tests of missing effects compare explanations. They assume that the network is approximately right, that residuals are
of the size of the noise for each person, and that no person's recordings are copies of another's. Otherwise they could
find "nothing is missing" in recordings of another quantity. Each function returns sentences; none if a check passes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.population.other_quantity import better_as
from bayes_impedance.quality.curve_anomalies import duplicates, suspect_units
from bayes_impedance.quality.negative_real_part import other_quantity
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.units import ELECTRICAL_UNIT, who

GROSS_ERROR = 0.3
"""Relative error of each person's best network from which results must not be used: neither magnitude (30 %) nor phase
(17 degrees) is described then. By choice."""

GROSS_NOISE = 2.0
"""Ratio of residual to noise that is required as well: with large noise, recordings differ much from any network. By
choice."""

MANY_COPIES = 0.1
"""Fraction of people who are copies of others from which a dispersion between people is not reported. By choice: with a
tenth fewer people the standard error of a standard deviation is 5 % larger."""

_MOST_NAMED = 5
"""Largest number of people named in a sentence. By choice."""


def far_off(error: np.ndarray, noise_scale: np.ndarray, unit: str) -> list[str]:
    """Whether the network is grossly wrong for the people as a whole.

    Parameters
    ----------
    error : ndarray, shape (N,)
        Relative root mean square error of each person's best network.
    noise_scale : ndarray, shape (N,)
        Ratio of each person's residuals to the estimated noise.
    unit : str
        Of the impedance: its quantity is named in the words of its field.
    """
    middle, factor = _usual(error), _usual(noise_scale)
    if middle < GROSS_ERROR or factor < GROSS_NOISE:
        return []
    quantity = "voltage over current" if unit == ELECTRICAL_UNIT else "force over velocity"
    return [
        f"the network does not describe the recordings: each subject's own best fit deviates by {100 * middle:.0f} % "
        f"(median of the relative rms error), and the residuals are {factor:.2g} times the noise; check the quantity "
        f"({quantity}), the unit and the sign of the phase with 'bayes-impedance check'"
    ]


def copies(recordings: Recordings) -> list[str]:
    """Whether too many people are copies of others for statements about a population.

    Parameters
    ----------
    recordings : Recordings
    """
    n = len(recordings.subjects)
    again = {pair.other_subject for pair in duplicates(recordings.subjects) if pair.subject != pair.other_subject}
    if not again or len(again) < MANY_COPIES * n:
        return []
    return [
        f"{len(again)} of {n} subjects are copies of others ({_some(sorted(again))}): they are not different "
        f"{who(recordings.unit)}, and no dispersion or interval follows from them; delete the copies"
    ]


def no_impedance(recordings: Recordings, network: str, remains: bool) -> list[str]:
    """Whether the recordings are of another quantity than force over velocity, whatever describes them.

    Another quantity of a passive load, such as accelerance, looks like an impedance behind a filter whose corner is
    outside of the band. It is taken for one if the filter describes it. Re z of a load without losses is negative with
    an error of the phase of any size, and it is passive divided by jw where its masses rule: so the network has to
    describe the other quantity better too.

    Parameters
    ----------
    recordings : Recordings
    network : str
        The claimed one.
    remains : bool
        Whether structure without a name was found beside the effects with a name.
    """
    if "phase_conjugated" in suspect_units(recordings.subjects, recordings.polar):
        return [
            "the recordings are complex conjugates: the phase agrees with the slope of the magnitude only if its sign "
            "is reversed; change the sign of the imaginary part or of the phase"
        ]
    if not remains:
        return []
    others = [other_quantity(subject) is not None for subject in recordings.subjects]
    if np.mean(others) <= 0.5:  # most people decide
        return []
    better = better_as(recordings, network)
    if better is None:
        return []
    name, error, as_impedance = better
    return [
        "the recordings are no impedance of a passive load, but would be one if they were divided or multiplied by jw, "
        f"and the network describes them as {name} to {error:.1%}, and as impedance only to {as_impedance:.1%}; check "
        "that the motion is a velocity, and not an acceleration or a displacement"
    ]


def badly_described(names: Sequence[str], noise_scale: np.ndarray) -> list[str]:
    """People whom the network does not describe though it describes the others.

    Parameters
    ----------
    names : sequence of str
    noise_scale : ndarray, shape (N,)
        Ratio of each person's residuals to the estimated noise.
    """
    poor = np.flatnonzero((noise_scale > GROSS_NOISE * _usual(noise_scale)) & (noise_scale > GROSS_NOISE))
    if not poor.size or poor.size > 0.5 * noise_scale.size:
        return []
    who = _some([names[int(i)] for i in poor])
    return [
        f"The network does not describe {poor.size} of {noise_scale.size} subjects "
        f"({who}; residuals up to {float(noise_scale[poor].max()):.2g} times the noise): "
        "check their recordings, or leave them out."
    ]


def _usual(values: np.ndarray) -> float:
    """The lower median: of two people, the smaller value."""
    return float(np.sort(values)[(values.size - 1) // 2])


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_MOST_NAMED]) + (" and others" if len(names) > _MOST_NAMED else "")
