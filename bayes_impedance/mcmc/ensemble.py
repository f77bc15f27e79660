r"""Ensemble sampling of a few dozen dimensions by emcee.

**Moves.** Affine-invariant moves slow down in proportion to the dimension, and a full covariance of eight elements has
52. Here the posterior is close to normal in its coordinates, so most proposals are of the Crank-Nicolson type around a
normal approximation (:mod:`bayes_impedance.mcmc.crank_nicolson`). Where few of them are accepted, because the target is
curved, and its gradient is given, Hamiltonian proposals take their place (:mod:`bayes_impedance.mcmc.hamiltonian`). One
step in ten is emcee's differential evolution, which needs no approximation. `DESnookerMove` is not used: in emcee 3.1.6
it samples the wrong distribution.

**Convergence.** Several ensembles start and adapt independently. R-hat is taken between ensembles, never between the
walkers of one, which are not independent chains; the autocorrelation time within ensembles gives the effective sample
size. Sampling continues until both meet their limits or the longest length is reached; the result states which.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.display import Brief, Chosen
from bayes_impedance.mcmc.autocorrelation import autocorrelation_time
from bayes_impedance.mcmc.chain_file import read_chain, write_chain
from bayes_impedance.mcmc.convergence import rhat
from bayes_impedance.mcmc.crank_nicolson import crank_nicolson_move
from bayes_impedance.mcmc.hamiltonian import hamiltonian_move
from bayes_impedance.mcmc.mirrored import labelled, mirrored_move
from bayes_impedance.runtime.progress import Progress

LogProbability = Callable[[np.ndarray], np.ndarray]
Gradient = Callable[[np.ndarray], np.ndarray]

_CURVED = 0.25
"""Acceptance at the end of the burn-in below which a target is too curved for Crank-Nicolson proposals. Measured, quick
fits of 16 to 71 persons: autocorrelation times of 40 to 100 steps above 0.3, 170 to 430 steps at 0.10 to 0.18. A step
along a trajectory takes about six times as long."""
_TRAJECTORIES = 40
"""Steps of the burn-in along trajectories. By choice: four to eight of their autocorrelation times."""
_KEPT_DRAWS = 500
"""Draws of each ensemble in the result. By choice: with four ensembles a hundred draws lie below a 5 % quantile."""
_PIECE, _KEPT_SHARE = 25, 0.1
"""Steps between reports of progress, by choice. A chain is rewritten when it has grown by this fraction: writing four
ensembles of 104 walkers in 52 dimensions after 400 steps cost 1.6 s in all (measured); emcee's own writing, step by
step, takes 9 s.
"""


@dataclass(frozen=True, kw_only=True, repr=False)
class SamplerSettings(Chosen):
    """Settings of the sampler's length and convergence.

    Attributes
    ----------
    ensembles : int
        At least two, for R-hat.
    burn_in : tuple of int
        Steps of each stage of adaptation.
    chunk, longest : int
        Steps between checks of convergence, and largest number of steps.
    rhat : float
        Largest accepted R-hat of any coordinate.
    effective : float
        Smallest accepted effective sample size of any coordinate.
    memories : float
        Smallest accepted length of the chains in autocorrelation times. It need not be large, because chains start
        close to equilibrium and the time is estimated from a hundred walkers.
    workers : int
        Ensembles that run side by side.
    """

    ensembles: int = 4
    burn_in: tuple[int, ...] = (80, 60)
    chunk: int = 40
    longest: int = 3000
    rhat: float = 1.01
    effective: float = 1500.0
    memories: float = 5.0
    workers: int = 2

    def satisfied_by(self, chains: Chains) -> bool:
        """Whether the chains meet all convergence limits."""
        return bool(
            chains.rhat.max() <= self.rhat
            and chains.effective.min() >= self.effective
            and chains.steps >= self.memories * chains.autocorrelation_time.max()
        )


QUICK = SamplerSettings(ensembles=2, burn_in=(80, 40), chunk=100, longest=1500, effective=600.0)
"""Settings of a quick fit. By choice: fewer and shorter ensembles take less time, but give fewer effective draws."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Chains(Brief):
    """Draws and their convergence diagnostics.

    Attributes
    ----------
    coordinates : ndarray, shape (E, S, D)
        Draws of each ensemble, at least one autocorrelation time apart.
    log_probability : ndarray, shape (E, S)
    rhat : ndarray, shape (D,)
        Between ensembles, rank-normalised.
    effective : ndarray, shape (D,)
        Effective sample size, summed over ensembles.
    autocorrelation_time : ndarray, shape (D,)
        In steps of an ensemble, mean over ensembles.
    acceptance : float
    steps, walkers : int
        Length of each ensemble after burn-in, and its size.
    """

    coordinates: np.ndarray
    log_probability: np.ndarray
    rhat: np.ndarray
    effective: np.ndarray
    autocorrelation_time: np.ndarray
    acceptance: float
    steps: int
    walkers: int


