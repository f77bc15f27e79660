"""What is done person by person: the same on threads, processes and a cluster that loses a worker."""

import os
import signal
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from process_numbers import pids

from bayes_impedance.commands.cli import main
from bayes_impedance.mcmc.ensemble import Chains, SamplerSettings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.absolute_density import Deviations
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.person.marginal_likelihood import LEAST_RHO
from bayes_impedance.population import sharded_likelihood
from bayes_impedance.population.contrasts import Contrasts
from bayes_impedance.population.draw_error import noise_within
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.likelihood_gradient import likelihood_gradient
from bayes_impedance.population.moved_dispersions import DispersionRange
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.person_densities import constants_of, log_densities
from bayes_impedance.population.person_draws import DrawingPlan, PersonDraws
from bayes_impedance.population.sampling import kept_sets
from bayes_impedance.population.sharded_likelihood import KeptDraws
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime import executors, sharded
from bayes_impedance.runtime.executors import Cluster, map_persons, without_message_log
from bayes_impedance.runtime.sharded import Kept, parts_of
from bayes_impedance.runtime.worker_processes import Processes

SETTINGS = FitSettings(draws=128, sampler=SamplerSettings(ensembles=2, burn_in=(20,), chunk=20, longest=20))


def people() -> Recordings:
    return simulate_recordings(THREE_ELEMENTS, 9, 2, np.geomspace(5, 5000, 41), 4).recordings


@pytest.fixture(scope="module", autouse=True)
def small_parts() -> Iterator[None]:
    """Nine people make three parts, so that sums over parts are what is compared."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sharded, "_SMALLEST_PART", 4)
        assert len(parts_of(9)) == 3
        yield


@pytest.fixture(scope="module")
def alone() -> PopulationFit:
    return fit_population(people(), settings=SETTINGS, seed=2)


def _require_same(one: PopulationFit, other: PopulationFit) -> None:
    np.testing.assert_array_equal(one.log_probability, other.log_probability)
    np.testing.assert_array_equal(one.person_draws, other.person_draws)
    np.testing.assert_array_equal(one.parameters.mu, other.parameters.mu)


def test_parts_make_no_difference_beyond_rounding(alone: PopulationFit, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharded, "_SMALLEST_PART", 128)
    whole = fit_population(people(), settings=SETTINGS, seed=2)
    np.testing.assert_allclose(whole.noise_scale, alone.noise_scale, rtol=1e-9)
    np.testing.assert_allclose(np.array(whole.deviations), np.array(alone.deviations), rtol=1e-6, atol=1e-9)


def add(a: int, b: int) -> int:
    return a + b


def total(part: list[int], beside: list[int], factor: int) -> int:
    return factor * (sum(part) + sum(beside))


def test_what_is_kept_is_worked_on_and_asked_part_by_part() -> None:
    with ThreadPoolExecutor(2) as executor:
        kept = Kept.of(executor, list(range(9)))
        more = kept.each(add, np.arange(9))
        assert more.gathered() == [2 * i for i in range(9)]
        assert more.gathered(str) == [str(2 * i) for i in range(9)]
        asked = kept.ask(total, 10, columns=[more])
        assert asked == [10 * 3 * sum(range(9)[rows]) for rows in parts_of(9)]
        assert list(kept.ask_in_turn(total, [([k], 1) for k in range(3)])) == [6, 23, 10]
        kept.forget()
        assert not kept.parts


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


def test_processes_of_which_one_is_killed_give_the_same(alone: PopulationFit) -> None:
    killed: list[int] = []

    def progress(stage: str, done: int, _total: int) -> None:
        if stage == "population estimate" and done >= 2 and not killed:
            killed.append(pids(executor)[0])
            os.kill(killed[0], signal.SIGKILL)

    with Processes(2) as executor:
        _require_same(alone, fit_population(people(), settings=SETTINGS, seed=2, executor=executor, progress=progress))
        assert killed[0] not in pids(executor)


@pytest.mark.parametrize(
    ("kept", "stage"), [(False, "population estimate"), (True, "population estimate"), (True, "sampling")]
)
def test_a_cluster_that_loses_a_worker_gives_the_same(alone: PopulationFit, kept: bool, stage: str) -> None:
    """As an executor like any other, and where draws stay with the workers: then a lost worker's are made again."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    killed: list[int] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a worker that dies is what this is about
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):

            def progress(current: str, done: int, _total: int) -> None:
                if current == stage and done >= 2 and not killed:
                    numbers = client.run(os.getpid)
                    holders = {w for who in client.who_has().values() for w in who} if kept else set()
                    killed.append(next((numbers[w] for w in numbers if w in holders), next(iter(numbers.values()))))
                    os.kill(killed[0], signal.SIGKILL)

            executor = Cluster(client) if kept else client.get_executor(pure=False, retries=5)
            fit = fit_population(people(), settings=SETTINGS, seed=2, executor=executor, progress=progress)
    assert killed
    _require_same(alone, fit)


