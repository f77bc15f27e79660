"""One ensemble of walkers: it adapts, samples, can be resumed from its file, and may turn to trajectories."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.mcmc.chain_file import read_chain, write_chain
from bayes_impedance.mcmc.crank_nicolson import crank_nicolson_move
from bayes_impedance.mcmc.hamiltonian import hamiltonian_move
from bayes_impedance.mcmc.mirrored import mirrored_move

LogProbability = Callable[[np.ndarray], np.ndarray]
Gradient = Callable[[np.ndarray], np.ndarray]

_CURVED = 0.25
"""Acceptance at the end of the burn-in below which a target is too curved for Crank-Nicolson proposals. Measured, quick
fits of 16 to 71 persons: autocorrelation times of 40 to 100 steps above 0.3, 170 to 430 steps at 0.10 to 0.18. A step
along a trajectory takes about six times as long."""
_TRAJECTORIES = 40
"""Steps of the burn-in along trajectories. By choice: four to eight of their autocorrelation times."""
_PIECE, _KEPT_SHARE = 25, 0.1
"""Steps between reports of progress, by choice. A chain is rewritten when it has grown by this fraction: writing four
ensembles of 104 walkers in 52 dimensions after 400 steps cost 1.6 s in all (measured); emcee's own writing, step by
step, takes 9 s.
"""
_HALVINGS = 10
"""Most times that the distance of a walker from the centre is halved at the start, while the density is zero there."""

_OF_MIRRORED = 0.2
"""Weight of the move of mirrored coordinates beside the others, whose weights add up to one. Measured with two groups
among 24 people (six populations, 13 dimensions): longest autocorrelation times 13 to 125 with 0.1 to 0.4, 220 to 390
with 1, and 370 to 1320 with 4, as the other coordinates are moved less often."""

_CLEARLY_NOT_ZERO = 2.0
"""Mean of a coordinate's absolute value, in its standard deviations, above which it is clearly not zero: 1.3 of a
normal distribution about zero, 5 where the normal distribution is five standard deviations away. By choice."""


class Ensemble:
    """One independent ensemble: adapts, samples, and can be resumed from its file.

    The chain grows in memory and is written as a whole from time to time (:mod:`~bayes_impedance.mcmc.chain_file`). The
    file is complete whenever the process is killed, and continuing from the random state at its end reproduces the lost
    steps exactly.
    """

    def __init__(
        self,
        log_probability: LogProbability,
        centre: np.ndarray,
        covariance: np.ndarray,
        seed: np.random.SeedSequence,
        file: Path | None,
        even: np.ndarray,
        gradient: Gradient | None = None,
        mirrored: np.ndarray | None = None,
    ) -> None:
        self.log_probability, self.gradient = log_probability, gradient
        self.mirrored = np.zeros(centre.size, dtype=bool) if mirrored is None else mirrored
        self.n_dimensions = centre.size
        self.n_walkers = 2 * max(centre.size, 16)
        self.centre, self.covariance, self.file = centre, covariance, file
        self.even = even
        self.seed = seed
        self.adapted: dict[str, Any] = {}
        self.kept = -1
        self.sampler: Any = None
        self.state: Any = None

    def prepare(self, stages: tuple[int, ...], progress: Callable[[int], None]) -> None:
        """Burn in, or resume where an earlier run stopped."""
        backend = self._empty()
        adapted = read_chain(self.file, backend) if self.file is not None else None
        if adapted is not None:
            self.kept = backend.iteration
        self.adapted = adapted or self._burn_in(stages, progress)
        self._begin(backend)

    def _empty(self) -> Any:
        import emcee

        backend = emcee.backends.Backend()
        backend.reset(self.n_walkers, self.n_dimensions)
        return backend

    def _begin(self, backend: Any) -> None:
        """Begin a chain where the adaptation ended, or go on at the end of the one that was read."""
        import emcee

        self.sampler = self._sampler(self.adapted["mean"], self.adapted["covariance"], backend, self.curved)
        if backend.iteration:
            self.state = backend.get_last_sample()
        else:
            self.state = emcee.State(self.adapted["coordinates"], random_state=self.adapted["random_state"])
        self.keep()

    def _burn_in(self, lengths: tuple[int, ...], progress: Callable[[int], None]) -> dict[str, Any]:
        rng = np.random.RandomState(np.random.MT19937(self.seed))
        normal = rng.standard_normal((self.n_walkers, self.n_dimensions))
        adapted = {
            "mean": self.centre,
            "covariance": self.covariance,
            "coordinates": self._inside(self.centre, normal @ np.linalg.cholesky(self.covariance).T),
            "random_state": rng.get_state(),
        }
        accepted = 1.0
        for n_steps in lengths:
            adapted, accepted = self._stage(adapted, n_steps, False, progress)
        curved = accepted < _CURVED and self.gradient is not None
        if curved:
            adapted, _ = self._stage(adapted, _TRAJECTORIES, True, progress)
        return adapted | {"curved": np.array(float(curved)), "turned": np.array(0.0)}

    def _stage(
        self, adapted: dict[str, Any], n_steps: int, curved: bool, progress: Callable[[int], None]
    ) -> tuple[dict[str, Any], float]:
        """Walk on and adapt to the second half of the steps; also the share of proposals that were accepted."""
        import emcee

        sampler = self._sampler(adapted["mean"], adapted["covariance"], None, curved)
        state = emcee.State(adapted["coordinates"], random_state=adapted["random_state"])
        iterator = sampler.sample(state, iterations=n_steps, skip_initial_state_check=True)
        for done, current in enumerate(iterator):
            state = current
            if done % 10 == 9:
                progress(10)
        recent = sampler.get_chain(discard=n_steps // 2, flat=True)
        one_sided = self._one_sided(recent)
        recent = np.where(one_sided, np.abs(recent), recent)
        after = {
            "mean": recent.mean(axis=0),
            "covariance": _refined(adapted["covariance"], np.atleast_2d(np.cov(recent.T))),
            "coordinates": np.where(one_sided, np.abs(state.coords), state.coords),
            "random_state": state.random_state,
        }
        return after, float(sampler.acceptance_fraction.mean())

    @property
    def curved(self) -> bool:
        """Whether it samples along trajectories."""
        return bool(self.adapted["curved"])

    @property
    def turned(self) -> bool:
        """Whether it does so because its chain had been too slow."""
        return bool(self.adapted["turned"])

    def turn(self) -> None:
        """Give up the chain, and sample along trajectories from where it ended."""
        state = self.sampler.backend.get_last_sample()
        here = self.adapted | {"coordinates": state.coords, "random_state": state.random_state}
        adapted, _ = self._stage(here, _TRAJECTORIES, True, lambda _: None)
        self.adapted, self.kept = adapted | {"curved": np.array(1.0), "turned": np.array(1.0)}, -1
        self._begin(self._empty())

    def _inside(self, mean: np.ndarray, away: np.ndarray) -> np.ndarray:
        """Walkers (W, D) at `away` from the mean, nearer where the density is zero: there no proposal is compared."""
        for _ in range(_HALVINGS):
            outside = ~np.isfinite(self.log_probability(mean + away))
            if not outside.any():
                break
            away[outside] *= 0.5
        return np.asarray(mean + away)

    def _one_sided(self, recent: np.ndarray) -> np.ndarray:
        """Even coordinates that are clearly not zero: walkers at the mirrored peak are brought to the other."""
        size = np.abs(recent)
        return np.asarray(self.even & (size.mean(axis=0) > _CLEARLY_NOT_ZERO * size.std(axis=0)))

    def _sampler(self, mean: np.ndarray, covariance: np.ndarray, backend: Any, curved: bool) -> Any:
        import emcee

        mostly = crank_nicolson_move(mean, covariance)
        if curved and self.gradient is not None:
            mostly = hamiltonian_move(self.gradient, mean, covariance)
        moves = [
            (mostly, 0.9),
            (emcee.moves.DEMove(), 0.08),
            (emcee.moves.DEMove(gamma0=1.0), 0.02),
        ]
        if self.mirrored.any():
            moves.append((mirrored_move(self.mirrored), _OF_MIRRORED))
        sampler = emcee.EnsembleSampler(
            self.n_walkers, self.n_dimensions, self.log_probability, moves=moves, vectorize=True, backend=backend
        )
        # emcee's wrapper prints walkers and traceback of any error, also of one that is told in a sentence elsewhere.
        sampler.log_prob_fn = self.log_probability
        return sampler

    def run_to(self, n_steps: int, progress: Callable[[int], None]) -> None:
        """Sample until the ensemble has this many steps."""
        backend = self.sampler.backend
        while backend.iteration < n_steps:
            piece = min(_PIECE, n_steps - backend.iteration)
            for state in self.sampler.sample(self.state, iterations=piece, skip_initial_state_check=True):
                self.state = state
            # The file is rewritten each time: the total cost should grow linearly with the chain, not quadratically.
            if backend.iteration - self.kept >= max(_PIECE, _KEPT_SHARE * backend.iteration):
                self.keep()
            progress(piece)

    def keep(self) -> None:
        """Write the chain if the file is not up to date."""
        if self.file is not None and self.kept < self.sampler.backend.iteration:
            write_chain(self.file, self.sampler.backend, self.adapted)
            self.kept = self.sampler.backend.iteration


def _refined(covariance: np.ndarray, sampled: np.ndarray) -> np.ndarray:
    """The previous covariance, rescaled to the sampled standard deviations and mixed with a little of the sampled one.

    A short burn-in gives good standard deviations but poor correlations, which outnumber the independent samples.
    """
    width = np.sqrt(np.diag(sampled) / np.diag(covariance))
    return np.asarray(0.8 * covariance * np.outer(width, width) + 0.2 * sampled)
