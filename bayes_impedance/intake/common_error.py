r"""The error that a calibration leaves in all recordings, as parameters of a rig that a fit can estimate.

The six parameters v of a smooth rig (:mod:`.smooth_rig`) have errors with a covariance :math:`\Sigma`. A recording of
the load z that was corrected with wrong parameters is, to first order, :math:`z + \sum_k S_k\,\delta v_k` with

.. math:: S_k = \frac{(-z,\, -1,\, z h)}{a - c h}\cdot\frac{\partial (a, b, c)}{\partial v_k},

the same :math:`\delta v` in every recording. What remains is itself a small rig around the load, with a gain, a delay,
an incompletely subtracted mass, damper and stiffness, whose first-order changes of z are
:math:`B = (z, -s z, s, 1, 1/s)`. Weighted least squares over all recordings and frequencies (weights 1/abs z) give
:math:`\delta p = M\,\delta v` and the covariance :math:`M \Sigma M^T` of what remains, which is the prior of these five
parameters in a fit. What no such rig describes (the mount's compliance, :math:`-s z^2`, as far as it differs from the
five) is left out, and the share of the error's variance that is described is said.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.intake.smooth_rig import SmoothRig
from bayes_impedance.intake.spectrum import ComplexArray, FloatArray, Spectrum
from bayes_impedance.recordings.calibration import CommonError

NETWORK = "gain[g_rig*](delay[d_rig*](offset[m_rig*](offset[r_rig*](offset[k_rig*](NETWORK)))))"
PARAMETERS = ("g_rig", "d_rig", "m_rig", "r_rig", "k_rig")
_LEAST = 1e-12
"""Least eigenvalue of the correlation of what remains: it stays positive definite when it is written and read."""


def common_error(rig: SmoothRig, corrected: Sequence[Spectrum]) -> CommonError | None:
    """What is left in the recordings.

    Parameters
    ----------
    rig : SmoothRig
        With which they were corrected.
    corrected : sequence of Spectrum

    Returns
    -------
    CommonError or None
        None if the errors of the rig are not known.
    """
    if not np.all(np.isfinite(rig.covariance)) or not np.all(rig.sds[:5] > 0):
        return None
    shapes = [_shapes(rig, one.frequency_hz, one.z) for one in corrected]
    changes = np.concatenate([change for change, _ in shapes])
    columns = np.concatenate([column for _, column in shapes])
    size = np.linalg.norm(columns, axis=0)
    solution = np.linalg.lstsq(columns / size, changes, rcond=None)[0] / size[:, None]
    root = np.linalg.cholesky(rig.covariance + np.diag(np.finfo(float).eps * rig.sds**2))
    total = float(np.sum((changes @ root) ** 2))
    rest = float(np.sum(((changes - columns @ solution) @ root) ** 2))
    covariance = solution @ rig.covariance @ solution.T
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    values, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    correlation = (vectors * np.maximum(values, _LEAST)) @ vectors.T
    correlation /= np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))
    return CommonError(
        network=NETWORK,
        parameters=PARAMETERS,
        mean=np.array([1.0, 0.0, 0.0, 0.0, 0.0]),
        sd=sd,
        correlation=correlation,
        share=1 - rest / total,
    )


def _shapes(rig: SmoothRig, frequency_hz: FloatArray, z: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Changes of z, over its size, by the rig's parameters, (2 F, 6), and by those of what remains, (2 F, 5)."""
    s = np.asarray(2j * np.pi * frequency_hz)
    changes = rig.changes(frequency_hz, z)
    columns = np.stack([z, -s * z, s, np.ones_like(s), 1 / s], axis=1)
    size = np.abs(z)[:, None]
    return _parts(np.asarray(changes / size)), _parts(np.asarray(columns / size))


def _parts(values: np.ndarray) -> FloatArray:
    return np.concatenate([values.real, values.imag])
