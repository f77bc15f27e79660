"""From the raw signals of a motor bench to datasets, and what a diagnosis finds in them.

Run from the repository's root::

    python analyses/motor_bench/run.py [-o out/motor_bench] [--diagnose] [--average]

Writes one dataset for each type of excitation (A, B) and each source of the velocity (velocity, encoder). With
``--diagnose`` each is diagnosed alone, and the velocity channel also with the encoder's recordings as the simulation;
the results are printed and written to ``results/verdicts.json`` beside this file. The signals are found through the
environment variable BAYES_IMPEDANCE_REAL_DATA.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_signals import CHANNELS, averaged, recordings_of

from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.files import read_recordings, write_recordings

HERE = Path(__file__).resolve().parent


def said(recordings: Recordings, simulation: Recordings | None = None) -> dict[str, Any]:
    """What is found, with 90 % intervals, and the relative error of z before and after (root mean square)."""
    start = time.perf_counter()
    diagnosis = diagnose(recordings, simulation=simulation)
    errors = [float(np.median(s.subject_rms_relative)) for s in (diagnosis.before, diagnosis.after) if s is not None]
    magnitude = diagnosis.verdict.improvement
    typical = float(np.mean(np.abs(recordings.subjects[0].z)))
    return {
        "found": {
            f"{entry.id} at {entry.place}": {n: [p.q05, p.median, p.q95, p.unit] for n, p in entry.parameters.items()}
            for entry in diagnosis.verdict.physics
        },
        "relative error of z, before and after": errors,
        "error of |z| over the mean of |z|, before and after": None
        if magnitude is None
        else [value / typical for value in magnitude.delta_magnitude],
        "remarks": diagnosis.verdict.remarks,
        "seconds": round(time.perf_counter() - start, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, default=Path("out/motor_bench"))
    parser.add_argument("--diagnose", action="store_true", help="diagnose the datasets")
    parser.add_argument("--average", action="store_true", help="one repetition: the mean over the periods")
    options = parser.parse_args()
    folder = os.environ.get("BAYES_IMPEDANCE_REAL_DATA")
    if not folder:
        parser.error("BAYES_IMPEDANCE_REAL_DATA is not set: the signals are not part of the repository")
    report = {}
    for kind in "AB":
        data = {}
        for channel in CHANNELS:
            made = recordings_of(Path(folder) / "motor_bench" / f"MultisineType{kind}.mat", channel)
            target = options.out / f"{kind}_{channel}"
            write_recordings(averaged(made) if options.average else made, target)
            data[channel] = read_recordings(target)
            print(f"{target}: {data[channel].subjects[0].z.shape[0]} repetitions")
        if options.diagnose:
            report[f"{kind}, velocity channel"] = said(data["velocity"])
            report[f"{kind}, encoder"] = said(data["encoder"])
            report[f"{kind}, velocity channel against encoder"] = said(data["velocity"], data["encoder"])
    if report:
        file = HERE / "results" / ("verdicts_average.json" if options.average else "verdicts.json")
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        print(json.dumps(report, indent=2))


if __name__ == "__main__":
    main()
