"""What the network described before something was added to it, kept in the result of the network with the addition.

A page can then show both on the same frequencies: the predicted bands of new recordings, eq. 5, the coverage of the
bands, and each person's fit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from bayes_impedance.results.result import Result


class Described(Protocol):
    """How well a network describes the recordings, as :class:`bayes_impedance.diagnosis.types.Snapshot` holds it."""

    @property
    def magnitude(self) -> np.ndarray:
        """5 %, 50 % and 95 % quantiles of a new person's recording, shape (3, F)."""

    @property
    def phase_deg(self) -> np.ndarray:
        """The same of its phase."""

    @property
    def delta_magnitude(self) -> np.ndarray:
        """Eq. 5 of the population network, shape (F,)."""

    @property
    def delta_phase_deg(self) -> np.ndarray:
        """The same of its phase."""

    @property
    def subject_rms_relative(self) -> np.ndarray:
        """Complex relative error of each person's own network, shape (N,)."""

    @property
    def coverage90(self) -> np.ndarray:
        """Share of people inside the 90 % bands of magnitude and of phase, shape (2, F)."""

    @property
    def person_curve(self) -> np.ndarray:
        """Each person's fit, complex, shape (N, F)."""


@dataclass(frozen=True)
class ModelBefore:
    """The network without what was added.

    Attributes
    ----------
    network : str
        Notation.
    described : Described
    """

    network: str
    described: Described

    def summary(self) -> dict[str, Any]:
        """Network and errors, as ``summary.json`` of the network with the addition keeps them; null if not finite."""
        own = self.described
        numbers = {
            "delta_magnitude": np.nanmean(own.delta_magnitude),
            "delta_phase_deg": np.nanmean(own.delta_phase_deg),
            "subject_rms_relative": np.median(own.subject_rms_relative),
            "coverage90": np.nanmean(own.coverage90),
        }
        return {"network": self.network} | {k: float(v) if np.isfinite(v) else None for k, v in numbers.items()}


def with_model_before(result: Result, before: ModelBefore) -> Result:
    """A result with the predictions of the network before something was added.

    Parameters
    ----------
    result : Result
    before : ModelBefore

    Returns
    -------
    Result
        The same result if the curves are on another grid: they cannot be shown together.
    """
    own = before.described
    if own.person_curve.shape != result.groups["constant_data"]["observed_re"].shape:
        return result
    kept = {
        "before_band_recording": np.stack([own.magnitude, own.phase_deg]),
        "before_error": np.stack([own.delta_magnitude, own.delta_phase_deg]),
        "before_coverage_90": own.coverage90,
        "before_person_curve_re": own.person_curve.real.copy(),
        "before_person_curve_im": own.person_curve.imag.copy(),
    }
    return replace(result, groups=result.groups | {"constant_data": result.groups["constant_data"] | kept})
