"""Population posterior against NUTS, on the full joint posterior and on the marginal one: same data, same priors.

The joint posterior and its data are those of the tests (`tests/nuts_model.py`): 16 people, three repetitions, five
elements, 30 frequencies; and 71 people, as many as the paper has. The marginal one is in `marginal_nuts.py`. The
measure is effective samples per second of the worst population parameter. Against the joint posterior these are
seconds of wall time, with compilation and adaptation on both sides and all steps before the sampling on ours; against
the marginal one they are seconds of sampling alone. NUTS gets as many draws as determine a dispersion to a few
percent. Point estimates are compared with those of R's nlme, where it is installed
(`mixed_effects.py`).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from bayes_impedance.population.fit import PopulationFit
    from bayes_impedance.recordings.files import Recordings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))


_MANY, _SHORTER = 71, {"warmup": 400, "draws": 800}


def measure(seed: int) -> dict[str, Any]:
    """Effective samples per second of all samplers, and the differences of their moments."""
    from nuts_model import POPULATION, virtual_recordings

    from bayes_impedance.population.fit import fit_population

    fit_population(virtual_recordings(seed), POPULATION.network, seed=seed)  # fills the cache of compiled functions
    few, fit = _against_joint(virtual_recordings(seed), seed, {})
    few |= _against_marginal(fit, seed)
    many, _ = _against_joint(virtual_recordings(seed, _MANY), seed, _SHORTER)
    return {"few": few, "many": many}


def _against_joint(recordings: Recordings, seed: int, length: dict[str, int]) -> tuple[dict[str, Any], PopulationFit]:
    from nuts_model import POPULATION, compare, from_fit, run_nuts

    from bayes_impedance.population.fit import fit_population

    started = time.perf_counter()
    fit = fit_population(recordings, POPULATION.network, seed=seed)
    seconds = time.perf_counter() - started
    effective = float(fit.diagnostics.effective_min)
    joint = run_nuts(fit, seed=seed, **length)
    table = [c for c in compare(from_fit(fit), joint) if not c.name.startswith("person")]
    ours = {
        "seconds": seconds,
        "of sampling": fit.seconds["population"],
        "effective": effective,
        "per second": effective / seconds,
        "problems": list(fit.diagnostics.problems),
    }
    row = beside_nuts(table, joint.seconds, joint.divergences, effective / seconds)
    return {"people": len(recordings.subjects), "parameters": len(table), "ours": ours, "joint": row}, fit


def _against_marginal(fit: PopulationFit, seed: int) -> dict[str, Any]:
    from marginal_nuts import prepared, run_nuts_on
    from mixed_effects import compare_with_nlme
    from nuts_model import ELEMENTS, POPULATION, Comparison, Moments

    from bayes_impedance.mcmc.ensemble import SamplerSettings, sample

    posterior = prepared(fit.recordings, POPULATION.network, seed)
    started = time.perf_counter()
    chains = sample(
        posterior.log_probability,
        posterior.mode,
        posterior.normal_covariance,
        SamplerSettings(),
        np.random.SeedSequence(seed),
        lambda *_: None,
    )
    ours_sampling = float(chains.effective.min()) / (time.perf_counter() - started)
    sets = posterior.coordinates.unpack(chains.coordinates.reshape(-1, chains.coordinates.shape[-1]))
    own = {"mu": sets.mu, "tau": np.log(sets.between_persons), "rho": np.log(sets.between_repetitions)}
    values, marginal_seconds, marginal_divergences = run_nuts_on(posterior, fit.prior.centre, seed)
    n_ensembles = len(chains.coordinates)
    against_marginal = [
        Comparison(
            f"{name} {e}",
            Moments.of(own[name][:, i].reshape(n_ensembles, -1)),
            Moments.of(values[name][..., i]),
        )
        for name in own
        for i, e in enumerate(ELEMENTS)
    ]
    return {
        "sampling alone per second": ours_sampling,
        "marginal": beside_nuts(against_marginal, marginal_seconds, marginal_divergences, ours_sampling),
        "nlme": compare_with_nlme(fit),
    }


def beside_nuts(table: list[Any], seconds: float, divergences: int, ours: float) -> dict[str, Any]:
    effective = min(c.nuts.effective for c in table)
    odd = max(table, key=lambda c: abs(np.log(c.spread)))
    return {
        "seconds": seconds,
        "effective": effective,
        "per second": effective / seconds,
        "times as many by ours": ours / (effective / seconds),
        "largest R-hat": max(c.nuts.rhat for c in table),
        "divergences": divergences,
        "largest difference of means, in standard deviations": max(abs(c.shift) for c in table),
        "ratio of standard deviations": [min(c.spread for c in table), max(c.spread for c in table)],
        "standard error of that ratio, at most": max(c.spread_error for c in table),
        "farthest from one": [odd.name, odd.spread, odd.spread_error],
    }
