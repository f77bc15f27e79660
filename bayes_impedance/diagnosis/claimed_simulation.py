r"""A simulation as the claim: its network and effects, its unexplained remainder, and the elements of its people.

The simulation is fitted and searched like recordings. Effects found in it belong to the claim. If structure remains,
the simulation contains more than the network, and the same structure in the recordings is not a difference between the
two. With the fit Z of each person's simulated z',

.. math:: 1 + \varrho(f) = \langle z'(f)/Z(f) \rangle, \qquad z(f) \to z(f)/(1 + \varrho(f)),

the mean being over a person's repetitions, weighted by their noise if it is given, where the simulation is of the same
people, over all people otherwise. The simulation's own noise comes with it.

If the people are the same, the search starts at the simulation's elements: an effect that the elements of the
recordings' own fit partly absorb is more visible there.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.extend import extended_start, starts_of
from bayes_impedance.diagnosis.fit.model import Model, build
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.locate import locate
from bayes_impedance.diagnosis.selection.predictive_gain import names_that_predict
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.diagnosis.selection.unnamed import structure_remains
from bayes_impedance.network.notation import Network
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.runtime.progress import Progress

_ROUNDS = 80
"""Largest number of rounds of the fit of a simulation. By choice: without noise it converges slowly, and it must
converge."""

_ALIKE = 0.25
"""Share of the median distance between two people below which the distance to one's own simulation shows that the
simulation is of the same people. By choice."""


@dataclass(frozen=True)
class Claim:
    """A simulation and its fit.

    Attributes
    ----------
    simulation : Recordings
    found : Found
        Its fitted population, and effects beyond the network that it contains.
    rest : tuple of ndarray
        For every person 1 + rho at the person's frequencies; empty if nothing remains unexplained.
    """

    simulation: Recordings
    found: Found
    rest: tuple[np.ndarray, ...]

    def is_of(self, recordings: Recordings) -> bool:
        """Whether simulation and recordings are of the same people at the same frequencies.

        Names are not sufficient: many simulations call their people S01, S02. The curves of one name have to be much
        more alike than those of different names.
        """
        simulated = {s.name: s for s in self.simulation.subjects}
        pairs = [(s, simulated[s.name]) for s in recordings.subjects if s.name in simulated]
        if len(pairs) != len(recordings.subjects) or len(pairs) != len(simulated):
            return False
        if any(not np.array_equal(ours.frequency_hz, theirs.frequency_hz) for ours, theirs in pairs):
            return False
        if len(pairs) == 1:
            return True
        if any(not np.array_equal(ours.frequency_hz, pairs[0][0].frequency_hz) for ours, _ in pairs):
            return False
        ours, theirs = (np.log(np.array([pair[k].mean for pair in pairs])) for k in (0, 1))
        distance = np.mean(np.abs(ours[:, None] - theirs[None]) ** 2, axis=2)
        same = np.eye(len(pairs), dtype=bool)
        return bool(np.median(distance[same]) < _ALIKE * np.median(distance[~same]))

    def without_rest(self, recordings: Recordings) -> Recordings:
        """The recordings divided by the part of the simulation that its fit does not explain."""
        if not self.rest:
            return recordings
        own = dict(zip(self.simulation.names, self.rest, strict=True)) if self.is_of(recordings) else None
        subjects = []
        for s in recordings.subjects:
            factor = self._mean_rest(s.frequency_hz) if own is None else own[s.name]
            noise = None if s.noise_sd is None else s.noise_sd / np.abs(factor)
            subjects.append(replace(s, z=s.z / factor, noise_sd=noise))
        return replace(recordings, subjects=tuple(subjects))

    def _mean_rest(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Mean of 1 + rho over the simulation's people, at other frequencies; constant outside of their range."""
        x = np.log(frequency_hz)
        rows = [
            np.interp(x, np.log(s.frequency_hz), factor.real) + 1j * np.interp(x, np.log(s.frequency_hz), factor.imag)
            for s, factor in zip(self.simulation.subjects, self.rest, strict=True)
        ]
        return np.asarray(np.mean(rows, axis=0))

    def start(self, fitted: Fitted, seed: int) -> tuple[Refit, Refit | None]:
        """The recordings' fit with the simulation's effects, and the fit at which the search for more starts.

        Each person's elements begin at the person's own fit without that physics, at the simulation's centre, and, if
        the people are the same, at their own elements in the simulation: the best result is kept, because a strong
        addition may have moved the elements far.
        """
        claimed = self.found.final
        own = fitted.fit.model
        model = build(own.network, claimed.model.additions, own.scales, starts_of(claimed.model))
        u, population = extended_start(fitted.fit, model)
        u[:, model.n_elements :] = claimed.u[:, model.n_elements :].mean(axis=0)
        varying = np.flatnonzero(~model.shared) >= model.n_elements
        mu, covariance, rho = population.mu.copy(), population.covariance.copy(), population.rho.copy()
        mu[varying], rho[varying] = claimed.population.mu[varying], claimed.population.rho[varying]
        covariance[np.ix_(varying, varying)] = claimed.population.covariance[np.ix_(varying, varying)]
        refitter = fitted.refitter
        ends = [refitter.fit(model, u, replace(population, mu=mu, covariance=covariance, rho=rho), _ROUNDS)]
        begin = None
        if self.is_of(fitted.recordings):
            people = self._people(fitted, model)
            begin = refitter.fit(model, people, claimed.population, rounds=0)
            ends.append(refitter.fit(model, people, claimed.population, _ROUNDS))
        else:
            centre = u.copy()
            centre[:, : model.n_elements] = claimed.u[:, : model.n_elements].mean(axis=0)
            ends.append(refitter.fit(model, centre, claimed.population, _ROUNDS))
        return refitter.settle(max(ends, key=lambda fit: float(fit.evidence.sum())), seed), begin

    def _people(self, fitted: Fitted, model: Model) -> np.ndarray:
        """Parameters of each recording's person in the simulation, means over repetitions, shape (M, P)."""
        claimed = self.found.final
        mean = {name: claimed.u[claimed.owner == i].mean(axis=0) for i, name in enumerate(self.simulation.names)}
        rows = np.array([mean[name] for name in fitted.recordings.names])
        return np.asarray(rows[fitted.refitter.owner][:, : len(model.kernel.elements)])


