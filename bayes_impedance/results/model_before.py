"""What the network described before a diagnosis added something to it, kept in the result of the network with it.

A page can then show both: the predicted bands and each person's fit, on the same frequencies.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.results.result import Result


def with_model_before(result: Result, magnitude: np.ndarray, phase_deg: np.ndarray, person_curve: np.ndarray) -> Result:
    """A result with the predictions of the network before something was added.

    Parameters
    ----------
    result : Result
    magnitude, phase_deg : ndarray, shape (3, F)
        5 %, 50 % and 95 % quantiles of a new person's recording.
    person_curve : ndarray, complex, shape (N, F)
        Each person's fit.

    Returns
    -------
    Result
        The same result if the curves are on another grid: they cannot be shown together.
    """
    if person_curve.shape != result.groups["constant_data"]["observed_re"].shape:
        return result
    kept = {
        "before_band_recording": np.stack([magnitude, phase_deg]),
        "before_person_curve_re": person_curve.real.copy(),
        "before_person_curve_im": person_curve.imag.copy(),
    }
    return replace(result, groups=result.groups | {"constant_data": result.groups["constant_data"] | kept})
