r"""Ensemble sampling of a few dozen dimensions: the only user of emcee.

**Moves.** Affine-invariant moves lose about one half of their speed with every doubling of the dimension, and a full
covariance of eight elements has 52. Here the posterior is close to normal in its coordinates, so most steps are
autoregressive proposals around a normal approximation N(m, C) taken from the burn-in,

.. math:: u' = m + \sqrt{1-\beta^2}\,(u - m) + \beta\, C^{1/2}\xi, \qquad \xi \sim N(0, I),

which leave N(m, C) invariant; the Metropolis ratio corrects for the difference between it and the target, and the
acceptance does not fall with the dimension as long as that difference is small. Short steps get along where the
approximation is poor, and one step in four is emcee's differential evolution, which needs no approximation at all.
`DESnookerMove` is not used: in emcee 3.1.6 it samples the wrong distribution.

**Convergence.** Several ensembles start and adapt independently. R-hat is taken between ensembles, never between the
walkers of one, which are not independent chains; the autocorrelation time within ensembles gives the effective sample
size. Sampling goes on until both are good or the allowed length is used up; the result says which.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.starts import Progress

LogProbability = Callable[[np.ndarray], np.ndarray]

_STEP_LENGTHS = (0.3, 0.5, 0.8)
_KEPT_DRAWS = 500


@dataclass(frozen=True)
class SamplerSettings:
    """How long to sample.

    Attributes
    ----------
    ensembles : int
        At least two, for R-hat.
    burn_in : tuple of int
        Steps of each stage of adaptation.
    chunk, longest : int
        Steps between checks of convergence, and at most.
    rhat : float
        Required of every coordinate.
    effective : float
        Required effective sample size of every coordinate.
    memories : float
        Required length of the chains in autocorrelation times.
    workers : int
        Ensembles that run side by side.
    """

    ensembles: int = 4
    burn_in: tuple[int, ...] = (40, 60, 80, 120)
    chunk: int = 200
    longest: int = 3000
    rhat: float = 1.01
    effective: float = 2000.0
    memories: float = 20.0
    workers: int = 2


    def satisfied_by(self, chains: Chains) -> bool:
        """Whether chains need not be longer."""
        return bool(
            chains.rhat.max() <= self.rhat
            and chains.effective.min() >= self.effective
            and chains.steps >= self.memories * chains.autocorrelation_time.max()
        )


QUICK = SamplerSettings(ensembles=2, burn_in=(40, 60, 80), chunk=100, longest=1500, effective=600.0)


@dataclass(frozen=True)
class Chains:
    """Draws and how good they are.

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


