"""Whole fits with parameters that are the same for everybody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.recordings.files import Recordings, Subject

VALUES = {"m1": 2e-3, "r1": 2.0, "n1": 1e-3, "d1": 2e-4}
FREQUENCY = np.geomspace(5, 500, 30)

SHORT = FitSettings(
    covariance="diagonal",
    sampler=SamplerSettings(ensembles=2, burn_in=(40, 40), chunk=60, longest=1500, effective=800.0, rhat=1.02),
)


def recordings(network: str, noise: tuple[float, ...], repetitions: int = 1, seed: int = 4) -> Recordings:
    """One person for each noise, relative to the impedance and known."""
    kernel, rng = Kernel(parse(network)), np.random.default_rng(seed)
    mean = np.array([p.u(VALUES[p.name]) for p in kernel.parameters])
    differs = np.array([not p.shared for p in kernel.parameters])
    subjects = []
    for i, relative in enumerate(noise):
        own = mean + differs * 0.2 * rng.normal(size=mean.size)
        z = kernel.impedance(own + differs * 0.05 * rng.normal(size=(repetitions, mean.size)), FREQUENCY)
        sd = relative * np.abs(z)
        noisy = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
        names = tuple(str(j + 1) for j in range(repetitions))
        subjects.append(Subject(name=f"P{i + 1}", repetitions=names, frequency_hz=FREQUENCY, z=noisy, noise_sd=sd))
    return Recordings(subjects=tuple(subjects), title="by hand", unit="N s/m", network=None, source=None, licence=None)


def without(fit: PopulationFit, name: str) -> np.ndarray:
    """Draws of everybody's other parameters, shape (n, N, P)."""
    draws = fit.person_draws[..., [e != name for e in fit.kernel.elements]]
    return draws.reshape(-1, *draws.shape[2:])


def errors(draws: np.ndarray, effective: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Standard errors of the means and of the standard deviations of (n, N, P), both (N, P): chains and weights."""
    batches = draws[: len(draws) // 20 * 20].reshape(20, -1, *draws.shape[1:])
    sd = draws.std(axis=0)
    of_weights = sd / np.sqrt(effective)[:, None]
    mean = np.hypot(batches.mean(axis=1).std(axis=0, ddof=1) / np.sqrt(20), of_weights)
    square = (batches - draws.mean(axis=0)) ** 2
    of_sd = square.mean(axis=1).std(axis=0, ddof=1) / np.sqrt(20) / (2 * sd)
    return mean, np.hypot(of_sd, of_weights / np.sqrt(2))


@pytest.mark.long
def test_held_at_the_true_value_gives_the_same_persons() -> None:
    """Two people recorded 500 times more precisely fix the delay; for the others it is as good as known."""
    noise = (1e-4, 1e-4, *[0.05] * 8)
    data = recordings("delay[d1*](m1|r1|n1)", noise)
    free = fit_population(data, "delay[d1*](m1|r1|n1)", settings=SHORT, seed=1, workers=1)
    held = fit_population(data, f"delay[d1={VALUES['d1']}](m1|r1|n1)", settings=SHORT, seed=2, workers=1)
    assert not free.diagnostics.problems
    assert not held.diagnostics.problems
    delay = free.person_draws[..., free.kernel.elements.index("d1")]
    assert np.all(np.ptp(delay, axis=2) == 0)
    assert abs(delay.mean() - VALUES["d1"]) < 4 * delay.std()
    assert delay.std() < 1e-3 * VALUES["d1"]
    ours, theirs = without(free, "d1")[:, 2:], without(held, "d1")[:, 2:]
    mine, other = (errors(x, f.diagnostics.effective_draws[2:]) for x, f in ((ours, free), (theirs, held)))
    z = (ours.mean(axis=0) - theirs.mean(axis=0)) / np.hypot(mine[0], other[0])
    of_spread = (ours.std(axis=0) - theirs.std(axis=0)) / np.hypot(mine[1], other[1])
    for scores in (z, of_spread):
        assert np.abs(scores).max() < 4.5
        assert np.sqrt(np.mean(scores**2)) < 1.5
    # Monte-Carlo errors are small: another value of the delay would show.
    assert np.all(np.hypot(mine[0], other[0]) < 0.12 * theirs.std(axis=0))
    wrong = fit_population(data, "delay[d1=0.0004](m1|r1|n1)", settings=SHORT, seed=3, workers=1)
    away = np.abs(without(wrong, "d1")[:, 2:].mean(axis=0) - theirs.mean(axis=0)) / theirs.std(axis=0)
    assert away.max() > 1


def test_same_seed_gives_the_same_bytes_whatever_the_workers() -> None:
    """Threads share the work in another order only."""
    data = recordings("delay[d1*](r1|n1)", (0.03,) * 6, repetitions=2)
    settings = replace(SHORT, draws=64, sampler=replace(SHORT.sampler, longest=60))
    one, again, other = (
        fit_population(data, "delay[d1*](r1|n1)", settings=settings, seed=seed, workers=workers)
        for seed, workers in ((1, 1), (1, 3), (2, 1))
    )

    def told(fit: PopulationFit) -> list[bytes]:
        some = fit.parameters
        assert some.shared is not None
        arrays = (some.mu, some.between_persons, some.between_repetitions, some.shared, fit.person_draws)
        return [a.tobytes() for a in (*arrays, fit.person_log_likelihood, fit.log_probability)]

    assert told(one) == told(again)
    assert all(a != b for a, b in zip(told(one), told(other), strict=True))
