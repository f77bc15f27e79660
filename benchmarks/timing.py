"""Times of peers in one run: measured in turns, so that disturbances of the machine affect all of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

_LEAST_SECONDS = 0.05
"""Shortest timing: long against the resolution of the clock and the switch to another process (milliseconds)."""


def seconds_of(work: Mapping[str, Callable[[], Any]], rounds: int = 15) -> dict[str, np.ndarray]:
    """Seconds of one call of each, shape (rounds,).

    Parameters
    ----------
    work : mapping of str to callable
        Each is called once before the clock starts, so that compiling does not count.
    rounds : int
        In every round each is called in turn, as often in a row as fills a twentieth of a second.
    """
    calls = {}
    for name, function in work.items():
        function()
        started = time.perf_counter()
        function()
        calls[name] = max(1, int(_LEAST_SECONDS / max(time.perf_counter() - started, 1e-7)))
    found: dict[str, list[float]] = {name: [] for name in work}
    for _ in range(rounds):
        for name, function in work.items():
            started = time.perf_counter()
            for _ in range(calls[name]):
                function()
            found[name].append((time.perf_counter() - started) / calls[name])
    return {name: np.array(values) for name, values in found.items()}


def shortest(function: Callable[[], Any], rounds: int = 300) -> float:
    """Seconds of the shortest of many calls: others on the machine make a call longer, never shorter.

    For comparisons with what the machine can do at most; the call should take less than some milliseconds, for which a
    system lets one process run.
    """
    function()
    found = []
    for _ in range(rounds):
        started = time.perf_counter()
        function()
        found.append(time.perf_counter() - started)
    return min(found)


def spread(values: np.ndarray) -> list[float]:
    """Median, and the tenth and ninetieth percentile."""
    return [float(v) for v in np.percentile(values, [50, 10, 90])]


def ratio(theirs: np.ndarray, ours: np.ndarray) -> list[float]:
    """How many times as long: median over the rounds, tenth and ninetieth percentile."""
    return spread(theirs / ours)
