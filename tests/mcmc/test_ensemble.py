"""Every move in use against known moments; seeds, interruption, and chains that did not mix."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import emcee
import numpy as np
import pytest
from scipy.stats import loggamma, norm, t

import bayes_impedance
from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import (
    Chains,
    SamplerSettings,
    _collect,
    _Ensemble,
    autocorrelation_time,
    crank_nicolson_move,
    sample,
)

D = 20
LONG = SamplerSettings(ensembles=4, chunk=500, longest=500, rhat=0.0, effective=np.inf)
SHORT = SamplerSettings(ensembles=2, burn_in=(20, 30), chunk=20, longest=60, rhat=0.0, effective=np.inf)


def silent(stage, done, total):
    """Progress that nobody watches."""


class Gaussian:
    """A correlated normal distribution, vectorised."""

    def __init__(self, dimensions=D, seed=0, mean=None):
        rng = np.random.default_rng(seed)
        a = rng.normal(size=(dimensions, 2 * dimensions))
        scale = np.exp(rng.normal(0, 1, dimensions))
        self.mean = 3 * rng.normal(size=dimensions) if mean is None else mean
        self.covariance = scale[:, None] * (a @ a.T / (2 * dimensions)) * scale
        self.precision = np.linalg.inv(self.covariance)
        self.sd = np.sqrt(np.diag(self.covariance))

    def __call__(self, x):
        offset = x - self.mean
        return -0.5 * np.einsum("wi,ij,wj->w", offset, self.precision, offset)

    def normal_scores(self, x):
        """Independent standard normal numbers, if x follows this distribution."""
        return np.linalg.solve(np.linalg.cholesky(self.covariance), (x - self.mean).T).T


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
        ensembles = [_Ensemble(target, target.mean, np.diag(target.sd**2), child, None) for child in rng.spawn(2)]
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


# Seeds


def as_bytes(chains):
    return tuple(np.ascontiguousarray(getattr(chains, name)).tobytes() for name in Chains.__dataclass_fields__)


def run(seed=1, settings=SHORT, log_probability=None, checkpoint=None):
    target = Gaussian(5, seed=1)
    log_probability = log_probability or target
    return sample(log_probability, target.mean, target.sd, settings, np.random.SeedSequence(seed), silent, checkpoint)


def changed(settings, **fields):
    return SamplerSettings(**{**settings.__dict__, **fields})


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


# Interruption


class StopError(Exception):
    """Raised in place of a computer that is switched off."""


class Interrupted:
    """The target, until it has been called often enough; counts the calls."""

    def __init__(self, most=np.inf):
        self.target, self.most, self.calls = Gaussian(5, seed=1), most, 0

    def __call__(self, x):
        self.calls += 1
        if self.calls > self.most:
            raise StopError
        return self.target(x)


@cache
def uninterrupted(settings):
    """A run and how many calls of the log probability it took."""
    counter = Interrupted()
    return run(settings=settings, log_probability=counter), counter.calls


def interrupted_and_resumed(settings, share, checkpoint):
    """The run without interruption, and the one that was stopped after a share of its calls and taken up again."""
    whole, calls = uninterrupted(settings)
    with pytest.raises(StopError):
        run(settings=settings, checkpoint=checkpoint, log_probability=Interrupted(int(share * calls)))
    return whole, run(settings=settings, checkpoint=checkpoint)


def test_checkpoint_changes_nothing(tmp_path):
    assert as_bytes(run(checkpoint=tmp_path)) == as_bytes(run())


def test_finished_run_is_continued(tmp_path):
    whole = as_bytes(run(settings=changed(SHORT, longest=80)))
    run(settings=changed(SHORT, longest=40), checkpoint=tmp_path)
    resumed = run(settings=changed(SHORT, longest=80), checkpoint=tmp_path)
    assert resumed.steps == 80
    assert as_bytes(resumed) == whole


def test_finished_run_is_not_sampled_again(tmp_path):
    whole = as_bytes(run(checkpoint=tmp_path))
    again = run(checkpoint=tmp_path, log_probability=Interrupted(0))
    assert as_bytes(again) == whole


@pytest.mark.parametrize("share", [0.0, 0.3, 0.47, 0.6, 0.8, 0.99])
@pytest.mark.parametrize("workers", [1, 2])
def test_interrupted_run_continues_as_if_nothing_had_happened(tmp_path, share, workers):
    whole, resumed = interrupted_and_resumed(changed(SHORT, workers=workers), share, tmp_path)
    assert as_bytes(resumed) == as_bytes(whole)


class SatisfiedAfter50(SamplerSettings):
    """Good enough as soon as the chains are longer than 50 steps."""

    def satisfied_by(self, chains):
        return chains.steps > 50


@pytest.mark.parametrize("share", [0.6, 0.8, 0.86, 0.9, 0.94, 0.97])
def test_interruption_does_not_change_where_a_run_ends(tmp_path, share):
    """Convergence is looked at after whole chunks only, also when an ensemble was stopped within one."""
    settings = SatisfiedAfter50(**{**SHORT.__dict__, "longest": 200, "workers": 1})
    whole, resumed = interrupted_and_resumed(settings, share, tmp_path)
    assert whole.steps == 60  # the end of a chunk of 20
    assert resumed.steps == whole.steps
    assert as_bytes(resumed) == as_bytes(whole)


def test_kept_chain_is_an_ordinary_file_of_emcee(tmp_path):
    """Chain, log probabilities, acceptance and random numbers, as emcee's own backend has them."""
    chains = run(checkpoint=tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["ensemble_0.h5", "ensemble_1.h5"]
    target, acceptance = Gaussian(5, seed=1), []
    for file in tmp_path.iterdir():
        backend = emcee.backends.HDFBackend(file, read_only=True)
        chain = backend.get_chain()
        assert chain.shape == (60, 32, 5)
        np.testing.assert_allclose(backend.get_log_prob(), [target(step) for step in chain], rtol=1e-12)
        acceptance.append(np.mean(backend.accepted / backend.iteration))
        last = backend.get_last_sample()
        np.testing.assert_array_equal(last.coords, chain[-1])
        state = np.random.RandomState(0)
        state.set_state(last.random_state)
        # emcee itself can go on from there, in a copy.
        copy = tmp_path.parent / file.name
        copy.write_bytes(file.read_bytes())
        own = emcee.EnsembleSampler(
            32, 5, target, vectorize=True, backend=emcee.backends.HDFBackend(copy), moves=emcee.moves.DEMove()
        )
        own.run_mcmc(None, 3, skip_initial_state_check=True)
        assert own.backend.iteration == 63
    assert chains.acceptance == pytest.approx(np.mean(acceptance))


def files_while(monkeypatch, n):
    """From the n-th on (0: never), chains are only half written; returns how many were begun."""
    begun = [0]
    grow = emcee.backends.HDFBackend.grow

    def stopped(self, *arguments):
        begun[0] += 1
        grow(self, *arguments)
        if 0 < n <= begun[0]:
            raise StopError

    monkeypatch.setattr(emcee.backends.HDFBackend, "grow", stopped)
    return begun


@pytest.mark.parametrize("n", range(1, 7))
def test_interruption_while_a_chain_is_written(tmp_path, monkeypatch, n):
    settings = changed(SHORT, workers=1)
    with monkeypatch.context() as patch:
        begun = files_while(patch, n)
        with pytest.raises(StopError):
            run(settings=settings, checkpoint=tmp_path)
        assert begun[0] >= n
    assert not list(tmp_path.glob("*.tmp"))
    assert as_bytes(run(settings=settings, checkpoint=tmp_path)) == as_bytes(uninterrupted(settings)[0])
    assert not list(tmp_path.glob("*.tmp"))


@pytest.mark.parametrize("n", [3, 6])
def test_process_killed_while_a_file_is_open(tmp_path, n):
    """Really killed, with an HDF5 file open and its contents not yet on the disk."""
    script = (
        "import os, sys\nfrom pathlib import Path\nimport test_ensemble as t\n"
        "from bayes_impedance.mcmc import chain_file\n"
        "put, calls = chain_file._put_random_state, []\n"
        "def killing(group, state):\n"
        "    calls.append(0)\n"
        f"    if len(calls) == {n}:\n        os.kill(os.getpid(), 9)\n"
        "    put(group, state)\n"
        "chain_file._put_random_state = killing\n"
        f"t.run(checkpoint=Path({str(tmp_path)!r}))\n"
    )
    root = Path(__file__).resolve().parent
    killed = subprocess.run([sys.executable, "-c", script], cwd=root, capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    assert list(tmp_path.glob("*.tmp"))
    assert as_bytes(run(checkpoint=tmp_path)) == as_bytes(run())


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_truncated_files_do_not_disturb(tmp_path, share):
    """A temporary file is never read; an ensemble whose own file is damaged is sampled anew."""
    whole = as_bytes(run(checkpoint=tmp_path))
    file = tmp_path / "ensemble_1.h5"
    content = file.read_bytes()
    for damaged in (tmp_path / "ensemble_0.h5.tmp", file):
        damaged.write_bytes(content[: int(share * len(content))])
    assert as_bytes(run(checkpoint=tmp_path)) == whole
    assert emcee.backends.HDFBackend(file, read_only=True).iteration == 60


def test_files_written_grow_with_the_chain_not_with_its_square(tmp_path, monkeypatch):
    settings = changed(SHORT, longest=2000, chunk=100, workers=1)
    begun = files_while(monkeypatch, 0)
    run(settings=settings, checkpoint=tmp_path)
    assert begun[0] < 2 * 40  # a chain of 2000 steps has 80 pieces


def test_chains_of_another_dimension_are_refused(tmp_path):
    run(checkpoint=tmp_path)
    target = Gaussian(4)
    with pytest.raises(InputError, match=r"ensemble_0\.h5: is of another fit \(5 parameters, not 4\); name another"):
        sample(target, target.mean, target.sd, SHORT, np.random.SeedSequence(1), silent, tmp_path)


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


def ensembles_in(places, distance, steps=300):
    result = []
    for place, child in zip(places, np.random.SeedSequence(5).spawn(len(places)), strict=True):
        ensemble = _Ensemble(TwoModes(distance), np.full(6, place), np.eye(6), child, None)
        ensemble.prepare((30, 30), lambda n: None)
        ensemble.run_to(steps, lambda n: None)
        result.append(ensemble)
    return _collect(result)


def test_rhat_finds_ensembles_in_different_modes():
    apart = ensembles_in((-20.0, 20.0, -20.0, 20.0), 20.0)
    together = ensembles_in((20.0, 20.0, 20.0, 20.0), 20.0)
    assert apart.rhat.min() > 1.5
    assert together.rhat.max() < 1.05


def test_progress_is_reported_to_the_end():
    seen = []
    target = Gaussian(3)
    sample(target, target.mean, target.sd, SHORT, np.random.SeedSequence(1), lambda *a: seen.append(a))
    stages = {stage: [entry for entry in seen if entry[0] == stage] for stage in ("burn-in", "sampling")}
    assert len(seen) == len(stages["burn-in"]) + len(stages["sampling"])
    for entries in stages.values():
        assert entries[-1][1] == entries[-1][2]
        assert all(0 <= done <= total for _, done, total in entries)
