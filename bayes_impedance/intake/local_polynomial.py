"""Frequency response of one record of random excitation, with leakage modelled: the local polynomial method.

Response and transient of a linear system are smooth over frequency, the spectrum U of a random excitation is not.
Within 2 n + 1 neighbouring lines, with r from -n to n::

    Y(k + r) = (G + g1 r + g2 r^2) U(k + r) + (t0 + t1 r + t2 r^2) + noise

is linear in six complex unknowns; G is the response at line k without the leakage error of a window, and the residual's
variance, with 2 n + 1 - 6 complex degrees of freedom, gives its uncertainty (Pintelon & Schoukens, System
Identification, 2nd edition 2012, chapter 7).
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.intake.ratio import FloatArray, Ratio

NEIGHBOURS = 6
"""n: 13 lines, 7 complex degrees of freedom. By choice: the smallest windows with six or more, as in the literature."""
_UNKNOWNS = 6
"""Complex unknowns of a window: constant, slope and bend, of the response and of the transient."""


def local_polynomial(force: FloatArray, motion: FloatArray, rate_hz: float) -> Ratio:
    """Motion over force at every line, of a record of shape (N,); the first and last `NEIGHBOURS` are left out."""
    u, y = np.fft.rfft(force), np.fft.rfft(motion)
    frequency: FloatArray = np.arange(float(u.size)) * (rate_hz / force.size)
    r = np.arange(-NEIGHBOURS, NEIGHBOURS + 1) / NEIGHBOURS
    powers = np.array([r**0, r, r**2])
    lines = np.arange(NEIGHBOURS + 1, u.size - NEIGHBOURS - 1)
    window = lines[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    local = u[window]
    scale = np.sqrt(np.mean(np.abs(local) ** 2, axis=1))
    columns = np.concatenate(
        [(local / scale[:, None])[:, :, None] * powers.T, np.broadcast_to(powers.T, (*local.shape, 3))], axis=2
    )
    q, triangle = np.linalg.qr(columns)
    observed = y[window]
    projected = np.einsum("kij,ki->kj", q.conj(), observed)
    solution = np.linalg.solve(triangle, projected[:, :, None])[:, :, 0]
    residual = observed - np.einsum("kij,kj->ki", q, projected)
    freedom = window.shape[1] - _UNKNOWNS
    variance = np.sum(np.abs(residual) ** 2, axis=1) / freedom
    first_row = np.linalg.inv(triangle)[:, 0]
    sd = np.sqrt(variance * np.sum(np.abs(first_row) ** 2, axis=1) / 2) / scale
    return Ratio(
        frequency_hz=frequency[lines],
        value=solution[:, 0] / scale,
        inverse=True,
        noise_sd=sd,
        degrees_of_freedom=2.0 * freedom,
        notes=("estimated with the local polynomial method; noise of neighbouring lines is alike",),
    )
