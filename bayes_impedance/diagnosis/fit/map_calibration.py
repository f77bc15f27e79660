r"""The error of a calibration at each frequency, estimated from all recordings and removed before a search.

As for a rig of few parameters (:mod:`.calibration_error`), with the map :math:`v = (a, b, c)` of each frequency
(:mod:`bayes_impedance.recordings.calibration_map`) as the parameters, known to be :math:`v_0` with the covariance
:math:`\Sigma = L L^H`. The network is fitted with the calibration's error as noise, so that each frequency weighs as
much as is known there. With the loads z that it predicts, recordings were measured as :math:`h_j` with the noise
:math:`\sigma_j`, and :math:`v = v_0 + L \xi` with :math:`\xi` standard normal in each of real and imaginary part
should have made :math:`m_j = (a z_j + b)/(c z_j + 1)` of them. The most probable :math:`\xi` follows by steps of Gauss
and Newton, as h is nearly linear in v even where z is not,

.. math:: B = \sum_j L^H J_j^H J_j L/\sigma_j^2, \qquad y = \sum_j L^H J_j^H (h_j - m_j)/\sigma_j^2 + B \xi,
          \qquad \xi' = (1 + B)^{-1} y, \qquad J = \frac{(z,\, 1,\, -z m)}{c z + 1}.

If the calibration's variances are right and the network describes everybody, y has the covariance
:math:`B (1 + B)`, and the sum of :math:`y^H [B (1 + B)]^{-1} y` over the frequencies is a chi-square with two degrees
of freedom for each eigenvalue of B, less the elements of the network. If it is improbably large, the network lacks
something or the variances are too small, and nothing is removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from bayes_impedance.diagnosis.fit.baseline import point_estimate
from bayes_impedance.network.notation import Network
from bayes_impedance.population.calibrated import prior_of
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.map_error import root_of, with_map_noise
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.recordings.calibration_map import CalibrationMap
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.progress import Progress

_STEPS = 5
"""Of Gauss and Newton. By choice: errors of a tenth are then below rounding."""
_NOTHING = 1e-9
"""Eigenvalue of B, over the largest, below which the recordings say nothing of an error: rounding."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MapError:
    """The most probable error of a map.

    Attributes
    ----------
    errors : ndarray of complex, shape (F, 3)
        What is to be added to (a, b, c) at each frequency of the map.
    probability : float
        Of errors that are as large, or larger, if the calibration is right and the network describes everybody.
    """

    errors: np.ndarray
    probability: float


def map_error(
    recordings: Recordings, network: Network | str | None, seed: int, executor: Executor, progress: Progress
) -> MapError | None:
    """Estimate the error; None if not all recordings come with their noise.

    Raises
    ------
    InputError
        If the network cannot be fitted.
    """
    error = recordings.calibration_map
    assert error is not None
    if any(one.noise_sd is None for one in recordings.subjects):
        return None
    noisier = with_map_noise(recordings)
    kernel = checked_model(noisier, network).kernel
    point = point_estimate(noisier, kernel, prior_of(kernel, noisier), seed, executor, progress)
    return most_probable_error(recordings, _predicted(point, recordings), len(kernel.elements))


def most_probable_error(recordings: Recordings, loads: Sequence[np.ndarray], elements: int) -> MapError:
    """The error with which recordings are what a network predicts.

    Parameters
    ----------
    recordings : Recordings
        With a map, and noise that does not hold its error.
    loads : sequence of ndarray of complex, shape (J, F)
        What the network predicts for each person's repetitions.
    elements : int
        Number of elements of the network.
    """
    error = recordings.calibration_map
    assert error is not None
    measured = [_measured(error, one) for one in recordings.subjects]
    root, at = root_of(error), np.array([error.a, error.b, error.c]).T
    xi, probability = np.zeros_like(at), 1.0
    for _ in range(_STEPS):
        size, follows = np.zeros_like(root), np.zeros_like(at)
        values = at + np.einsum("fij,fj->fi", root, xi)
        for z, (h, noise, index) in zip(loads, measured, strict=True):
            a, b, c = values[index].T
            below = c * z + 1
            made = (a * z + b) / below
            each = np.stack([z, np.ones_like(z), -z * made], axis=-1) / (below * noise)[..., None]
            each = np.einsum("jfi,fik->jfk", each, root[index])
            np.add.at(size, index, np.einsum("jfk,jfm->fkm", each.conj(), each))
            np.add.at(follows, index, np.einsum("jfk,jf->fk", each.conj(), (h - made) / noise))
        follows += np.einsum("fij,fj->fi", size, xi)
        xi, probability = _most_probable(size, follows, elements)
    return MapError(errors=np.einsum("fij,fj->fi", root, xi), probability=probability)


def _measured(error: CalibrationMap, subject: Subject) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What was measured before it was corrected, with its noise, shape (J, F), and the map's frequencies (F,)."""
    assert subject.noise_sd is not None  # checked by who asks
    index, _ = error.changes(subject.frequency_hz, subject.z)
    a, b, c = error.a[index], error.b[index], error.c[index]
    below = c * subject.z + 1
    return (a * subject.z + b) / below, subject.noise_sd * np.abs((a - b * c) / below**2), index


def _predicted(point: Estimate, recordings: Recordings) -> list[np.ndarray]:
    """What the fitted network makes of each repetition, shape (J, F)."""
    pooling, found = point.pooling, []
    nothing = np.zeros(len(pooling.names))
    for subject, mode, deviations in zip(recordings.subjects, point.modes, point.deviations, strict=True):
        theta = pooling.whole(mode.theta, point.shared) if pooling.names else mode.theta
        apart = pooling.whole(deviations, nothing) if pooling.names else deviations
        found.append(pooling.kernel.impedance(theta + apart, subject.frequency_hz))
    return found


def _most_probable(size: np.ndarray, follows: np.ndarray, elements: int) -> tuple[np.ndarray, float]:
    """Most probable xi (F, 3) from B (F, 3, 3) and y (F, 3), and the probability of such a y."""
    values, vectors = np.linalg.eigh(size)
    along = np.einsum("fji,fj->fi", vectors.conj(), follows)
    told = values > _NOTHING * values.max()
    b = np.where(told, values, 1.0)
    square = float(np.sum(np.where(told, np.abs(along) ** 2 / (b * (1 + b)), 0.0)))
    freedom = max(2 * int(np.count_nonzero(told)) - elements, 1)
    xi = np.einsum("fij,fj->fi", vectors, np.where(told, along / (1 + b), 0.0))
    return xi, float(chi2.sf(square, freedom))


def removed(recordings: Recordings, found: MapError) -> Recordings:
    """Recordings without the error, which are then taken as exactly calibrated."""
    error = recordings.calibration_map
    assert error is not None
    subjects = tuple(_without(error, found.errors, one) for one in recordings.subjects)
    return replace(recordings, subjects=subjects, calibration_map=None)


def _without(error: CalibrationMap, errors: np.ndarray, subject: Subject) -> Subject:
    """Corrected anew with the map without its error, noise too."""
    h, noise, index = _measured(error, subject)
    a, b, c = (np.array([error.a, error.b, error.c]) + errors.T)[:, index]
    return replace(subject, z=(h - b) / (a - c * h), noise_sd=noise * np.abs((a - b * c) / (a - c * h) ** 2))
