r"""Posterior predictive distribution of new persons, and posterior predictive checks against the measured ones.

Three kinds of curve are drawn from the posterior, each including the uncertainty of the population's parameters:

* the population **centre**, the network with the median elements, z(exp mu);
* a new **person**: elements from N(mu, Sigma), or from the t distribution of a population with heavier tails, without
  noise;
* a new **recording**: a person's mean over J repetitions, with their deviations and with noise. Only this kind is
  comparable with recordings: by the pointwise coverage of the bands, and by the error of eq. 5. For the latter whole
  populations of the measured size are replicated, and their error about the same model curve is computed. At every
  frequency the observed error has a rank in that distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.population.covariate_terms import goes_with_others
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.noise_tails import drawn_stretch
from bayes_impedance.population.shapes import standard_people
from bayes_impedance.results.curve_errors import (
    ErrorCurves,
    common_grid,
    coverage,
    error_curves,
    lookup_table,
    on_grid,
    relative_rms,
)
from bayes_impedance.results.shown import predictive_html, predictive_table
from bayes_impedance.units import INTERVAL

if TYPE_CHECKING:
    import pandas as pd

PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Quantiles of every band: its 50 % and 90 % limits and the median."""
_AT_ONCE = 1000
"""People whose draws are copied at once. By choice: memory."""


