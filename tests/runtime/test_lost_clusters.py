"""Clusters that lose all their workers or the scheduler in the middle of a job, or ask for certificates: one sentence.

Workers and scheduler are processes of their own that nobody starts again (no nannies).
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from tiny_fits import fit_arguments

from bayes_impedance.commands import cli
from bayes_impedance.commands.cli import main
from bayes_impedance.runtime import executors

distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")


@contextmanager
def running(program: str, *arguments: str) -> Iterator[subprocess.Popen[bytes]]:
    """A scheduler or a worker, until it is killed or the context ends."""
    command = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard", *arguments]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


class Cluster:
    """A scheduler and two workers, each a process."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.stack, file = stack, folder / "scheduler.json"
        own = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        self.scheduler = stack.enter_context(running("dask_scheduler", *own))
        while not file.exists():  # written when the scheduler listens
            assert self.scheduler.poll() is None
            time.sleep(0.1)
        self.address = json.loads(file.read_text(encoding="utf-8"))["address"]
        self.workers = [self.start_worker() for _ in range(2)]
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)

    def start_worker(self) -> subprocess.Popen[bytes]:
        return self.stack.enter_context(running("dask_worker", self.address, "--no-nanny", "--nthreads", "1"))

    def lose_workers(self) -> None:
        for worker in self.workers:
            worker.kill()

    def lose_scheduler(self) -> None:
        self.scheduler.kill()

    def replace_workers(self) -> None:
        self.lose_workers()
        self.start_worker()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with ExitStack() as stack, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # connections that break are what this is about
        yield Cluster(tmp_path, stack)


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds instead of a minute until a job without workers gives up."""
    monkeypatch.setattr(executors, "_WORKER_SECONDS", 3)
    monkeypatch.setattr(executors, "_FAREWELL_SECONDS", 1)


def at_stage(stage: str, fault: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Let a fault happen once the command has begun with a stage; the list tells whether it has."""
    happened: list[str] = []

    class Bars(cli.Bars):
        def __call__(self, current: str, done: int, total: int) -> None:
            super().__call__(current, done, total)
            if current == stage and not happened:
                happened.append(stage)
                fault()

    monkeypatch.setattr(cli, "Bars", Bars)
    return happened


def require_one_sentence(capsys: pytest.CaptureFixture[str], *words: str) -> None:
    """On standard error one line, and nothing at all of what fitted so far on the other."""
    told = capsys.readouterr()
    progress = re.compile(r"waiting up to |\d\d:\d\d:\d\d .*: \d+ of \d+$")  # of a slow machine
    lines = [line for line in told.err.splitlines() if line and not progress.match(line)]
    assert len(lines) == 1, told.err
    assert lines[0].startswith("error: the Dask scheduler at ")
    assert all(word in lines[0] for word in words), lines[0]
    assert not told.out.strip()


def pieces(out: Path) -> set[str]:
    return {file.name for file in (out / "checkpoint").iterdir()}


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize(
    ("stage", "kept"),
    [
        pytest.param("population estimate", "first_fits.npz", marks=(pytest.mark.slow, pytest.mark.ci)),
        pytest.param("searching", "belongs_to.txt", marks=pytest.mark.slow),
        pytest.param("draws", "point_estimate.npz", marks=pytest.mark.slow),
        pytest.param("sampling", "ensemble_0.h5", marks=pytest.mark.slow),
        pytest.param("examining the fit", "ensemble_0.h5", marks=pytest.mark.slow),
    ],
)
def test_a_fit_that_loses_all_workers(
    stage: str,
    kept: str,
    cluster: Cluster,
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened = at_stage(stage, cluster.lose_workers, monkeypatch)
    arguments, out = fit_arguments(tiny / "data", tmp_path / "out"), tmp_path / "out"
    assert main([*arguments, "--scheduler", cluster.address]) == 1
    assert happened
    require_one_sentence(capsys, "has lost all its workers and got none for 3 s", "with --resume")
    assert kept in pieces(out)
    assert main([*arguments, "--resume"]) == 0
    assert (out / "result.nc").read_bytes() == (tiny / "out" / "result.nc").read_bytes()
    assert not (out / "checkpoint").exists()


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["population estimate", "sampling"])
def test_a_fit_that_loses_the_scheduler(
    stage: str,
    cluster: Cluster,
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened = at_stage(stage, cluster.lose_scheduler, monkeypatch)
    arguments, out = fit_arguments(tiny / "data", tmp_path / "out"), tmp_path / "out"
    assert main([*arguments, "--scheduler", cluster.address]) == 1
    assert happened
    require_one_sentence(capsys, "no longer answers", "with --resume")
    assert "first_fits.npz" in pieces(out)
    assert main([*arguments, "--resume"]) == 0
    assert (out / "result.nc").read_bytes() == (tiny / "out" / "result.nc").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["population estimate", "sampling"])
def test_a_fit_whose_workers_are_all_replaced_is_the_same(
    stage: str, cluster: Cluster, tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the lost workers kept is made again from the recordings."""
    happened = at_stage(stage, cluster.replace_workers, monkeypatch)
    assert main(fit_arguments(tiny / "data", tmp_path / "out", "--scheduler", cluster.address)) == 0
    assert happened
    assert (tmp_path / "out" / "result.nc").read_bytes() == (tiny / "out" / "result.nc").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("impatient")
def test_a_diagnosis_that_loses_all_workers(
    cluster: Cluster,
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    happened = at_stage("looking for what is missing", cluster.lose_workers, monkeypatch)
    arguments = ["diagnose", str(tiny / "data"), "-o", str(tmp_path / "out"), "--quick", "--network", "m1|r1|n1"]
    assert main([*arguments, "--scheduler", cluster.address]) == 1
    assert happened
    require_one_sentence(capsys, "has lost all its workers and got none for 3 s", "with --resume")
    assert not (tmp_path / "out" / "verdict.json").exists()
    assert any(path.is_dir() for path in (tmp_path / "out").iterdir())  # the checkpoint


# -------------------------------------------------------------------- certificates

AUTHORITY, CERTIFICATE = "distributed.comm.tls.ca-file", "distributed.comm.tls.client.cert"


@pytest.mark.parametrize(
    ("configuration", "reason"),
    [
        ({}, "does not name them"),
        ({AUTHORITY: "{folder}/authority.pem"}, "does not name them"),
        ({AUTHORITY: "{folder}/none.pem", CERTIFICATE: "{folder}/none.pem"}, "No such file"),
        ({AUTHORITY: "{folder}/text.pem", CERTIFICATE: "{folder}/text.pem"}, "no certificate"),
    ],
)
@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_scheduler_that_needs_certificates(
    command: str,
    configuration: dict[str, str],
    reason: str,
    tiny: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import dask

    (tmp_path / "text.pem").write_text("no certificate")
    named = {key: file.format(folder=tmp_path) for key, file in configuration.items()}
    arguments = [command, str(tiny / "data"), "-o", str(tmp_path / "out"), "--scheduler", "tls://127.0.0.1:9"]
    capsys.readouterr()
    with dask.config.set(named):
        assert main(arguments) == 2
    require_one_sentence(capsys, "'tls://127.0.0.1:9' needs certificates", reason, "distributed.comm.tls.ca-file")
    assert not (tmp_path / "out").exists()
