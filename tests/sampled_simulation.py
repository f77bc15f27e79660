"""A device in a user's hand, marched through time: forces between nodes, Newton's law, a buffer for the delay.

Nothing here is the package's own: nodes with displacements and velocities in place of energy coordinates, the network
of the paper written out by hand, and a force that is looked up in time in place of delayed states.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

FINE = 20
"""Steps per sampling period; delays are whole numbers of them."""


def mechanics(user: dict[str, float], device: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, R and K of the nodes: actuator, tip, tissue (m2), limb (m1).

    A device without a structure (no key ``n``) has its tip at the actuator; a user may lack r1 and n1 to ground.
    """
    rigid = "n" not in device
    nodes = (
        {"actuator": 0, "tip": 0, "tissue": 1, "limb": 2}
        if rigid
        else {"actuator": 0, "tip": 1, "tissue": 2, "limb": 3}
    )
    size = max(nodes.values()) + 1
    m, r, k = (np.zeros((size, size)) for _ in range(3))

    def link(matrix, value, one, other=None):
        a = nodes[one]
        matrix[a, a] += value
        if other is not None:
            b = nodes[other]
            matrix[b, b] += value
            matrix[a, b] -= value
            matrix[b, a] -= value

    link(m, device["m"], "actuator")
    link(r, device["r"], "actuator")
    if not rigid:
        link(k, 1 / device["n"], "actuator", "tip")
        link(r, device["rs"], "actuator", "tip")
    link(m, device["mt"], "tip")
    link(k, 1 / user["n3"], "tip", "tissue")
    link(r, user["r3"], "tip", "tissue")
    link(m, user["m2"], "tissue")
    if "n1" in user:
        link(k, 1 / user["n1"], "tissue")
        link(r, user["r1"], "tissue")
    link(k, 1 / user["n2"], "tissue", "limb")
    link(r, user["r2"], "tissue", "limb")
    link(m, user["m1"], "limb")
    return m, r, k


def first_order(m: np.ndarray, r: np.ndarray, k: np.ndarray) -> np.ndarray:
    """[displacements, velocities, force at the actuator] as one linear system."""
    n = len(m)
    a = np.zeros((2 * n + 1, 2 * n + 1))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, :n] = -np.linalg.solve(m, k)
    a[n : 2 * n, n : 2 * n] = -np.linalg.solve(m, r)
    a[n : 2 * n, 2 * n] = np.linalg.solve(m, np.eye(n)[:, 0])
    return a


def grows(
    systems: list[np.ndarray],
    period: np.ndarray,
    steps_of_delay: np.ndarray,
    stiffness: np.ndarray,
    damping: np.ndarray,
    periods: int,
) -> np.ndarray:
    """Whether the motion after a push grows, for N systems of one size; shapes (N,).

    Parameters
    ----------
    systems : list of ndarray, shape (q, q)
    period : ndarray
        Sampling period in s.
    steps_of_delay : ndarray of int
        Delay in parts of the period, see :data:`FINE`.
    stiffness, damping : ndarray
        Of the wall.
    periods : int
        How long.
    """
    step = np.array([expm(a * t / FINE) for a, t in zip(systems, period, strict=True)])
    number, size = len(systems), systems[0].shape[0]
    state = np.zeros((number, size))
    state[:, (size - 1) // 2 : size - 1] = 1.0  # everything moves
    known = int(steps_of_delay.max() // FINE) + 2
    forces = np.zeros((known, number))  # what the controller has asked for, the latest first
    previous = np.zeros(number)
    late = np.zeros((2, number))
    windows = (range(int(0.45 * periods), int(0.55 * periods)), range(int(0.9 * periods), periods))
    who = np.arange(number)
    for sample in range(periods):
        position = state[:, 0]
        forces = np.roll(forces, 1, axis=0)
        forces[0] = -stiffness * position - damping * (position - previous) / period
        previous = position.copy()
        for part in range(FINE):
            age = (steps_of_delay - part + FINE - 1) // FINE  # samples back, of the force that acts now
            state[:, -1] = forces[np.maximum(age, 0), who]
            state = np.einsum("nij,nj->ni", step, state)
        size_now = np.linalg.norm(state[:, :-1], axis=1)
        for w, window in enumerate(windows):
            if sample in window:
                late[w] = np.maximum(late[w], size_now)
        scale = np.where(size_now > 1e100, 1e-100, 1.0)  # linear: the same motion in smaller units
        state, forces, previous, late = state * scale[:, None], forces * scale, previous * scale, late * scale
    return late[1] > late[0]
