"""Model adequacy: whether the network describes the recordings well enough that the fit's numbers may be used.

Convergence of the sampler shows that the posterior of a model is known, not that the model is right. The misfits found
in the model itself are kept here, as plain data that the summary, the terminal, the report and ``result.nc`` all show.
:func:`bayes_impedance.diagnosis.examine.examine` fills it in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Adequacy:
    """Whether a network describes recordings, as far as the recordings can show.

    Attributes
    ----------
    gross : tuple of str
        Sentences: misfits so large that no number may be used.
    misfit : tuple of str
        Sentences: effects that the network lacks, and contradictions to the assumed shape of the population, the most
        important first.
    bent : mapping of str to float
        Elements whose population centre changes by more than its own interval if the best explanations of the misfit
        are included, with the largest such change of the natural logarithm; infinite if it is not known.
    log_p : float
        Natural logarithm of the p-value of the strongest missing effect, corrected for the number of effects tried.
    p_value : float
        Of the hypothesis that residuals have no structure.
    effects : tuple of str
        Ids of the best explanations, best first; not a diagnosis.
    """

    gross: tuple[str, ...] = ()
    misfit: tuple[str, ...] = ()
    bent: Mapping[str, float] = field(default_factory=dict)
    log_p: float = 0.0
    p_value: float = 1.0
    effects: tuple[str, ...] = ()

    def summary(self) -> dict[str, Any]:
        """Entry of ``summary.json``."""
        return {
            "gross": list(self.gross),
            "misfit": list(self.misfit),
            "bent": {name: change if math.isfinite(change) else None for name, change in self.bent.items()},
            "log_p": self.log_p,
            "p_value": self.p_value,
            "effects": list(self.effects),
        }
