"""The machine's peak: multiply-adds and divisions of full vectors that stay in registers, on one core.

Written as LLVM code, because a compiler decides for itself whether a loop becomes vectors and stays out of memory. A
number of independent vectors are carried through a loop, so that the latency of one instruction is hidden behind the
others, and nothing is loaded or stored until the end. Widths of two, four and eight numbers are tried; the widest
registers of the machine win, and what it has not got is split by the compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic
from timing import shortest

_WIDTHS = (2, 4, 8)
_VECTORS = {"multiply-add": (6, 8, 10, 12), "division": (4, 8)}
"""Numbers of independent vectors that are tried. A multiply-add has a latency of four cycles and two of them start in a
cycle, so that eight vectors are needed; sixteen registers of the older instruction sets hold twelve and the constants.
A division takes four to sixteen cycles before the next may start."""
_SECONDS = 0.0005
"""Length of one timing: long against the clock's resolution, and short against the time for which a system lets one
process run (milliseconds)."""
_TRIAL = 10_000
"""Repetitions by which the length of a timing is found."""


def _loop(operation: str, width: int, n_vectors: int) -> Callable[[int], float]:
    """A compiled function that applies an operation a number of times to each of some vectors, and returns a sum."""

    @intrinsic
    def repeated(_typing: Any, times: Any) -> Any:
        def code(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            double, vector = ir.DoubleType(), ir.VectorType(ir.DoubleType(), width)
            factor = ir.Constant(vector, [1.0 - 1e-9] * width)
            term = ir.Constant(vector, [1e-9] * width)
            start = [ir.Constant(vector, [1.0 + 0.1 * k + 0.01 * i for i in range(width)]) for k in range(n_vectors)]
            kept = [cgutils.alloca_once_value(builder, value) for value in start]
            multiply_add = cgutils.get_or_insert_function(
                builder.module, ir.FunctionType(vector, [vector] * 3), f"llvm.fma.v{width}f64"
            )
            with cgutils.for_range(builder, arguments[0]):
                for own in kept:  # the compiler keeps them in registers over the loop
                    value = builder.load(own)
                    if operation == "multiply-add":
                        value = builder.call(multiply_add, [value, factor, term])
                    else:
                        value = builder.fdiv(factor, value)
                    builder.store(value, own)
            total = ir.Constant(double, 0.0)
            for own in kept:
                for i in range(width):
                    element = builder.extract_element(builder.load(own), ir.Constant(ir.IntType(32), i))
                    total = builder.fadd(total, element)
            return total

        return types.float64(times), code

    @njit
    def run(times: int) -> float:
        return repeated(times)

    return run


def per_second(operation: str) -> float:
    """Most operations per second on single numbers: multiply-adds (each counts once), or divisions."""
    best = 0.0
    for width in _WIDTHS:
        for n_vectors in _VECTORS[operation]:
            run = _loop(operation, width, n_vectors)
            if not np.isfinite(run(_TRIAL)):
                raise RuntimeError("the operations have left the range of numbers, where they may take another time")
            times = max(1, int(_TRIAL * _SECONDS / shortest(lambda run=run: run(_TRIAL), 3)))
            best = max(best, width * n_vectors * times / shortest(lambda run=run, times=times: run(times)))
    return best
