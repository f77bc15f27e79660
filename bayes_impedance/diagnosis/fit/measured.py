"""An explanation measured: fitted with the dispersions that its recordings show.

A quick refit has typical dispersions, and every person's shapes where they started. Before an explanation is believed,
everybody's frequencies are searched (:mod:`.shape_starts`), dispersions are taken from the posterior
(:mod:`.coefficient_posterior`), and the model is fitted with them, to where its evidence is largest
(:mod:`.evidence_surface`). If the evidence has become much less on the way, the fit has run away (:mod:`.fitter`), and
the quick one is the better.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior, coefficient_posterior
from bayes_impedance.diagnosis.fit.evidence_surface import climbed
from bayes_impedance.diagnosis.fit.extend import extended_start, with_pooling
from bayes_impedance.diagnosis.fit.fitter import RAN_AWAY, Refitter
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.shape_starts import searched_shapes

_PASSES = 2
"""How often dispersions are taken over. By choice: the second time the first one's have become others a little."""

_DISPERSIONS = (0.03, 1.5)
"""Bounds of the relative dispersions that are taken over from a posterior. By choice: below the first, a coefficient is
nearly shared; above the second, a coefficient of one sign cannot vary."""


def measured(refitter: Refitter, fit: Refit, seed: int) -> Refit:
    """The fit with dispersions at their posterior medians, where its evidence is largest.

    Parameters
    ----------
    refitter : Refitter
    fit : Refit
        Of a model with at least one addition.
    seed : int
    """
    begin = fit = searched_shapes(refitter, fit)
    for _ in range(_PASSES):
        if all(a.pooling == "shared" for a in fit.model.additions):
            break
        fit = with_measured_dispersions(refitter, fit, seed)
    there = climbed(refitter, fit, seed)
    return there if there.evidence.sum() >= begin.evidence.sum() - RAN_AWAY else begin


def with_measured_dispersions(refitter: Refitter, fit: Refit, seed: int) -> Refit:
    """Refit with the dispersions of varying parameters at their posterior medians.

    That of an effect which only some have stays: the posterior's is among those who have it, that of a fit among all.
    """
    posterior, model = coefficient_posterior(fit, seed), fit.model
    for i, addition in enumerate(model.additions):
        if addition.pooling != "shared":
            middle = medians(fit.model, i, posterior)
            if addition.absent_in_some:
                middle[0] = addition.dispersion
            model = with_pooling(model, i, addition.pooling, middle)
    return refitter.fit(model, *extended_start(fit, model))


def medians(model: Model, addition: int, posterior: CoefficientPosterior) -> list[float]:
    """Medians of an addition's relative dispersions, within what may be taken over."""
    columns = [c - model.n_elements for c in model.columns(addition)]
    middle = np.clip(np.median(posterior.relative_dispersion[:, columns], axis=0), *_DISPERSIONS)
    return [float(value) for value in middle]
