r"""The error of a calibration at each frequency, in a fit: shared by everybody, with the calibration's distribution.

The errors :math:`\delta v_f` of a rig's map (:mod:`bayes_impedance.recordings.calibration_map`) are three complex
parameters of the rig at each frequency. They are the same for all recordings, and their prior is normal with the
covariance :math:`\Sigma_f`. Recording i at f is off by :math:`g_{if}\,\delta v_f`.

A rig of few lumped elements around the network, as for a smooth rig, does not describe that, because it is white over
frequency. Its projection on such a rig is right for a network whose derivatives the rig's contain, as those of one
mass, spring and damper; the part of another network's derivatives that the rig lacks would be read from what is left,
as if that averaged out over people. So the error is carried on as it is, in two steps.

**Weights.** Within one recording the error is as good as noise: it is independent from frequency to frequency. The fit
is given the noise :math:`\sigma^2 + g \Sigma g^H`, so that a frequency counts as much as is known there. Where
recordings do not say their noise, its estimate from the roughness of the curves holds this error already.

**What does not average out.** The posterior of the fit averages such noise over the M recordings of all people, so that
a part 1/M of its variance is left in the centre, and of a person with :math:`R_i` recordings a part :math:`1/R_i`. What
is missing is added. To first order the estimates follow an error :math:`e_i` of person i's recordings as those of
linear least squares do. With the derivatives :math:`J_i` of the network, the weights :math:`W_i`, the covariance
:math:`\Omega_i` of a person's mean elements in the population, the precision :math:`\Lambda_0` of the centre's prior,
:math:`A_i = \Re(J_i^H W_i J_i)` and :math:`b_i = \Re(J_i^H W_i e_i)`,

.. math::
    \delta\mu &= \Bigl(\Lambda_0 + \sum_i K_i A_i\Bigr)^{-1} \sum_i K_i b_i, \qquad K_i = (1 + A_i \Omega_i)^{-1}, \\
    \delta\theta_i &= (1 + \Omega_i A_i)^{-1} (\delta\mu + \Omega_i b_i).

For each posterior draw :math:`\delta v` is drawn from its prior, and centre and persons are moved by minus what it
makes, with :math:`b_i` times :math:`\sqrt{1 - 1/M}` in the first line and :math:`\sqrt{1 - 1/R_i}` in the second. To
first order recordings cannot tell such a shift of everybody from another population, so that the prior of
:math:`\delta v` is its posterior; dispersions do not change.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.prior import Prior
from bayes_impedance.recordings.calibration_map import CalibrationMap
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.files import Recordings

if TYPE_CHECKING:
    from bayes_impedance.population.fit import PopulationFit


def with_map_noise(recordings: Recordings) -> Recordings:
    """Recordings whose noise holds the error of the calibration's map; as they are without one, or if it does."""
    error = recordings.calibration_map
    if error is None or error.in_noise:
        return recordings
    noisier = tuple(_noisier(error, one) for one in recordings.subjects)
    return replace(recordings, subjects=noisier, calibration_map=replace(error, in_noise=True))


def with_map_error(fit: PopulationFit, seed: np.random.SeedSequence, most: float) -> PopulationFit:
    """The posterior with the error of a calibration at each frequency; as it is without one.

    Parameters
    ----------
    fit : PopulationFit
    seed : SeedSequence
    most : float
        Standard deviation from which a central value is not identified any more.
    """
    if fit.recordings.calibration_map is None:
        return fit
    elements = fit.person_means
    follows = response(fit.recordings, fit.kernel, elements, fit.effective_noise, fit.parameters, fit.prior)
    parameters, persons = moved(follows, fit.parameters, fit.person_draws.reshape(-1, *elements.shape), seed)
    return replace(
        fit,
        parameters=parameters,
        person_draws=persons.reshape(fit.person_draws.shape),
        identified=fit.identified & (parameters.mu.std(axis=0) < most),
    )


def without_map_noise(recordings: Recordings) -> Recordings:
    """Recordings without the error of the map in their noise: what :func:`with_map_noise` was given."""
    error = recordings.calibration_map
    if error is None or not error.in_noise:
        return recordings
    subjects = tuple(
        one
        if one.noise_sd is None
        else replace(one, noise_sd=np.sqrt(one.noise_sd**2 - error.variance(one.frequency_hz, one.z)))
        for one in recordings.subjects
    )
    return replace(recordings, subjects=subjects, calibration_map=replace(error, in_noise=False))


def _noisier(error: CalibrationMap, subject: Subject) -> Subject:
    if subject.noise_sd is None:
        return subject
    noise = np.sqrt(subject.noise_sd**2 + error.variance(subject.frequency_hz, subject.z))
    return replace(subject, noise_sd=noise)


