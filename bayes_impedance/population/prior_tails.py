r"""Central values whose prior is a Student t: knowledge that recordings may overrule.

A normal prior draws a centre that is z of its standard deviations away with a force that grows with z. Of a Student t
with :math:`\nu` degrees of freedom the force is

.. math:: -\frac{d}{dz}\log p(z) = \frac{(\nu + 1)\, z}{\nu + z^2},

which vanishes far off: there the recordings decide (O'Hagan 1979, on outlier-prone priors). Two forms are needed.

**Sampling.** The coordinate u of such a centre is standard normal under the prior: with the distribution functions
:math:`\Phi` and :math:`T_\nu`, :math:`z = T_\nu^{-1}(\Phi(u))`. So coordinates reach as
far as those of a normal prior.

**Maximising.** A Student t is a normal distribution of unknown precision, whose expected factor at z is
:math:`w = (\nu + 1)/(\nu + z^2)`. Expectation-maximisation with a normal prior of this precision
has its fixed point at the mode under the Student t.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import gammaln, ndtr, ndtri, stdtr, stdtrit

DEGREES = 4.0
"""Degrees of freedom of the prior. By choice: between 3 and 7, as the Stan team recommends for priors with tails; the
variance is finite, and 1 in 20 draws is more than 2.8 scales away (of a normal distribution 1 in 200)."""
_FAR = 1e-100
"""Least tail probability of a coordinate, so that distances are finite: far beyond what is sampled."""
_SMALLEST = 1e-14
"""Least tail probability of a Student t that is turned back. By choice: a coordinate of 7.7, inside the limit of 8 for
those that are sampled."""


def changed(rows: np.ndarray, columns: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Rows (..., N) in which `columns` (N,), of bool, went through `change`."""
    result = np.array(rows, dtype=float)
    result[..., columns] = change(result[..., columns])
    return result


def from_standard(u: np.ndarray) -> np.ndarray:
    """Distances from the prior's centre, in its scales, of standard normal coordinates; same shape."""
    return np.asarray(-np.sign(u) * stdtrit(DEGREES, np.maximum(ndtr(-np.abs(u)), _FAR)))


def to_standard(z: np.ndarray) -> np.ndarray:
    """Standard normal coordinates of distances, same shape."""
    return np.asarray(-np.sign(z) * ndtri(np.clip(stdtr(DEGREES, -np.abs(z)), _SMALLEST, 0.5)))


def slope(u: np.ndarray) -> np.ndarray:
    """Derivative of :func:`from_standard`: the ratio of the two densities, same shape."""
    return np.asarray(np.exp(-0.5 * u**2) / np.sqrt(2 * np.pi) / density(from_standard(u)))


def density(z: np.ndarray) -> np.ndarray:
    """Density at distances z in scales, same shape."""
    norm = gammaln((DEGREES + 1) / 2) - gammaln(DEGREES / 2) - 0.5 * np.log(DEGREES * np.pi)
    return np.asarray(np.exp(norm + log_density(z)))


def log_density(z: np.ndarray) -> np.ndarray:
    """Log density at distances z in scales, 0 at the centre; same shape."""
    return np.asarray(-0.5 * (DEGREES + 1) * np.log1p(z**2 / DEGREES))


def weight(z: np.ndarray) -> np.ndarray:
    """Factor on the precision of a normal prior that has the mode in the same place, same shape."""
    return np.asarray((DEGREES + 1) / (DEGREES + z**2))
