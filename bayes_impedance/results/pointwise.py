r"""Log predictive density of every point of a person's recordings, given the person's own elements.

Given log elements, deviations of the repetitions and noise scale, points are independent, and with posterior draws
:math:`\theta_s` of the person's elements the density of the values at frequency k in all J repetitions is

.. math:: \ln\frac1S\sum_s \prod_j \frac{1}{2\pi\sigma_{jk}^2}
          \exp\left(-\frac{|z_{jk} - Z_k(\theta_s+\delta_j)|^2}{2\sigma_{jk}^2}\right),

with deviations at their estimate and the person's noise, scale included; of noise with tails the density is that of
:mod:`bayes_impedance.person.heavy_noise`. It says **where** in the band a network
predicts a person badly. It is no leave-one-out value: the point took part in the estimate of the elements, which
all points of a person share. For the comparison of networks there is the density of each person's recordings as a whole
(:mod:`bayes_impedance.population.person_densities`), in which the noise scale and the elements are integrated out, and
which does not factor into points; so it alone stands in the group ``log_likelihood``.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.population.fit import PopulationFit

POINTWISE = "pointwise_log_density"
"""Variable of ``constant_data``."""
_DRAWS = 100
"""Posterior draws of a person's elements, evenly spread. By choice: the mean over them is known to some percent where a
point is about as probable under each of them."""
_SAME = 1e-9
"""Relative difference of frequencies that are the same: rounding."""


def pointwise_log_densities(fit: PopulationFit, frequency_hz: np.ndarray) -> np.ndarray:
    """Log predictive density of each person's recordings at each frequency of a grid.

    Parameters
    ----------
    fit : PopulationFit
    frequency_hz : ndarray, shape (F,)
        The common grid, ascending.

    Returns
    -------
    ndarray, shape (N, F)
        Natural logarithms of the density of the J complex values, real and imaginary parts in the unit of the
        recordings; NaN where a person has no point at that very frequency.
    """
    draws = fit.person_draws.reshape(-1, *fit.person_draws.shape[2:])
    rows = np.unique(np.linspace(0, len(draws) - 1, _DRAWS).astype(int))
    result = np.full((len(fit.recordings.subjects), frequency_hz.size), np.nan)
    tail = 0.0 if fit.noise_tail is None else float(fit.noise_tail[0])
    people = zip(fit.recordings.subjects, fit.noise, fit.deviations, strict=True)
    for i, (subject, noise, deviations) in enumerate(people):
        own = subject.frequency_hz
        column = np.clip(np.searchsorted(frequency_hz, own * (1 - _SAME)), 0, frequency_hz.size - 1)
        there = np.abs(frequency_hz[column] / own - 1) < _SAME
        theta = draws[rows, i][:, None] + deviations
        z = fit.kernel.impedance(theta.reshape(-1, theta.shape[-1]), own[there]).reshape(*theta.shape[:2], -1)
        variance = noise[:, there] ** 2
        square = np.abs(z - subject.z[:, there]) ** 2 / variance
        shape = (0.5 / tail + 1) * np.log1p(tail * square) if tail else 0.5 * square
        each = np.sum(-shape - np.log(2 * np.pi * variance), axis=1)
        result[i, column[there]] = np.logaddexp.reduce(each, axis=0) - np.log(rows.size)
    return result