def autoregressive_move(mean: np.ndarray, covariance: np.ndarray) -> Any:
    """An emcee move that is exact for, and leaves invariant, a normal approximation of the target.

    Parameters
    ----------
    mean : ndarray, shape (D,)
    covariance : ndarray, shape (D, D)
    """
    from emcee.moves import MHMove

    factor = np.linalg.cholesky(covariance)

    def whiten(x: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.solve(factor, (x - mean).T).T)

    def propose(x: np.ndarray, rng: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        beta = _STEP_LENGTHS[rng.randint(len(_STEP_LENGTHS))]
        u = whiten(x)
        new = np.sqrt(1 - beta**2) * u + beta * rng.standard_normal(u.shape)
        # The proposal is reversible with respect to N(m, C): q(x'|x) / q(x|x') is the ratio of the two densities.
        return mean + new @ factor.T, 0.5 * (np.sum(new**2, axis=1) - np.sum(u**2, axis=1))

    return MHMove(propose)


class _Ensemble:
    """One independent ensemble: adapts, samples, and can be taken up again from its file."""

    def __init__(
        self,
        log_probability: LogProbability,
        centre: np.ndarray,
        scale: np.ndarray,
        seed: np.random.SeedSequence,
        file: Path | None,
    ) -> None:
        self.log_probability = log_probability
        self.n_dimensions = centre.size
        self.n_walkers = 2 * int(np.ceil(max(1.2 * centre.size, 16)))
        self.centre, self.scale, self.file = centre, scale, file
        self.seed = seed
        self.sampler: Any = None
        self.state: Any = None

    def prepare(self, stages: tuple[int, ...], progress: Callable[[int], None]) -> None:
        """Burn in, or take up where an earlier run stopped."""
        import emcee

        kept = self.file.with_suffix(".npz") if self.file is not None else None
        if kept is not None and kept.exists() and self.file is not None and self.file.exists():
            with np.load(kept, allow_pickle=False) as data:
                mean, covariance = data["mean"], data["covariance"]
                coordinates = data["coordinates"]
                random_state: Any = (
                    "MT19937",
                    data["keys"],
                    int(data["position"]),
                    int(data["has_normal"]),
                    float(data["normal"]),
                )
        else:
            rng = np.random.RandomState(np.random.MT19937(self.seed))
            coordinates = self.centre + self.scale * rng.standard_normal((self.n_walkers, self.n_dimensions))
            mean, covariance = self.centre, np.diag(self.scale**2)
            random_state = rng.get_state()
            for n_steps in stages:
                sampler = self._sampler(mean, covariance, None)
                state = emcee.State(coordinates, random_state=random_state)
                iterator = sampler.sample(state, iterations=n_steps, skip_initial_state_check=True)
                for done, current in enumerate(iterator):
                    state = current
                    if done % 10 == 9:
                        progress(10)
                coordinates, random_state = state.coords, state.random_state
                recent = sampler.get_chain(discard=n_steps // 2, flat=True)
                mean, covariance = recent.mean(axis=0), self._shrunk(np.cov(recent.T))
            if kept is not None:
                _save_state(kept, mean, covariance, coordinates, random_state)
        self.sampler = self._sampler(mean, covariance, self.file)
        if self.sampler.backend.iteration:
            self.state = self.sampler.backend.get_last_sample()
        else:
            self.state = emcee.State(coordinates, random_state=random_state)

    def _shrunk(self, covariance: np.ndarray) -> np.ndarray:
        # Fewer independent samples than it takes for 52 x 52 entries: pull the correlations a little towards zero.
        return np.asarray(0.9 * covariance + 0.1 * np.diag(np.diag(covariance)))

    def _sampler(self, mean: np.ndarray, covariance: np.ndarray, file: Path | None) -> Any:
        import emcee

        moves = [
            (autoregressive_move(mean, covariance), 0.75),
            (emcee.moves.DEMove(), 0.2),
            (emcee.moves.DEMove(gamma0=1.0), 0.05),
        ]
        backend = None
        if file is not None:
            backend = emcee.backends.HDFBackend(str(file))
            if not file.exists():
                backend.reset(self.n_walkers, self.n_dimensions)
        return emcee.EnsembleSampler(
            self.n_walkers, self.n_dimensions, self.log_probability, moves=moves, vectorize=True, backend=backend
        )

    def run_to(self, n_steps: int, progress: Callable[[int], None]) -> None:
        """Sample until the ensemble has this many steps."""
        missing = n_steps - self.sampler.backend.iteration
        if missing <= 0:
            return
        iterator = self.sampler.sample(self.state, iterations=missing, skip_initial_state_check=True)
        for done, state in enumerate(iterator):
            self.state = state
            if done % 10 == 9:
                progress(10)


def sample(
    log_probability: LogProbability,
    centre: np.ndarray,
    scale: np.ndarray,
    settings: SamplerSettings,
    seed: np.random.SeedSequence,
    progress: Progress,
    checkpoint: Path | None = None,
) -> Chains:
    """Sample a distribution that is not far from normal.

    Parameters
    ----------
    log_probability : callable
        Maps (W, D) to (W,); called from several threads.
    centre, scale : ndarray, shape (D,)
        A first guess of the distribution's centre and width; walkers start there.
    settings : SamplerSettings
    seed : SeedSequence
    progress : callable
    checkpoint : Path, optional
        Folder that keeps the chains as they grow; what is found there is continued.

    Returns
    -------
    Chains
        Compare ``rhat`` and ``effective`` with what was required: nothing is raised when they fall short.
    """
    ensembles = [
        _Ensemble(log_probability, centre, scale, child, checkpoint / f"ensemble_{i}.h5" if checkpoint else None)
        for i, child in enumerate(seed.spawn(settings.ensembles))
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
        length = max(settings.chunk, -(-kept // settings.chunk) * settings.chunk)  # the end of the chunk begun
        done[0], total = 0, settings.ensembles * length
        while True:
            list(pool.map(lambda e, n=length: e.run_to(n, lambda n: count(n, "sampling")), ensembles))
            chains = _collect(ensembles)
            if settings.satisfied_by(chains) or length >= settings.longest:
                progress("sampling", total, total)
                return chains
            length += settings.chunk
            total += settings.ensembles * settings.chunk


def _collect(ensembles: list[_Ensemble]) -> Chains:
    import emcee

    from bayes_impedance.arviz_adapter import rhat

    draws, log_probability, times = [], [], []
    for ensemble in ensembles:
        chain = ensemble.sampler.get_chain()  # (steps, walkers, D)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # constant coordinates in a stuck ensemble: reported as infinite below
            tau = emcee.autocorr.integrated_time(chain, quiet=True, tol=0)
        tau = np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)
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
        coordinates,
        np.array([p[:fewest] for p in log_probability]),
        rhat(coordinates),
        np.sum(steps * walkers / tau, axis=0),
        tau.mean(axis=0),
        float(np.mean([e.sampler.acceptance_fraction.mean() for e in ensembles])),
        steps,
        walkers,
    )


def _save_state(
    file: Path, mean: np.ndarray, covariance: np.ndarray, coordinates: np.ndarray, random_state: Any
) -> None:
    temporary = file.with_suffix(".tmp.npz")
    np.savez(
        temporary,
        mean=mean,
        covariance=covariance,
        coordinates=coordinates,
        keys=random_state[1],
        position=random_state[2],
        has_normal=random_state[3],
        normal=random_state[4],
    )
    temporary.replace(file)
