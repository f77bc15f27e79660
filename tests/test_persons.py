"""What is done person by person: the same on threads, processes and a cluster that loses a worker."""

import os
import signal
import warnings
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_impedance.cli import main
from bayes_impedance.persons import map_persons
from bayes_impedance.population import FitSettings, PopulationFit, fit_population
from bayes_impedance.recordings import Recordings
from bayes_impedance.sampling import SamplerSettings
from bayes_impedance.simulate import VirtualPopulation, simulate_recordings

SETTINGS = FitSettings(draws=128, sampler=SamplerSettings(ensembles=2, burn_in=(20,), chunk=20, longest=20))
POPULATION = VirtualPopulation(
    network="m1|r1|n1",
    central={"m1": 1e-4, "r1": 3.0, "n1": 1e-3},
    between_persons={"m1": 0.2, "r1": 0.3, "n1": 0.2},
    between_repetitions={"m1": 0.05, "r1": 0.05, "n1": 0.05},
)


def people() -> Recordings:
    return simulate_recordings(POPULATION, 9, 2, np.geomspace(5, 5000, 41), 4).recordings


@pytest.fixture(scope="module")
def alone() -> PopulationFit:
    return fit_population(people(), settings=SETTINGS, seed=2)


def _require_same(one: PopulationFit, other: PopulationFit) -> None:
    np.testing.assert_array_equal(one.log_probability, other.log_probability)
    np.testing.assert_array_equal(one.person_draws, other.person_draws)
    np.testing.assert_array_equal(one.parameters.mu, other.parameters.mu)


def add(a: int, b: int) -> int:
    return a + b


@pytest.mark.parametrize("n", [1, 63, 64, 65, 200])
def test_results_come_in_order_in_few_tasks(n: int) -> None:
    class Counting(ThreadPoolExecutor):
        submitted = 0

        def submit(self, *arguments: Any, **named: Any) -> Any:
            self.submitted += 1
            return super().submit(*arguments, **named)

    with Counting(2) as executor:
        assert list(map_persons(executor, add, range(n), np.arange(n))) == [2 * i for i in range(n)]
        assert executor.submitted <= 64


def test_an_error_of_one_person_is_an_error() -> None:
    with ThreadPoolExecutor(2) as executor, pytest.raises(TypeError):
        list(map_persons(executor, add, [1, 2, None], [1, 2, 3]))


def test_processes_give_the_same(alone: PopulationFit) -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        _require_same(alone, fit_population(people(), settings=SETTINGS, seed=2, executor=executor))


def test_a_cluster_that_loses_a_worker_gives_the_same(alone: PopulationFit) -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    killed: list[int] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a worker that dies is what this is about
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):

            def progress(stage: str, done: int, _total: int) -> None:
                if stage == "population estimate" and done == 2 and not killed:
                    killed.append(next(iter(client.run(os.getpid).values())))
                    os.kill(killed[0], signal.SIGKILL)

            executor = client.get_executor(pure=False, retries=5)
            fit = fit_population(people(), settings=SETTINGS, seed=2, executor=executor, progress=progress)
    assert killed
    _require_same(alone, fit)


def test_a_scheduler_that_does_not_answer_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    from bayes_impedance import persons
    from bayes_impedance.recordings import write_recordings

    monkeypatch.setattr(persons, "_PATIENCE", "1s")
    write_recordings(people(), tmp_path / "data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        status = main(["fit", str(tmp_path / "data"), "-o", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"])
    assert status == 2
    said = capsys.readouterr().err
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:9'" in said
    assert not (tmp_path / "out").exists()
