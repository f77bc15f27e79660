"""One likelihood (eight elements, 401 frequencies) and its gradient, against peers and the arithmetic floor."""

from __future__ import annotations

from typing import Any

import numpy as np
from floor import counted, floor_seconds
from peers import (
    ELEMENTS,
    NETWORK,
    impedance_py,
    jax_functions,
    numpy_chi_square,
    numpy_gradient,
)
from timing import ratio, seconds_of, shortest, spread
from vector_peak import per_second

from bayes_impedance.network.kernel import Kernel, compiled
from bayes_impedance.network.notation import parse
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, all_repetitions, log_likelihood
from bayes_impedance.population.fingertip import FINGERTIP

_POINTS, _SETS, _SMALL = 401, 256, 16
"""The paper's grid; sets per call, as a sampler with many walkers asks for; and a smaller call of numpy, with arrays of
16 x 401 complex numbers (100 kB) that fit the second-level cache."""


def measure() -> dict[str, Any]:
    """Seconds of one likelihood by each peer, ratios to ours, and the floor."""
    kernel = Kernel(parse(NETWORK))
    order = [ELEMENTS.index(name) for name in kernel.elements]
    frequency = np.geomspace(5, 5000, _POINTS)
    centre = np.log([FINGERTIP.central[name] for name in ELEMENTS])
    theta = centre + np.random.default_rng(1).normal(0, 0.2, (_SETS, len(ELEMENTS)))
    z = kernel.impedance(centre[order], frequency)
    sd = 0.01 * np.abs(z)
    likelihood = Likelihood.make(frequency, z[None], sd[None], np.zeros((1, len(ELEMENTS))))
    omega, weight = likelihood.omega, sd**-2.0
    own = np.ascontiguousarray(theta[:, order])
    _require_equal(kernel, own, theta, frequency, z, weight)

    work = {
        "ours": lambda: log_likelihood(kernel, likelihood, own),
        "numpy": lambda: [numpy_chi_square(theta[k : k + _SMALL], omega, z, weight) for k in range(0, _SETS, _SMALL)],
        "numpy at once": lambda: numpy_chi_square(theta, omega, z, weight),
        "impedance.py": impedance_py(theta[0], omega, z, weight),
        "ours, gradient": lambda: log_likelihood_gradient(kernel, likelihood, own),
        "numpy, gradient": lambda: [
            numpy_gradient(theta[k : k + _SMALL], omega, z, weight) for k in range(0, _SETS, _SMALL)
        ],
    }
    jax = jax_functions(omega, z, weight)
    if jax is not None:
        work["jax"] = lambda: jax[0](theta).block_until_ready()
        work["jax, gradient"] = lambda: jax[1](theta)[1].block_until_ready()
    seconds = seconds_of(work)
    per_set = {name: values / (1 if name == "impedance.py" else _SETS) for name, values in seconds.items()}
    peak = {operation: per_second(operation) for operation in ("multiply-add", "division")}
    floor = _POINTS * floor_seconds(parse(NETWORK), *peak.values())
    return {
        "seconds": {name: spread(values) for name, values in per_set.items()},
        "times ours": {
            name: ratio(values, per_set["ours, gradient" if name.endswith("gradient") else "ours"])
            for name, values in per_set.items()
            if not name.startswith("ours")
        },
        "floor": {
            "seconds": floor,
            "operations per frequency": list(counted(parse(NETWORK))),
            "peak per second": peak,
            "ours, shortest": (least := shortest(work["ours"]) / _SETS),
            "ours over floor": least / floor,
        },
        "points": _POINTS,
        "sets per call": _SETS,
    }


def log_likelihood_gradient(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log likelihood of log elements (S, P), (S,), and its gradient, (S, P), as the search for a mode computes them."""
    d = likelihood
    return _gradients(kernel.program, np.ascontiguousarray(theta), d.deviations, d.omega, d.z, d.weight, d.count)


@compiled
def _gradients(
    program: Program,
    theta: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    count: float,
) -> tuple[np.ndarray, np.ndarray]:
    values, gradients = np.empty(theta.shape[0]), np.empty(theta.shape)
    for i in range(theta.shape[0]):
        chi, gradient, _ = all_repetitions(program, theta[i], deviations, omega, z, weight)
        values[i] = -(SCALE_SHAPE + count) * np.log(SCALE_SHAPE + 0.5 * chi)
        gradients[i] = -(SCALE_SHAPE + count) / (SCALE_SHAPE + 0.5 * chi) * gradient
    return values, gradients


def _require_equal(
    kernel: Kernel, own: np.ndarray, theta: np.ndarray, frequency: np.ndarray, z: np.ndarray, weight: np.ndarray
) -> None:
    """Check that all peers compute the same numbers, without which times are not comparable."""
    omega = 2 * np.pi * frequency
    rest = kernel.impedance(own, frequency) - z
    expected = np.sum(weight * np.abs(rest) ** 2, axis=1)
    np.testing.assert_allclose(numpy_chi_square(theta, omega, z, weight), expected, rtol=1e-9)
    np.testing.assert_allclose(impedance_py(theta[3], omega, z, weight)(), expected[3], rtol=1e-9)
