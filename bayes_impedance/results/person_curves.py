"""One person's own curve: the network with that person's elements, drawn from the person's posterior."""

from __future__ import annotations

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.results.predictive import Band
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.user_table import hint, shown

_CURVES = 200
"""Draws of a person's curve. By choice: quantiles of 5 % have a relative error of 30 %, too little to be seen."""


def person_band(result: Result, subject: str, frequency_hz: np.ndarray) -> Band:
    """Pointwise quantiles of a person's impedance, without noise, as the mean over the person's repetitions.

    Parameters
    ----------
    result : Result
    subject : str
    frequency_hz : ndarray, shape (F,)

    Raises
    ------
    InputError
        If the subject is not in the result, or elements of the network have no number.
    """
    names = [str(name) for name in result.coords["subject"]]
    if subject not in names:
        raise InputError(f"subject {shown(subject)} is not in the result ({hint(subject, names)})")
    own = np.asarray(result.groups["posterior"]["person_log_elements"])[:, :, names.index(subject)]
    flat = own.reshape(-1, own.shape[-1])
    lost = [e for e, known in zip(result.elements, np.isfinite(flat).all(axis=0), strict=True) if not known]
    if lost:
        raise InputError(
            f"the recordings do not determine {', '.join(lost)}, so that a person's own curve is not in the result; "
            "fit a network without"
        )
    rows = np.linspace(0, len(flat) - 1, min(_CURVES, len(flat))).astype(int)
    return Band.of(Kernel(parse(str(result.attributes["network"]))).impedance(flat[rows], frequency_hz))
