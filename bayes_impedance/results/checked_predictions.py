r"""Recordings as the prior and the posterior predict them, beside the measured ones, under the same names.

ArviZ compares ``observed_data`` with ``posterior_predictive`` and ``prior_predictive`` by names and axes. There are
three variables:

* ``log_magnitude`` and ``phase_deg`` of each subject's mean recording, at some frequencies;
* ``recordings``, one number for each subject: the mean of ``log_magnitude`` over these frequencies. It has the name of
  the log density in ``log_likelihood``, which is that of the subject's recordings as a whole, so that leave-one-out
  probability integral transforms leave out the person.

Predicted is a **new person** who is recorded as the subject was: elements from N(mu + B x, Sigma), or from the t
distribution of a population with heavier tails, with the subject's
covariates, number of repetitions, and noise. It is the prediction whose density ``log_likelihood`` holds: the subject's
own elements are not used. Of one person alone, it is that person recorded again.

There is a prediction for every draw of the posterior, because ArviZ weights them with the log density of the same draw.
To keep files small there are then as many frequencies as :data:`MOST_NUMBERS` allows, evenly spread over the grid.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.noise_tails import drawn_stretch
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior_draws import draw_prior
from bayes_impedance.population.shapes import standard_people
from bayes_impedance.results.predictive import Predictive, relative_noise

MOST_NUMBERS = 1_000_000
"""Most predicted magnitudes in a file, about 2 MB when compressed. By choice: 71 people with 2000 draws keep 7
frequencies."""
PRIOR_DRAWS = 500
"""Sets of population parameters from the prior. By choice: quantiles of 5 % have a relative error of 20 %."""
_AT_ONCE = 2_000_000
"""Most elements of people that are drawn at once, 16 MB in double precision. By choice: memory."""
_BITS = 12
"""Binary digits that are kept of a number: a relative error of 1e-4, below the noise of any recording. Files are then
half as large."""

MEANINGS = {
    "log_magnitude": {
        "long_name": "log magnitude of the impedance",
        "units": "1",
        "description": "natural logarithm of |z| over its unit, of the mean over a subject's repetitions",
    },
    "phase_deg": {
        "long_name": "phase of the impedance",
        "units": "deg",
        "description": "of the mean over a subject's repetitions",
    },
    "recordings": {
        "long_name": "level of a subject's recordings",
        "units": "1",
        "description": "mean of log_magnitude over predictive_frequency_hz, one number for each subject",
    },
}
"""Attributes of the variables of observed and predicted recordings."""


@dataclass(frozen=True)
class Checks:
    """Variables of ``observed_data`` and of what is predicted, and of the prior.

    Attributes
    ----------
    frequency_hz : ndarray, shape (F',)
    observed : dict of str to ndarray
        ``log_magnitude`` and ``phase_deg`` (N, F'), ``recordings`` (N,).
    posterior_predictive : dict of str to ndarray
        The same with axes chain and draw first.
    prior : PopulationParameters
        :data:`PRIOR_DRAWS` sets.
    prior_predictive : dict of str to ndarray
    """

    frequency_hz: np.ndarray
    observed: dict[str, np.ndarray]
    posterior_predictive: dict[str, np.ndarray]
    prior: PopulationParameters
    prior_predictive: dict[str, np.ndarray]


def checked_predictions(fit: PopulationFit, predictive: Predictive) -> Checks:
    """Predict recordings of everybody under every posterior draw and under draws of the prior.

    Parameters
    ----------
    fit : PopulationFit
        Its seed is that of the draws, which are independent of all others.
    predictive : Predictive
        Observed recordings on the common grid.
    """
    sets = len(fit.parameters.mu)
    columns = _frequencies(predictive.observed, sets)
    frequency, seen = predictive.frequency_hz[columns], predictive.observed[:, columns]
    noise = relative_noise(fit, predictive.frequency_hz)[:, columns]
    posterior_seed, prior_seed = np.random.SeedSequence([fit.seed, sets]).spawn(2)
    prior = draw_prior(
        fit.prior,
        PRIOR_DRAWS,
        np.random.default_rng(prior_seed),
        shared=np.array([p.shared for p in fit.kernel.parameters]) & (not fit.one_person),
        correlated=fit.settings.covariance == "full" and not fit.one_person,
        repetitions=fit.repeated,
        n_covariates=len(fit.settings.covariates),
        tails=fit.parameters.tail is not None,
        groups=fit.parameters.groups is not None,
    )
    missing = ~np.isfinite(seen)

    def predicted(parameters: PopulationParameters, chains: int, seed: np.random.SeedSequence) -> dict[str, np.ndarray]:
        rng, rows = np.random.default_rng(seed), len(parameters.mu)
        step = max(1, _AT_ONCE // (len(seen) * len(fit.kernel.elements)))
        parts: dict[str, list[np.ndarray]] = {}
        for first in range(0, rows, step):
            z = _recorded_again(fit, parameters[first : first + step], frequency, noise, rng)
            z[:, missing] = np.nan
            for name, values in _variables(z).items():
                parts.setdefault(name, []).append(_rounded(values))
        whole = {name: np.concatenate(part) for name, part in parts.items()}
        return {name: values.reshape(chains, -1, *values.shape[1:]) for name, values in whole.items()}

    return Checks(
        frequency,
        _variables(seen),
        predicted(fit.parameters, fit.n_ensembles, posterior_seed),
        prior,
        predicted(prior, 1, prior_seed.spawn(1)[0]),
    )


def _frequencies(observed: np.ndarray, sets: int) -> np.ndarray:
    """Columns of the grid: of those where everybody was recorded, if there are any, as many as are kept."""
    complete = np.flatnonzero(np.all(np.isfinite(observed), axis=0))
    offered = complete if complete.size else np.arange(observed.shape[1])
    most = max(1, MOST_NUMBERS // (sets * len(observed)))
    if most >= offered.size:
        return offered
    return np.asarray(offered[np.linspace(0, offered.size - 1, most + 2).round().astype(int)[1:-1]])


def _recorded_again(
    fit: PopulationFit,
    parameters: PopulationParameters,
    frequency: np.ndarray,
    noise: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Mean recordings (W, N, F') of somebody new in everybody's place, complex, for W sets of population parameters."""
    people = fit.recordings.subjects
    theta = np.repeat(parameters.mu[:, None], len(people), axis=1)
    counts = np.array([len(s.repetitions) for s in people])
    if not fit.one_person:
        x = standardised_covariates(fit.recordings, fit.settings.covariates)
        theta = theta + np.einsum("wpq,nq->wnp", parameters.slopes, x)
        own = standard_people(rng.normal(size=theta.shape), parameters.tail, parameters.groups, rng)
        theta = theta + np.einsum("wpr,wnr->wnp", parameters.covariance_cholesky, own)
        theta = theta + (parameters.between_repetitions[:, None] / np.sqrt(counts)[:, None]) * rng.normal(
            size=theta.shape
        )
    with np.errstate(all="ignore"):  # a prior may reach where an element overflows
        z = fit.kernel.impedance(theta.reshape(-1, theta.shape[-1]), frequency).reshape(*theta.shape[:2], -1)
        stretch = drawn_stretch(fit.noise_tail, np.tile(counts, len(theta)), frequency.size, rng)
        sd = np.abs(z) * noise * (stretch.reshape(z.shape) if stretch.size > 1 else 1.0)
        return np.asarray(z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))


def _variables(z: np.ndarray) -> dict[str, np.ndarray]:
    """Of complex curves (..., N, F')."""
    with np.errstate(all="ignore"):
        magnitude = np.log(np.abs(z))
        phase = np.angle(z, deg=True)
    lost = ~np.isfinite(magnitude)
    magnitude[lost] = phase[lost] = np.nan
    count = np.maximum(np.sum(~lost, axis=-1), 1)
    level = np.where(np.all(lost, axis=-1), np.nan, np.nansum(magnitude, axis=-1) / count)
    return {"log_magnitude": magnitude, "phase_deg": phase, "recordings": level}


def _rounded(values: np.ndarray) -> np.ndarray:
    """In single precision, rounded to :data:`_BITS` binary digits; the others are zeros, which compress."""
    with np.errstate(invalid="ignore"):
        mantissa, exponent = np.frexp(values)
        return np.asarray(np.ldexp(np.round(np.ldexp(mantissa, _BITS)), exponent - _BITS), dtype=np.float32)
