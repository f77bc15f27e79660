"""Whether a network describes recordings at all, and whether the people are people: in absolute terms.

Tests of what is missing compare explanations. All of them take for granted that something near the network is right,
that residuals are of the size of the noise for everybody, and that people are different people. Where that is not so,
"nothing is missing" would be said of recordings of another quantity. Each function returns sentences; none if all is
well.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.quality.curve_anomalies import duplicates
from bayes_impedance.recordings.files import Recordings

GROSS_ERROR = 0.3
"""Relative error of people's own best networks from which nothing may be used: neither magnitude (30 %) nor phase
(17 degrees) is described then. By choice."""

GROSS_NOISE = 2.0
"""Ratio of residual to noise that must go with it: recordings whose noise is large differ from any network by much."""

MANY_COPIES = 0.1
"""Share of people who are copies of others from which on a dispersion between people means nothing. By choice; the
standard deviation of a tenth fewer people is 5 % less sure."""

_MOST_NAMED = 5
"""People whom a sentence names."""


def far_off(error: np.ndarray, noise_scale: np.ndarray) -> list[str]:
    """Whether the network is grossly wrong for the people together.

    Parameters
    ----------
    error : ndarray, shape (N,)
        Relative root mean square of everybody's own best network.
    noise_scale : ndarray, shape (N,)
        Ratio of everybody's residuals to the estimated noise.
    """
    middle, factor = _usual(error), _usual(noise_scale)
    if middle < GROSS_ERROR or factor < GROSS_NOISE:
        return []
    return [
        f"the network does not describe the recordings: each subject's own best network is {100 * middle:.0f} % off "
        f"(median) and residuals are {factor:.2g} times the noise; check the quantity (force over velocity), the unit "
        "and the sign of the phase with 'bayes-impedance check', then the network with 'bayes-impedance diagnose'"
    ]


def copies(recordings: Recordings) -> list[str]:
    """Whether so many people are copies of others that nothing follows about people.

    Parameters
    ----------
    recordings : Recordings
    """
    n = len(recordings.subjects)
    again = {pair.other_subject for pair in duplicates(recordings.subjects) if pair.subject != pair.other_subject}
    if not again or len(again) < MANY_COPIES * n:
        return []
    return [
        f"{len(again)} of {n} subjects are copies of others ({_some(sorted(again))}): they are not different people, "
        "and no dispersion or interval follows from them; delete the copies"
    ]


def badly_described(names: Sequence[str], noise_scale: np.ndarray) -> list[str]:
    """People whom the network does not describe though it describes the others.

    Parameters
    ----------
    names : sequence of str
    noise_scale : ndarray, shape (N,)
        Ratio of everybody's residuals to the estimated noise.
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
    """The median; of two people, that of the better one."""
    return float(np.sort(values)[(values.size - 1) // 2])


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_MOST_NAMED]) + (" and others" if len(names) > _MOST_NAMED else "")
