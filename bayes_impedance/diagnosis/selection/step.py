"""One step of the forward selection, and how significant what it looks for is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.trial import Trial

SPREAD_PENALTY = float(np.log(100.0))
"""Stricter level for the spread between people, by a factor of 100: noise of a different shape in some people looks
similar. By choice."""


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of the forward selection.

    Attributes
    ----------
    before : Refit
        Without the addition.
    residuals : tuple of PersonResiduals
        Of that fit.
    screening : Screening
        Of that fit.
    trials : tuple of Trial
        All refits.
    chosen : Trial or None
        The addition of this step.
    unpredictive : bool
        Whether nothing was added because what describes these people better does not predict others.
    richer : Screening, optional
        Of richer laws, where one of them was chosen (:mod:`.richer_law`).
    unshown : Trial, optional
        Why nothing was added: an explanation that only repeated sweeps can show (:mod:`.one_sweep`).
    refused : Trial, optional
        What would have been added otherwise.
    """

    before: Refit
    residuals: tuple[PersonResiduals, ...]
    screening: Screening
    trials: tuple[Trial, ...] = ()
    chosen: Trial | None = None
    unpredictive: bool = False
    richer: Screening | None = None
    unshown: Trial | None = None
    refused: Trial | None = None

    @property
    def after(self) -> Refit:
        """With the addition, if there is one."""
        return self.before if self.chosen is None else self.chosen.fit

    @property
    def offered(self) -> int:
        """Number of effects, each at each of its places, among which the step chooses."""
        return len({(c.effect.id, c.effect.form, c.place) for c in self.screening.candidates})

    @property
    def log_p(self) -> float:
        """Smallest corrected log p-value: of shared or varying effects with an admissible sign, or of poles."""
        s = self.screening
        z = np.where(s.physical, np.nan_to_num(s.z), 0.0)
        body = np.array([c.effect.side == "body" for c in s.candidates], dtype=bool)
        spread = float(np.min(np.where(body & s.physical, s.log_p_spread, 0.0), initial=0.0))
        return min(float(s.log_p(np.abs(z).max(initial=0.0))), spread + SPREAD_PENALTY, s.log_p_levels)
