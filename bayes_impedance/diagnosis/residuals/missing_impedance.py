r"""The missing one-port at a place of the network: the relative change of its impedance that explains the residuals.

If the impedance of place p changes by the fraction :math:`\rho(\omega)`, that of the port changes by
:math:`a_p z_p \rho`. The ratio is one complex curve for all people, expanded in K bumps over log frequency,


.. math:: \rho(\omega) = \sum_k (x_k + j y_k)\, B_k(\ln \omega),

and with the elements of every recording free its coefficients are the weighted least squares solution over the whole
population. This averages coherently, so that an effect below the noise of one person becomes visible. The improvement
of chi-square, relative to the total excess, is the share of the mismatch that can be explained at that place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances
from bayes_impedance.diagnosis.types import OnePort

_BUMPS = 12
"""Basis functions over the band, four per decade between 5 Hz and 5 kHz: noise is averaged, broad resonances
remain. By choice."""

_POINTS = 60
"""Frequencies at which the ratio is reported, five for each basis function. By choice."""

_BUMP_WIDTH = 0.7
"""Standard deviation of a bump in units of their distance: their sum is flat, and neighbours are still distinct.
By choice."""

_RIDGE = 1.0
"""Prior standard deviation of each coefficient: a change by the impedance itself."""


def missing_one_ports(fit: Refit, residuals: Sequence[PersonResiduals]) -> tuple[OnePort, ...]:
    """The missing one-port at every place, the place that explains most of the mismatch first.

    Parameters
    ----------
    fit : Refit
    residuals : sequence of PersonResiduals
        Of that fit.
    """
    low = min(r.frequency_hz[0] for r in residuals)
    high = max(r.frequency_hz[-1] for r in residuals)
    grid = np.geomspace(low, high, _POINTS)
    names = [p.name for p in fit.model.network.places()]
    size = 2 * _BUMPS
    gram = {name: np.zeros((size, size)) for name in names}
    score = {name: np.zeros(size) for name in names}
    start = 0
    excess = 0.0
    for person in residuals:
        rows = slice(start, start + len(person.white))
        start = rows.stop
        omega = 2 * np.pi * person.frequency_hz
        bumps = _bumps(person.frequency_hz, low, high)
        outside = person.outside(person.white)
        excess += float(np.sum(outside**2)) - (outside.size - float(np.sum(person.basis**2)))
        for name, local in local_impedances(fit.model, fit.u[rows], omega).items():
            if name not in gram:
                continue
            felt = local.adjoint * local.z / person.sd
            columns = np.concatenate([felt[:, None] * bumps, 1j * felt[:, None] * bumps], axis=1)
            g = np.concatenate([columns.real, columns.imag], axis=-1)
            g = np.swapaxes(person.outside(np.swapaxes(g, 1, 2)), 1, 2)
            gram[name] += np.einsum("jkf,jlf->kl", g, g, optimize=True)
            score[name] += np.einsum("jkf,jf->k", g, person.white)
    found = []
    shown = _bumps(grid, low, high)
    for name in names:
        precision = gram[name] + np.eye(size) / _RIDGE**2
        covariance = np.linalg.inv(precision)
        x = covariance @ score[name]
        improvement = float(score[name] @ x) - size
        real, imaginary = x[:_BUMPS] @ shown, x[_BUMPS:] @ shown
        variance = np.einsum("kf,kl,lf->f", shown, covariance[:_BUMPS, :_BUMPS], shown)
        total = max(excess, improvement, 1.0)
        share = float(np.clip(improvement / total, 0.0, 1.0))
        found.append(OnePort(name, grid, real + 1j * imaginary, np.sqrt(np.maximum(variance, 0.0)), share))
    return tuple(sorted(found, key=lambda port: -port.share))


def _bumps(frequency_hz: np.ndarray, low: float, high: float) -> np.ndarray:
    """Gaussian bumps over log frequency that sum to one, shape (K, F)."""
    x = np.log(frequency_hz / low) / np.log(high / low) * (_BUMPS - 1)
    weight = np.exp(-0.5 * ((x - np.arange(_BUMPS)[:, None]) / _BUMP_WIDTH) ** 2)
    return np.asarray(weight / weight.sum(axis=0))
