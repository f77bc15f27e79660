r"""Ensemble sampling of a few dozen dimensions by emcee.

**Moves.** Affine-invariant moves slow down in proportion to the dimension, and a full covariance of eight elements has
52. Here the posterior is close to normal in its coordinates, so most proposals are of the Crank-Nicolson type around a
normal approximation (:mod:`bayes_impedance.mcmc.crank_nicolson`). Where few of them are accepted, because the target is
curved, and its gradient is given, Hamiltonian proposals take their place (:mod:`bayes_impedance.mcmc.hamiltonian`); so
they do where chains turn out to be slow, because walkers in a tail are hardly moved although most others are. One step
in ten is emcee's differential evolution, which needs no approximation. `DESnookerMove` is not used: in emcee 3.1.6 it
samples the wrong distribution.

**Convergence.** Several ensembles start and adapt independently. R-hat is taken between ensembles, never between the
walkers of one, which are not independent chains; the autocorrelation time within ensembles gives the effective sample
size. Sampling continues until both meet their limits or the longest length is reached; the result states which.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np

from bayes_impedance.display import Brief, Chosen
from bayes_impedance.mcmc.autocorrelation import autocorrelation_time
from bayes_impedance.mcmc.convergence import rhat
from bayes_impedance.mcmc.mirrored import labelled
from bayes_impedance.mcmc.one_ensemble import Ensemble, Gradient, LogProbability
from bayes_impedance.runtime.progress import Progress

_KEPT_DRAWS = 500
"""Draws of each ensemble in the result. By choice: with four ensembles a hundred draws lie below a 5 % quantile."""
_SLOW = 100.0
"""Autocorrelation time, in steps, above which chains are given up for trajectories. By choice: at about 270 walkers a
chain of this time needs 550 steps, and trajectories with a time of 10 to 25 steps, each six times as long, with their
burn-in as much as 600 to 1100. Measured with a high-pass and two dispersions between repetitions of which either may
vanish: 318 steps after 600 and still growing, standard deviations of these two 0.6 times the right ones; along
trajectories 22 steps, and 120 sufficed. With 18 people recorded once they had grown beyond 100, and became 31."""


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
        Ensemble(log_probability, centre, covariance, child, file, even, gradient, mirrored)
        for child, file in zip(children, files, strict=True)
    ]
    total = settings.ensembles * sum(settings.burn_in)
    done, reporting = [0], Lock()  # ensembles run side by side, and report one after the other

    def count(n: int, stage: str = "burn-in") -> None:
        with reporting:
            done[0] += n
            progress(stage, min(done[0], total), total)

    with ThreadPoolExecutor(settings.workers) as pool:
        list(pool.map(lambda e: e.prepare(settings.burn_in, count), ensembles))
        progress("burn-in", total, total)
        if any(e.turned for e in ensembles):  # killed while they turned: all of them were to
            list(pool.map(lambda e: e.turn(), [e for e in ensembles if not e.turned]))
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
            if gradient is not None and _too_slow(chains) and not all(e.curved for e in ensembles):
                for ensemble in ensembles:
                    ensemble.keep()  # all at this length, so that a run that is killed now turns as this one does
                list(pool.map(lambda e: e.turn(), ensembles))
                length, done[0], total = settings.chunk, 0, settings.ensembles * settings.chunk
                continue
            length += settings.chunk
            total += settings.ensembles * settings.chunk


def _too_slow(chains: Chains) -> bool:
    return float(chains.autocorrelation_time.max()) > _SLOW


def _collect(ensembles: list[Ensemble]) -> Chains:
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
