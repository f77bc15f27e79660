"""Size of a known effect in recordings with a known model, estimated before and after the effect is added.

The physics that was found in the original recordings stays in the model. The effect is put at the port, and the model
is refitted to the recordings without and with the addition. Structure that the model does not describe biases both
estimates equally, so it cancels in their difference.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register)
from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior, reported
from bayes_impedance.diagnosis.fit.extend import extended_start, starts_of
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.selection.stepwise import search
from bayes_impedance.recordings.files import Recordings

Estimate = tuple[float, float, float]
_FRESH = 60
"""Most rounds of a refit: twice those of a search, because the start may be far from the optimum."""


def without_and_with(before: Recordings, after: Recordings, effect_id: str, seed: int = 1) -> tuple[Estimate, Estimate]:
    """Estimates of an effect at the port, each as 5 %, 50 % and 95 % of its posterior, by one model for both.

    Parameters
    ----------
    before, after : Recordings
        The same people, without and with the addition.
    effect_id : str
        Of an effect that acts at the port.
    seed : int
    """
    with ThreadPoolExecutor(1) as executor:
        fitted = fit_network(before, None, seed, executor, lambda *_: None)
        found = search(fitted.refitter, fitted.fit, before.names, registered(), seed, executor, lambda *_: None).final
        effect = next(e for e in registered() if e.id == effect_id)
        known = found.model
        kept = [i for i, a in enumerate(known.additions) if (a.effect.id, a.place) != (effect_id, "port")]
        starts = [starts_of(known)[i] for i in kept]
        additions = (*(known.additions[i] for i in kept), Addition(effect=effect, place="port", pooling="shared"))
        shape = {coefficient.name: 0.0 for coefficient in effect.coefficients}
        model = build(known.network, additions, known.scales, [*starts, shape])
        estimates = []
        for refitter in (fitted.refitter, fit_network(after, None, seed, executor, lambda *_: None).refitter):
            start, population = extended_start(found, model)
            fit = refitter.settle(refitter.fit(model, start, population, _FRESH), seed)
            fit = replace(fit, model=model)
            centre = np.asarray(fit.u[:, : model.n_elements].mean(axis=0))
            row = reported(model, len(additions) - 1, coefficient_posterior(fit, seed), centre)[0]
            estimates.append((float(row.q05), float(row.median), float(row.q95)))
    return estimates[0], estimates[1]
