"""One person's curve fitted by three programs: how often the global optimum is found, and how long it takes.

Each program gets the mean curve of each person of `data/fingertip_71`, the same weights (1 % of the magnitude) and the
same start: each element's impedance equals the data's magnitude in mid-band. lmfit (Levenberg-Marquardt on log
elements) and ours may also begin at random starts around it; impedance.py is used as in its documentation, with one
start and not in logarithms. The optimum counts as found if chi-square is within 1 % + 1 of the lowest of all programs.
A search that has not ended after twenty seconds is stopped; it counts with these seconds and as not found (one of
impedance.py's had not ended after forty minutes).
"""

from __future__ import annotations

import signal
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from peers import CIRCUIT, CIRCUIT_ORDER, ELEMENTS, NETWORK, numpy_parts
from timing import spread

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import find_mode
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.starting_fits import search_modes, thinned_points
from bayes_impedance.recordings.files import read_recordings

DATASET = Path(__file__).resolve().parents[1] / "data" / "fingertip_71"
_STARTS, _SPREAD, _NOISE = 769, 2.5, 0.01
_LMFIT_STARTS = 20
_LONGEST_S = 20.0
_SLOW = (f"lmfit, {_LMFIT_STARTS} starts", "impedance.py")

Fit = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Frequency (F,), mean curve (F,) and starts (S, 8) in the order of :data:`ELEMENTS` to the log elements found."""


def measure(people_of_slow: int) -> dict[str, Any]:
    """Success and seconds of each program; programs that take seconds per curve are run on `slow_people` only."""
    recordings = read_recordings(DATASET)
    kernel = Kernel(parse(NETWORK))
    order = [kernel.elements.index(name) for name in ELEMENTS]
    prior = default_prior(kernel, recordings)
    draws = np.random.default_rng(1).normal(0, _SPREAD, (_STARTS - 1, len(ELEMENTS)))
    starts = np.vstack([prior.centre, prior.centre + draws])[:, order]
    programs: dict[str, Fit] = {
        "ours": lambda f, z, s: _ours(kernel, prior, order, f, z, s),
        "lmfit, one start": lambda f, z, s: _lmfit(f, z, s[:1]),
        f"lmfit, {_LMFIT_STARTS} starts": lambda f, z, s: _lmfit(f, z, s[:_LMFIT_STARTS]),
        "impedance.py": _impedance_py,
    }
    people = recordings.subjects
    some = set(np.linspace(0, len(people) - 1, people_of_slow).round().astype(int).tolist())
    chi = {name: np.full(len(people), np.inf) for name in programs}
    seconds: dict[str, list[float]] = {name: [] for name in programs}
    stopped = dict.fromkeys(programs, 0)
    _ours(kernel, prior, order, people[0].frequency_hz, people[0].mean, starts)  # compiling does not count
    for i, person in enumerate(people):
        for name, fit in programs.items():
            if name in _SLOW and i not in some:
                continue
            started = time.perf_counter()
            try:
                with warnings.catch_warnings(), np.errstate(all="ignore"), _at_most(_LONGEST_S):
                    warnings.simplefilter("ignore")
                    found = fit(person.frequency_hz, person.mean, starts)
                chi[name][i] = _chi_square(found, person.frequency_hz, person.mean)
            except TimeoutError:
                stopped[name] += 1
            seconds[name].append(time.perf_counter() - started)
    lowest = np.min(list(chi.values()), axis=0)
    return {
        name: {
            "found": int(np.sum(chi[name] <= 1.01 * lowest + 1)),
            "people": len(seconds[name]),
            "stopped": stopped[name],
            "seconds allowed": _LONGEST_S,
            "seconds": spread(np.array(seconds[name])),
            "times ours": float(np.median(seconds[name]) / np.median(seconds["ours"])),
        }
        for name in programs
    }


@contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """Raise TimeoutError inside if it takes longer."""

    def stop(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def _chi_square(theta: np.ndarray, frequency: np.ndarray, z: np.ndarray) -> float:
    if not np.all(np.isfinite(theta)):
        return np.inf
    rest = (numpy_parts(theta[None], 2 * np.pi * frequency)[-1][0] - z) / (_NOISE * np.abs(z))
    return float(np.sum(np.abs(rest) ** 2))


def _ours(
    kernel: Kernel, prior: Prior, order: list[int], frequency: np.ndarray, z: np.ndarray, starts: np.ndarray
) -> np.ndarray:
    own = np.empty_like(starts)
    own[:, order] = starts

    def data(points: np.ndarray | slice) -> Likelihood:
        curve = z[None, points]
        return Likelihood.make(frequency[points], curve, _NOISE * np.abs(curve), np.zeros((1, len(order))))

    best = search_modes(kernel, data(thinned_points(frequency.size)), own, prior, 4)
    precision = np.eye(len(order)) / prior.centre_sd**2
    return find_mode(kernel, data(slice(None)), best, prior.centre, precision).theta[order]


def _lmfit(frequency: np.ndarray, z: np.ndarray, starts: np.ndarray) -> np.ndarray:
    from lmfit import Parameters, minimize

    omega, sd = 2 * np.pi * frequency, _NOISE * np.abs(z)

    def residual(parameters: Any) -> np.ndarray:
        theta = np.array([parameters[name].value for name in ELEMENTS])
        rest = (numpy_parts(theta[None], omega)[-1][0] - z) / sd
        return np.nan_to_num(np.concatenate([rest.real, rest.imag]), nan=1e6, posinf=1e6, neginf=-1e6)

    best = None
    for start in starts:
        parameters = Parameters()
        for name, value in zip(ELEMENTS, start, strict=True):
            parameters.add(name, value=value, min=-40.0, max=20.0)
        result = minimize(residual, parameters, method="leastsq")
        if best is None or result.chisqr < best.chisqr:
            best = result
    assert best is not None  # there is a start
    return np.array([best.params[name].value for name in ELEMENTS])


def _impedance_py(frequency: np.ndarray, z: np.ndarray, starts: np.ndarray) -> np.ndarray:
    from impedance.models.circuits import CustomCircuit

    values = dict(zip(ELEMENTS, np.exp(starts[0]), strict=True))
    circuit = CustomCircuit(CIRCUIT, initial_guess=[values[name] for name in CIRCUIT_ORDER])
    try:
        circuit.fit(frequency, z, weight_by_modulus=True)
    except (RuntimeError, ValueError):  # no convergence
        return np.full(len(ELEMENTS), np.nan)
    found = dict(zip(CIRCUIT_ORDER, np.abs(circuit.parameters_), strict=True))
    return np.log([found[name] for name in ELEMENTS])
