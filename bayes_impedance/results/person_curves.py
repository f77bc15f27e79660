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
    own = np.asarray(result.groups["posterior"]["person_log_elements"])[:, :, _position(result, subject)]
    flat = own.reshape(-1, own.shape[-1])
    lost = without_number(result)
    if lost:
        raise InputError(
            f"the recordings do not determine {', '.join(lost)}, so that a subject's own band is not in the result; "
            "take the curve alone (fitted_curve), or fit a network without"
        )
    rows = np.linspace(0, len(flat) - 1, min(_CURVES, len(flat))).astype(int)
    return Band.of(Kernel(parse(str(result.attributes["network"]))).impedance(flat[rows], frequency_hz))


def fitted_curve(result: Result, subject: str) -> np.ndarray:
    """A person's fitted curve on the result's grid, complex, shape (F,).

    It is there also where the recordings do not determine some elements, which have no number: these leave the curve
    as it is where it was recorded.

    Raises
    ------
    InputError
        If the subject is not in the result, or the result holds no curves.
    """
    row, kept = _position(result, subject), result.groups["constant_data"]
    if "person_curve_re" not in kept:
        raise InputError("the result holds no fitted curves, as those of earlier versions; fit it again")
    return np.asarray(kept["person_curve_re"][row] + 1j * kept["person_curve_im"][row])


def without_number(result: Result) -> tuple[str, ...]:
    """Elements of which the result holds no draws of people, because the recordings do not determine them."""
    own = np.asarray(result.groups["posterior"]["person_log_elements"])
    known = np.isfinite(own).all(axis=(0, 1, 2))
    return tuple(e for e, finite in zip(result.elements, known, strict=True) if not finite)


def _position(result: Result, subject: str) -> int:
    names = [str(name) for name in result.coords["subject"]]
    if subject not in names:
        raise InputError(f"subject {shown(subject)} is not in the result ({hint(subject, names)})")
    return names.index(subject)
