"""One diagnosis through the command line, in a process of its own, from a folder alone."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from sealed_cases import ROOT, VERDICTS, digest_of, slim, sources

LONGEST = 1200.0
"""Seconds after which a diagnosis is given up: more than ten times what any may take."""


def diagnosed(folder: Path, seed: int = 1, quick: bool = True) -> dict[str, Any]:
    """Verdict, exit status and seconds of a dataset.

    Returns
    -------
    dict
        ``case``, ``data_sha256``, ``seconds``, ``processor_seconds``, ``exit`` (None if given up), ``verdict`` (None if
        there is none), ``crash`` (end of what was printed, if there is no verdict or a traceback), ``sources``.
    """
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"} | threads
    with tempfile.TemporaryDirectory() as room:
        out = Path(room) / "out"
        command = [sys.executable, "-m", "bayes_impedance", "diagnose", str(folder), "-o", str(out), f"--seed={seed}"]
        started = time.perf_counter()
        with (Path(room) / "printed").open("w+", encoding="utf-8") as printed_to:
            child = subprocess.Popen(
                [*command, *(["--quick"] if quick else [])], stdout=subprocess.DEVNULL, stderr=printed_to, cwd=room,
                env=environment,
            )  # fmt: skip
            status, processor = _ended(child, started + LONGEST)
            printed_to.seek(0)
            printed = printed_to.read() if status is not None else f"given up after {LONGEST:.0f} s"
        seconds = time.perf_counter() - started
        file = out / "verdict.json"
        verdict = slim(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else None
    crashed = verdict is None or "Traceback" in printed
    return {
        "case": folder.name,
        "data_sha256": digest_of(folder),
        "seconds": round(seconds, 2),
        "processor_seconds": round(processor, 2),
        "exit": status,
        "verdict": verdict,
        "crash": _without_machine(printed)[-1500:] if crashed else None,
        "sources": sources(),
    }


def _without_machine(printed: str) -> str:
    """What was printed, without where this machine keeps the package and Python."""
    for folder in (ROOT, Path(sys.prefix), Path(sys.base_prefix)):
        printed = printed.replace(f"{folder}{os.sep}", "")
    return printed.strip()


def _ended(child: subprocess.Popen, latest: float) -> tuple[int | None, float]:
    """Exit status, or None if given up; and the processor's seconds, which other work on the machine leaves alone."""
    while True:
        pid, status, used = os.wait4(child.pid, os.WNOHANG)
        if pid:
            child.returncode = os.waitstatus_to_exitcode(status)
            return child.returncode, used.ru_utime + used.ru_stime
        if time.perf_counter() > latest:
            child.kill()
            _, _, used = os.wait4(child.pid, 0)
            child.returncode = -9
            return None, used.ru_utime + used.ru_stime
        time.sleep(0.1)


def run(folders: Iterable[Path], out: Path, jobs: int) -> None:
    """Diagnose datasets and append each record when it is there."""
    path = out / VERDICTS
    torn = path.is_file() and path.read_bytes()[-1:] not in (b"", b"\n")
    with path.open("a", encoding="utf-8") as file:
        file.write("\n" if torn else "")
        for record in _records(list(folders), jobs):
            file.write(json.dumps(record) + "\n")
            file.flush()
            said = "no verdict" if record["verdict"] is None else _said(record["verdict"])
            print(f"{record['case']}: {said} ({record['seconds']:.0f} s, exit {record['exit']})", flush=True)


def _records(folders: list[Path], jobs: int) -> Iterator[dict[str, Any]]:
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        for future in as_completed([pool.submit(diagnosed, folder) for folder in folders]):
            yield future.result()


def _said(verdict: dict[str, Any]) -> str:
    return ", ".join(f"{p['id']} at {p.get('place')}" for p in verdict["physics"]) or "nothing"
