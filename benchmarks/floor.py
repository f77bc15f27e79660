"""The arithmetic floor: a lower bound of the time for a network's arithmetic on this machine.

Multiplications, additions and divisions of the tree are counted, without those that do not depend on the frequency, and
divided by the throughput of compiled loops over arrays in the first-level cache.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numba import njit

from bayes_impedance.network.notation import Network
from bayes_impedance.network.program import compile_network

_INVERSE = 5
"""1/z = conj(z)/|z|^2: three for the square, two for the product, and one division."""

_CHI_SQUARE = 7
"""Two differences, their squares, their sum, the weight, the total."""


def counted(network: Network) -> tuple[int, int]:
    """Multiplications and additions, and divisions, of one frequency of one chi-square."""
    program = compile_network(network)
    plain = divisions = 0
    for node in range(program.node_parent.size):
        powers = program.term_power[program.term_node == node]
        imaginary = len(set(powers[powers != 0].tolist()))
        plain += imaginary + max(imaginary - 1, 0)  # times omega, times 1/omega, and the difference
        children = int(np.sum(program.node_parent == node))
        plain += 2 * children
        if program.node_invert[node]:
            plain += _INVERSE
            divisions += 1
    return plain + _CHI_SQUARE, divisions


@njit(cache=True)
def _multiply_add(a: np.ndarray, b: np.ndarray, c: np.ndarray, times: int) -> None:
    for _ in range(times):
        for i in range(a.size):
            c[i] = a[i] * b[i] + c[i]


@njit(cache=True, error_model="numpy")
def _divide(a: np.ndarray, b: np.ndarray, c: np.ndarray, times: int) -> None:
    for k in range(times):
        for i in range(a.size):
            c[i] = a[i] / (b[i] + k)


def throughput(n: int = 401, times: int = 20000, rounds: int = 7) -> tuple[float, float]:
    """Multiplications and additions, and divisions, per second on one core: the best of some rounds."""
    rng = np.random.default_rng(1)
    a, b, c = rng.uniform(0.5, 1.0, n), rng.uniform(0.5, 1.0, n), np.zeros(n)

    def best(function: Any, operations: int) -> float:
        function(a, b, c, 1)
        seconds = []
        for _ in range(rounds):
            started = time.perf_counter()
            function(a, b, c, times)
            seconds.append(time.perf_counter() - started)
        return operations * n * times / min(seconds)

    return best(_multiply_add, 2), best(_divide, 1)
