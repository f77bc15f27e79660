r"""The rig as six numbers for all frequencies: gain, skew, moving mass, damper, stiffness, and the mount's compliance.

A force sensor of gain g that is late by tau measures a load z through a mount of compliance n (one force: mobilities
add), and with it the mass m0, damper r0 and stiffness k0 between sensor and mount (one velocity: impedances add):

.. math:: h = g e^{-s\tau}\left(\frac{z}{1 + s n z} + s m_0 + r_0 + \frac{k_0}{s}\right).

This is the map of :mod:`.two_port` with :math:`c = s n`, :math:`b = g e^{-s\tau} y`,
:math:`a = g e^{-s\tau} + b c` and :math:`y = s m_0 + r_0 + k_0/s`. Six real numbers from all frequencies together are
known much better than three complex ones at each, they hold between the frequencies of the runs, and two loads
determine the mount too, by its resonance with the known mass. They are fitted by least squares to real and imaginary
parts over their noise.

**Starts.** A known mass on a mount without damper is a resonance with a pole on the axis, from which least squares
finds no way to another frequency. What the rig carries drops out of the difference of two runs, and its reciprocal has
no pole:

.. math:: D_{kl} = \frac{z_k - z_l}{h_k - h_l}
    = \frac{e^{s\tau}}{g}\left(1 + s n (z_k + z_l) + s^2 n^2 z_k z_l\right).

On a grid of n, for resonances of the heaviest load from below the band to far above it, D over the bracket gives g by
its size and tau by its phase, as medians over the frequencies (of twice the phase, which does not jump where the
bracket changes sign). From the best of them least squares in D gives g, tau and n, and the rest of h is linear in m0,
r0 and k0.

**Errors.** The covariance of the parameters is :math:`(J^T W J)^{-1}`, times the reduced chi-square if that is above
one.

**Whether it holds.** The reduced chi-square is the mean square of misfit and noise over that of the noise. Up to
:data:`LARGEST_MISFIT` the misfit is smaller than the noise of the runs, which is the error that a map of each frequency
would have; above, the rig has something that these six numbers do not describe.

**In the language of networks** the same is ``gain[g_rig](delay[d_rig](offset[m_rig](offset[r_rig](offset[k_rig](
n_rig-(NETWORK))))))``, so that the rig may be part of a network that is fitted to what was measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from bayes_impedance.intake.spectrum import ComplexArray, FloatArray
from bayes_impedance.intake.two_port import TwoPort

PARAMETERS = (("g_rig", "1"), ("d_rig", "s"), ("m_rig", "kg"), ("r_rig", "N s/m"), ("k_rig", "N/m"), ("n_rig", "m/N"))
"""Name in a network, and unit."""
LARGEST_MISFIT = 2.0
"""Reduced chi-square: misfit and noise are then equal; derived above."""
SEEN = 3.0
"""Standard deviations from zero above which a mount is said to give way. By choice: chance does it once in 370."""
_COMPLIANCES, _HIGHEST_RESONANCE, _TRIED = 60, 30.0, 3
"""Number of starts, the highest resonance of a mount over the highest frequency, and how many starts are fitted. By
choice: a sixth between neighbours, and 30 times above the band a mount changes the load by a thousandth."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SmoothRig:
    """The six parameters.

    Attributes
    ----------
    values : ndarray of float, shape (6,)
        In the order of :data:`PARAMETERS`.
    covariance : ndarray of float, shape (6, 6)
        Infinite variance of what the runs do not determine.
    misfit : float or None
        Reduced chi-square; None if the noise of the runs is not known.
    """

    values: FloatArray
    covariance: FloatArray
    misfit: float | None

    @property
    def sds(self) -> FloatArray:
        """Standard deviations, shape (6,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def mount_is_seen(self) -> bool:
        """Whether the mount's compliance is above zero by more than chance."""
        return bool(self.values[5] > SEEN * self.sds[5])

    def at(self, frequency_hz: FloatArray) -> TwoPort:
        """The map at some frequencies, shape (F,)."""
        s = np.asarray(2j * np.pi * frequency_hz)
        map_, slopes = _map(self.values, s)
        covariance = np.einsum("fpi,ij,fqj->fpq", slopes, self.covariance, slopes.conj()) / 2
        relation = np.einsum("fpi,ij,fqj->fpq", slopes, self.covariance, slopes) / 2
        return TwoPort(
            frequency_hz=frequency_hz, a=map_[0], b=map_[1], c=map_[2], covariance=covariance, relation=relation
        )

    def changes(self, frequency_hz: FloatArray, z: ComplexArray) -> ComplexArray:
        """Derivatives of a corrected load z (F,) by the parameters that it is corrected with, shape (F, 6)."""
        (a, b, c), slopes = _map(self.values, np.asarray(2j * np.pi * frequency_hz))
        measured = (a * z + b) / (c * z + 1)
        gradient = np.stack([-z, -np.ones_like(z), z * measured], axis=1) / (a - c * measured)[:, None]
        return np.asarray(np.einsum("fp,fpi->fi", gradient, slopes))


