"""Chains kept in files: an interrupted run continues to the same bytes as one that was not interrupted."""

from __future__ import annotations

import subprocess
import sys
from functools import cache
from pathlib import Path

import emcee
import numpy as np
import pytest
from short_chains import SHORT, Gaussian, as_bytes, changed, run, silent

from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import (
    SamplerSettings,
    sample,
)


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
    write = Path.write_bytes

    def stopped(self, content):
        begun[0] += 1
        if 0 < n <= begun[0]:
            write(self, content[: len(content) // 2])
            raise StopError
        return write(self, content)

    monkeypatch.setattr(Path, "write_bytes", stopped)
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
    """Really killed, with a part of the file on the disk."""
    script = (
        "import os, sys\nfrom pathlib import Path\nimport short_chains as t\n"
        "write, calls = Path.write_bytes, []\n"
        "def killing(self, content):\n"
        "    calls.append(0)\n"
        f"    if len(calls) == {n}:\n"
        "        write(self, content[: len(content) // 2])\n        os.kill(os.getpid(), 9)\n"
        "    return write(self, content)\n"
        "Path.write_bytes = killing\n"
        f"t.run(checkpoint=Path({str(tmp_path)!r}))\n"
    )
    tests = Path(__file__).resolve().parents[1]
    killed = subprocess.run([sys.executable, "-c", script], cwd=tests, capture_output=True, text=True, check=False)
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
    with pytest.raises(InputError, match=r"ensemble_0\.h5: is the chain of another fit \(5 parameters, not 4\)"):
        sample(target, target.mean, target.sd, SHORT, np.random.SeedSequence(1), silent, tmp_path)
