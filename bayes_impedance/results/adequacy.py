"""What stands between a fit and the use of its numbers: a network that does not describe the recordings.

A sampler that has converged says that the posterior of a model is known, not that the model is right. What is found
wrong with the model itself is kept here, as plain data that the summary, the terminal, the report and ``result.nc`` all
show. :func:`bayes_impedance.diagnosis.examine.examine` fills it in.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, kw_only=True)
class Adequacy:
    """Whether a network describes recordings, as far as they can tell.

    Attributes
    ----------
    gross : tuple of str
        Sentences: misfits so large that no number may be used.
    misfit : tuple of str
        Sentences: what the network leaves out or the population's shape contradicts, the most important first.
    bent : mapping of str to float
        Elements whose population centre the best explanations of the misfit move by more than its own interval, with
        the largest such change of the natural logarithm; infinite where it is not known.
    log_p : float
        Natural logarithm of the p-value of the strongest missing effect, corrected for all that were tried.
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

    @property
    def sentences(self) -> tuple[str, ...]:
        """Everything that is wrong, the gravest first."""
        return (*self.gross, *self.misfit)

    def summary(self) -> dict[str, Any]:
        """As it stands in ``summary.json``."""
        return {
            "gross": list(self.gross),
            "misfit": list(self.misfit),
            "bent": {name: change if math.isfinite(change) else None for name, change in self.bent.items()},
            "log_p": self.log_p,
            "p_value": self.p_value,
            "effects": list(self.effects),
        }
