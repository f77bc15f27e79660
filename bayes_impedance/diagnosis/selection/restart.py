r"""A second start: the network fitted to recordings from which an effect of the rig has been removed.

A strong effect of the rig drives the fit of the network alone to wrong elements in all people, and a refit with the
effect does not recover from there. But an effect of the rig acts at the port, where it can be removed without knowing
the network behind it. With :math:`z_0` and :math:`z_1` a person's network without and with the effect, recordings z
become

.. math:: z\,z_0/z_1, \qquad z - (z_1 - z_0), \qquad \left(1/z - (1/z_1 - 1/z_0)\right)^{-1}

for an effect that multiplies the impedance, is beside the finger, or in series with it: none of the three depends on
the elements of which :math:`z_0` is made. The network is fitted to the corrected recordings from scratch. The size need
only be roughly right: the elements found are only the start for refits of the original recordings.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import try_candidate
from bayes_impedance.network.operations import ADDING
from bayes_impedance.population.starting_fits import thinned_points
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.progress import Progress

_PEOPLE = 12
"""People on whom effects of the rig are tried. By choice: the effect is shared, so a subset shows it."""

_FEWEST = 5
"""With fewer people, a single one in a local optimum decides which start looks best. By choice."""

_LONGER = 2.0
"""Factor by which the one-step size may be too small because elements have absorbed part of the effect. By choice."""

_ROUNDS = 40
"""Largest number of rounds of the refit from the new start, which is far from its end. By choice."""

_SHARE = 0.6
"""Fraction of the known gain that the effect alone must reach from the new start. By choice: below it, the following
refits would start further from the end than before."""


def another_beginning(
    fitted: Fitted, step: Step, known: float, seed: int, executor: Executor, progress: Progress
) -> Refit | None:
    """Fit of the network alone after removing the effect of the rig that biases it most; None without enough gain.

    The effect is selected on a subset of people and frequencies.

    Parameters
    ----------
    fitted : Fitted
    step : Step
        The first step of a search, with its trials.
    known : float
        Gain of the effects found without a new start, of which the effect alone must reach a fraction.
    seed : int
    executor : Executor
    progress : callable

    Returns
    -------
    Refit or None
        Of the original recordings; not converged.
    """
    recordings, base = fitted.recordings, fitted.fit
    n = len(recordings.subjects)
    if n < _FEWEST or base.model.additions:
        return None
    some = np.unique(np.linspace(0, n - 1, min(n, _PEOPLE)).round().astype(int))

    def fitted_to(freed: Recordings) -> Refit:
        return fit_network(freed, base.model.network, seed, executor, lambda *_: None).fit

    def evidence(freed: Recordings) -> float:
        few = (freed.subjects[i] for i in some)
        thinned = tuple(s.at(thinned_points(s.frequency_hz.size)) for s in few)
        return float(fitted_to(replace(freed, subjects=thinned)).evidence.sum())

    sizes = _sizes(step)
    best, most = None, evidence(recordings) + LEAST_GAIN
    for k, (candidate, size) in enumerate(sizes):
        progress("another beginning", k, len(sizes) + 1)
        value = evidence(without(recordings, base, candidate, size))
        if value > most:
            best, most = (candidate, size), value
    progress("another beginning", len(sizes), len(sizes) + 1)
    if best is None:
        return None
    candidate, size = best
    # Where elements have absorbed part of the effect, the one-step size is too small.
    if evidence(without(recordings, base, candidate, _LONGER * size)) > most:
        size *= _LONGER
    end = fitted_to(without(recordings, base, candidate, size))
    begin = fitted.refitter.fit(base.model, end.u, end.population, rounds=0)
    trial = try_candidate(fitted.refitter, base, candidate, size, ("shared",), _ROUNDS, begin)[0]
    return begin if trial.gain > _SHARE * known else None


def without(recordings: Recordings, base: Refit, candidate: Candidate, size: float) -> Recordings:
    """Recordings with an effect at the port removed.

    Parameters
    ----------
    recordings : Recordings
    base : Refit
        The network alone.
    candidate : Candidate
        The effect, with its shape.
    size : float
        Its coefficient, in the unit of the effect.
    """
    model = extended(base.model, candidate, "shared", size)
    u = extended_start(base, model)[0]
    coefficient = model.columns(len(model.additions) - 1)[0]
    u[:, coefficient] = candidate.effect.coefficients[0].unbounded(size, model.scales)
    subjects = []
    for i, s in enumerate(recordings.subjects):
        rows = base.owner == i
        with_it = model.kernel.impedance(u[rows], s.frequency_hz)
        without_it = base.model.kernel.impedance(base.u[rows], s.frequency_hz)
        z, stretch = _freed(candidate.effect, s.z, without_it, with_it)
        subjects.append(replace(s, z=z, noise_sd=None if s.noise_sd is None else s.noise_sd * stretch))
    return replace(recordings, subjects=tuple(subjects))


def _freed(effect: Effect, z: np.ndarray, z0: np.ndarray, z1: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Impedance without the effect, and the factor of its noise, both of the shape of z."""
    if effect.operation in ADDING:
        return z - (z1 - z0), np.ones(z.shape)
    if effect.connection == "series":
        freed = 1 / (1 / z - (1 / z1 - 1 / z0))
        return freed, np.abs(freed / z) ** 2
    return z * z0 / z1, np.abs(z0 / z1)


def _sizes(step: Step) -> list[tuple[Candidate, float]]:
    """Effects of the rig, each with the shape that explains most and the one-step estimate of its coefficient."""
    screening = step.screening
    best: dict[str, int] = {}
    for k, candidate in enumerate(screening.candidates):
        effect, z = candidate.effect, abs(float(np.nan_to_num(screening.z[k])))
        if effect.side != "rig" or not effect.operation or candidate.place != "port":
            continue
        if effect.id not in best or z > abs(float(np.nan_to_num(screening.z[best[effect.id]]))):
            best[effect.id] = k
    sizes = [(screening.candidates[k], float(screening.size[k])) for k in best.values()]
    return [(c, size) for c, size in sizes if np.isfinite(size) and (c.effect.signed or size > 0)]
