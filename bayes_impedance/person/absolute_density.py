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

**Other dispersions.** The likelihood of the deviations is known at one rho only, where they were integrated out. For
others chi-square is taken as a quadratic in the contrasts d at the mode of theta, with curvature M and slope b,

.. math:: \chi^2(d) = \chi_0^2 - 2b^Td + d^TMd, \qquad d \sim N(0, R\otimes I),

and Laplace's method is applied to it as above: :math:`d = (M w + R^{-1})^{-1} w b` and
:math:`w = (\alpha+N)/(\beta+\tfrac12\chi^2(d))`, in turn until they agree, give

.. math:: G(\rho) = -(\alpha+N)\ln\left(\beta+\tfrac12\chi^2(d)\right) - \tfrac12 d^TR^{-1}d
          - \tfrac12\ln|I + w D M D|, \qquad D = \operatorname{diag}\rho .

:math:`G(\rho) - G(\rho_0)` is what another rho changes. (In sampling w is held fixed; here the scale follows, because
somebody whose repetitions differ more than others' must not be taken for noisy.)

**Noise with tails.** Constants are those of Student's t at the mode (:mod:`bayes_impedance.person.heavy_noise`), and N
is the share of the values that they are worth.

**The scale once more.** Laplace's method holds w while the contrasts are integrated, although the scale is unknown: in
m directions that the data determine it errs by about :math:`\tfrac m2(\tfrac m2+1)/(2N)`, which is 0.2 for three
repetitions of eight elements and sixty frequencies, and not the same for networks of different size. With the quadratic
above the integral over the contrasts is exact at every s^2, so only one dimension remains. With eigenvalues lambda of
:math:`DMD` and components h of Db along its eigenvectors,

.. math:: I(s^2) = \exp\left(-\frac{\chi_0^2}{2s^2} + \sum\frac{h^2}{2s^2(s^2+\lambda)}\right)
          \prod\left(1+\frac{\lambda}{s^2}\right)^{-1/2},

:math:`\int I(s^2)\, s^{-2(\alpha+1+N)} e^{-\beta/s^2} ds^2` is computed on a grid, and the logarithm of its ratio to
:math:`\Gamma(\alpha+N)\,e^{G(\rho_0)}` is added. It is zero if nothing depends on the deviations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from bayes_impedance.network.kernel import Kernel, compiled
from bayes_impedance.person.heavy_noise import log_density, squares_at
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, repetition_equations
from bayes_impedance.person.marginal_likelihood import Ridge
from bayes_impedance.person.noise import contrasts
from bayes_impedance.person.small_matrices import inverted, solved

_REACH, _STEP = 30.0, 0.05
"""How far the grid over ln s^2 goes below the scale of the least chi-square and above that without deviations, and its
step; both in standard deviations of about 1/sqrt(alpha + N). By choice: the integrand is smooth, so that the sum is
exact to rounding; deviations with as many directions as there are values shift its peak by a few of them."""
_ROUNDS, _SAME = 50, 1e-4
"""Most iterations of the weight w, and the relative change at which they end. By choice: each multiplies the error by
about m/N, and G changes by less than m times it, a thousandth; ten times more digits take a third more time."""


@dataclass(frozen=True)
class Deviations:
    """Chi-square of one person as a quadratic in the S = (J - 1) P contrasts between repetitions.

    Attributes
    ----------
    curvature : ndarray, shape (S, S)
        M; the combined index runs over contrasts and, within each, over elements.
    slope : ndarray, shape (S,)
        b.
    at_zero : float
        Chi-square without deviations.
    count : float
        Number N of complex values.
    tails : float or None
        Of noise with tails: what the log likelihood at the deviations' mode lacks of the log density there.
    """

    curvature: np.ndarray
    slope: np.ndarray
    at_zero: float
    count: float
    tails: float | None = None

    def log_likelihood(self, rho: np.ndarray) -> np.ndarray:
        """G of dispersions between repetitions (W, P), shape (W,); zero with one repetition."""
        if not self.slope.size:
            return np.zeros(len(rho))
        exponent = SCALE_SHAPE + self.count
        sd = np.ascontiguousarray(np.tile(rho, self.slope.size // rho.shape[1]))
        return np.asarray(_laplace(self.curvature, self.slope, self.at_zero, exponent, sd))


def deviations_of(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> Deviations:
    """The quadratic at log elements (P,), expanded at the deviations of the likelihood."""
    gradient, information = repetition_equations(kernel, likelihood, theta)
    d, own, rows = likelihood, likelihood.deviations, contrasts(len(gradient))
    pull = np.einsum("jpq,jq->jp", information, own) - gradient
    size = rows.shape[0] * own.shape[1]
    curvature = np.einsum("cj,dj,jpq->cpdq", rows, rows, information).reshape(size, size)
    residual = kernel.impedance(theta + own, d.omega / (2 * np.pi)) - (d.z[:, 0] + 1j * d.z[:, 1])
    at_mode = np.sum(d.weight * np.abs(residual) ** 2)
    at_zero = at_mode - np.sum(own * (gradient - pull))
    return Deviations(curvature, (rows @ pull).ravel(), float(at_zero), d.values, _of_tails(kernel, d, theta))


def _of_tails(kernel: Kernel, likelihood: Likelihood, theta: np.ndarray) -> float | None:
    """The constant of noise with tails, which makes the density at the mode that of Student's t."""
    d = likelihood
    if d.plain is None:
        return None
    square = squares_at(kernel, d, theta)
    chi_square = float(np.sum(square * d.weight / d.plain))
    density = log_density(square, float(np.sum(np.log(d.plain))), d.degrees)
    return density + (SCALE_SHAPE + d.values) * float(np.log(SCALE_SHAPE + 0.5 * chi_square))


def log_constant(likelihood: Likelihood, ridge: Ridge, deviations: Deviations) -> float:
    """What :func:`marginal_log_likelihood` lacks of the log density of a person's recordings.

    Parameters
    ----------
    likelihood : Likelihood
        With the deviations at their mode.
    ridge : Ridge
        Its rho is that for which the density holds.
    deviations : Deviations
        At the ridge's point of expansion, the mode.

    Returns
    -------
    float
        Natural logarithm; the density is that of real and imaginary parts in the unit of the recordings.
    """
    n, d = deviations.count, likelihood
    if deviations.tails is None:
        constant = SCALE_SHAPE * np.log(SCALE_SHAPE) + gammaln(SCALE_SHAPE + n) - gammaln(SCALE_SHAPE)
        constant += np.sum(np.log(d.weight)) - n * np.log(2 * np.pi)  # the weight is 1/sigma^2
    else:
        constant = deviations.tails
    if d.z.shape[0] > 1:
        constant += _unknown_scale(deviations, ridge.rho) - (d.z.shape[0] - 1) * np.sum(np.log(ridge.rho))
    return float(constant)


def _unknown_scale(deviations: Deviations, rho: np.ndarray) -> float:
    """Logarithm of the integral over the scale less that of Laplace's method, for dispersions (P,)."""
    d, exponent = deviations, SCALE_SHAPE + deviations.count
    sd = np.tile(rho, d.slope.size // rho.size)
    eigenvalues, vectors = np.linalg.eigh(sd[:, None] * d.curvature * sd)
    eigenvalues, slope = np.maximum(eigenvalues, 0), vectors.T @ (sd * d.slope)
    laplace = gammaln(exponent) + d.log_likelihood(rho[None])[0]

    least = d.at_zero - np.sum(slope**2 / np.maximum(eigenvalues, 1e-300) * (eigenvalues > 0))
    middle = np.log((SCALE_SHAPE + 0.5 * max(least, 0.0)) / exponent)
    farthest = np.log((SCALE_SHAPE + 0.5 * max(d.at_zero, 0.0)) / exponent)
    around = _REACH / np.sqrt(exponent)
    log_variance = np.arange(middle - around, farthest + around, _STEP / np.sqrt(exponent))
    variance = np.exp(log_variance)[:, None]
    values = -exponent * log_variance - (SCALE_SHAPE + 0.5 * d.at_zero) / variance[:, 0]
    values += 0.5 * np.sum(slope**2 / (variance * (variance + eigenvalues)) - np.log1p(eigenvalues / variance), axis=1)
    return float(np.logaddexp.reduce(values) + np.log(log_variance[1] - log_variance[0]) - laplace)


@compiled
def _laplace(curvature: np.ndarray, slope: np.ndarray, at_zero: float, exponent: float, sd: np.ndarray) -> np.ndarray:
    """Laplace's method for contrasts of standard deviations (W, S): shape (W,)."""
    size = slope.size
    result = np.empty(sd.shape[0])
    w = 1.0
    for k in range(sd.shape[0]):
        scaled = curvature * sd[k] * sd[k].reshape(size, 1)
        pull = slope * sd[k]
        for _ in range(_ROUNDS):  # the weight of the dispersions before is a good start
            curved = np.eye(size) + w * scaled
            at = solved(curved, w * pull)
            chi = at_zero - 2.0 * np.dot(pull, at) + np.dot(at, scaled @ at)
            before = w
            w = exponent / (SCALE_SHAPE + 0.5 * max(chi, 0.0))
            if np.abs(w - before) < _SAME * w:
                break
        result[k] = -exponent * np.log(SCALE_SHAPE + 0.5 * max(chi, 0.0)) - 0.5 * np.dot(at, at)
        result[k] -= 0.5 * inverted(curved)
    return result
