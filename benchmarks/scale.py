"""A population on a local Dask cluster: growth of time and memory with the number of people, and the gain by workers.

Virtual fingertips with 101 frequencies and three repetitions, or as many as asked for. Everybody's fits and draws stay
with the workers, which return sums; this process keeps the recordings, the sampler's walkers and the result. With
``--kill`` a worker is killed while the chains grow, and the result is compared with that of an undisturbed run.

With ``--files csv``, ``parquet`` or ``table`` the people are written as a dataset in a temporary folder, by a process
of its own, and read from there: as one CSV file, as Parquet files partitioned by subject, of which no impedances stay
in this process, or as one Parquet file.

Memory is the largest anonymous memory during the fit, of this process and of the larger of the first workers.

``--overhead`` measures what a likelihood costs beside its arithmetic: every part of the people is asked for 104 numbers
that cost nothing.

Run from the repository's root: ``python benchmarks/scale.py --people 1000 4000 30000``; results go to ``scale.json``.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import Any

import numpy as np
from report import replace_between

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings, write_recordings
from bayes_impedance.runtime.executors import Cluster, without_message_log
from bayes_impedance.runtime.sharded import Kept, parts_of

HERE = Path(__file__).resolve().parent
_SAMPLER = SamplerSettings(ensembles=2, burn_in=(80, 40), chunk=100, longest=400, effective=600.0)


def peak_megabytes() -> float:
    """Largest resident memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def anonymous_megabytes(process: int) -> float:
    """Memory of a process that is not a file's; zero if the process or the system's table of it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return sum(float(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon"))


@contextmanager
def watched(processes: dict[str, list[int]]) -> Iterator[dict[str, float]]:
    """Largest anonymous memory of the largest of some processes, for each of their names, while the block runs."""
    peaks, done = dict.fromkeys(processes, 0.0), Event()

    def watch() -> None:
        while not done.wait(0.2):
            for name, some in processes.items():
                peaks[name] = max(peaks[name], *map(anonymous_megabytes, some))

    thread = Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peaks
    finally:
        done.set()
        thread.join()


def measured(
    recordings: Recordings, workers: int, draws: int, kill: bool = False
) -> tuple[dict[str, Any], PopulationFit]:
    """One fit on a cluster of its own."""
    import distributed

    killed: list[int] = []
    with (
        without_message_log(),
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, memory_limit=0, silence_logs=50
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        watched({"here": [os.getpid()], "worker": list(client.run(os.getpid).values())}) as peaks,
    ):

        def progress(stage: str, done: int, _total: int) -> None:
            if kill and stage == "sampling" and done > 30 and not killed:
                killed.append(next(iter(client.run(os.getpid).values())))
                os.kill(killed[0], signal.SIGKILL)

        started = time.perf_counter()
        settings = FitSettings(draws=draws, sampler=_SAMPLER)
        fit = fit_population(recordings, settings=settings, seed=1, executor=Cluster(client), progress=progress)
        seconds = time.perf_counter() - started
    d = fit.diagnostics
    return {
        "people": len(recordings.subjects),
        "points": recordings.subjects[0].frequency_hz.size,
        "repetitions": len(recordings.subjects[0].repetitions),
        "workers": workers,
        "draws": draws,
        "seconds": seconds,
        "stages": fit.seconds,
        "anonymous MB of this process": peaks["here"],
        "anonymous MB of a worker": peaks["worker"],
        "R-hat": d.rhat_max,
        "effective": d.effective_min,
        "steps": d.steps,
        "noise of the likelihood": d.log_likelihood_variance,
        "problems": list(d.problems),
        "mu": fit.parameters.mu.mean(axis=0).tolist(),
        "mu sd": fit.parameters.mu.std(axis=0).tolist(),
        "tau": fit.parameters.between_persons.mean(axis=0).tolist(),
        "tau sd": fit.parameters.between_persons.std(axis=0).tolist(),
        "killed": bool(killed),
    }, fit


def nothing(_part: Any, sets: np.ndarray) -> np.ndarray:
    """A likelihood without arithmetic."""
    return np.zeros(len(sets))


def overhead(n: int, workers: int, rounds: int = 20) -> dict[str, Any]:
    """Milliseconds for which a cluster is asked for a likelihood of n people that costs nothing."""
    import distributed

    with (
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, dashboard_address=None, memory_limit=0, silence_logs=50
        ) as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
    ):
        executor = Cluster(client)
        parts = [executor.keep(range, 1) for _ in parts_of(n)]
        kept, sets, times = Kept(executor, parts), np.ones((104, 88)), []
        client.gather(parts)
        for _ in range(1 + rounds):
            started = time.perf_counter()
            kept.ask(nothing, sets)
            times.append(1e3 * (time.perf_counter() - started))
    return {
        "people": n,
        "workers": workers,
        "parts": len(parts),
        "median ms": float(np.median(times[1:])),
        "least ms": min(times[1:]),
        "load": os.getloadavg()[0],
    }


def people(n: int, points: int, repetitions: int) -> Recordings:
    """The first n people of one sequence, so that larger populations contain the smaller ones."""
    return simulate_recordings(FINGERTIP, n, repetitions, np.geomspace(5, 5000, points), 1).recordings


def write_people(n: int, points: int, repetitions: int, folder: Path, files: str) -> None:
    """The same people as a dataset."""
    recordings = people(n, points, repetitions)
    write_recordings(recordings if files == "csv" else recordings.select(recordings.names[:1]), folder)
    if files == "csv":
        return
    import pyarrow as pa
    import pyarrow.parquet as pq

    (folder / "recordings.csv").unlink()
    (folder / "subjects.csv").unlink(missing_ok=True)
    if files == "table":
        pq.write_table(pa.concat_tables(table_of(s) for s in recordings.subjects), folder / "recordings.parquet")
        return
    for s in recordings.subjects:
        part = folder / "recordings.parquet" / f"subject={s.name}"
        part.mkdir(parents=True)
        pq.write_table(table_of(s).drop_columns(["subject"]), part / "part-0.parquet")


def table_of(s: Subject) -> Any:
    """One person's recordings as a long table."""
    import pyarrow as pa

    n = s.z.size
    return pa.table(
        {
            "subject": [s.name] * n,
            "repetition": np.repeat(s.repetitions, s.frequency_hz.size),
            "frequency_hz": np.tile(s.frequency_hz, len(s.repetitions)),
            "z_re": s.z.real.ravel(),
            "z_im": s.z.imag.ravel(),
        }
    )


