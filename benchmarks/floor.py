"""The arithmetic floor: a lower bound of the time for a network's arithmetic on one core of this machine.

Multiplications, additions and divisions of the tree are counted, without those that do not depend on the frequency. No
program can do them faster than the machine's peak (:mod:`vector_peak`): all multiplications and additions paired into
multiply-adds of full vectors that never leave the registers, and the divisions meanwhile in a unit of their own.
"""

from __future__ import annotations

import numpy as np

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


def floor_seconds(network: Network, multiply_adds_per_second: float, divisions_per_second: float) -> float:
    """Seconds for one frequency of one chi-square: the longer of its multiply-adds and its divisions."""
    plain, divisions = counted(network)
    return max(0.5 * plain / multiply_adds_per_second, divisions / divisions_per_second)
