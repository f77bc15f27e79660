"""Hamiltonian proposals: the target is kept, whatever the gradient, and curved targets are sampled by them."""

from __future__ import annotations

import emcee
import numpy as np
import pytest
from short_chains import SHORT, Gaussian, as_bytes, changed, silent

from bayes_impedance.mcmc.autocorrelation import autocorrelation_time
from bayes_impedance.mcmc.chain_file import read_chain
from bayes_impedance.mcmc.ensemble import SamplerSettings, sample
from bayes_impedance.mcmc.hamiltonian import hamiltonian_move


class Curved:
    """Pairs of coordinates on a parabola: x ~ N(0, 1), y ~ N(b (x^2 - 1), 0.5^2)."""

    width = 0.5

    def __init__(self, pairs=10, bend=0.3):
        self.pairs, self.bend, self.calls = pairs, bend, 0
        self.mean = np.zeros(2 * pairs)
        self.sd = np.repeat([1.0, np.sqrt(self.width**2 + 2 * self.bend**2)], pairs)

    def parts(self, u):
        x, y = u[:, : self.pairs], u[:, self.pairs :]
        return x, (y - self.bend * (x**2 - 1)) / self.width**2

    def __call__(self, u):
        x, rest = self.parts(u)
        return -0.5 * np.sum(x**2 + rest**2 * self.width**2, axis=1)

    def gradient(self, u):
        self.calls += 1
        x, rest = self.parts(u)
        return np.hstack([-x + 2 * self.bend * x * rest, -rest])

    def normal_scores(self, u):
        x, rest = self.parts(u)
        return np.hstack([x, rest * self.width])


def gradient_of(gaussian):
    return lambda x: -(x - gaussian.mean) @ gaussian.precision


def chain_of(target, gradient, covariance, steps=1500, walkers=40, seed=1):
    """Chain (steps, walkers, D) of the move alone."""
    move = hamiltonian_move(gradient, target.mean, covariance)
    sampler = emcee.EnsembleSampler(walkers, target.mean.size, target, moves=move, vectorize=True)
    rng = np.random.RandomState(seed)
    sampler.random_state = rng.get_state()
    start = target.mean + rng.normal(size=(walkers, target.mean.size)) * target.sd
    sampler.run_mcmc(start, steps, skip_initial_state_check=True)
    return sampler.get_chain(discard=200), sampler.acceptance_fraction.mean()


def check_scores(target, chain):
    """Scores are independent standard normal numbers, within 4.5 Monte-Carlo errors."""
    scores = target.normal_scores(chain.reshape(-1, chain.shape[2])).reshape(chain.shape)
    for power, expected, spread in ((1, 0.0, 1.0), (2, 1.0, np.sqrt(2.0)), (3, 0.0, np.sqrt(15.0))):
        own = scores**power
        error = spread * np.sqrt(autocorrelation_time(own) / (own.shape[0] * own.shape[1]))
        assert np.abs((own.mean(axis=(0, 1)) - expected) / error).max() < 4.5


@pytest.mark.parametrize("factor", [1.0, 0.7, 0.0], ids=["gradient", "a gradient of 0.7", "no gradient"])
def test_the_target_is_kept_whatever_the_gradient(factor):
    target = Gaussian(5, seed=3)
    exact = gradient_of(target)
    chain, _ = chain_of(target, lambda x: factor * exact(x), target.covariance)
    check_scores(target, chain)


def test_a_curved_target_is_kept():
    target = Curved(2, bend=0.7)
    chain, _ = chain_of(target, target.gradient, np.diag(target.sd**2), steps=3000)
    check_scores(target, chain)


def test_a_normal_target_is_forgotten_along_one_trajectory():
    target = Gaussian(20, seed=4)
    chain, accepted = chain_of(target, gradient_of(target), target.covariance, steps=700)
    assert accepted > 0.7
    assert autocorrelation_time(chain).max() < 5


LONG = SamplerSettings(ensembles=2, burn_in=(80, 40), chunk=400, longest=400, rhat=0.0, effective=np.inf)


def test_a_curved_target_is_sampled_along_trajectories_and_faster():
    target = Curved()
    seeds = [np.random.SeedSequence(2) for _ in range(2)]
    plain = sample(target, target.mean, target.sd, LONG, seeds[0], silent)
    assert target.calls == 0
    assert plain.acceptance < 0.25
    curved = sample(target, target.mean, target.sd, LONG, seeds[1], silent, gradient=target.gradient)
    assert target.calls > 0
    assert curved.acceptance > 2 * plain.acceptance
    assert curved.effective.min() > 3 * plain.effective.min()
    assert curved.rhat.max() < 1.03


def test_a_normal_target_is_not_sampled_along_trajectories():
    target = Gaussian(12, seed=5)

    def never(x):
        raise AssertionError("the normal approximation is good")

    sample(target, target.mean, target.sd, LONG, np.random.SeedSequence(1), silent, gradient=never)


@pytest.mark.parametrize("stopped_after", [20, 60])
def test_a_run_along_trajectories_is_resumed_to_the_same_bytes(tmp_path, stopped_after):
    target = Curved()

    def run(settings, checkpoint=None):
        seed = np.random.SeedSequence(7)
        return sample(target, target.mean, target.sd, settings, seed, silent, checkpoint, gradient=target.gradient)

    settings = changed(SHORT, longest=80, burn_in=(40, 40))
    whole = run(settings)
    run(changed(settings, longest=stopped_after), tmp_path)
    backend = emcee.backends.Backend()
    backend.reset(2 * target.mean.size, target.mean.size)
    adapted = read_chain(tmp_path / "ensemble_0.h5", backend)
    assert adapted["curved"] == 1.0
    assert as_bytes(run(settings, tmp_path)) == as_bytes(whole)


class Interrupted(Curved):
    """A nearly normal target that is switched off when its gradient has been asked for so often."""

    def __init__(self, most=np.inf):
        super().__init__(bend=0.1)
        self.most = most

    def gradient(self, u):
        if self.calls >= self.most:
            raise InterruptedError
        return super().gradient(u)


def slow(target, settings, checkpoint=None):
    """A run whose chains are held to be slow after the first chunk."""
    seed = np.random.SeedSequence(7)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayes_impedance.mcmc.ensemble._SLOW", 1.0)
        return sample(target, target.mean, target.sd, settings, seed, silent, checkpoint, gradient=target.gradient)


def test_slow_chains_are_given_up_for_trajectories():
    target = Interrupted()
    seed = np.random.SeedSequence(7)
    plain = sample(target, target.mean, target.sd, LONG, seed, silent, gradient=target.gradient)
    assert target.calls == 0  # most proposals are accepted, and nothing is slow
    turned = slow(target, changed(LONG, chunk=200), None)
    assert target.calls > 0
    assert turned.steps == 400  # none of the chain that was given up
    assert turned.effective.min() > 2 * plain.effective.min()
    check_scores(target, turned.coordinates.swapaxes(0, 1))


@pytest.mark.parametrize("most", [1, 400, 700], ids=["while it turns", "of one ensemble", "later"])
def test_a_run_that_turns_is_resumed_to_the_same_bytes(tmp_path, most):
    settings = changed(SHORT, longest=80, burn_in=(40, 40), workers=1)
    whole = slow(Interrupted(), settings)
    with pytest.raises(InterruptedError):
        slow(Interrupted(most), settings, tmp_path)
    assert as_bytes(slow(Interrupted(), settings, tmp_path)) == as_bytes(whole)
