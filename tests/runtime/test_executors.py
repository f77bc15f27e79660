"""A diagnosis by threads, processes and a cluster, some of which are killed: the same; and what the commands say."""

from __future__ import annotations

import json
import os
import signal
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from experiments import die_at_once
from process_numbers import pids

from bayes_impedance.commands.cli import main
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.types import Diagnosis
from bayes_impedance.diagnosis.verdict_file import to_json
from bayes_impedance.errors import WorkerError
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings, read_recordings, write_recordings
from bayes_impedance.runtime import worker_processes
from bayes_impedance.runtime.executors import Cluster, executor_of
from bayes_impedance.runtime.worker_processes import Processes


def delayed() -> Recordings:
    """Ten people, two of them on a grid of their own, with a skew between the channels."""
    given = simulate_recordings(THREE_ELEMENTS, 10, 2, np.geomspace(5, 5000, 41), 4).recordings
    subjects = [replace(s, z=s.z * np.exp(-2j * np.pi * s.frequency_hz * 2e-5)) for s in given.subjects]
    subjects[3:5] = [s.at(np.arange(41) != 7) for s in subjects[3:5]]
    return replace(given, subjects=tuple(subjects))


CANDIDATES = [e for e in registered() if e.id in ("rig.delay", "rig.mass")]


@pytest.fixture(scope="module")
def alone() -> Diagnosis:
    return diagnose(delayed(), effects=CANDIDATES, quick=True, seed=1)


def _require_same(one: Diagnosis, other: Diagnosis) -> None:
    assert one.verdict == other.verdict
    assert one.ranking == other.ranking
    assert one.after is not None
    assert other.after is not None
    for name in ("residual_magnitude", "residual_phase"):
        np.testing.assert_array_equal(getattr(one.after, name), getattr(other.after, name))


class Killing:
    """Progress that kills one of the processes as soon as the search has begun."""

    def __init__(self, pids: Any) -> None:
        self.pids, self.killed = pids, list[int]()

    def __call__(self, stage: str, _done: int, _total: int) -> None:
        if stage == "looking for what is missing" and not self.killed:
            self.killed.append(self.pids()[0])
            os.kill(self.killed[0], signal.SIGKILL)


def test_a_diagnosis_does_not_depend_on_threads(alone: Diagnosis) -> None:
    assert [entry.id for entry in alone.verdict.physics] == ["rig.delay"]
    _require_same(alone, diagnose(delayed(), effects=CANDIDATES, quick=True, seed=1, workers=1))


@pytest.mark.long
def test_a_diagnosis_by_processes_of_which_one_is_killed_is_the_same(alone: Diagnosis) -> None:
    with Processes(2) as executor:
        progress = Killing(lambda: pids(executor))
        _require_same(
            alone, diagnose(delayed(), effects=CANDIDATES, quick=True, seed=1, executor=executor, progress=progress)
        )
        assert progress.killed
        assert progress.killed[0] not in pids(executor)


@pytest.mark.long
def test_a_diagnosis_by_the_standard_library_s_processes_is_the_same(alone: Diagnosis) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        _require_same(alone, diagnose(delayed(), effects=CANDIDATES, quick=True, seed=1, executor=executor))


@contextmanager
def local_cluster(workers: int) -> Iterator[Any]:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a worker that dies is what this is about
        with distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=":0", silence_logs=50
        ) as cluster:
            yield cluster


@pytest.mark.long
def test_a_diagnosis_by_a_cluster_that_loses_a_worker_is_the_same(alone: Diagnosis) -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    with local_cluster(2) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        progress = Killing(lambda: list(client.run(os.getpid).values()))
        executor = Cluster(client)
        found = diagnose(delayed(), effects=CANDIDATES, quick=True, seed=1, executor=executor, progress=progress)
    assert progress.killed
    _require_same(alone, found)


# -------------------------------------------------------------------- the commands


@pytest.mark.long
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_processes_that_die_again_and_again_are_one_sentence(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker_processes, "_work", die_at_once)
    write_recordings(delayed(), tmp_path / "data")
    assert main([command, str(tmp_path / "data"), "-o", str(tmp_path / "out"), "--workers", "1"]) == 1
    said = capsys.readouterr().err
    assert said.count("error:") == 1
    assert "4 processes died on the same task" in said
    assert "Traceback" not in said


def test_a_cluster_s_workers_that_die_again_and_again_are_one_sentence() -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        local_cluster(1) as cluster,
        pytest.raises(WorkerError, match="workers of the cluster died"),
        executor_of(scheduler=cluster.scheduler_address) as executor,
    ):
        executor.submit(os._exit, 1).result()


def test_workers_of_the_command_are_processes_and_threads_without(monkeypatch: pytest.MonkeyPatch) -> None:
    with executor_of(FitOptions().threads, FitOptions().workers) as executor:
        assert isinstance(executor, ThreadPoolExecutor)
        assert executor._max_workers == 2
    with executor_of(FitOptions(workers=3).threads, FitOptions(workers=3).workers) as executor:
        assert isinstance(executor, Processes)
        assert len(executor._workers) == 3
        assert pids(executor) == ()  # they start when they are needed


@pytest.mark.long
def test_the_command_diagnoses_the_same_with_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[diagnose.__module__], "registered", lambda: CANDIDATES)
    write_recordings(delayed(), tmp_path / "data")
    assert main(["diagnose", str(tmp_path / "data"), "--quick", "-o", str(tmp_path / "out"), "--workers", "2"]) == 0
    written = json.loads((tmp_path / "out" / "verdict.json").read_text(encoding="utf-8"))
    assert written["physics"]
    assert written == to_json(diagnose(read_recordings(tmp_path / "data"), quick=True, seed=1).verdict)
