r"""The rig as a two-port between what is measured and the load, from runs with known loads, at each frequency.

Whatever is linear between the transducers and the load (gain and delay of the channels, a mass below the force sensor,
its suspension, a mount that gives way) turns force and velocity of the load into those that are measured by a matrix
of two rows. Their ratio is then a bilinear map, in which one of four numbers is free:

.. math:: h = \frac{a z + b}{c z + 1}, \qquad z = \frac{h - b}{a - c h}.

b is what is measured without a load, a the gain for small loads, and c, the compliance of the mount times s, what a
large load loses. **Three different known loads determine a, b and c**, from the linear equations
:math:`a z_k + b - c z_k h_k = h_k`; more are fitted by least squares with the weights :math:`1/\sigma_k`, in a few
steps of Gauss and Newton from the solution of the linear equations. **Two** determine a and b for a rigid mount
(c = 0). **One** determines b for a = 1 and c = 0, which is the paper's calibration if it is the unloaded rig:
:math:`z = h - b`. That is right only if the gain is 1 and the mount rigid; :func:`undetermined` says so.

**Uncertainty.** The noise of h is circular with :math:`\sigma` in each part and h is analytic in (a, b, c), so the
estimate's covariance (of each part) is :math:`\Sigma = (J^H W J)^{-1}`. A corrected value has

.. math::
    \frac{\partial z}{\partial h} = \frac{a - b c}{(a - c h)^2}, \qquad
    g = \frac{\partial z}{\partial (a, b, c)} = \frac{(-z,\, -1,\, z h)}{a - c h},

its own noise :math:`\sigma\,|\partial z/\partial h|`, and :math:`g \Sigma g^H` from the calibration. The second is
**the same error in all recordings that one calibration corrects**: it does not average out over people, and is
therefore no part of their ``noise_sd`` but is kept beside it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray
from bayes_impedance.recordings.calibration_map import CalibrationMap

_STEPS = 5
"""Of Gauss and Newton. The linear equations are wrong by the noise only, so the second step is already below it."""
_LARGEST_CONDITION = 1e8
"""Of the scaled equations. By choice: loads that differ by less than a hundred millionth are the same load."""
_NEIGHBOURS, _NEAR = 4, 1.1
"""Lines on either side over which the noise of a run is averaged, and the largest ratio of neighbours. By choice: a
weight from the few periods of a single line may be wrong by a factor; noise that grows as the frequency squared is
a fifth larger at the edge of such a neighbourhood."""
_FEWEST_DEGREES = 3.0
"""Of freedom. By choice: with two or fewer there is no mean square."""


@dataclass(frozen=True, eq=False, kw_only=True)
class TwoPort:
    """The map of the rig at some frequencies.

    Attributes
    ----------
    frequency_hz : ndarray of float, shape (F,)
    a, b, c : ndarray of complex, shape (F,)
        Without unit, in N s/m, and in m/(N s).
    covariance : ndarray of complex, shape (F, 3, 3), or None
        Of (a, b, c), half the mean of errors times their conjugates, which is that of real and of imaginary part if
        they are circular; None if the noise of the runs is not known.
    relation : ndarray of complex, shape (F, 3, 3), or None
        Half the mean of products of the errors without conjugates, of a map whose errors are not circular
        (:mod:`.smooth_rig`).
    """

    frequency_hz: FloatArray
    a: ComplexArray
    b: ComplexArray
    c: ComplexArray
    covariance: ComplexArray | None = None
    relation: ComplexArray | None = None

    @property
    def recorded(self) -> CalibrationMap:
        """The map as a dataset keeps it."""
        return CalibrationMap(
            frequency_hz=self.frequency_hz, a=self.a, b=self.b, c=self.c, covariance=self.covariance
        )  # fmt: skip

    def measured(self, z: ComplexArray) -> ComplexArray:
        """What is measured with a load, shapes (..., F)."""
        return np.asarray((self.a * z + self.b) / (self.c * z + 1))

    def load(self, measured: ComplexArray) -> ComplexArray:
        """The load behind what was measured, shapes (..., F)."""
        with np.errstate(all="ignore"):  # what is not finite is refused later, with its place
            return np.asarray((measured - self.b) / (self.a - self.c * measured))

    def noise_factor(self, measured: ComplexArray) -> FloatArray:
        """Noise of the load over that of the measured value, shapes (..., F)."""
        with np.errstate(all="ignore"):
            return np.asarray(np.abs((self.a - self.b * self.c) / (self.a - self.c * measured) ** 2))

    def common_sd(self, measured: ComplexArray) -> FloatArray | None:
        """Standard deviation of real and imaginary part of the load from the calibration alone, shape (..., F, 2)."""
        if self.covariance is None:
            return None
        z = self.load(measured)
        gradient = np.stack([-z, -np.ones_like(z), z * measured], axis=-1) / (self.a - self.c * measured)[..., None]
        variance = np.einsum("...fi,fij,...fj->...f", gradient, self.covariance, gradient.conj()).real
        difference = (
            np.zeros_like(variance)
            if self.relation is None
            else np.einsum("...fi,fij,...fj->...f", gradient, self.relation, gradient).real
        )
        return np.asarray(np.sqrt(np.maximum(np.stack([variance + difference, variance - difference], axis=-1), 0.0)))


def smoothed_noise(
    frequency_hz: FloatArray, noise_sd: FloatArray, degrees_of_freedom: float | None = None
) -> FloatArray:
    """Noise averaged, as a variance, over neighbouring lines of about the same frequency.

    An error over its standard deviation estimated with nu degrees of freedom is distributed as Student's t, and its
    mean square is nu/(nu - 2). With that factor in the variance it is one, as for a known standard deviation.

    Parameters
    ----------
    frequency_hz, noise_sd : ndarray of float, shape (F,)
    degrees_of_freedom : float, optional
        Of each value.
    """
    variance = noise_sd**2
    total, count = variance.copy(), np.ones_like(variance)
    for k in range(1, _NEIGHBOURS + 1):
        near = frequency_hz[k:] <= _NEAR * frequency_hz[:-k]
        total[k:] += near * variance[:-k]
        total[:-k] += near * variance[k:]
        count[k:] += near
        count[:-k] += near
    variance = total / count
    if degrees_of_freedom is not None:
        degrees = np.maximum(degrees_of_freedom * count, _FEWEST_DEGREES)
        variance = variance * degrees / (degrees - 2)
    return np.asarray(np.sqrt(variance))


def two_port(
    frequency_hz: FloatArray, loads: ComplexArray, measured: ComplexArray, noise_sd: FloatArray | None, n_different: int
) -> TwoPort:
    """The map from runs with known loads, at each frequency for itself.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    loads, measured : ndarray of complex, shape (K, F)
        In N s/m; a load may be there several times.
    noise_sd : ndarray of float, shape (K, F), or None
        Of each part of what was measured. Without it all runs have the same relative weight.
    n_different : int
        Number of different loads, at least one.

    Raises
    ------
    InputError
        If the loads are too much alike.
    """
    free = min(n_different, 3)
    columns = [1, 0, 2][:free]  # b first, then a, then c
    with np.errstate(divide="ignore"):
        weight = 1 / (np.abs(measured) if noise_sd is None else noise_sd).T  # (F, K)
    weight = np.where(
        np.isfinite(weight), weight, weight[np.isfinite(weight)].max() if np.isfinite(weight).any() else 1
    )
    z, h = loads.T, measured.T
    solution = np.zeros((len(frequency_hz), 3), dtype=complex)
    solution[:, 0] = 1.0
    linear = np.stack([z, np.ones_like(z), -z * h], axis=-1)
    target = h - z if free == 1 else h
    step, _ = _least_squares(linear[..., columns], target, weight)
    solution[:, columns] = step
    covariance = None
    for _ in range(_STEPS):
        a, b, c = solution.T[:, :, None]
        below = 1 + c * z
        fitted = (a * z + b) / below
        jacobian = np.stack([z, np.ones_like(z), -z * fitted], axis=-1) / below[..., None]
        step, covariance = _least_squares(jacobian[..., columns], h - fitted, weight)
        solution[:, columns] += step
    full = np.zeros((len(frequency_hz), 3, 3), dtype=complex)
    full[np.ix_(range(len(frequency_hz)), columns, columns)] = covariance
    a, b, c = solution.T
    return TwoPort(
        frequency_hz=frequency_hz, a=a, b=b, c=c, covariance=None if noise_sd is None else full
    )  # fmt: skip


def _least_squares(
    jacobian: ComplexArray, target: ComplexArray, weight: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Solution (F, P) and covariance (F, P, P) of the weighted equations (F, K, P)."""
    rows = jacobian * weight[..., None]
    scale = np.linalg.norm(rows, axis=1)
    scale = np.where(scale > 0, scale, 1.0)
    q, r = np.linalg.qr(rows / scale[:, None, :])
    if not np.all(np.isfinite(r)) or np.linalg.cond(r).max() > _LARGEST_CONDITION:
        raise InputError("--known-load: the measured runs of different loads are too much alike; check loads and files")
    inverse = np.linalg.inv(r) / scale[:, :, None]
    step = np.einsum("fij,fkj,fk->fi", inverse, q.conj(), target * weight)
    return step, np.einsum("fij,fkj->fik", inverse, inverse.conj())


def undetermined(n_different: int, unloaded: bool) -> str:
    """What the known loads leave open, in a sentence; empty if nothing.

    Parameters
    ----------
    n_different : int
        Number of different known loads.
    unloaded : bool
        Whether the rig without a load is among them.
    """
    if n_different == 1 and unloaded:
        return (
            "one unloaded run does not determine gain, skew and mount, which are taken as 1, 0 and rigid, so that "
            "their errors remain in z; runs with two known masses (--known-load) determine them"
        )
    if n_different == 1:
        return (
            "one known load does not separate gain and seismic mass: the gain is taken as 1, the skew as 0 and the "
            "mount as rigid; an unloaded run and a second known load determine them"
        )
    if n_different == 2:
        return (
            "two known loads do not separate the gain from the compliance of the mount at a single frequency: the "
            "mount is taken as rigid there; a third load determines it"
        )
    return ""
