"""The commands as a user starts them, on the shipped population: wall time, processor time, peak memory, cold and warm.

*Cold* is without compiled functions on disk, as after an installation; *warm* is any later time.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DATASET = ROOT / "data" / "fingertip_71"


def measure(rounds: int) -> dict[str, Any]:
    """Each command once cold and `rounds` times warm."""
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        cache = Path(folder) / "cache"
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
        for command in ("run", "diagnose"):
            shutil.rmtree(cache, ignore_errors=True)
            out = Path(folder) / command
            times = [_one(command, out, environment) for _ in range(1 + rounds)]
            results[command] = {
                "cold": times[0],
                "warm": {key: sorted(t[key] for t in times[1:])[rounds // 2] for key in times[0]},
                "warm, each": [t["seconds"] for t in times[1:]],
            }
        summary = json.loads((Path(folder) / "run" / "summary.json").read_text(encoding="utf-8"))
        results["run"]["sampler"] = {k: v for k, v in summary["sampler"].items() if not isinstance(v, list | dict)}
    return results


def _one(command: str, out: Path, environment: dict[str, str]) -> dict[str, float]:
    """Seconds, processor seconds and peak memory of one command, by a parent that has no other children."""
    code = (
        "import resource, subprocess, sys, time, json\n"
        "t = time.perf_counter()\n"
        "done = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)\n"
        "s = time.perf_counter() - t\n"
        "u = resource.getrusage(resource.RUSAGE_CHILDREN)\n"
        "print(json.dumps([done.returncode, s, u.ru_utime + u.ru_stime, u.ru_maxrss, done.stderr[-500:]]))\n"
    )
    arguments = [sys.executable, "-m", "bayes_impedance", command, str(DATASET), "-o", str(out)]
    answer = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True, env=environment
    )
    status, seconds, processor, peak, said = json.loads(answer.stdout)
    if status != 0:
        raise RuntimeError(f"{command} ended with status {status}: {said}")
    return {"seconds": seconds, "processor seconds": processor, "peak MB": peak / 1024}
