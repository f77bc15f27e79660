"""Earlier additions chosen anew, when later ones are known.

The first step names what explains most while everything else is still missing. There an effect with more freedom can
win because it takes part of the other effect's place: beside a high-pass that had not been found yet, a resonator that
differs between people was 7500 nats ahead of a resonance of the rig; with the high-pass it is 56 behind. And what the
step did not consider as a rival may be the truth: beside a residual mass that was still missing a relaxation with a
damper of 0.42 N s/m explained twice as much as the damping of the rig that was there. So after the search each addition
but the last is left out, and one step of the search chooses anew beside the others; if that describes more than what
was found, the search goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior
from bayes_impedance.diagnosis.fit.extend import rebuilt, shrunk
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN, log_evidence
from bayes_impedance.diagnosis.selection.step import Step


@dataclass(frozen=True)
class Way:
    """Where a search has come to: the model that it began with, the last one, the steps between, and its posterior."""

    base: Refit
    fit: Refit
    steps: tuple[Step, ...]
    posterior: CoefficientPosterior | None


def without(refitter: Refitter, fit: Refit, addition: int) -> Refit:
    """The fit of the model without one of its additions, from the fit with it."""
    kept = [k for k in range(len(fit.model.additions)) if k != addition]
    return shrunk(refitter, fit, rebuilt(fit.model, [fit.model.additions[k] for k in kept], kept), kept)


def exchanged(refitter: Refitter, way: Way, step_from: Callable[[Way], Way]) -> Way | None:
    """The way with one addition chosen anew beside the later ones, if that is better; None if nothing is.

    Parameters
    ----------
    refitter : Refitter
    way : Way
        Of a search.
    step_from : callable
        Makes one more step from a way.
    """
    made = [step for step in way.steps if step.chosen is not None]
    for k, step in enumerate(made[:-1]):
        others = (*made[:k], *made[k + 1 :])
        anew = step_from(Way(way.base, without(refitter, way.fit, len(way.base.model.additions) + k), others, None))
        new = anew.steps[len(others)]
        if new.chosen is not None and log_evidence(anew.fit) > log_evidence(way.fit) + LEAST_GAIN:
            # What was tried beside the others is what it is compared with; the step's place and residuals stay.
            instead = replace(step, before=new.before, trials=new.trials, chosen=new.chosen)
            return replace(anew, steps=(*made[:k], instead, *made[k + 1 :]))
    return None
