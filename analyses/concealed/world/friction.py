r"""Stick-slip friction: a spring in series with a Coulomb slider (Jenkins element), which depends on amplitude.

While the deflection x of amplitude X stays below x_c = F_c/k it is a spring k; beyond, it slides in each half cycle
and the force follows a parallelogram. Its fundamental (describing function, harmonic balance) as a stiffness is, for X
> x_c,

.. math:: \Re = \frac k\pi\Bigl(\theta - \tfrac12\sin 2\theta\Bigr), \quad
          \Im = \frac{k}{\pi}\sin^2\theta, \qquad \cos\theta = 1 - 2 x_c/X ,

the loss being the area 4 F_c (X - x_c) over pi X^2. The deflection follows from the whole finger and the shaker, and
is found by iteration at every frequency of every recording. :func:`simulate` integrates the equations of motion in
time and demodulates with the lock-in; a test compares the two.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from world.rig import AVERAGED_PERIODS, SETTLING_PERIODS

_ITERATIONS = 60
"""Of the deflection's fixed point."""


def describing_function(
    amplitude_m: np.ndarray, stiffness: np.ndarray | float, breakaway_m: np.ndarray | float
) -> np.ndarray:
    """Complex stiffness in N/m at an amplitude of the deflection, in m."""
    cosine = 1 - 2 * np.minimum(breakaway_m / np.maximum(amplitude_m, 1e-300), 1.0)
    theta = np.arccos(np.clip(cosine, -1, 1))
    return np.asarray(stiffness / np.pi * (theta - 0.5 * np.sin(2 * theta) + 1j * np.sin(theta) ** 2))


def sliding(
    s: np.ndarray,
    part: np.ndarray,
    rest: Callable[[np.ndarray], np.ndarray],
    drive: Callable[[np.ndarray], np.ndarray],
    stiffness: np.ndarray | float,
    breakaway_m: np.ndarray | float,
) -> np.ndarray:
    """Impedance of the finger with a Jenkins element beside skin or tissue, by harmonic balance.

    Parameters
    ----------
    s : ndarray, complex, shape (F,)
    part : ndarray, shape (..., F)
        Of skin or tissue alone, N s/m.
    rest : callable
        Impedance of that part to that of the finger.
    drive : callable
        Impedance of the finger to the amplitude of the contactor's velocity, m/s.
    stiffness, breakaway_m : ndarray or float
    """
    friction = np.asarray(stiffness) / s + 0 * part
    for _ in range(_ITERATIONS):
        total = part + friction
        z = rest(total)
        deflection = np.abs(drive(z) * z / total) / s.imag  # skin and tissue carry the same force
        friction = 0.5 * (friction + describing_function(deflection, stiffness, breakaway_m) / s)
    return rest(part + friction)


def simulate(
    elements: Mapping[str, float],
    frequency_hz: np.ndarray,
    velocity: np.ndarray,
    stiffness: float,
    breakaway_m: float,
    place: str,
    steps: int = 2000,
) -> np.ndarray:
    """The same in the time domain: stepped sine, 5 periods to settle and 5 for the lock-in; frequencies in parallel.

    Parameters
    ----------
    elements : mapping
        n3, r3, m2, r1, n1, m1, n2, r2.
    frequency_hz, velocity : ndarray, shape (F,)
        Amplitude of the contactor's velocity v cos wt, in m/s.
    stiffness, breakaway_m : float
        Of the Jenkins element.
    place : str
        ``skin`` or ``tissue``: what it stands beside.
    steps : int
        Of each period (Runge-Kutta of second order, the slider exact in each step).

    Returns
    -------
    ndarray, complex, shape (F,)
        Fundamental of the force over that of the velocity.
    """
    e, omega = elements, 2 * np.pi * frequency_hz
    dt = 1 / (frequency_hz * steps)
    state = np.zeros((5, frequency_hz.size))  # deflections of skin and tissue, velocity of the tissue, x and v of m1
    slid = np.zeros(frequency_hz.size)
    force_sum = np.zeros(frequency_hz.size, dtype=complex)
    velocity_sum = np.zeros(frequency_hz.size, dtype=complex)
    of_skin, of_tissue = (stiffness, 0.0) if place == "skin" else (0.0, stiffness)
    slides = 0 if place == "skin" else 1

    def skin_force(y: np.ndarray, v: np.ndarray, slip: np.ndarray) -> np.ndarray:
        return np.asarray(y[0] / e["n3"] + e["r3"] * (v - y[2]) + of_skin * (y[0] - slip))

    def rate(y: np.ndarray, v: np.ndarray, slip: np.ndarray) -> np.ndarray:
        holder = (y[1] - y[3]) / e["n2"] + e["r2"] * (y[2] - y[4])
        inside = e["r1"] * y[2] + y[1] / e["n1"] + holder + of_tissue * (y[1] - slip)
        return np.array([v - y[2], y[2], (skin_force(y, v, slip) - inside) / e["m2"], y[4], holder / e["m1"]])

    for k in range((SETTLING_PERIODS + AVERAGED_PERIODS) * steps):
        v0, v1 = (velocity * np.cos(omega * dt * i) for i in (k, k + 0.5))
        if k >= SETTLING_PERIODS * steps:
            turn = np.exp(-1j * omega * dt * k)
            force_sum += skin_force(state, v0, slid) * turn
            velocity_sum += v0 * turn
        half = state + 0.5 * dt * rate(state, v0, slid)
        state = state + dt * rate(half, v1, slid)
        slid = np.clip(slid, state[slides] - breakaway_m, state[slides] + breakaway_m)
    return np.asarray(force_sum / velocity_sum)
