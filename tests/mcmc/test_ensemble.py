"""The sampler: every move against known moments, seeds, stopping rule, and chains that did not mix."""

from __future__ import annotations

import ast
import time
from pathlib import Path

import emcee
import numpy as np
import pytest
from scipy.stats import loggamma, norm, t
from short_chains import SHORT, D, Gaussian, as_bytes, changed, run, silent

import bayes_impedance
from bayes_impedance.mcmc.autocorrelation import autocorrelation_time
from bayes_impedance.mcmc.crank_nicolson import crank_nicolson_move
from bayes_impedance.mcmc.ensemble import (
    Ensemble,
    SamplerSettings,
    _collect,
    sample,
)

LONG = SamplerSettings(ensembles=4, chunk=500, longest=500, rhat=0.0, effective=np.inf)


class Independent:
    """Independent coordinates of one distribution."""

    def __init__(self, distribution, dimensions=D):
        self.distribution = distribution
        self.mean, self.sd = np.full(dimensions, distribution.mean()), np.full(dimensions, distribution.std())

    def __call__(self, x):
        return self.distribution.logpdf(x).sum(axis=1)

    def normal_scores(self, x):
        below = self.distribution.logcdf(x)
        above = self.distribution.logsf(x)
        return np.where(below < above, norm.ppf(np.exp(below)), norm.isf(np.exp(above)))


TARGETS = {
    "gaussian": Gaussian(),
    "log-gamma, skewed": Independent(loggamma(2.0)),
    "t with 8 degrees of freedom": Independent(t(8)),
}


def check_standard_normal(scores, effective):
    """Means, variances and the variance of all coordinates together, within 4.5 Monte-Carlo errors."""
    assert np.abs(scores.mean(axis=0) * np.sqrt(effective)).max() < 4.5
    assert np.abs((np.mean(scores**2, axis=0) - 1) * np.sqrt(effective / 2)).max() < 4.5
    assert np.mean(scores**2) == pytest.approx(1, abs=4.5 * np.sqrt(2 / effective.min() / scores.shape[1]))


@pytest.mark.parametrize("name", TARGETS)
def test_production_mixture_recovers_means_and_variances(name):
    target = TARGETS[name]
    chains = sample(target, target.mean + target.sd, 2 * target.sd, LONG, np.random.SeedSequence(1), silent)
    kept = chains.coordinates.reshape(-1, D)
    effective = np.minimum(chains.effective, len(kept))
    check_standard_normal(target.normal_scores(kept), effective)
    error = target.sd / np.sqrt(effective)
    assert np.all(np.abs(kept.mean(axis=0) - target.mean) < 4.5 * error)
    assert chains.rhat.max() < 1.02
    assert chains.effective.min() > 500


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_reported_effective_size_is_right(name):
    """Errors of the mean over 40 runs, in units of the reported error."""
    target = TARGETS[name]
    settings = SamplerSettings(ensembles=2, chunk=300, longest=300, rhat=0.0, effective=np.inf)
    z = []
    for seed in range(40):
        rng = np.random.SeedSequence(100 + seed)
        ensembles = [
            Ensemble(target, target.mean, np.diag(target.sd**2), child, None, np.zeros(target.mean.size, dtype=bool))
            for child in rng.spawn(2)
        ]
        for ensemble in ensembles:
            ensemble.prepare(settings.burn_in, lambda n: None)
            ensemble.run_to(300, lambda n: None)
        chains = _collect(ensembles)
        means = np.mean([e.sampler.get_chain(flat=True).mean(axis=0) for e in ensembles], axis=0)
        z.append((means - target.mean) / target.sd * np.sqrt(chains.effective))
    assert np.mean(np.square(z)) == pytest.approx(1, abs=0.25)


def run_single_move(move, target, steps, walkers=64, seed=3, thin=1):
    """Draws (S, W, D) of one move alone, from starts that follow the target."""
    rng = np.random.RandomState(seed)
    start = target.mean + rng.standard_normal((walkers, target.mean.size)) @ np.linalg.cholesky(target.covariance).T
    sampler = emcee.EnsembleSampler(walkers, target.mean.size, target, moves=move, vectorize=True)
    sampler.run_mcmc(emcee.State(start, random_state=rng.get_state()), steps, skip_initial_state_check=True)
    return sampler.get_chain(thin=thin), sampler


MOVES = {
    "Crank-Nicolson, exact": lambda target: crank_nicolson_move(target.mean, target.covariance),
    "Crank-Nicolson, wrong mean": lambda target: crank_nicolson_move(target.mean + target.sd, target.covariance),
    "Crank-Nicolson, too wide": lambda target: crank_nicolson_move(target.mean, 3 * target.covariance),
    "Crank-Nicolson, too narrow": lambda target: crank_nicolson_move(target.mean, 0.6 * target.covariance),
    "Crank-Nicolson, no correlation": lambda target: crank_nicolson_move(target.mean, np.diag(target.sd**2)),
    "differential evolution": lambda target: emcee.moves.DEMove(),
    "differential evolution, leaps": lambda target: emcee.moves.DEMove(gamma0=1.0),
}


@pytest.mark.parametrize("name", MOVES)
def test_every_move_alone_keeps_a_known_variance(name):
    target = Gaussian(4, seed=2)
    chain, sampler = run_single_move(MOVES[name](target), target, 2500)
    tau = autocorrelation_time(chain).max()
    scores = target.normal_scores(chain.reshape(-1, 4))
    check_standard_normal(scores, np.full(4, len(scores) / tau))
    assert tau < 100  # or the test shows nothing
    assert sampler.acceptance_fraction.mean() > 0.02