@contextmanager
def read_people(
    n: int, points: int, repetitions: int, files: str | None
) -> Iterator[tuple[Recordings, dict[str, Any]]]:
    """The people, and time and memory of reading them."""
    if files is None:
        yield people(n, points, repetitions), {}
        return
    with TemporaryDirectory() as folder:
        writer = get_context("spawn").Process(target=write_people, args=(n, points, repetitions, Path(folder), files))
        writer.start()
        writer.join()
        before, started = peak_megabytes(), time.perf_counter()
        recordings = read_recordings(folder)
        told = {"files": files, "seconds to read": time.perf_counter() - started}
        told["peak MB before reading"], told["peak MB after reading"] = before, peak_megabytes()
        print(json.dumps(told), flush=True)
        yield recordings, told


def table(rows: list[dict[str, Any]]) -> str:
    """One line for each fit."""
    head = [
        "people",
        "points",
        "workers",
        "seconds",
        "modes",
        "draws",
        "sampling",
        "persons",
        "MB here",
        "MB of a worker",
        "R-hat",
    ]
    head += ["effective", "noise", "a worker killed"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for row in rows:
        stages = [f"{row['stages'][name]:.0f}" for name in ("modes", "draws", "population", "persons")]
        killed = {None: "no", True: "yes: the same numbers", False: "yes: OTHER NUMBERS"}[
            row.get("same numbers as undisturbed")
        ]
        memory = [f"{row[f'anonymous MB of {who}']:.0f}" for who in ("this process", "a worker")]
        quality = [f"{row['R-hat']:.3f}", f"{row['effective']:.0f}", f"{row['noise of the likelihood']:.2g}", killed]
        size = f"{row['repetitions']} x {row['points']}"
        cells = [str(row["people"]), size, str(row["workers"]), f"{row['seconds']:.0f}", *stages, *memory, *quality]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, nargs="+", default=[100, 1000, 10000])
    parser.add_argument("--workers", type=int, nargs="+", default=[2])
    parser.add_argument("--draws", type=int, default=256)
    parser.add_argument("--points", type=int, default=101, help="frequencies of a recording")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument(
        "--files", choices=("csv", "parquet", "table"), help="write the people to files and read them there"
    )
    parser.add_argument("--kill", action="store_true", help="repeat each fit with a worker killed in the middle")
    parser.add_argument("--overhead", action="store_true", help="only what a likelihood costs beside its arithmetic")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "scale.json")
    options = parser.parse_args(arguments)
    if options.overhead:
        for n in options.people:
            for workers in options.workers:
                print(json.dumps(overhead(n, workers)), flush=True)
        return
    rows = json.loads(options.out.read_text(encoding="utf-8")) if options.out.is_file() else []
    for n in options.people:
        with read_people(n, options.points, options.repetitions, options.files) as (recordings, told):
            for workers in options.workers:
                row, fit = measured(recordings, workers, options.draws)
                rows.append(row | told)
                print(json.dumps({k: v for k, v in row.items() if not isinstance(v, list)}), flush=True)
                if options.kill:
                    again, other = measured(recordings, workers, options.draws, kill=True)
                    same = np.array_equal(fit.parameters.mu, other.parameters.mu)
                    rows.append(again | told | {"same numbers as undisturbed": bool(same)})
                    print(f"a worker killed: {again['killed']}, the same numbers: {same}", flush=True)
                options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    if options.files != "csv":
        replace_between(HERE / "README.md", "scale", table(rows))


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # a killed worker causes many warnings
    main()
