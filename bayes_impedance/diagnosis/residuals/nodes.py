r"""Residuals of all people pooled on common frequency nodes, as errors of magnitude and of phase.

White residuals are rotated by :math:`e^{-i\arg Z}`, so that their first half is an error of magnitude and the second
one of phase, projected, and summed over the points nearest to a node. With B the rotated and summed basis of the
elements' tangent space, and D the numbers of points, a recording's sums are

.. math:: x_r \sim N(0, C_r), \qquad C_r = D_r - B_r B_r^T

if nothing is missing. On a common grid the nodes are its points and D is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.person.noise import contrasts

MINIMUM_CONTRASTS = 10
"""Number of contrasts between repetitions from which the noise is estimated from them: its variance then has a standard
error of 45 % at one real point, and less over a window. With fewer, the assumed noise is the better estimate."""


@dataclass(frozen=True)
class Pooled:
    """Residuals of all recordings on common nodes, magnitude first, then phase.

    Attributes
    ----------
    frequency_hz : ndarray, shape (G,)
    owner : ndarray of int, shape (R,)
        Person of each recording, ascending.
    scores : ndarray, shape (R, 2 G)
        Projected whitened residuals, summed over the points nearest to a node.
    count : ndarray, shape (R, 2 G)
        Number of these points.
    basis : ndarray, shape (R, 2 G, P)
        Basis of the elements' tangent space, summed in the same way.
    """

    frequency_hz: np.ndarray
    owner: np.ndarray
    scores: np.ndarray
    count: np.ndarray
    basis: np.ndarray

    @property
    def persons(self) -> int:
        """Number of persons N."""
        return int(self.owner[-1]) + 1

    def variance(self, templates: np.ndarray) -> np.ndarray:
        """Variances of the scores of templates (2 G, M) in each recording, shape (R, M)."""
        r, g, p = self.basis.shape
        absorbed = (self.basis.transpose(0, 2, 1).reshape(r * p, g) @ templates).reshape(r, p, -1)
        return np.asarray(self.count @ templates**2 - np.sum(absorbed**2, axis=1))

    def node_variance(self) -> np.ndarray:
        """Variance at each node of each recording, shape (R, 2 G)."""
        return np.asarray(np.maximum(self.count - np.sum(self.basis**2, axis=2), 0.0))

    def covariance(self) -> np.ndarray:
        """Covariance of the scores' sum over all recordings, shape (2 G, 2 G)."""
        stacked = self.basis.transpose(1, 0, 2).reshape(self.basis.shape[1], -1)
        return np.asarray(np.diag(self.count.sum(axis=0)) - stacked @ stacked.T)

    def by_person(self, values: np.ndarray) -> np.ndarray:
        """Sums over the recordings (R, ...) of each person, shape (N, ...)."""
        return np.add.reduceat(values, np.flatnonzero(np.diff(self.owner, prepend=-1)), axis=0)

    def without(self, templates: np.ndarray) -> Pooled:
        """Project templates (2 G, K) out of every recording, with a free amplitude in each, besides the elements."""
        root = np.sqrt(self.count)[:, :, None]
        inverse = np.divide(1.0, root, out=np.zeros_like(root), where=root > 0)
        old = self.basis * inverse
        new = root * templates
        for _ in range(2):  # twice, because the first difference of nearly absorbed templates is inexact
            new = new - old @ (old.transpose(0, 2, 1) @ new)
        new = np.linalg.qr(new)[0]
        white = self.scores[:, :, None] * inverse
        white = white - new @ (new.transpose(0, 2, 1) @ white)
        basis = np.concatenate([self.basis, new * root], axis=2)
        return replace(self, scores=(white * root)[:, :, 0], basis=basis)


def contrast_matrix(owner: np.ndarray) -> np.ndarray:
    """Orthonormal contrasts between the recordings of each person.

    Parameters
    ----------
    owner : ndarray of int, shape (R,)
        Person of each recording; those of one person are adjacent.

    Returns
    -------
    ndarray, shape (R - N, R)
    """
    repetitions = np.unique(owner, return_counts=True)[1]
    matrix = np.zeros((owner.size - repetitions.size, owner.size))
    row = column = 0
    for j in repetitions.tolist():
        matrix[row : row + j - 1, column : column + j] = contrasts(j)
        row, column = row + j - 1, column + j
    return matrix


def pool(residuals: Sequence[PersonResiduals]) -> Pooled:
    """Rotate residuals into magnitude and phase, project them, and sum them on common nodes.

    The nodes are the frequency grid if all people share it, else quantiles of all frequencies.
    """
    first = residuals[0].frequency_hz
    same = all(r.frequency_hz.shape == first.shape and np.allclose(r.frequency_hz, first) for r in residuals)
    x = np.log(np.concatenate([r.frequency_hz for r in residuals]))
    most = max(r.frequency_hz.size for r in residuals)
    nodes = np.log(first) if same else np.unique(np.quantile(x, np.linspace(0, 1, most)))
    middle, g = 0.5 * (nodes[1:] + nodes[:-1]), nodes.size
    p = max(r.basis.shape[2] for r in residuals)
    scores, count, basis, owner = [], [], [], []
    for i, person in enumerate(residuals):
        f, j = person.frequency_hz.size, person.white.shape[0]
        one = np.searchsorted(middle, np.log(person.frequency_hz)) if not same else np.arange(g)
        index = np.concatenate([one, one + g])
        columns = np.zeros((j, 2 * f, p + 1))
        columns[:, :, 0] = turn(person, person.outside(person.white))
        columns[:, :, 1 : 1 + person.basis.shape[2]] = turn(person, person.basis)
        summed = columns
        if not same:
            summed = np.zeros((j, 2 * g, p + 1))
            for r in range(j):
                np.add.at(summed[r], index, columns[r])
        scores.append(summed[:, :, 0])
        basis.append(summed[:, :, 1:])
        count.append(np.tile(np.bincount(index, minlength=2 * g).astype(float), (j, 1)))
        owner.append(np.full(j, i))
    return Pooled(np.exp(nodes), *(np.concatenate(part) for part in (owner, scores, count, basis)))


def turn(person: PersonResiduals, vectors: np.ndarray) -> np.ndarray:
    """Rotate whitened vectors (J, 2 F, ...) from real and imaginary parts to along and across the model's impedance."""
    f = person.frequency_hz.size
    unit = person.model / np.abs(person.model)
    unit = unit.reshape(unit.shape + (1,) * (vectors.ndim - 2))
    real, imag = vectors[:, :f], vectors[:, f:]
    along = unit.real * real + unit.imag * imag
    return np.concatenate([along, unit.real * imag - unit.imag * real], axis=1)
