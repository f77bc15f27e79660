r"""The constants that make one person's log likelihood the logarithm of a probability density.

:func:`~bayes_impedance.person.marginal_likelihood.marginal_log_likelihood` leaves out what does not depend on the log
elements, because no draw depends on it. To compare networks the density itself is needed: that of all N = JF complex
values of the person, real and imaginary parts in the unit of the recordings (so 2N real numbers). It is

.. math:: p(z\,|\,\theta, \rho) = \int ds^2\,\mathrm{IG}(s^2; \alpha, \beta) \int d\delta\, N(\delta; 0, \rho)
          \prod_{jk} \frac{1}{2\pi s^2\sigma_{jk}^2}
          \exp\left(-\frac{|z_{jk} - Z_k(\theta+\delta_j)|^2}{2 s^2\sigma_{jk}^2}\right),

where theta is the mean of the person's log elements over the repetitions, and the deviations, which sum to zero, are
J - 1 orthonormal contrasts of N(0, R), R = diag rho^2, in each of P elements.

**One repetition.** There are no deviations, and the integral over s^2 is a gamma function,

.. math:: \ln p(z\,|\,\theta) = c - (\alpha+N)\ln\left(\beta+\tfrac12\chi^2\right), \qquad
          c = \alpha\ln\beta + \ln\frac{\Gamma(\alpha+N)}{\Gamma(\alpha)} - N\ln 2\pi - 2\sum_{jk}\ln\sigma_{jk} .

**More repetitions.** Laplace's method over the contrasts has three factors: the prior's density
:math:`(2\pi)^{-(J-1)P/2}|R|^{-(J-1)/2}\exp(-\frac12\sum_j\delta_j^TR^{-1}\delta_j)`, the integral of the exponential,
:math:`(2\pi)^{(J-1)P/2}|U^TAU|^{-1/2}`, and the likelihood at the maximum. The powers of two pi cancel; what the
marginal log likelihood leaves out is c and

.. math:: -(J-1)\sum_p \ln\rho_p .

**The scale once more.** Laplace's method holds the weight w of the data at its value at the maximum, but the scale is
unknown while the contrasts are integrated: in m directions that the data determine it errs by about
:math:`\tfrac m2(\tfrac m2+1)/(2N)`, which is 0.2 for three repetitions of eight elements and sixty frequencies, and
not the same for networks of different size. Where the residual is linear in the deviations the integral over them is
exact at every s^2, so only one dimension remains. With M and b the curvature and the slope of
:math:`\tfrac12\chi^2` in the contrasts d, :math:`\chi^2 = \chi_0^2 - 2b^Td + d^TMd`, eigenvalues lambda of
:math:`DMD`, :math:`D = \operatorname{diag}\rho`, and h the components of Db along the eigenvectors,

.. math:: I(s^2) = \exp\left(-\frac{\chi_0^2}{2s^2} + \sum\frac{h^2}{2s^2(s^2+\lambda)}\right)
          \prod\left(1+\frac{\lambda}{s^2}\right)^{-1/2},

:math:`\int I(s^2)\, s^{-2(\alpha+1+N)} e^{-\beta/s^2} ds^2` is computed on a grid, Laplace's method is applied to the
same quadratic, and the difference of the logarithms, at the mode, is added. It is zero if nothing depends on the
deviations.
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaln

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, repetition_equations
from bayes_impedance.person.marginal_likelihood import Ridge
from bayes_impedance.person.noise import contrasts

_REACH, _POINTS = 30.0, 1201
"""Half the width of the grid over ln s^2, in its standard deviations of about 1/sqrt(alpha + N), and its points: twenty
in each. By choice: the integrand is smooth, so that the sum is exact to rounding; deviations with as many directions as
there are values shift its peak by a few standard deviations."""
_ROUNDS = 20
"""Fixed-point iterations of the weight at the maximum. By choice: each multiplies the error by about m/N or less."""


def log_constant(kernel: Kernel, likelihood: Likelihood, ridge: Ridge) -> float:
    """What :func:`marginal_log_likelihood` lacks of the log density of a person's recordings.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        With the deviations at their mode.
    ridge : Ridge
        Its point of expansion is the mode, its rho that for which the density holds.

    Returns
    -------
    float
        Natural logarithm; the density is that of real and imaginary parts in the unit of the recordings.
    """
    d = likelihood
    n = d.z.shape[0] * d.omega.size
    constant = SCALE_SHAPE * np.log(SCALE_SHAPE) + gammaln(SCALE_SHAPE + n) - gammaln(SCALE_SHAPE)
    constant += np.sum(np.log(d.weight)) - n * np.log(2 * np.pi)  # the weight is 1/sigma^2
    if d.z.shape[0] > 1:
        constant += _unknown_scale(kernel, d, ridge) - (d.z.shape[0] - 1) * np.sum(np.log(ridge.rho))
    return float(constant)


def _unknown_scale(kernel: Kernel, likelihood: Likelihood, ridge: Ridge) -> float:
    """Integral over the scale less Laplace's method, both with the residual linear in the deviations at the mode."""
    gradient, information = repetition_equations(kernel, likelihood, ridge.theta)
    rows = contrasts(len(gradient))
    own = likelihood.deviations
    pull = np.einsum("jpq,jq->jp", information, own) - gradient
    sd = np.tile(ridge.rho, len(rows))
    curvature = np.einsum("cj,dj,jpq->cpdq", rows, rows, information).reshape(sd.size, sd.size)
    eigenvalues, vectors = np.linalg.eigh(sd[:, None] * curvature * sd)
    eigenvalues = np.maximum(eigenvalues, 0)
    slope = vectors.T @ (sd * (rows @ pull).ravel())
    exponent = SCALE_SHAPE + likelihood.z.shape[0] * likelihood.omega.size
    at_mode = _chi_square(kernel, likelihood, ridge.theta)
    at_zero = at_mode - np.sum(own * (2 * gradient - np.einsum("jpq,jq->jp", information, own)))

    w = exponent / (SCALE_SHAPE + 0.5 * at_mode)
    for _ in range(_ROUNDS):
        at = w * slope / (1 + w * eigenvalues)
        chi = at_zero - 2 * slope @ at + eigenvalues @ at**2
        w = exponent / (SCALE_SHAPE + 0.5 * chi)
    laplace = gammaln(exponent) - exponent * np.log(SCALE_SHAPE + 0.5 * chi)
    laplace -= 0.5 * np.sum(at**2) + 0.5 * np.sum(np.log1p(w * eigenvalues))

    log_variance = -np.log(w) + np.linspace(-_REACH, _REACH, _POINTS) / np.sqrt(exponent)
    variance = np.exp(log_variance)[:, None]
    values = -exponent * log_variance - (SCALE_SHAPE + 0.5 * at_zero) / variance[:, 0]
    values += 0.5 * np.sum(slope**2 / (variance * (variance + eigenvalues)) - np.log1p(eigenvalues / variance), axis=1)
    step = log_variance[1] - log_variance[0]
    return float(np.logaddexp.reduce(values) + np.log(step) - laplace)


def _chi_square(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> float:
    """Chi-square of all repetitions at theta (P,) and the deviations of the likelihood."""
    d = likelihood
    residual = kernel.impedance(theta + d.deviations, d.omega / (2 * np.pi)) - (d.z[:, 0] + 1j * d.z[:, 1])
    return float(np.sum(d.weight * np.abs(residual) ** 2))