@dataclass(frozen=True, eq=False, kw_only=True)
class Response:
    """How estimates follow the errors of a map, standardised to D independent standard normal numbers.

    Attributes
    ----------
    centre : ndarray, shape (P, D)
    persons : ndarray, shape (N, P, D)
    """

    centre: np.ndarray
    persons: np.ndarray


def response(
    recordings: Recordings,
    kernel: Kernel,
    elements: np.ndarray,
    noise: Sequence[np.ndarray],
    parameters: PopulationParameters,
    prior: Prior,
) -> Response:
    """The first-order response of a fit.

    Parameters
    ----------
    recordings : Recordings
        With a map.
    kernel : Kernel
    elements : ndarray, shape (N, P)
        Estimated log elements of each person.
    noise : sequence of ndarray, shape (J, F)
        Standard deviation of each part of each person's recordings.
    parameters : PopulationParameters
        Posterior draws; dispersions are NaN of one person.
    prior : Prior
    """
    error = recordings.calibration_map
    assert error is not None
    root = root_of(error)
    p, numbers = len(kernel.elements), 2 * root[..., 0].size
    one = len(recordings.subjects) == 1
    between, within = (np.zeros((p, p)), np.zeros((p, p))) if one else _dispersions(parameters)
    precision, total = prior.precision, np.zeros((p, numbers))
    equations = []
    for subject, theta, sd in zip(recordings.subjects, elements, noise, strict=True):
        a, b = _normal_equations(error, root, kernel, subject, theta, sd)
        omega = between + within / len(subject.repetitions)
        k = np.linalg.inv(np.eye(p) + a @ omega)
        precision, total = precision + k @ a, total + k @ b
        equations.append((a, b, omega))
    each = np.array([len(subject.repetitions) for subject in recordings.subjects])
    centre = np.sqrt(1 - 1 / each.sum()) * np.linalg.solve(precision, total)
    persons = [
        np.linalg.solve(np.eye(p) + omega @ a, centre + np.sqrt(1 - 1 / n) * omega @ b)
        for (a, b, omega), n in zip(equations, each.tolist(), strict=True)
    ]
    return Response(centre=centre, persons=np.array(persons))


def root_of(error: CalibrationMap) -> np.ndarray:
    """Factor of the covariance at each frequency, shape (F, 3, 3)."""
    assert error.covariance is not None
    values, vectors = np.linalg.eigh(error.covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])


def _dispersions(parameters: PopulationParameters) -> tuple[np.ndarray, np.ndarray]:
    """Mean covariance of the log elements between persons, and between repetitions, shape (P, P) each."""
    factor = parameters.between_persons[..., None] * parameters.correlation_cholesky
    between = np.einsum("wij,wkj->ik", factor, factor) / len(factor)
    return between, np.diag(np.mean(parameters.between_repetitions**2, axis=0))


def _normal_equations(
    error: CalibrationMap, root: np.ndarray, kernel: Kernel, subject: Subject, theta: np.ndarray, sd: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Information of a person's recordings (P, P), and how its right side follows the errors, shape (P, D)."""
    jacobian = kernel.derivative(theta, subject.frequency_hz)[1]
    index, gradient = error.changes(subject.frequency_hz, subject.z)
    weight = 1 / sd**2
    information = np.einsum("pf,jf,qf->pq", jacobian.conj(), weight, jacobian).real
    follows = np.einsum("pf,jf,jfi,fik->fpk", jacobian.conj(), weight, gradient, root[index])
    at = np.zeros((len(root), len(jacobian), root.shape[2]), dtype=complex)
    np.add.at(at, index, follows)
    flat = at.transpose(1, 0, 2).reshape(len(jacobian), -1)
    return information, np.concatenate([flat.real, -flat.imag], axis=1)


def moved(
    follows: Response, parameters: PopulationParameters, person_draws: np.ndarray, seed: np.random.SeedSequence
) -> tuple[PopulationParameters, np.ndarray]:
    """Posterior draws with the error of the calibration.

    Parameters
    ----------
    follows : Response
    parameters : PopulationParameters
        W sets.
    person_draws : ndarray, shape (W, N, P)
    seed : SeedSequence
    """
    rng = np.random.default_rng(seed)
    drawn = rng.normal(size=(len(parameters.mu), follows.centre.shape[1]))
    persons = person_draws - np.einsum("wd,npd->wnp", drawn, follows.persons, optimize=True)
    return replace(parameters, mu=parameters.mu - drawn @ follows.centre.T), persons
