"""Draws and chains, until the draws hold for the populations of the chain.

Whether importance draws hold can be told only from populations that the posterior contains, and these are known when it
has been sampled: a normal approximation of it misses the long tails of ridges. The first chain therefore serves as the
pilot. If the error that the draws leave in its intervals (:mod:`bayes_impedance.population.draw_error`) is smaller than
the error that the chain leaves, and no dispersion lies beyond the range in which the draws' likelihoods are known, the
chain is the result, and nothing was spent. Otherwise everybody's draws are made anew for the populations of this chain,
and the posterior is sampled again. The last error decides whether numbers are reported
(:mod:`bayes_impedance.population.diagnostics`).
"""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path

import numpy as np

from bayes_impedance.mcmc.ensemble import Chains, SamplerSettings, sample
from bayes_impedance.population.draw_error import ERROR_WANTED, DrawError
from bayes_impedance.population.moved_dispersions import BEYOND_ALLOWED
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.runtime.clock import Clock
from bayes_impedance.runtime.progress import Progress

_HOPELESS = 0.5
"""Error with draws made for the populations of a chain above which they are not made once more. By choice, for time:
the same number of draws again leaves about as much, unless the chain has moved."""

_MOST_TIMES = 2
"""Most times that draws are made anew for the populations of a chain. By choice: a bound on the time of hopeless fits;
in a band of 1 % the first time sufficed, or the second."""


_MOST_NUMBERS, _FEWEST_SETS = 30_000_000, 100
"""Most numbers of persons in a result, 0.24 GB in double precision, and fewest sets kept of each ensemble. By choice:
memory against the number of posterior draws."""

_MUCH_LOWER = 20.0
"""Difference of the log densities at the two modes above which draws that were made anew are worse than the first: both
estimate one density, and errors of a few units are those that new draws are to mend. By choice."""


def sampled(
    posterior: Posterior,
    settings: SamplerSettings,
    drawing: np.random.SeedSequence,
    sampling: np.random.SeedSequence,
    executor: Executor,
    clock: Clock,
    progress: Progress,
    checkpoint: Path | None,
) -> tuple[Posterior, Chains, DrawError]:
    """Draw and sample until the draws hold.

    Parameters
    ----------
    posterior : Posterior
        Without draws.
    settings : SamplerSettings
    drawing, sampling : SeedSequence
    executor : Executor
        Makes and keeps the draws.
    clock : Clock
        Measures ``draws`` and ``population``.
    progress : callable
    checkpoint : Path, optional
        Folder of the chains; those of each repetition have files of their own.

    Returns
    -------
    posterior : Posterior
        With the draws that leave the least error.
    chains : Chains
        Of this posterior.
    error : DrawError
        By the draws, in these chains.
    """
    with clock.measure("draws"):
        posterior.draw(drawing, executor, progress)
    best: tuple[Posterior, Chains, DrawError] | None = None
    for time in range(_MOST_TIMES + 1):
        with clock.measure("population"):
            chains = sample(
                posterior.log_probability,
                posterior.mode,
                posterior.normal_covariance,
                settings,
                sampling,
                progress,
                checkpoint,
                first_file=time * settings.ensembles,
                even=posterior.coordinates.even,
                gradient=posterior.gradient,
                mirrored=posterior.coordinates.mirrored,
            )
            error = posterior.error(chains)
        if best is None or _order(error) < _order(best[2]):
            best = posterior, chains, error
        hopeless = time > 0 and not error.interval_end <= _HOPELESS
        holds = error.interval_end <= ERROR_WANTED and error.beyond <= BEYOND_ALLOWED
        if holds or time == _MOST_TIMES or hopeless:
            break
        with clock.measure("draws"):
            excess = error.interval_end / ERROR_WANTED
            other = posterior.moved_to(chains, excess, drawing.spawn(1)[0], executor, progress)
        if _height(other) < _height(posterior) - _MUCH_LOWER:  # draws that miss what the first ones had found
            break
        posterior = other
    assert best is not None  # the first chain is always there
    return best


def _order(error: DrawError) -> tuple[bool, float]:
    """Draws whose chain lies where their likelihoods are known come first, of these the ones with the least error."""
    return error.beyond > BEYOND_ALLOWED, error.interval_end


def _height(posterior: Posterior) -> float:
    """Log density at the mode of the normal approximation, with constants that differ between sets of draws."""
    coordinates, mode = posterior.coordinates, posterior.mode[None]
    value = posterior.marginal.log_density(coordinates.unpack(mode)) + coordinates.log_prior(mode)
    return float(value[0])


def kept_sets(chains: Chains, numbers_each: int) -> np.ndarray:
    """Indices of the draws kept of each ensemble: all, or as many as memory allows for the elements of all persons."""
    available = chains.coordinates.shape[1]
    most = max(_MOST_NUMBERS // (numbers_each * chains.coordinates.shape[0]), _FEWEST_SETS)
    return np.unique(np.linspace(0, available - 1, min(available, most)).astype(int))