def doubled(part: list[int], factor: int) -> int:
    return factor * sum(part)


def test_parts_that_are_with_one_worker_are_asked_together() -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50, processes=False
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        executor = Cluster(client)
        parts = [executor.keep(list, range(k + 1)) for k in range(12)]
        client.gather(parts)
        kept, expected = Kept(executor, parts), [3 * sum(range(k + 1)) for k in range(12)]
        workers = {w for who in client.who_has(parts).values() for w in who}
        assert kept.ask(doubled, 3) == expected
        some = [0, 2, 140, 299]
        assert Kept.of(executor, range(300)).of_some(np.array(some)).gathered() == some
        assert len(executor._together([(part,) for part in parts])) == len(workers)
        unborn = executor.keep(list, range(5))
        assert executor.ask(doubled, [([1, 2],), (unborn,), (parts[1],)], 3) == [9, 30, 3]


@pytest.mark.parametrize(("people", "parts"), [(1, 1), (1000, 8), (10_000, 20), (100_000, 196), (1_000_000, 256)])
def test_many_people_have_few_parts(people: int, parts: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharded, "_SMALLEST_PART", 128)
    assert len(parts_of(people)) == parts
    assert parts_of(people)[-1].stop == people


def test_a_cluster_forgets_how_iterations_came_about() -> None:
    """It remembers the inputs of what it may have to compute again: those of the last iteration, not of all."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")

    remembered: list[int] = []
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):

        def progress(stage: str, _done: int, _total: int) -> None:
            if stage == "population estimate":
                remembered.append(len(cluster.scheduler.tasks))

        fit_population(people(), settings=SETTINGS, seed=2, executor=Cluster(client), progress=progress)
    assert len(remembered) >= 6
    assert max(remembered) <= remembered[0] + 3  # a task for each of three parts may be on its way


def test_a_client_does_not_keep_the_messages_it_has_sent() -> None:
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")

    with (
        without_message_log(),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=":0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        assert client.submit(add, 1, 2).result() == 3
        sent: Any = client.scheduler_comm
        assert len(sent.recent_message_log) == 0


def test_heavier_tails_on_a_cluster_are_the_same() -> None:
    """The weights of persons go to where their fits are, and the factors of their draws too."""
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    settings = replace(SETTINGS, distribution="student_t", covariance="diagonal")
    here = fit_population(people(), settings=settings, seed=2)
    with (
        warnings.catch_warnings(),
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, dashboard_address=":0", silence_logs=50, processes=False
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        warnings.simplefilter("ignore")
        there = fit_population(people(), settings=settings, seed=2, executor=Cluster(client))
    _require_same(here, there)
    assert here.parameters.tail is not None
    np.testing.assert_array_equal(here.parameters.tail, there.parameters.tail)


def deviations_at_random(rng: np.random.Generator, size: int) -> Deviations:
    root = rng.normal(size=(size, 2 * size))
    return Deviations(root @ root.T, rng.normal(size=size), 50.0, 40)


def test_sums_over_parts_are_those_over_all_persons() -> None:
    """More persons than one part holds, with one, two and three repetitions: parts have the contrasts of their own."""
    rng = np.random.default_rng(3)
    n, k = 300, 64
    repetitions = rng.integers(1, 4, n)
    equal = np.full(k, -np.log(k))
    draws = [
        Draws(rng.normal(size=(k, 2)), rng.normal(size=k), equal, rng.normal(), deviations_at_random(rng, 2 * (j - 1)))
        for j in repetitions
    ]
    means, covariates = rng.normal(size=(n, 2)), rng.normal(size=(n, 1))
    contrasts = []
    for j in (2, 3):
        size, own = 2 * (j - 1), int(np.sum(repetitions == j))
        root = rng.normal(size=(own, size, 2 * size))
        information = np.moveaxis(root @ np.swapaxes(root, 1, 2), 0, -1)
        contrasts.append(Contrasts(np.ascontiguousarray(information), rng.normal(size=(size, own))))
    span = DispersionRange(np.full(2, 0.1), np.full(2, 0.04), np.full(2, 0.25), np.full(2, 0.1))
    responses = [0.5 * rng.normal(size=(4, k)) for _ in draws]
    plan = DrawingPlan(
        kernel=Kernel(parse("m1|r1")),
        rho=np.zeros(2),
        covariance=np.eye(2),
        n_draws=k,
        along_valley=False,
        sharing=None,
        span=span,
    )
    drawn = [PersonDraws(d, None, r) for d, r in zip(draws, responses, strict=True)]
    parts = []
    for rows in parts_of(n):
        inside = np.zeros(n, dtype=bool)
        inside[rows] = True
        own = [
            Contrasts(np.ascontiguousarray(c.information[..., some]), np.ascontiguousarray(c.gradient[:, some]))
            for j, c in zip((2, 3), contrasts, strict=True)
            for some in [inside[repetitions == j]]
        ]
        parts.append(sharded_likelihood._part(plan, drawn[rows], repetitions[rows], own, means[rows], covariates[rows]))
    assert len(parts) > 2
    sets = PopulationParameters(
        mu=rng.normal(size=(5, 2)),
        between_persons=rng.uniform(0.5, 1, (5, 2)),
        correlation_cholesky=np.tile(np.eye(2), (5, 1, 1)),
        between_repetitions=rng.uniform(0.05, 0.2, (5, 2)),
        slopes=rng.normal(size=(5, 2, 1)),
    )
    whole = ImportanceLikelihood(
        draws, means, np.eye(2), repetitions, covariates, contrasts, span=span, responses=responses
    )
    with ThreadPoolExecutor(1) as executor:
        kept = KeptDraws(parts, executor)
        np.testing.assert_allclose(kept(sets), whole(sets), rtol=1e-9)
        np.testing.assert_allclose(kept.variance(sets), whole.variance(sets), rtol=1e-6)
        np.testing.assert_allclose(kept.effective(sets), whole.terms(sets, effective=True)[1], rtol=1e-6)
        summed, exact = kept.gradient(sets, k), likelihood_gradient(whole, sets)
        for name in ("mu", "covariance", "between_repetitions", "slopes"):
            np.testing.assert_allclose(getattr(summed, name), getattr(exact, name), rtol=1e-5, atol=1e-5)
        theta, log_likelihood = kept.persons(sets, np.random.SeedSequence(1))
    constants = constants_of(draws, np.full(2, LEAST_RHO))
    np.testing.assert_allclose(
        log_likelihood, log_densities(whole, [d.deviations for d in draws], constants, sets), rtol=1e-9, atol=1e-9
    )
    assert len(set(constants.tolist())) == n
    stacked = np.array([d.theta for d in draws])
    away = np.abs(theta[:, :, None] - stacked[None]).max(axis=-1)
    assert away.min(axis=-1).max() < 1e-6  # draws are kept in single precision
    gathered, ratios = kept.gathered()
    np.testing.assert_allclose(gathered, stacked, atol=1e-6)
    np.testing.assert_allclose(ratios, [d.log_ratio - d.log_ratio.max() for d in draws], atol=1e-6)


def test_noise_counts_as_far_as_it_differs_within_the_posterior() -> None:
    assert noise_within(0.3, 16, 52) == 0.3
    assert noise_within(30.0, 10_000, 50) == pytest.approx(0.15)


@pytest.mark.parametrize(("people", "kept"), [(71, 500), (100_000, 100)])
def test_a_result_of_many_persons_keeps_fewer_sets(people: int, kept: int) -> None:
    nothing = np.zeros(1)
    chains = Chains(
        coordinates=np.zeros((4, 500, 3)),
        log_probability=np.zeros((4, 500)),
        rhat=nothing,
        effective=nothing,
        autocorrelation_time=nothing,
        acceptance=0.3,
        steps=300,
        walkers=104,
    )
    chosen = kept_sets(chains, 8 * people)
    assert len(chosen) == kept
    assert (chosen[0], chosen[-1]) == (0, 499)


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_a_scheduler_that_does_not_answer_is_one_sentence(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    from bayes_impedance.recordings.files import write_recordings

    monkeypatch.setattr(executors, "_SCHEDULER_SECONDS", 1)
    write_recordings(people(), tmp_path / "data")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        status = main(
            [command, str(tmp_path / "data"), "-o", str(tmp_path / "out"), "--scheduler", "tcp://127.0.0.1:9"]
        )
    assert status == 2
    said = capsys.readouterr().err
    assert "no Dask scheduler answers at 'tcp://127.0.0.1:9'" in said
    assert not (tmp_path / "out").exists()
