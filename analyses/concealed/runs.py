"""Many diagnoses in separate processes, each appended as one JSON line when it ends; cases on file are skipped."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from bayes_impedance.recordings.dataset import Recordings

Record = dict[str, Any]
Work = Callable[[Mapping[str, Any]], Record]


def diagnose(recordings: Recordings, seed: int, through_command: bool = False) -> Record:
    """Verdict on some recordings, by the package's function or by its command (`--quick`) on files."""
    if not through_command:
        from bayes_impedance.diagnosis.diagnose import diagnose as run_diagnosis
        from bayes_impedance.diagnosis.verdict_file import to_json

        return to_json(run_diagnosis(recordings, quick=True, seed=seed).verdict)
    from bayes_impedance.recordings.files import write_recordings

    with tempfile.TemporaryDirectory() as folder:
        dataset, out = Path(folder) / "dataset", Path(folder) / "out"
        write_recordings(recordings, dataset, significant_digits=8)
        command = [sys.executable, "-m", "bayes_impedance", "diagnose", str(dataset), "-o", str(out), "--quick"]
        done = subprocess.run([*command, "--seed", str(seed)], capture_output=True, text=True, check=False)
        verdict = out / "verdict.json"
        if not verdict.is_file():  # with a verdict, an exit status of 1 says "not reliable": that is a result
            raise RuntimeError(f"exit status {done.returncode}, no verdict: {done.stderr.strip()[-2000:]}")
        return dict(json.loads(verdict.read_text(encoding="utf-8")))


def read_lines(path: Path) -> list[Record]:
    """Records of a file, the last one of each case; a line that was cut off by a kill is skipped."""
    if not path.is_file():
        return []
    latest: dict[str, Record] = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            continue
        latest[_key(record["case"])] = record
    return list(latest.values())


def run_cases(
    cases: Iterable[Mapping[str, Any]], work: Work, path: Path, jobs: int, say: Callable[[str], None] = print
) -> None:
    """Work on the cases that have no record without an error, and append a record for each.

    Parameters
    ----------
    cases : iterable of mapping
        Serialisable as JSON; equal cases count as one.
    work : callable
        Case to record, which gets ``case`` and ``seconds`` added, or ``error`` if it raises. A function of a module.
    path : Path
        File of JSON lines, made if it is not there.
    jobs : int
        Processes; 0 works in this one.
    say : callable
        Called with a line of text for each case that ends.
    """
    done = {_key(record["case"]) for record in read_lines(path) if "error" not in record}
    waiting = {_key(case): dict(case) for case in cases}
    waiting = {key: case for key, case in waiting.items() if key not in done}
    say(f"{len(waiting)} to do, {len(done)} on file")
    path.parent.mkdir(parents=True, exist_ok=True)
    torn = path.is_file() and path.read_bytes()[-1:] not in (b"", b"\n")
    with path.open("a", encoding="utf-8") as file:
        if torn:
            file.write("\n")
        for i, record in enumerate(_records(list(waiting.values()), work, jobs)):
            file.write(json.dumps(record, default=lambda value: value.tolist()) + "\n")  # numpy's numbers
            file.flush()
            end = record["error"].strip().splitlines()[-1] if "error" in record else f"{record['seconds']:.0f} s"
            say(f"{i + 1}/{len(waiting)} {' '.join(str(v) for v in record['case'].values())}: {end}")


def replace_between(path: Path, name: str, content: str) -> None:
    """Put content between the lines ``<!-- name:start -->`` and ``<!-- name:end -->`` of a file."""
    start, end = f"<!-- {name}:start -->", f"<!-- {name}:end -->"
    text = path.read_text(encoding="utf-8")
    if text.count(start) != 1 or text.count(end) != 1:
        raise ValueError(f"{path} needs exactly one line {start} and one {end}")
    head, rest = text.split(start)
    path.write_text(f"{head}{start}\n{content.strip()}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def _records(cases: Sequence[Record], work: Work, jobs: int) -> Iterable[Record]:
    if jobs == 0:
        yield from (_one(work, case) for case in cases)
        return
    # Child processes read these variables before they import numpy or numba.
    os.environ.update({"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"})
    with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(_one, work, case) for case in cases]
        for future in as_completed(waiting):
            yield future.result()


def _one(work: Work, case: Record) -> Record:
    started = time.perf_counter()
    try:
        record = work(case)
    except Exception:  # one failure must not end a long run: it is recorded, and the next run tries again
        record = {"error": traceback.format_exc(limit=-3)}
    return {"case": case, **record, "seconds": time.perf_counter() - started}


def _key(case: Mapping[str, Any]) -> str:
    return json.dumps(case, sort_keys=True)
