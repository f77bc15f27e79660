r"""The network's curves nearest to given ones, and the residual that the elements cannot reproduce.

For curves z' of recordings with noise sigma and their best elements,

.. math:: d = \left(z' - Z(\hat x)\right)/\sigma, \qquad \hat x = \arg\min_x \sum_f |d|^2,

the sum of the squares of d is the noncentrality of the best chi-square test there is when the elements x of each
recording are free and the shape of the effect is known; its root is the number of standard errors by which it stands
out. A projection on the tangent space (first order) overestimates it for a strong effect at the skin, which changes the
elements by half of their size.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from people import Change, impedance

Curve = Callable[[np.ndarray], np.ndarray]
"""Unknowns (N, J, Q) to curves (N, J, F)."""

_STEP = 1e-5
"""Of log unknowns: truncation and rounding of central differences are both below 1e-9 of a curve."""
_ROUNDS = 25
"""Most iterations of a search, which begins near the optimum."""


def white(values: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Real parts, then imaginary parts along the last axis, over the noise."""
    return np.concatenate([values.real / sd, values.imag / sd], axis=-1)


def tangent(curve: Curve, x: np.ndarray, sd: np.ndarray) -> np.ndarray:
    """Derivative of white curves by their unknowns (N, J, Q), by central differences: shape (N, J, 2 F, Q)."""
    steps = _STEP * np.eye(x.shape[-1])
    return np.stack([white((curve(x + step) - curve(x - step)) / (2 * _STEP), sd) for step in steps], axis=-1)


def tangent_basis(log_elements: np.ndarray, frequency_hz: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal basis of the changes of white curves by the elements, and the variance of each element.

    Returns
    -------
    basis : ndarray, shape (N, J, 2 F, P)
    variance : ndarray, shape (N, J, P)
        Of one estimate of each log element from one recording.
    """
    basis, r = np.linalg.qr(tangent(lambda x: impedance(x, frequency_hz), log_elements, sd))
    return basis, np.sum(np.linalg.inv(r) ** 2, axis=-1)


def outside(values: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Part of white curves (N, J, 2 F) orthogonal to the tangent space of the elements."""
    return np.asarray(values - np.einsum("ijfp,ijp->ijf", basis, np.einsum("ijfp,ijf->ijp", basis, values)))


def nearest(
    log_elements: np.ndarray,
    z: np.ndarray,
    frequency_hz: np.ndarray,
    sd: np.ndarray,
    changes: Mapping[str, Change] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """The network fitted to curves without noise, from the elements that are given.

    Parameters
    ----------
    log_elements : ndarray, shape (N, J, P)
    z : ndarray, complex, shape (N, J, F)
    frequency_hz : ndarray, shape (F,)
    sd : ndarray, shape (N, J, F)
        Noise of real and of imaginary part.
    changes : mapping of str to Change, optional
        Further changes at the network's places.

    Returns
    -------
    log_elements : ndarray, shape (N, J, P)
    rest : ndarray, shape (N, J, 2 F)
        Residual over the noise, real parts first.
    """
    return fitted(lambda x: impedance(x, frequency_hz, changes), log_elements, z, sd)


def fitted(curve: Curve, start: np.ndarray, z: np.ndarray, sd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (N, J, Q) of curves nearest to z (N, J, F), by Levenberg and Marquardt, and what is left (N, J, 2 F)."""
    x, damping = start, np.full(start.shape[:2], 1e-3)
    rest = white(z - curve(x), sd)
    for _ in range(_ROUNDS):
        a = tangent(curve, x, sd)
        normal, right = np.swapaxes(a, -1, -2) @ a, np.einsum("ijfp,ijf->ijp", a, rest)
        own = np.einsum("ijpp->ijp", normal)
        own = np.maximum(own, 1e-12 * own.max(axis=-1, keepdims=True))  # an unknown may have no effect here
        diagonal = own[..., None, :] * np.eye(x.shape[-1])
        step = np.linalg.solve(normal + damping[..., None, None] * diagonal, right[..., None])[..., 0]
        trial = x + np.clip(step, -1.0, 1.0)
        new = white(z - curve(trial), sd)
        better = np.sum(new**2, axis=-1) < np.sum(rest**2, axis=-1)
        gained = float(np.sum((rest**2 - new**2)[better]))
        x, rest = np.where(better[..., None], trial, x), np.where(better[..., None], new, rest)
        damping = np.where(better, damping / 10, damping * 10)
        if better.mean() > 0.5 and gained < 1e-4 * float(np.sum(rest**2)) + 1e-3:
            break
    return x, rest


def size(rest: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Rms over the recordings (N, J, 2 F) of the people who are members (N,), for each frequency (F,)."""
    n = rest.shape[-1] // 2
    return np.asarray(np.sqrt(np.mean((rest[..., :n] ** 2 + rest[..., n:] ** 2)[members], axis=(0, 1))))


def bands(frequency_hz: np.ndarray, strength: np.ndarray) -> list[list[float]]:
    """Intervals in which the strength (F,) exceeds half of its maximum; a point reaches halfway to its neighbours."""
    middle = np.sqrt(frequency_hz[1:] * frequency_hz[:-1])
    edges = np.concatenate([frequency_hz[:1], middle, frequency_hz[-1:]])
    inside = np.concatenate([[False], strength > 0.5 * strength.max(), [False]]).astype(int)
    starts, ends = np.flatnonzero(np.diff(inside) == 1), np.flatnonzero(np.diff(inside) == -1)
    return [[float(edges[a]), float(edges[b])] for a, b in zip(starts, ends, strict=True)]