def test_crank_nicolson_move_is_mostly_accepted_where_the_approximation_is_exact():
    """Also in 52 dimensions; differential evolution takes 16 % there."""
    for dimension in (4, 52):
        target = Gaussian(dimension)
        _, sampler = run_single_move(crank_nicolson_move(target.mean, target.covariance), target, 100, walkers=104)
        assert sampler.acceptance_fraction.mean() > 0.5


def test_snooker_move_is_never_used():
    """In emcee 3.1.6 it samples the wrong distribution. Docstrings and comments may say so; code may not name it."""
    files = sorted(Path(bayes_impedance.__file__).parent.rglob("*.py"))
    assert len(files) > 10
    for file in files:
        tree = ast.parse(file.read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):  # a docstring
                node.value.value = ""
        assert "snooker" not in ast.unparse(tree).lower(), file.name


def test_same_seed_same_bytes():
    one = as_bytes(run())
    assert as_bytes(run()) == one
    assert as_bytes(run(settings=changed(SHORT, workers=1))) == one
    assert as_bytes(run(seed=2)) != one


def test_global_random_state_is_neither_used_nor_touched():
    np.random.seed(7)  # noqa: NPY002  the state that must not matter
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    one = as_bytes(run())
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    np.random.seed(8)  # noqa: NPY002
    assert as_bytes(run()) == one


def test_ensembles_differ():
    chains = run()
    assert chains.coordinates.shape[0] == 2
    assert not np.any(np.isin(chains.coordinates[0], chains.coordinates[1]))


# What is reported


def test_shapes_of_the_result():
    chains = run()
    ensembles, draws, dimensions = chains.coordinates.shape
    assert (ensembles, dimensions) == (2, 5)
    assert chains.log_probability.shape == (2, draws)
    assert chains.rhat.shape == chains.effective.shape == chains.autocorrelation_time.shape == (5,)
    assert chains.steps == 60
    assert 0 < chains.acceptance < 1
    np.testing.assert_allclose(
        chains.log_probability.ravel(), Gaussian(5, seed=1)(chains.coordinates.reshape(-1, 5)), rtol=1e-12
    )


def test_run_stops_when_it_is_good_enough():
    settings = SamplerSettings(ensembles=2, burn_in=(40, 60), chunk=50, longest=3000, rhat=1.05, effective=300.0)
    chains = run(settings=settings)
    assert chains.steps < 3000
    assert chains.steps % 50 == 0
    assert chains.rhat.max() <= 1.05
    assert chains.effective.min() >= 300


def test_run_that_is_never_good_enough_ends_and_says_so():
    chains = run(settings=changed(SHORT, effective=1e9))
    assert chains.steps == 60
    assert chains.effective.max() < 1e9


class TwoModes:
    """An equal mixture of two normal distributions, far apart in all coordinates."""

    def __init__(self, distance):
        self.distance = distance

    def __call__(self, x):
        left, right = (-0.5 * np.sum((x - side * self.distance) ** 2, axis=1) for side in (-1, 1))
        return np.logaddexp(left, right)


def ensembles_in(places, distance, steps=300, mirrored=False):
    result = []
    for place, child in zip(places, np.random.SeedSequence(5).spawn(len(places)), strict=True):
        even, own = np.zeros(6, dtype=bool), np.full(6, mirrored)
        ensemble = Ensemble(TwoModes(distance), np.full(6, place), np.eye(6), child, None, even, None, own)
        ensemble.prepare((30, 30), lambda n: None)
        ensemble.run_to(steps, lambda n: None)
        result.append(ensemble)
    return _collect(result)


def test_rhat_finds_ensembles_in_different_modes():
    apart = ensembles_in((-20.0, 20.0, -20.0, 20.0), 20.0)
    together = ensembles_in((20.0, 20.0, 20.0, 20.0), 20.0)
    assert apart.rhat.min() > 1.5
    assert together.rhat.max() < 1.05
    images = ensembles_in((-20.0, 20.0, -20.0, 20.0), 20.0, mirrored=True)
    assert images.rhat.max() < 1.05
    assert np.all(images.coordinates[..., -1] < 0)


def test_progress_is_reported_to_the_end():
    seen = []
    target = Gaussian(3)
    sample(target, target.mean, target.sd, SHORT, np.random.SeedSequence(1), lambda *a: seen.append(a))
    stages = {stage: [entry for entry in seen if entry[0] == stage] for stage in ("burn-in", "sampling")}
    assert len(seen) == len(stages["burn-in"]) + len(stages["sampling"])
    for entries in stages.values():
        assert entries[-1][1] == entries[-1][2]
        assert all(0 <= done <= total for _, done, total in entries)


def test_ensembles_that_run_side_by_side_report_one_after_the_other():
    together, most = [0], [0]

    def progress(*_):
        together[0] += 1
        most[0] = max(most[0], together[0])
        time.sleep(2e-3)
        together[0] -= 1

    target = Gaussian(3)
    side_by_side = changed(SHORT, ensembles=4, workers=4)
    sample(target, target.mean, target.sd, side_by_side, np.random.SeedSequence(1), progress)
    assert most == [1]


@pytest.mark.parametrize("calls", [5, 60])  # in the burn-in, and in the chains
def test_an_error_of_the_density_is_raised_and_not_printed(calls, capfd):
    """emcee prints walkers and a traceback; whoever catches the error says what has happened."""
    left = [calls]

    def density(x):
        left[0] -= 1
        if left[0] < 0:
            raise ZeroDivisionError("lost")
        return Gaussian()(x)

    settings = SamplerSettings(ensembles=1, burn_in=(20,), chunk=200, longest=200)
    with pytest.raises(ZeroDivisionError, match="lost"):
        sample(density, np.zeros(D), np.ones(D), settings, np.random.SeedSequence(1), silent)
    assert capfd.readouterr() == ("", "")
