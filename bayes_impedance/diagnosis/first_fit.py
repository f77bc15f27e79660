"""The network's fit to the recordings, without the points that hum of the mains has spoilt.

Hum is looked for before anything else that may be missing, because it acts on few points, which are left out. But
physics that is missing leaves structure in the residuals, and where that is narrow and near the mains it looks like
hum: beside a resonance of the rig, hum was claimed with p = 9e-4. So when the search has found its first effect, and
when it has ended, hum is looked for again in what is left of all points; if there is none, the search begins anew with
all of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path

from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.hum.leakage import find_skirts
from bayes_impedance.diagnosis.hum.line import Hum, find_mains, without_hum
from bayes_impedance.diagnosis.types import Snapshot
from bayes_impedance.diagnosis.verdict.model_bands import snapshot
from bayes_impedance.network.notation import Network
from bayes_impedance.population.given_prior import GivenPrior
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.progress import Progress

_MAINS_ALPHA = 1e-3
"""Corrected level of the search for hum. By choice: stricter than other levels, because affected points are left
out."""

_ROUNDS = 15
"""Rounds of the fit to all points beside which hum is looked for again. By choice: it begins where the others are at
rest."""


@dataclass(frozen=True, kw_only=True)
class FirstFit:
    """The network's fit to the points that hum does not affect.

    Attributes
    ----------
    clean : Recordings
        Without the points affected by hum.
    fitted : Fitted
        Fit to these.
    hum : Hum or None
    spoilt : Snapshot or None
        Of the fit to all points, if there is hum.
    to_everything : Fitted
        Fit to all points.
    """

    clean: Recordings
    fitted: Fitted
    hum: Hum | None
    spoilt: Snapshot | None
    to_everything: Fitted

    def imagined(self, final: Refit, executor: Executor) -> bool:
        """Whether there was hum, and is none beside what was found: `final` is the fit with it to the clean points."""
        if self.hum is None:
            return False
        # A sharp resonance that these points would have told is off there by more than their noise before it is fitted.
        beside = self.to_everything.refitter.fit(final.model, final.u, final.population, _ROUNDS)
        return _hum_in(person_residuals(beside, self.to_everything.recordings.names, executor)) is None

    def of_everything(self) -> FirstFit:
        """The fit to all points, as if there were no hum."""
        return replace(self, clean=self.to_everything.recordings, fitted=self.to_everything, hum=None, spoilt=None)


def fit_without_hum(
    recordings: Recordings,
    network: Network | str | None,
    seed: int,
    executor: Executor,
    progress: Progress,
    checkpoint: Path | None = None,
    given: GivenPrior | None = None,
) -> FirstFit:
    """Fit the network to all points, and without those that hum affects if there is hum.

    Parameters are those of :func:`~bayes_impedance.diagnosis.fit.baseline.fit_network`.
    """
    fitted = fit_network(recordings, network, seed, executor, progress, checkpoint, given)
    first = FirstFit(clean=recordings, fitted=fitted, hum=None, spoilt=None, to_everything=fitted)
    residuals = person_residuals(fitted.fit, recordings.names, executor)
    hum = _hum_in(residuals)
    if hum is None:
        return first
    spoilt = snapshot("with hum", recordings, fitted.fit, residuals, seed)
    clean = without_hum(recordings, hum)
    again = fit_network(clean, network, seed, executor, progress, given=given)
    return replace(first, clean=clean, fitted=again, hum=hum, spoilt=spoilt)


def _hum_in(residuals: Sequence[PersonResiduals]) -> Hum | None:
    return find_mains(residuals, _MAINS_ALPHA) or find_skirts(residuals, _MAINS_ALPHA)