@dataclass(frozen=True, repr=False)
class Band(Brief):
    """Pointwise quantiles of magnitude and phase.

    Attributes
    ----------
    magnitude, phase_deg : ndarray, shape (5, F)
        Rows in the order of :data:`PROBABILITIES`.
    """

    magnitude: np.ndarray
    phase_deg: np.ndarray

    @classmethod
    def of(cls, z: np.ndarray) -> Band:
        """Band from complex curves, shape (S, F)."""
        return cls(
            np.quantile(np.abs(z), PROBABILITIES, axis=0), np.quantile(np.angle(z, deg=True), PROBABILITIES, axis=0)
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class Replication(Brief):
    """Error (eq. 5) of the population network in replicated populations, and the rank of the observed error.

    Attributes
    ----------
    magnitude, phase_deg : ndarray, shape (3, F)
        5 %, 50 % and 95 % quantiles over replicates.
    magnitude_rank, phase_rank : ndarray, shape (F,)
        Share of replicates whose error is at least the observed one, pointwise.
    mean_magnitude_rank, mean_phase_rank : float
        The same for the mean over frequency: small if the recordings scatter more than the posterior can explain.
    replicates : int
    """

    magnitude: np.ndarray
    phase_deg: np.ndarray
    magnitude_rank: np.ndarray
    phase_rank: np.ndarray
    mean_magnitude_rank: float
    mean_phase_rank: float
    replicates: int


@dataclass(frozen=True, kw_only=True)
class Predictive:
    """Bands and errors on one grid.

    Attributes
    ----------
    frequency_hz : ndarray, shape (F,)
    observed : ndarray, complex, shape (N, F)
        Each person's mean recording; NaN outside the person's range.
    centre, person, recording : Band
    network_magnitude, network_phase_deg : ndarray, shape (F,)
        Curve of the population network: the posterior medians of the central values.
    errors : dict of str to ErrorCurves
        ``population_network``, ``lookup_mean``, ``lookup_median``.
    replication : Replication
    coverage50, coverage90 : ndarray, shape (2, F)
        Share of people inside the recording's bands, of magnitude and of phase.
    person_relative_rms : ndarray, shape (N,)
        Root-mean-square complex relative error of the network with each person's posterior median elements.
    person_delta_magnitude, person_delta_phase_deg : ndarray, shape (N,)
        Mean absolute errors of the same network.
    person_curve : ndarray, complex, shape (N, F)
        Impedance of the same network, averaged over the person's repetitions as the recordings are.
    """

    frequency_hz: np.ndarray
    observed: np.ndarray
    centre: Band
    person: Band
    recording: Band
    network_magnitude: np.ndarray
    network_phase_deg: np.ndarray
    errors: dict[str, ErrorCurves]
    replication: Replication
    coverage50: np.ndarray
    coverage90: np.ndarray
    person_relative_rms: np.ndarray
    person_delta_magnitude: np.ndarray
    person_delta_phase_deg: np.ndarray
    person_curve: np.ndarray

    def __repr__(self) -> str:
        f, n = self.frequency_hz, len(self.observed)
        return f"<Predictive of {n} subject{'s' if n > 1 else ''}: {f.size} frequencies from {f[0]:g} to {f[-1]:g} Hz>"

    def _repr_html_(self) -> str:
        return predictive_html(self)

    def to_dataframe(self) -> pd.DataFrame:
        """The bands over frequency.

        Returns
        -------
        DataFrame
            One row for each frequency in Hz. Columns such as ``recording_magnitude_q05``: of centre, person and
            recording, of magnitude (in the unit of the impedance) and phase_deg, each quantile of
            :data:`PROBABILITIES`; then network_magnitude and network_phase_deg.
        """
        return predictive_table(self)


def predict(fit: PopulationFit, *, n_draws: int = 1000, n_replicates: int = 200, seed: int = 1) -> Predictive:
    """Posterior-predictive bands and errors.

    Parameters
    ----------
    fit : PopulationFit
    n_draws : int
        Curves in each band.
    n_replicates : int
        Replicated populations.
    seed : int
    """
    rng = np.random.default_rng(seed)
    frequency = common_grid(fit.recordings)
    observed = on_grid(fit.recordings, frequency)
    kernel = fit.kernel
    total = fit.parameters.mu.shape[0]
    rows = np.linspace(0, total - 1, min(n_draws, total)).astype(int)

    centre = Band.of(kernel.impedance(fit.parameters.mu[rows], frequency))
    # The recordings are those of the same people: the bands then differ by repetitions and noise only.
    people = _people(fit, rows, rng)
    person = Band.of(kernel.impedance(people, frequency))
    noise = relative_noise(fit, frequency)
    recording = Band.of(_recordings(fit, rows, people, frequency, noise, rng))

    network = kernel.impedance(np.median(fit.parameters.mu, axis=0), frequency)
    magnitude, phase = np.abs(network), np.angle(network, deg=True)
    errors = {"population_network": error_curves(magnitude, phase, observed)}
    for statistic in ("mean", "median"):
        errors[f"lookup_{statistic}"] = error_curves(*lookup_table(observed, statistic), observed)

    measured = [np.abs(observed), np.angle(observed, deg=True)]
    measured[1][~np.isfinite(measured[0])] = np.nan
    bands = [recording.magnitude, recording.phase_deg]
    own = _own_networks(fit)
    return Predictive(
        frequency_hz=frequency,
        observed=observed,
        centre=centre,
        person=person,
        recording=recording,
        network_magnitude=magnitude,
        network_phase_deg=phase,
        errors=errors,
        replication=_replicate(
            fit, frequency, observed, noise, magnitude, phase, errors["population_network"], n_replicates, rng
        ),
        coverage50=np.array([coverage(m, b[1], b[3]) for m, b in zip(measured, bands, strict=True)]),
        coverage90=np.array([coverage(m, b[0], b[4]) for m, b in zip(measured, bands, strict=True)]),
        person_relative_rms=own[0],
        person_delta_magnitude=own[1],
        person_delta_phase_deg=own[2],
        person_curve=_own_curves(fit, frequency),
    )


def _people(fit: PopulationFit, rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Log elements of one new person for each given posterior draw, (S, P); of the only person if there is one."""
    parameters = fit.parameters[rows]
    if fit.one_person:
        return parameters.mu
    factor = parameters.covariance_cholesky
    own = standard_people(rng.normal(size=parameters.mu.shape), parameters.tail, parameters.groups, rng)
    theta = parameters.mu + np.einsum("spq,sq->sp", factor, own)
    if fit.settings.covariates:
        theta = theta + np.einsum("spq,sq->sp", parameters.slopes, drawn_covariates(fit, rows.size, rng))
    return np.asarray(theta)


def drawn_covariates(fit: PopulationFit, number: int, rng: np.random.Generator) -> np.ndarray:
    """Standardised covariates of new people, (S, Q): normal, or those of measured people where they go together."""
    names = fit.settings.covariates
    if not any(goes_with_others(name) for name in names):
        return np.asarray(rng.normal(size=(number, len(names))))
    measured = standardised_covariates(fit.recordings, names)
    return np.asarray(measured[rng.integers(len(measured), size=number)])


def _recordings(
    fit: PopulationFit,
    rows: np.ndarray,
    people: np.ndarray,
    frequency: np.ndarray,
    noise: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """Mean recordings of new people with given log elements (S, P), complex, (S, F).

    Each is the mean over a number of repetitions taken at random from the measured persons, with the relative noise
    (N, F) of a measured person.
    """
    theta = people
    counts = np.array([len(s.repetitions) for s in fit.recordings.subjects])
    if not fit.one_person:
        spread = fit.parameters[rows].between_repetitions / np.sqrt(rng.choice(counts, rows.size))[:, None]
        theta = people + spread * rng.normal(size=people.shape)
    z = fit.kernel.impedance(theta, frequency)
    who = rng.integers(len(fit.recordings.subjects), size=rows.size)
    sd = np.abs(z) * noise[who] * drawn_stretch(fit.noise_tail, counts[who], frequency.size, rng)
    return np.asarray(z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))


def relative_noise(fit: PopulationFit, frequency: np.ndarray) -> np.ndarray:
    """Noise of each person's mean recording relative to |z|, (N, F)."""
    rows = []
    for subject, noise in zip(fit.recordings.subjects, fit.noise, strict=True):
        sd = np.sqrt(np.sum(noise**2, axis=0)) / noise.shape[0]
        rows.append(np.interp(np.log(frequency), np.log(subject.frequency_hz), sd / np.abs(subject.mean)))
    return np.array(rows)


def _replicate(
    fit: PopulationFit,
    frequency: np.ndarray,
    observed: np.ndarray,
    noise: np.ndarray,
    magnitude: np.ndarray,
    phase: np.ndarray,
    seen: ErrorCurves,
    n_replicates: int,
    rng: np.random.Generator,
) -> Replication:
    n = len(fit.recordings.subjects)
    missing = ~np.isfinite(observed)
    total = fit.parameters.mu.shape[0]
    errors = []
    for row in rng.choice(total, n_replicates, replace=total < n_replicates):
        rows = np.full(n, row)
        z = _recordings(fit, rows, _people(fit, rows, rng), frequency, noise, rng)
        z[missing] = np.nan
        errors.append(error_curves(magnitude, phase, z))
    m, p = np.array([e.magnitude for e in errors]), np.array([e.phase_deg for e in errors])

    def rank(replicated: np.ndarray, value: np.ndarray) -> np.ndarray:
        # One is added to both counts: the observed population counts as a replicate, so that no rank is zero.
        return np.asarray((1 + np.sum(replicated >= value, axis=0)) / (n_replicates + 1))

    return Replication(
        magnitude=np.quantile(m, INTERVAL, axis=0),
        phase_deg=np.quantile(p, INTERVAL, axis=0),
        magnitude_rank=rank(m, seen.magnitude),
        phase_rank=rank(p, seen.phase_deg),
        mean_magnitude_rank=float(rank(np.nanmean(m, axis=1), np.nanmean(seen.magnitude))),
        mean_phase_rank=float(rank(np.nanmean(p, axis=1), np.nanmean(seen.phase_deg))),
        replicates=n_replicates,
    )


def _own_networks(fit: PopulationFit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of each person's posterior median network on the person's grid: relative rms, magnitude, phase; (N,)."""
    middle = _own_elements(fit)
    result = []
    for i, subject in enumerate(fit.recordings.subjects):
        # Repetitions are compared one by one: their mean is not the impedance of any single network.
        model = fit.kernel.impedance(middle[i] + fit.deviations[i], subject.frequency_hz)
        rms = np.sqrt(np.mean(relative_rms(model, subject.z) ** 2))
        errors = error_curves(np.abs(model.mean(axis=0)), np.angle(model.mean(axis=0), deg=True), subject.mean[None])
        result.append((rms, errors.magnitude.mean(), errors.phase_deg.mean()))
    columns = np.array(result).T
    return columns[0], columns[1], columns[2]


def _own_curves(fit: PopulationFit, frequency: np.ndarray) -> np.ndarray:
    """Impedance of each person's posterior median network, mean over the person's repetitions, complex, (N, F)."""
    middle = _own_elements(fit)
    rows = [
        fit.kernel.impedance(own + d, frequency).mean(axis=0) for own, d in zip(middle, fit.deviations, strict=True)
    ]
    return np.array(rows)


def _own_elements(fit: PopulationFit) -> np.ndarray:
    """Posterior median of each person's elements, as logarithms, (N, P)."""
    draws = fit.person_draws.reshape(-1, *fit.person_draws.shape[2:])
    people = range(0, draws.shape[1], _AT_ONCE)  # a median copies what it is taken of
    return np.concatenate([np.median(draws[:, i : i + _AT_ONCE], axis=0) for i in people], dtype=float)