def smooth_rig(
    frequency_hz: FloatArray, loads: ComplexArray, measured: ComplexArray, noise_sd: FloatArray | None
) -> SmoothRig | None:
    """Six parameters from runs with at least two different loads.

    Parameters
    ----------
    frequency_hz : ndarray of float, shape (F,)
    loads, measured : ndarray of complex, shape (K, F)
    noise_sd : ndarray of float, shape (K, F), or None
        None for noise in proportion to what was measured, of a size that follows from the misfit.

    Returns
    -------
    SmoothRig or None
        None if there is no such rig: the fit does not end, its gain is not positive, or something is not determined.
    """
    s = np.asarray(2j * np.pi * frequency_hz)
    sd = np.abs(measured) if noise_sd is None else noise_sd
    if not np.all(sd > 0):
        return None
    scale = _scales(s, loads)

    def misfit(u: FloatArray) -> FloatArray:
        (a, b, c), _ = _map(u * scale, s)
        return _real((measured - (a * loads + b) / (c * loads + 1)) / sd)

    def jacobian(u: FloatArray) -> FloatArray:
        (a, b, c), slopes = _map(u * scale, s)
        below = c * loads + 1
        by_map = np.stack([loads, np.ones_like(loads), -loads * (a * loads + b) / below], axis=-1) / below[..., None]
        rows = np.einsum("kfp,fpq->kfq", by_map, slopes) * scale / sd[..., None]
        return -np.array([_real(rows[..., q]) for q in range(rows.shape[-1])]).T

    with np.errstate(all="ignore"):
        fits = [_fit(misfit, jacobian, start / scale) for start in _starts(s, loads, measured, sd, scale)]
    found = min((fit for fit in fits if fit is not None), key=lambda fit: float(fit.cost), default=None)
    if found is None:
        return None
    degrees = found.fun.size - len(PARAMETERS)
    lengths = np.linalg.norm(found.jac, axis=0)
    if degrees <= 0 or not found.x[0] > 0 or not np.all(lengths > 0):
        return None
    r = np.linalg.qr(found.jac / lengths, mode="r")
    if np.linalg.cond(r) > 1 / np.sqrt(np.finfo(float).eps):
        return None
    inverse = np.linalg.inv(r) / lengths[:, None]
    reduced = float(found.fun @ found.fun) / degrees
    factor = reduced if noise_sd is None else max(1.0, reduced)
    covariance = factor * (inverse @ inverse.T) * np.outer(scale, scale)
    return SmoothRig(values=found.x * scale, covariance=covariance, misfit=None if noise_sd is None else reduced)


def rig_around(network: str, values: FloatArray | None, mount: bool) -> str:
    """A network behind the rig, as it is measured.

    Parameters
    ----------
    network : str
    values : ndarray of float, shape (6,), or None
        Parameters that are held; None for parameters that are the same for everybody (``*``) and estimated.
    mount : bool
        Whether the mount gives way.
    """
    said = [name + ("*" if values is None else f"={values[i]:.9g}") for i, (name, _) in enumerate(PARAMETERS)]
    inner = f"{said[5]}-({network})" if mount else network
    for word, parameter in (("offset", 4), ("offset", 3), ("offset", 2), ("delay", 1), ("gain", 0)):
        inner = f"{word}[{said[parameter]}]({inner})"
    return inner


def _map(values: FloatArray, s: ComplexArray) -> tuple[tuple[ComplexArray, ...], ComplexArray]:
    """The map (a, b, c) and its derivatives by the six parameters, shape (F, 3, 6)."""
    g, delay, mass, damper, stiffness, compliance = values
    lag = np.exp(-s * delay)
    carried, c = s * mass + damper + stiffness / s, s * compliance
    b = g * lag * carried
    a = g * lag + b * c
    slopes = np.zeros((s.size, 3, len(PARAMETERS)), dtype=complex)
    slopes[:, 1, 0], slopes[:, 1, 1] = b / g, -s * b
    for i, factor in ((2, s), (3, np.ones_like(s)), (4, 1 / s)):
        slopes[:, 1, i] = g * lag * factor
    slopes[:, 2, 5] = s
    slopes[:, 0, :] = slopes[:, 1, :] * c[:, None] + b[:, None] * slopes[:, 2, :]
    slopes[:, 0, 0] += lag
    slopes[:, 0, 1] -= s * g * lag
    return (a, b, c), slopes


