"""Physics outside the catalogue: a small passive network that stands for it, selected on held-out data.

Small branches of masses, springs and dampers are tried beside and in series with the places at which the missing
one-port explains most of the mismatch. All are passive by construction. They are screened like any candidate, the best
are refitted, and the one that gains most on **held-out people** is selected, so that a larger branch is not preferred
merely for its number of elements. It has to be better by the same criterion as an effect that has a name
(:mod:`.compare`): of 44 people to whom nothing was missing, one that was 3.3 ahead with a standard error of 5.3
predicted the others better by 14, which is 2.5 standard errors, and was the best of three.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, FEWEST_TO_VARY, compare
from bayes_impedance.diagnosis.selection.cross_validation import clearly_gains, held_out, people_gain
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import best_shapes
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.diagnosis.selection.trial import Trial, try_candidate
from bayes_impedance.diagnosis.types import OnePort

BRANCHES = ("m", "n", "r", "n|r", "m-r", "n-r", "m-(n|r)", "n-(m|r)", "(n-r)|(n-r)", "(n-r)-(m|r)")
"""Branches of one to four elements. By choice: with more elements, branches can no longer be told apart."""

_PLACES = 3
"""Number of best places at which branches are tried. By choice."""

_REFITTED = 6
"""Number of branches that are refitted. By choice, as `SHORTLIST` is."""

_COMPARED = 3
"""Number of those that are compared on held-out people. By choice: each costs five refits."""


@dataclass(frozen=True)
class Realised:
    """A network that stands for unknown physics.

    Attributes
    ----------
    trial : Trial
    gain, gain_se : float
        On held-out people, over the model without it.
    """

    trial: Trial
    gain: float
    gain_se: float | None


def structure_remains(found: Found, p_value: float) -> bool:
    """Whether a search leaves structure: in the residuals (p-value), or in the scores of candidates that it refused.

    A search that ended at the largest number of additions has not tested what remains. What was refused because it
    predicts nobody else is no structure.
    """
    last = found.steps[-1]
    refused = last.chosen is None and not last.unpredictive
    return bool(p_value < STRUCTURE_ALPHA or (last.log_p < np.log(STRUCTURE_ALPHA) and refused))


def branch_effects() -> tuple[Effect, ...]:
    """The small branches as unnamed effects."""
    return tuple(
        Effect(
            id="unknown",
            name="unknown physics",
            side="body",
            pooling="varying",
            places=("port", "groups", "springs", "dampers"),
            formula=f"{branch} {'in parallel with' if connection == 'beside' else 'in series with'} the place",
            story="No effect of the catalogue explains what is missing. A small passive network represents it.",
            look_for="structure that remains after all known effects were tried",
            separates="measurements of another kind",
            source="inversion of the network",
            branch=_numbered(branch),
            connection=connection,
        )
        for branch in BRANCHES
        for connection in ("beside", "series")
    )


def along_the_sweep(trial: Trial) -> Trial:
    """An explanation that only repeated sweeps could show, as an unnamed one (:mod:`.one_sweep`)."""
    model = trial.fit.model
    effect = replace(
        trial.effect,
        id="unknown",
        name="element that changes along the sweep",
        story="The element has another value at one end of the sweep than at the other: it changes with time, or with "
        "the amplitude of the motion. In one sweep of each subject time, amplitude and frequency go together, so that "
        "the recordings cannot show which. Sweeps in both directions, or at two drive levels, would.",
    )
    additions = (*model.additions[:-1], replace(model.additions[-1], effect=effect))
    fit = replace(trial.fit, model=replace(model, additions=additions))
    return replace(trial, candidate=replace(trial.candidate, effect=effect), fit=fit)


def stand_in_network(
    refitter: Refitter,
    fit: Refit,
    residuals: Sequence[PersonResiduals],
    one_ports: Sequence[OnePort],
    seed: int,
    executor: Executor,
) -> Realised | None:
    """The small network with the largest gain on held-out people; None if none gains.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
    residuals : sequence of PersonResiduals
        Of that fit.
    one_ports : sequence of OnePort
        Best place first.
    seed : int
    executor : Executor
    """
    wanted = [port.place for port in one_ports[:_PLACES]]
    screening = screen(fit, residuals, branch_effects(), seed, executor, wanted)
    order = best_shapes(screening)[:_REFITTED]
    pooling = "varying" if len(refitter.data) >= FEWEST_TO_VARY else "shared"
    trials = [
        t
        for k in order
        for t in try_candidate(refitter, fit, screening.candidates[k], float(screening.size[k]), ("shared", pooling))
    ]
    good = [t for t in trials if np.isfinite(t.gain) and compare(t.fit, fit).decided]
    if not good:
        return None
    good = sorted(good, key=lambda t: -t.gain)[:_COMPARED]
    if len(refitter.data) < FEWEST_PEOPLE:
        held = [held_out(refitter, fit, t.fit, seed) for t in good]
        best = int(np.argmax([h.blocks or 0.0 for h in held]))
        gain = held[best].blocks or 0.0
        return Realised(good[best], gain, held[best].blocks_se) if gain > 0 else None
    gains = [people_gain(refitter, fit, t.fit, seed) for t in good]
    best = int(np.argmax([g for g, _ in gains]))
    total, se = gains[best]
    # A gain in a single person is that person's local optimum, not physics.
    return Realised(good[best], total, se) if clearly_gains(total, se) else None


def _numbered(branch: str) -> str:
    """Number the elements of a branch, so that names are unique."""
    counts: dict[str, int] = {}
    text = ""
    for character in branch:
        if character in "mnr":
            counts[character] = counts.get(character, 0) + 1
            text += f"{character}{counts[character]}"
        else:
            text += character
    return text