_HALVINGS = 10
"""Most times that the distance of a walker from the centre is halved at the start, while the density is zero there."""

_OF_MIRRORED = 0.2
"""Weight of the move of mirrored coordinates beside the others, whose weights add up to one. Measured with two groups
among 24 people (six populations, 13 dimensions): longest autocorrelation times 13 to 125 with 0.1 to 0.4, 220 to 390
with 1, and 370 to 1320 with 4, as the other coordinates are moved less often."""

_CLEARLY_NOT_ZERO = 2.0
"""Mean of a coordinate's absolute value, in its standard deviations, above which it is clearly not zero: 1.3 of a
normal distribution about zero, 5 where the normal distribution is five standard deviations away. By choice."""


class _Ensemble:
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
        import emcee

        backend = emcee.backends.Backend()
        backend.reset(self.n_walkers, self.n_dimensions)
        adapted = read_chain(self.file, backend) if self.file is not None else None
        if adapted is not None:
            self.kept = backend.iteration
        self.adapted = adapted or self._burn_in(stages, progress)
        curved = bool(self.adapted["curved"])
        self.sampler = self._sampler(self.adapted["mean"], self.adapted["covariance"], backend, curved)
        if backend.iteration:
            self.state = backend.get_last_sample()
        else:
            self.state = emcee.State(self.adapted["coordinates"], random_state=self.adapted["random_state"])
        self.keep()

    def _burn_in(self, lengths: tuple[int, ...], progress: Callable[[int], None]) -> dict[str, Any]:
        import emcee

        rng = np.random.RandomState(np.random.MT19937(self.seed))
        mean, covariance = self.centre, self.covariance
        normal = rng.standard_normal((self.n_walkers, self.n_dimensions))
        coordinates = self._inside(mean, normal @ np.linalg.cholesky(covariance).T)
        random_state = rng.get_state()
        curved, stages = False, list(lengths)
        while stages:
            n_steps = stages.pop(0)
            sampler = self._sampler(mean, covariance, None, curved)
            state = emcee.State(coordinates, random_state=random_state)
            iterator = sampler.sample(state, iterations=n_steps, skip_initial_state_check=True)
            for done, current in enumerate(iterator):
                state = current
                if done % 10 == 9:
                    progress(10)
            coordinates, random_state = state.coords, state.random_state
            recent = sampler.get_chain(discard=n_steps // 2, flat=True)
            one_sided = self._one_sided(recent)
            coordinates = np.where(one_sided, np.abs(coordinates), coordinates)
            recent = np.where(one_sided, np.abs(recent), recent)
            mean, covariance = recent.mean(axis=0), _refined(covariance, np.atleast_2d(np.cov(recent.T)))
            poor = float(sampler.acceptance_fraction.mean()) < _CURVED
            if not stages and not curved and poor and self.gradient is not None:
                curved, stages = True, [_TRAJECTORIES]
        return {
            "mean": mean,
            "covariance": covariance,
            "coordinates": coordinates,
            "random_state": random_state,
            "curved": np.array(float(curved)),
        }

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


def sample(
    log_probability: LogProbability,
    centre: np.ndarray,
    scale: np.ndarray,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress,
    checkpoint: Path | None = None,
    first_file: int = 0,
    even: np.ndarray | None = None,
    gradient: Gradient | None = None,
    mirrored: np.ndarray | None = None,
) -> Chains:
    """Sample a distribution that is close to normal.

    Parameters
    ----------
    log_probability : callable
        Maps (W, D) to (W,); called from several threads.
    centre : ndarray, shape (D,)
        A first guess of the distribution's centre.
    scale : ndarray, shape (D,) or (D, D)
        A first guess of its standard deviations or of its covariance; walkers start there.
    settings : SamplerSettings
    seed : SeedSequence
    progress : callable
    checkpoint : Path, optional
        Folder in which the growing chains are saved (``ensemble_0.h5`` and so on, readable by emcee's ``HDFBackend``);
        chains found there are continued.
    first_file : int
        Number of the first ensemble's file, so that several samplings share the folder.
    even : ndarray of bool, shape (D,), optional
        Coordinates of whose sign the density does not depend; their absolute values are returned.
    gradient : callable, optional
        Gradient of the log density, or nearly: maps (W, D) to (W, D). Where it is given, a curved density is sampled
        along trajectories.
    mirrored : ndarray of bool, shape (D,), optional
        Coordinates that may change their signs together without the density changing; the signs that are returned are
        chosen by :func:`~bayes_impedance.mcmc.mirrored.labelled`.

    Returns
    -------
    Chains
        Compare ``rhat`` and ``effective`` with the settings: no error is raised if they are not met.

    Raises
    ------
    InputError
        If the folder keeps chains of another number of dimensions.
    """
    covariance = np.diag(scale**2) if scale.ndim == 1 else scale
    children = seed.spawn(settings.ensembles)
    files = [checkpoint / f"ensemble_{first_file + i}.h5" if checkpoint else None for i in range(settings.ensembles)]
    even = np.zeros(centre.size, dtype=bool) if even is None else even
    ensembles = [
        _Ensemble(log_probability, centre, covariance, child, file, even, gradient, mirrored)
        for child, file in zip(children, files, strict=True)
    ]
    total = settings.ensembles * sum(settings.burn_in)
    done = [0]

    def count(n: int, stage: str = "burn-in") -> None:
        done[0] += n
        progress(stage, min(done[0], total), total)

    with ThreadPoolExecutor(settings.workers) as pool:
        list(pool.map(lambda e: e.prepare(settings.burn_in, count), ensembles))
        progress("burn-in", total, total)
        kept = max(e.sampler.backend.iteration for e in ensembles)
        length = max(settings.chunk, -(-kept // settings.chunk) * settings.chunk)  # end of the current chunk
        done[0], total = 0, settings.ensembles * length
        while True:
            list(pool.map(lambda e, n=length: e.run_to(n, lambda n: count(n, "sampling")), ensembles))
            chains = _collect(ensembles)
            if settings.satisfied_by(chains) or length >= settings.longest:
                for ensemble in ensembles:
                    ensemble.keep()
                progress("sampling", total, total)
                return chains
            length += settings.chunk
            total += settings.ensembles * settings.chunk


def _collect(ensembles: list[_Ensemble]) -> Chains:
    draws, log_probability, times = [], [], []
    chains = [_positive(e.sampler.get_chain(), e.even) for e in ensembles]  # (steps, walkers, D)
    for ensemble, chain in zip(ensembles, labelled(chains, ensembles[0].mirrored), strict=True):
        tau = autocorrelation_time(chain)
        times.append(tau)
        spacing = int(np.clip(np.ceil(tau.max()), 1, max(len(chain) // 10, 1)))
        kept = chain[spacing - 1 :: spacing]
        rows = np.unique(np.linspace(0, kept.shape[0] * kept.shape[1] - 1, _KEPT_DRAWS).astype(int))
        draws.append(kept.reshape(-1, chain.shape[2])[rows])
        log_probability.append(ensemble.sampler.get_log_prob()[spacing - 1 :: spacing].reshape(-1)[rows])
    fewest = min(len(d) for d in draws)
    coordinates = np.array([d[:fewest] for d in draws])
    steps, walkers = ensembles[0].sampler.get_chain().shape[:2]
    tau = np.array(times)
    return Chains(
        coordinates=coordinates,
        log_probability=np.array([p[:fewest] for p in log_probability]),
        rhat=rhat(coordinates),
        effective=np.sum(steps * walkers / tau, axis=0),
        autocorrelation_time=tau.mean(axis=0),
        acceptance=float(np.mean([e.sampler.acceptance_fraction.mean() for e in ensembles])),
        steps=steps,
        walkers=walkers,
    )


def _positive(chain: np.ndarray, even: np.ndarray) -> np.ndarray:
    """A copy of a chain with the absolute values of even coordinates."""
    copied = chain.copy()
    np.abs(copied, out=copied, where=even)
    return copied


def _refined(covariance: np.ndarray, sampled: np.ndarray) -> np.ndarray:
    """The previous covariance, rescaled to the sampled standard deviations and mixed with a little of the sampled one.

    A short burn-in gives good standard deviations but poor correlations, which outnumber the independent samples.
    """
    width = np.sqrt(np.diag(sampled) / np.diag(covariance))
    return np.asarray(0.8 * covariance * np.outer(width, width) + 0.2 * sampled)