def _fit(misfit: Callable[..., FloatArray], jacobian: Any, start: FloatArray) -> Any:
    try:
        found = least_squares(misfit, start, jacobian, method="lm", x_scale="jac", ftol=1e-12, xtol=1e-12, gtol=1e-12)
    except ValueError:  # values that are not finite
        return None
    return found if found.success else None


def _compliances(s: ComplexArray, loads: ComplexArray) -> FloatArray:
    """Zero, and those for which the heaviest load resonates, from below the band to far above it, shape (N,)."""
    heaviest = max(np.abs(loads[:, -1]).max() / np.abs(s[-1]), np.finfo(float).tiny)
    resonances = np.geomspace(np.abs(s).min() / 2, np.abs(s).max() * _HIGHEST_RESONANCE, _COMPLIANCES)
    return np.concatenate([[0.0], 1 / (heaviest * resonances**2)])


def _starts(
    s: ComplexArray, loads: ComplexArray, measured: ComplexArray, sd: FloatArray, scale: FloatArray
) -> list[FloatArray]:
    """Parameters near the best ones, by differences of runs (module docstring)."""
    first, second = np.triu_indices(len(loads), 1)
    different = np.any(loads[first] != loads[second], axis=1)
    first, second = first[different], second[different]
    step = measured[first] - measured[second]
    quotient = (loads[first] - loads[second]) / step
    weight = np.abs(step) / (np.abs(quotient) * np.hypot(sd[first], sd[second]))
    good = np.isfinite(quotient) & np.isfinite(weight)
    if not good.any():
        return []
    quotient, weight = np.where(good, quotient, 0), np.where(good, weight, 0)
    total, product = s * (loads[first] + loads[second]), s**2 * loads[first] * loads[second]

    def misfit(u: FloatArray) -> FloatArray:
        inverse_gain, delay, n = u[0], u[1] * scale[1], u[2] * scale[5]
        return _real((quotient - inverse_gain * np.exp(s * delay) * (1 + n * total + n**2 * product)) * weight)

    found = []
    for n in _compliances(s, loads):
        ratio = np.where(good, quotient / (1 + n * total + n**2 * product), np.nan)
        twice = np.unwrap(np.angle(np.nan_to_num(ratio) ** 2), axis=1) / (2 * s.imag)
        u = np.array([np.nanmedian(np.abs(ratio)), np.median(twice[good]) / scale[1], n / scale[5]])
        if np.all(np.isfinite(u)):
            found.append((float(np.sum(misfit(u) ** 2)), u))
    found.sort(key=lambda one: one[0])
    fits = [_fit(misfit, "2-point", u) for _, u in found[:_TRIED]]
    return [_with_carried(s, loads, measured, sd, fit.x, scale) for fit in fits if fit is not None and fit.x[0] > 0]


def _with_carried(
    s: ComplexArray, loads: ComplexArray, measured: ComplexArray, sd: FloatArray, u: FloatArray, scale: FloatArray
) -> FloatArray:
    """All six parameters for 1/g, delay and compliance: those of what the rig carries by linear least squares."""
    gain, delay, n = 1 / u[0], u[1] * scale[1], u[2] * scale[5]
    below = 1 + s * n * loads
    # Near a resonance the load behind the mount is known badly; there the run counts less.
    weight = gain * np.minimum(1.0, np.abs(below) ** 2) / sd
    carried = _real((measured * np.exp(s * delay) / gain - loads / below) * weight)
    columns = np.array([_real(column * weight) for column in (s, np.ones_like(s), 1 / s)]).T * scale[2:5]
    mass, damper, stiffness = np.linalg.lstsq(columns, carried, rcond=None)[0] * scale[2:5]
    return np.array([gain, delay, mass, damper, stiffness, n])


def _scales(s: ComplexArray, loads: ComplexArray) -> FloatArray:
    """Natural size of each parameter: that of a load, and a radian at the highest frequency."""
    highest, middle = np.abs(s).max(), np.sqrt(np.abs(s).min() * np.abs(s).max())
    load = max(float(np.median(np.abs(loads[np.abs(loads) > 0]))), np.finfo(float).tiny)
    return np.array([1.0, 1 / highest, load / middle, load, load * middle, 1 / (load * middle)])


def _real(values: ComplexArray) -> FloatArray:
    return np.concatenate([values.real.ravel(), values.imag.ravel()])
