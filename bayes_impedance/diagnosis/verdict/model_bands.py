"""Description of all recordings by a model with additions: predictive bands, the paper's errors, residual maps.

Bands are posterior-predictive for a new person's mean recording, from the population estimate: elements and varying
coefficients are drawn from the population, their deviations between repetitions and the noise are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor

import numpy as np

from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.calibration_error import without_calibration_error
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.locate import residual_maps
from bayes_impedance.diagnosis.types import Snapshot
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.curve_errors import common_grid, coverage, error_curves, on_grid, relative_rms
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.units import INTERVAL

_DRAWS = 600
"""Predictive draws: the probability below the 5 % quantile then has a standard error of 0.9 %."""


def described(recordings: Recordings, network: str, seed: int, executor: Executor, progress: Progress) -> Snapshot:
    """A network alone, fitted and described as at the beginning of its diagnosis.

    Parameters
    ----------
    recordings : Recordings
    network : str
    seed : int
    executor : Executor
    progress : callable
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        inside = without_calibration_error(recordings.in_memory(), network, seed, executor, progress)
        recordings, network = inside.recordings, str(inside.network)
        fit = fit_network(recordings, network, seed, executor, progress).fit
        residuals = person_residuals(fit, recordings.names, executor)
        return snapshot("before", recordings, fit, residuals, seed)


def snapshot(
    label: str, recordings: Recordings, fit: Refit, residuals: Sequence[PersonResiduals], seed: int
) -> Snapshot:
    """Describe a fitted model.

    Parameters
    ----------
    label : str
    recordings : Recordings
    fit : Refit
    residuals : sequence of PersonResiduals
        Of that fit.
    seed : int
        For the predictive draws.
    """
    frequency = common_grid(recordings)
    observed = on_grid(recordings, frequency)
    kernel, shared = fit.model.kernel, fit.model.shared
    population = fit.population
    rng = np.random.default_rng(seed)
    counts = np.array([len(s.repetitions) for s in recordings.subjects])
    one_person = len(recordings.subjects) == 1
    u = np.empty((_DRAWS, shared.size))
    u[:, shared] = fit.shared_value
    if one_person:  # no population: the band is that of this person's own recordings
        u[:] = np.tile(fit.u, (_DRAWS // len(fit.u) + 1, 1))[:_DRAWS]
    else:
        factor = np.linalg.cholesky(population.covariance)
        people = population.mu + rng.normal(size=(_DRAWS, factor.shape[0])) @ factor.T
        spread = population.rho / np.sqrt(rng.choice(counts, _DRAWS))[:, None] * (counts.max() > 1)
        u[:, ~shared] = people + spread * rng.normal(size=people.shape)
    z = kernel.impedance(u, frequency)
    noise = np.array([_relative_noise(person, frequency) for person in residuals])
    sd = np.abs(z) * noise[rng.integers(len(noise), size=_DRAWS)]
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    z = z[np.all(np.isfinite(z), axis=1)]
    magnitude = np.quantile(np.abs(z), INTERVAL, axis=0)
    phase = np.quantile(np.angle(z, deg=True), INTERVAL, axis=0)
    centre = np.empty((1, shared.size))
    centre[:, shared], centre[:, ~shared] = fit.shared_value, fit.u[:, ~shared].mean(axis=0)
    if not one_person:
        centre[:, ~shared] = population.mu
    curve = kernel.impedance(centre, frequency)[0]
    errors = error_curves(np.abs(curve), np.angle(curve, deg=True), observed)
    measured = np.where(np.isfinite(observed), np.angle(observed, deg=True), np.nan)
    inside = [coverage(np.abs(observed), magnitude[0], magnitude[2]), coverage(measured, phase[0], phase[2])]
    maps = residual_maps(residuals, frequency)
    return Snapshot(
        label=label,
        network=fit.model.notation,
        frequency_hz=frequency,
        magnitude=magnitude,
        phase_deg=phase,
        residual_magnitude=maps[0],
        residual_phase=maps[1],
        delta_magnitude=errors.magnitude,
        delta_phase_deg=errors.phase_deg,
        subject_rms_relative=own_errors(recordings, residuals),
        coverage90=np.array(inside),
        person_curve=_own_curves(residuals, frequency),
    )


def _own_curves(residuals: Sequence[PersonResiduals], frequency_hz: np.ndarray) -> np.ndarray:
    """Each person's fitted model on a common grid, mean over the repetitions, complex, (N, F); NaN outside."""
    result, x = np.full((len(residuals), frequency_hz.size), np.nan + 0j), np.log(frequency_hz)
    for row, person in zip(result, residuals, strict=True):
        own, mean = np.log(person.frequency_hz), person.model.mean(axis=0)
        row[:] = np.interp(x, own, mean.real, np.nan, np.nan) + 1j * np.interp(x, own, mean.imag, np.nan, np.nan)
    return result


def own_errors(recordings: Recordings, residuals: Sequence[PersonResiduals]) -> np.ndarray:
    """Complex relative error of each person's fitted network, rms over frequency and repetitions, shape (N,)."""
    return np.array(
        [
            np.sqrt(np.mean(relative_rms(person.model, subject.z) ** 2))
            for person, subject in zip(residuals, recordings.subjects, strict=True)
        ]
    )


def _relative_noise(person: PersonResiduals, frequency_hz: np.ndarray) -> np.ndarray:
    """Noise standard deviation of a person's mean recording relative to |z|, shape (F,)."""
    sd = np.sqrt(np.sum(person.sd**2, axis=0)) / person.sd.shape[0]
    size = np.abs(person.model).mean(axis=0)
    return np.asarray(np.interp(np.log(frequency_hz), np.log(person.frequency_hz), sd / size))
