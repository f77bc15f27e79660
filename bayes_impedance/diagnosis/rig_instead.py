"""Whether an error of the calibration, however large, describes the recordings as well as what was found.

What is within the calibration's own uncertainty was removed before the search, and is no finding
(:mod:`bayes_impedance.diagnosis.fit.calibration_error`). What was found may still be an error of the calibration that
is larger than its standard deviations say. The network is fitted with the rig's parameters in place of what was found,
without any prior to speak of, and compared with it by the one criterion
(:mod:`bayes_impedance.diagnosis.selection.compare`). A gain takes no part: the elements describe any.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.catalogue.rig import RIG_DAMPING, RIG_DELAY, RIG_MASS, RIG_STIFFNESS
from bayes_impedance.diagnosis.fit.baseline import ROUNDS, Fitted
from bayes_impedance.diagnosis.fit.calibration_error import (
    Corrected,
    deviations_of,
    largest_deviation,
    listed,
    probability_of,
)
from bayes_impedance.diagnosis.fit.extend import extended, extended_start, rebuilt
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import compare
from bayes_impedance.diagnosis.selection.misfit import dependence
from bayes_impedance.diagnosis.verdict_types import Detectable
from bayes_impedance.network.extensions import Wrapped
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.calibration import CommonError

_AS_EFFECTS = {
    ("offset", "m"): RIG_MASS,
    ("offset", "r"): RIG_DAMPING,
    ("offset", "k"): RIG_STIFFNESS,
    ("delay", "d"): RIG_DELAY,
}
"""Effects of the catalogue that are a wrapper with a parameter of this letter around the network."""


def rig_instead(
    inside: Corrected, fitted: Fitted, final: Refit, remaining: Sequence[PersonResiduals]
) -> tuple[str, ...]:
    """Say whether an error of the calibration describes the recordings as well as what was found.

    Parameters
    ----------
    inside : Corrected
    fitted : Fitted
        The network alone.
    final : Refit
        With what was found.
    remaining : sequence of PersonResiduals
        Of the final model, if structure remains in them.

    Returns
    -------
    tuple of str
        One sentence; none without a calibration, or if nothing was found.
    """
    error, base = inside.given.calibration, fitted.fit
    if error is None or not final.model.additions:
        return ()
    effects = _effects_of(error)
    model = base.model
    for effect in effects.values():
        model = extended(model, Candidate(effect, "port", {}), "shared", 0.0)
    if model is base.model:
        return ()
    rig = fitted.refitter.fit(model, *extended_start(base, model), ROUNDS)
    values = dict(inside.values)
    for k, (name, effect) in enumerate(effects.items()):
        coefficient = effect.coefficients[0]
        values[name] += float(coefficient.value(rig.u[0, model.columns(k)[0]], model.scales))
    better = compare(final, rig, dependence(final, rig, remaining) if remaining else 1.0)
    if better.decided:
        return (
            "No error of the calibration, however large, describes the recordings as well as what was found (log "
            f"evidence {-better.difference:.0f}).",
        )
    told, probability = listed(error, values, inside.given.unit), probability_of(error, deviations_of(error, values))
    return (
        f"What was found may be an error of the calibration, which describes the recordings as well: {told}. Under "
        f"the calibration an error as large has a probability of {probability:.1g}; repeat the runs with known loads.",
    )


def without_rig(model: Model, inside: Corrected) -> Model:
    """A model without what a calibration's error may be: beside the rig that describes it, only their sum is seen."""
    error = inside.given.calibration
    own = set() if error is None else {effect.id for effect in _effects_of(error).values()}
    kept = [k for k, addition in enumerate(model.additions) if addition.effect.id not in own]
    return rebuilt(model, [model.additions[k] for k in kept], kept)


def beyond_calibration(inside: Corrected, limits: Sequence[Detectable]) -> tuple[Detectable, ...]:
    """Detection limits, those of the rig's effects beyond the largest error that is taken for the calibration's.

    Parameters
    ----------
    inside : Corrected
    limits : sequence of Detectable
        In recordings without the calibration's error.
    """
    error = inside.given.calibration
    if error is None:
        return tuple(limits)
    sd = dict(zip(error.parameters, (error.sd * largest_deviation(error)).tolist(), strict=True))
    taken = {effect.id: sd[name] for name, effect in _effects_of(error).items()}
    return tuple(replace(limit, above=limit.above + taken.get(limit.id, 0.0)) for limit in limits)


def _effects_of(error: CommonError) -> dict[str, Effect]:
    """Effects of the catalogue that a calibration's rig consists of, by the names of its parameters."""
    wrappers = (node for _, node in parse(error.around("r1")).walk() if isinstance(node, Wrapped))
    named = ((node.symbols[0].name, node.construct.word) for node in wrappers)
    return {name: _AS_EFFECTS[word, name[0]] for name, word in named if (word, name[0]) in _AS_EFFECTS}