def claim_of(
    simulation: Recordings,
    network: Network | str | None,
    effects: Sequence[Effect],
    seed: int,
    executor: Executor,
    progress: Progress,
) -> Claim:
    """Fit a simulation and search it for effects.

    Parameters
    ----------
    simulation : Recordings
    network : Network or str, optional
        The claimed network; that of the simulation if not given.
    effects : sequence of Effect
        Candidates.
    seed : int
    executor : Executor
    progress : callable
    """
    fitted = fit_network(simulation, network, seed, executor, progress)
    found = search(fitted.refitter, fitted.fit, simulation.names, effects, seed, executor, progress)
    found, _ = names_that_predict(fitted.refitter, found, seed)  # as of recordings
    final = found.final
    p_value = locate(tuple(person_residuals(final, simulation.names, executor)), seed).p_value
    if not structure_remains(found, p_value):
        return Claim(simulation, found, ())
    rest = []
    for i, s in enumerate(simulation.subjects):
        fitted_z = final.model.kernel.impedance(final.u[final.owner == i], s.frequency_hz)
        # Repetitions count by their stated noise: a disturbed one would put its disturbance into all recordings.
        weight = None if s.noise_sd is None else (np.abs(fitted_z) / s.noise_sd) ** 2
        rest.append(np.average(s.z / fitted_z, axis=0, weights=weight))
    return Claim(simulation, found, tuple(rest))
