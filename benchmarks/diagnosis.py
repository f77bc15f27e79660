"""The diagnosis: seconds of the screening of all candidates at all places, and how they grow with what is screened.

Growth is an exponent: the slope of log seconds against log size, fitted to the sizes measured.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from bayes_impedance.diagnosis import diagnose, registered
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings

_PEOPLE, _POINTS, _REPETITIONS = (20, 40, 80), (101, 201, 401), 3
_ROUNDS = 3
"""Repeated timings, of which the median counts: one disturbance of the machine does not change it."""


def measure() -> dict[str, Any]:
    """Screening and whole diagnosis of populations of several sizes."""
    simulated = {(n, f): _people(n, f) for n, f in {(n, 201) for n in _PEOPLE} | {(40, f) for f in _POINTS}}
    _screening(simulated[_PEOPLE[0], 201], 1.0)  # compiling does not count
    by_people = {n: _screening(simulated[n, 201], 1.0) for n in _PEOPLE}
    by_points = {f: _screening(simulated[40, f], 1.0) for f in _POINTS}
    by_share = {share: _screening(simulated[40, 201], share) for share in (0.25, 0.5, 1.0)}
    started = time.perf_counter()
    diagnose(simulated[40, 201], seed=1, quick=True)
    whole = time.perf_counter() - started
    candidates = by_share[1.0][1]
    return {
        "screening, 40 people, 201 frequencies": {
            "seconds": by_people[40][0],
            "candidates": candidates,
            "microseconds per candidate and person": 1e6 * by_people[40][0] / candidates / 40,
        },
        "growth": {
            "people": _slope({k: v[0] for k, v in by_people.items()}),
            "frequencies": _slope({k: v[0] for k, v in by_points.items()}),
            "candidates": _slope({v[1]: v[0] for v in by_share.values()}),
        },
        "seconds": {
            "people": {str(k): v[0] for k, v in by_people.items()},
            "frequencies": {str(k): v[0] for k, v in by_points.items()},
            "candidates": {str(v[1]): v[0] for v in by_share.values()},
        },
        "whole diagnosis of 40 people without anything missing, seconds": whole,
    }


def _people(n: int, points: int) -> Recordings:
    return simulate_recordings(FINGERTIP, n, _REPETITIONS, np.geomspace(5, 5000, points), 1).recordings


def _screening(recordings: Recordings, share: float) -> tuple[float, int]:
    """Median seconds of one screening, and how many candidates (entry, place and shape) it had."""
    effects = registered()[: max(1, round(share * len(registered())))]
    with ThreadPoolExecutor(2) as executor:
        fitted = fit_network(recordings, None, 1, executor, lambda *_: None)
        residuals = tuple(person_residuals(fitted.fit, recordings.names))
        seconds = []
        for _ in range(_ROUNDS):
            started = time.perf_counter()
            found = screen(fitted.fit, residuals, effects, 1, executor)
            seconds.append(time.perf_counter() - started)
    return float(np.median(seconds)), len(found.candidates)


def _slope(seconds: dict[int, float]) -> float:
    return float(np.polyfit(np.log(list(seconds)), np.log(list(seconds.values())), 1)[0])
