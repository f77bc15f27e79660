"""Whether each named effect improves the prediction of data that were held out.

A search selects, from many candidates, what describes the recordings at hand best. An effect keeps its name only if it
also improves the prediction of people who had no part in estimating it; with too few people for folds, of frequencies.
The first effect must gain; every further one must gain by more than chance over people, because what the first leaves
is small, and structure of another origin has many ways to resemble some effect of a catalogue.
"""

from __future__ import annotations

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE
from bayes_impedance.diagnosis.selection.cross_validation import clearly_gains, held_out, people_gain
from bayes_impedance.diagnosis.selection.identifiability import without
from bayes_impedance.diagnosis.selection.stepwise import Found

Gain = tuple[float, float | None]


def names_that_predict(refitter: Refitter, found: Found, seed: int) -> tuple[Found, dict[tuple[str, str, str], Gain]]:
    """What was found, without the effects that do not improve predictions; and the gain of each that does.

    Parameters
    ----------
    refitter : Refitter
    found : Found
    seed : int
        Of the division into folds.

    Returns
    -------
    found : Found
    gains : dict
        Gain on held-out people with its standard error, by the effect's key; empty with too few people.
    """
    if len(refitter.data) < FEWEST_PEOPLE:
        while (own := _own(found)) and (held_out(refitter, found.base, found.final, seed).blocks or 0.0) <= 0:
            found = without(refitter, found, own[-1:])
        return found, {}
    gains: dict[tuple[str, str, str], Gain] = {}
    for addition in _own(found):
        step = found.step_of(addition)
        if step is not None and step.chosen is not None:
            gains[addition.key] = people_gain(refitter, step.before, step.chosen.fit, seed)
    first = next(iter(gains), None)
    weak = [
        addition
        for addition in _own(found)
        if addition.key in gains and not _enough(*gains[addition.key], is_first=addition.key == first)
    ]
    return (without(refitter, found, weak) if weak else found), gains


def _enough(gain: float, se: float | None, is_first: bool) -> bool:
    return gain > 0 and (is_first or clearly_gains(gain, se))


def _own(found: Found) -> tuple[Addition, ...]:
    """The effects that were found, in their order."""
    return tuple(found.final.model.additions[len(found.base.model.additions) :])
