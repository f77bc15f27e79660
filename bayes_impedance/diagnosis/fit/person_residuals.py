r"""Whitened residuals of all recordings, outside of the tangent space of the elements.

With noise sd sigma (the person's own scale included) and z - Z stacked as real parts, then imaginary parts,

.. math:: r_{ij} = \begin{pmatrix}\operatorname{Re}(z_{ij} - Z(\hat\theta_{ij}))/\sigma_{ij}\\
          \operatorname{Im}(z_{ij} - Z(\hat\theta_{ij}))/\sigma_{ij}\end{pmatrix} \in \mathbb R^{2F}

is standard normal noise, less what the elements have absorbed. Residuals are compared only **outside of the tangent
space** :math:`\partial Z/\partial\theta` of each single recording: with Q an orthonormal basis of it,
:math:`(1 - QQ^T)\,r \sim N(0, 1 - QQ^T)` when nothing is missing, whatever the elements of that recording are and
however they are distributed between people.

Leaving the elements this free costs little power. Holding them to the population's distribution instead makes the
*shape* of that distribution part of the evidence: simulated populations with nothing missing then "show" a constant
stiffness at the port with z = -9.5.

But an element that the fit has driven to nothing can absorb nothing more: it is positive, so that its part could only
grow, and the residual asks for less. What it does is nearly zero then, but has a direction, and in this very direction
the misfit lies: of 112 recordings with too much damping subtracted 9123 units of chi-square were there (784 would be
noise), and nothing outside. With the singular values of the tangent space in logarithms of the elements,

.. math:: \partial Z/\partial\theta = Q\,S\,V^T,

a displacement by one along a column v of V moves the whitened recording by S along the column q of Q. Two kinds of
directions absorb nothing: those with S so small that they would not move a score either if all M recordings were
displaced, :math:`S\sqrt{M} < 0.1`, and those in which the fit leaves more than noise though elements would have to
change by a factor :math:`e^5` for it, :math:`|q \cdot r| > 5 \max(1, S)`. Noise does that in one of two million.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial

import numpy as np

from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.runtime.executors import map_persons


@dataclass(frozen=True, kw_only=True)
class PersonResiduals:
    """Whitened residuals of one person's J recordings on F frequencies.

    Attributes
    ----------
    name : str
    frequency_hz : ndarray, shape (F,)
    model : ndarray, complex, shape (J, F)
        Fitted impedance of each recording.
    sd : ndarray, shape (J, F)
        Noise of the real and of the imaginary part, the person's own scale included.
    white : ndarray, shape (J, 2 F)
        Residuals over sd: real parts, then imaginary parts.
    basis : ndarray, shape (J, 2 F, P)
        Orthonormal basis of what each recording's elements can absorb, in the same coordinates; columns of zeros
        for what the band does not see.
    """

    name: str
    frequency_hz: np.ndarray
    model: np.ndarray
    sd: np.ndarray
    white: np.ndarray
    basis: np.ndarray

    def outside(self, vectors: np.ndarray) -> np.ndarray:
        """The part of whitened vectors (J, 2 F, ...) that no element can absorb, same shape."""
        inside = np.einsum("jfp,jf...->jp...", self.basis, vectors)
        return np.asarray(vectors - np.einsum("jfp,jp...->jf...", self.basis, inside))


_FAINT = 0.1
"""Change of a score, in standard errors, by a factor e in the elements of all recordings, below which a combination of
elements absorbs nothing. By choice: so small that what the recordings hardly determine does not become evidence."""

_BEYOND_REACH = 5.0
"""Standard errors that are more than noise, and change of the elements' logarithm that is more than linear. By choice:
a factor of 150; no element moves so far in one step from a fit that is at rest."""

_ROUNDING = 1e-13
"""Ratio of singular values below which one is rounding error."""

_SHARPER = 1.5
"""Ratio of variances above which roughness instead of the residual gives the noise: a smaller one may be chance. By
choice."""


def person_residuals(
    fit: Refit, names: Sequence[str], executor: Executor | None = None, returning: bool = False
) -> list[PersonResiduals]:
    """Residuals of a fitted model, whitened, with the elements' tangent spaces.

    Parameters
    ----------
    fit : Refit
    names : sequence of str
        Of the people.
    executor : Executor, optional
        Distributes the persons; without it they are computed one after the other.
    returning : bool
        Whether elements that were driven to nothing may come back with what is looked for, so that all directions of
        the tangent space absorb.
    """
    ends = np.cumsum([d.z.shape[0] for d in fit.data])[:-1]
    limits = (0.0, np.inf) if returning else (_FAINT / np.sqrt(len(fit.u)), _BEYOND_REACH)
    function = partial(_residuals_of, fit.model.kernel, fit.model.n_elements, limits)
    rows = np.split(fit.u, ends)
    if executor is None:
        return [function(*person) for person in zip(fit.data, names, rows, strict=True)]
    return list(map_persons(executor, function, fit.data, names, rows))


def _residuals_of(
    kernel: Kernel, n_elements: int, limits: tuple[float, float], d: Likelihood, name: str, u: np.ndarray
) -> PersonResiduals:
    """Residuals of one person, at u (J, P), with the limits of what is faint and of what is beyond reach."""
    faint, reach = limits
    frequency = d.omega / (2 * np.pi)
    z, dz = kernel.derivative(u, frequency)
    difference = (d.z[:, 0] + 1j * d.z[:, 1] - z) * np.sqrt(d.weight)
    white = real_and_imaginary(difference)
    q, moved = directions(real_and_imaginary(dz[:, :n_elements] * np.sqrt(d.weight)[:, None]), faint)
    own = sharper_weight(own_weight(white, q), difference)
    left = np.abs(np.einsum("jfp,jf->jp", q, white)) * np.sqrt(own)
    basis = q * (left <= reach * np.maximum(1.0, moved * np.sqrt(own)))[:, None, :]
    own = sharper_weight(own_weight(white, basis), difference)
    sd = 1 / np.sqrt(d.weight * own)
    return PersonResiduals(
        name=name,
        frequency_hz=frequency,
        model=z,
        sd=sd,
        white=white * np.sqrt(own),
        basis=basis,
    )


def own_weight(white: np.ndarray, basis: np.ndarray) -> float:
    """1/scale^2 of a person's noise from the residuals outside of the elements, corrected for degrees of freedom.

    Parameters
    ----------
    white : ndarray, shape (J, 2 F)
        Residuals over the noise before the person's own scale.
    basis : ndarray, shape (J, 2 F, P)
    """
    square = np.sum(white**2) - np.sum(np.einsum("jfp,jf->jp", basis, white) ** 2)
    freedom = white.size - np.sum(basis**2)
    return float((SCALE_SHAPE + 0.5 * freedom) / (SCALE_SHAPE + 0.5 * square))


def sharper_weight(weight: float, residual: np.ndarray) -> float:
    """1/scale^2 of a person's noise, from the residual's roughness if that implies a much smaller noise.

    The scale that a fit infers counts all misfit as noise. A smooth misfit hardly enters the difference between a point
    and the mean of its neighbours, which has 3/2 of the variance of white noise.
    """
    rough = residual[:, 1:-1] - 0.5 * (residual[:, :-2] + residual[:, 2:])
    square = float(np.mean(np.abs(rough) ** 2)) / (2 * 1.5)
    own = 1 / max(square, 1e-300)
    return own if own > _SHARPER * weight else weight


def directions(derivative: np.ndarray, faint: float) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal bases Q of what elements can absorb, and how far a displacement by one moves along each.

    Parameters
    ----------
    derivative : ndarray, shape (..., P, 2 F)
        Of the whitened recordings with respect to the logarithms of the elements.
    faint : float
        Directions with smaller singular values absorb nothing.

    Returns
    -------
    q : ndarray, shape (..., 2 F, P)
        With columns of zeros for what absorbs nothing.
    singular : ndarray, shape (..., P)
    """
    q, singular, _ = np.linalg.svd(np.swapaxes(derivative, -1, -2), full_matrices=False)
    smallest = np.maximum(_ROUNDING * singular[..., :1], faint)
    return q * (singular > smallest)[..., None, :], singular


def real_and_imaginary(values: np.ndarray) -> np.ndarray:
    """Real parts, then imaginary parts: complex (..., F) as real (..., 2 F)."""
    return np.concatenate([values.real, values.imag], axis=-1)
