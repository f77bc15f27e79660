r"""Representative users of a population, chosen by stated rules so that the choice is reproducible.

**Named users.** With the population's centre c and the covariance S of a new user's parameters u (log elements), the
most probable user among those with a given value of a property q lies, to first order, along :math:`S g` with g the
gradient of ln q:

.. math:: \theta = c \pm t\,\frac{S g}{\sqrt{g^T S g}}, \qquad t = \Phi^{-1}(0.95) = 1.645 .

Such a user is stiffer (or softer, ...) than 95 % of people and otherwise the most probable: elements that are
correlated with stiffness change with it. For `stiff` and `soft`, q = abs(Im z) at the frequency in the band where the
centre's phase is lowest; for `heavy` and `light`, where it is highest. If the centre is nowhere spring-like, or
nowhere mass-like, it has no such pair.

**Spanning set.** Of the drawn users inside the 95 % ellipsoid :math:`(\theta - c)^T S^{-1} (\theta - c) \le
\chi^2_P(0.95)`, first the one nearest to the centre, then repeatedly the one farthest from all chosen so far
([1]_: no set of the same size covers them with less than half the radius). Distances are Mahalanobis distances.

References
----------
.. [1] T. F. Gonzalez, "Clustering to minimize the maximum intercluster distance", Theoretical Computer Science 38
   (1985) 293-306.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2, norm

from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.display import Brief
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.units import who

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.95
"""Share of people whom a named user exceeds, and probability of the ellipsoid of the spanning set. By choice: the 95th
percentile is usual in design."""


@dataclass(frozen=True, repr=False)
class Representatives(Brief):
    """Representative users.

    Attributes
    ----------
    users : Users
        Those with names (``median``, ``stiff``, ...) first, then ``span_1``, ``span_2``, ...
    rules : tuple of str
        The rule of choice of each user, as a sentence.
    radius : float
        Largest Mahalanobis distance of a drawn user inside the ellipsoid from the nearest of the spanning set.
    """

    users: Users
    rules: tuple[str, ...]
    radius: float

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each user: its elements, and the rule that chose it."""
        return self.users.to_dataframe().assign(rule=list(self.rules))


def representatives(
    population: UserPopulation, users: Users, band_hz: tuple[float, float], number: int = 8
) -> Representatives:
    """Representative users.

    Parameters
    ----------
    population : UserPopulation
    users : Users
        Drawn from it: candidates of the spanning set.
    band_hz : (float, float)
        Band in which stiffness and inertia are evaluated.
    number : int
        Size of the spanning set; fewer if there are not so many candidates.
    """
    centre, covariance = population.centre, population.covariance
    names, rules, rows = ["median"], ["posterior median of the population's mean"], [centre]
    for pair, frequency, gradient in _properties(population, band_hz):
        step = norm.ppf(LEVEL) * covariance @ gradient / np.sqrt(gradient @ covariance @ gradient)
        for name, sign in zip(pair, (1, -1), strict=True):
            more = "larger" if sign > 0 else "smaller"
            names.append(name)
            rules.append(
                f"the most probable one whose |Im z| at {frequency:.4g} Hz is {more} than that of "
                f"{100 * LEVEL:.0f} % of {who(population.unit)}"
            )
            rows.append(centre + sign * step)
    chosen, radius = spanning(population, users, number)
    names += [f"span_{i + 1}" for i in range(chosen.size)]
    rules += [
        f"of those drawn inside the {100 * LEVEL:.0f} % ellipsoid "
        + ("the one nearest to the centre" if i == 0 else "the one farthest from all chosen before")
        + f" ({users.names[row]})"
        for i, row in enumerate(chosen)
    ]
    theta = np.concatenate([np.array(rows), users.u[chosen]])
    return Representatives(population.users(names, theta), tuple(rules), radius)


def spanning(population: UserPopulation, users: Users, number: int) -> tuple[np.ndarray, float]:
    """Rows of a set of users that spans the 95 % ellipsoid, and the largest distance of the others from the set.

    Returns
    -------
    rows : ndarray of int
    radius : float
        Mahalanobis distance.
    """
    free = [i for i, e in enumerate(population.network.elements) if e not in population.fixed]
    factor = np.linalg.cholesky(population.covariance[np.ix_(free, free)])
    white = np.linalg.solve(factor, (users.u - population.centre)[:, free].T).T
    away = np.sum(white**2, axis=1)
    inside = np.flatnonzero(away <= chi2.ppf(LEVEL, len(free)))
    if inside.size == 0:
        return inside, float("nan")
    chosen = [int(inside[np.argmin(away[inside])])]
    distance = np.linalg.norm(white[inside] - white[chosen[0]], axis=1)
    while len(chosen) < number and distance.max() > 0:
        chosen.append(int(inside[np.argmax(distance)]))
        distance = np.minimum(distance, np.linalg.norm(white[inside] - white[chosen[-1]], axis=1))
    return np.array(chosen), float(distance.max())


def _properties(
    population: UserPopulation, band_hz: tuple[float, float]
) -> list[tuple[tuple[str, str], float, np.ndarray]]:
    """Names, frequency in Hz and gradient of ln abs(Im z) of each property that the centre has in the band."""
    frequency = np.geomspace(*band_hz, 201)
    z, dz = Kernel(population.network).derivative(population.centre, frequency)
    phase, found = np.angle(z), []
    spring, mass = int(np.argmin(phase)), int(np.argmax(phase))
    for pair, at, there in (
        (("stiff", "soft"), spring, phase[spring] < 0),
        (("heavy", "light"), mass, phase[mass] > 0),
    ):
        gradient = dz[:, at].imag / z[at].imag
        if there and np.any(population.covariance @ gradient != 0):
            found.append((pair, float(frequency[at]), gradient))
    return found
