r"""The share of a population's users with whom a device is stable: its Z-width over the population.

For gains (K, B) let :math:`s_i` be 1 if the loop with user i is stable and 0 otherwise, determined from its poles
(:mod:`bayes_impedance.design.loop.sampled_loop`). In one population of the posterior the share of stable users is
estimated with the users' importance weights (:meth:`UserPopulation.weights`),

.. math:: p_r = \sum_i w_{ri}\, s_i ,

and the posterior consists of many populations r. The finite number of users adds an uncertainty: with :math:`n_r =
1/\sum_i w_{ri}^2` effective users, p is drawn from Beta(1/2 + n p, 1/2 + n (1 - p)) [1]_. The quantiles of all draws
are the credible interval and their median is the reported share. The interval contains the uncertainty of the
population and the sampling error of the users.

The limit of a share, "stable for 99 % up to K", needs no grid, and it is not a quantile of the drawn users: it is a
quantile of every population of the posterior (:mod:`bayes_impedance.design.loop.population_limit`). The median and the
90 % interval of these quantiles are reported.

**Which elements cause the worst user's limit.** The change of :math:`\ln K_\max` from the centre of the population to
the user is attributed to the elements by integrated gradients [2]_ along the straight line in the parameters u (log
elements); the contributions add up to the difference.

References
----------
.. [1] L. D. Brown, T. T. Cai, A. DasGupta, "Interval estimation for a binomial proportion", Statistical Science 16
   (2001) 101-133.
.. [2] M. Sundararajan, A. Taly, Q. Yan, "Axiomatic attribution for deep networks", ICML (2017).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.design.circuits.equivalent import realised
from bayes_impedance.design.loop.device import Device
from bayes_impedance.design.loop.population_limit import POPULATIONS, limits_of_populations
from bayes_impedance.design.loop.sampled_loop import SampledLoop, largest_stiffness, sampled_loop, stable
from bayes_impedance.design.users import UserPopulation, Users, values_of
from bayes_impedance.display import Brief
from bayes_impedance.units import INTERVAL

if TYPE_CHECKING:
    import pandas as pd

_STEPS = 8
"""Points of the midpoint rule along the line to the worst user. By choice: few, as the gradient varies slowly."""

_DIFFERENCE = 1e-3
"""Step of a parameter u in central differences. By choice: the truncation error is of the order of its square, 1e-6,
and the bisected limits are much more accurate than the step."""


@dataclass(frozen=True, kw_only=True, repr=False)
class StabilityMap(Brief):
    """Share of users with whom the loop is stable.

    Attributes
    ----------
    device : Device
    stiffness, damping : ndarray, shape (G,) and (H,)
        Gains K in N/m and B in N s/m.
    users : Users
    stable : ndarray of bool, shape (N, H, G)
    probability, low, high : ndarray, shape (H, G)
        Share in the population: median, 5 % and 95 % quantile of its posterior.
    mean_user : ndarray of bool, shape (H, G)
        Whether the loop is stable with the population's centre: the result for one average user.
    mean_user_limit : ndarray, shape (H,)
        Stiffness limit of the centre in N/m, for each damping.
    classical : ndarray, shape (H,)
        Largest stiffness of the bound b > K T/2 + abs(B).
    effective_users : float
        Median of n over populations.
    """

    device: Device
    stiffness: np.ndarray
    damping: np.ndarray
    users: Users
    stable: np.ndarray
    probability: np.ndarray
    low: np.ndarray
    high: np.ndarray
    mean_user: np.ndarray
    mean_user_limit: np.ndarray
    classical: np.ndarray
    effective_users: float

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each pair of gains: share of users with its 90 % interval, and whether the centre is stable."""
        import pandas as pd

        damping, stiffness = np.meshgrid(self.damping, self.stiffness, indexing="ij")
        frame = pd.DataFrame(
            {
                "damping": damping.ravel(),
                "stiffness": stiffness.ravel(),
                "share": self.probability.ravel(),
                "share_q05": self.low.ravel(),
                "share_q95": self.high.ravel(),
                "mean_user_stable": self.mean_user.ravel(),
            }
        )
        frame.attrs["units"] = {"damping": "N s/m", "stiffness": "N/m"}
        return frame


@dataclass(frozen=True, kw_only=True, repr=False)
class Limit(Brief):
    """Stiffness up to which the loop is stable for a share of the users, at one virtual damping.

    Attributes
    ----------
    damping : float
        B in N s/m.
    share : float
    stiffness, low, high : float
        Limit in N/m for that share of the population: median, 5 % and 95 % quantile of its posterior.
    mean_user, mean_user_hz : float
        Limit of the population's centre, and the frequency of the oscillation there.
    classical : float
        Limit in N/m by the classical bound.
    each, each_hz : ndarray, shape (N,)
        Limit of each user in N/m, and the frequency of the oscillation there.
    worst : int
        Row of the user with the smallest limit.
    """

    damping: float
    share: float
    stiffness: float
    low: float
    high: float
    mean_user: float
    mean_user_hz: float
    classical: float
    each: np.ndarray
    each_hz: np.ndarray
    worst: int


@dataclass(frozen=True, repr=False)
class Reason(Brief):
    """Attribution to the elements of the difference between a user's limit and the centre's.

    Attributes
    ----------
    elements : tuple of str
        Names, the most important first.
    change : ndarray, shape (P,)
        Natural logarithm of the element's value relative to the centre's.
    part : ndarray, shape (P,)
        Contribution of the element to ln(limit / centre's limit).
    difference : float
        ln(limit / centre's limit).
    """

    elements: tuple[str, ...]
    change: np.ndarray
    part: np.ndarray
    difference: float


def loop_of(device: Device, users: Users) -> SampledLoop:
    """The sampled loop of a device and each of the users."""
    return sampled_loop(device, realised(users))


def stability_map(
    population: UserPopulation,
    users: Users,
    device: Device,
    stiffness: np.ndarray,
    damping: np.ndarray,
    *,
    seed: int = 1,
    populations: int = POPULATIONS,
    workers: int = 2,
    progress: Callable[[str, int, int], None] | None = None,
) -> StabilityMap:
    """Share of users with whom the loop is stable, over a grid of gains.

    Parameters
    ----------
    population : UserPopulation
    users : Users
        Drawn from it.
    device : Device
    stiffness, damping : ndarray, shape (G,) and (H,)
        Gains in N/m and N s/m.
    seed : int
        For the Beta draws that represent the finite number of users.
    populations : int
        Number of posterior draws used.
    workers : int
        Threads.
    progress : callable, optional
    """
    k, b = (x.ravel() for x in np.meshgrid(stiffness, damping))
    shape = (damping.size, stiffness.size)
    found = stable(loop_of(device, users), k, b, workers=workers, progress=progress)
    alone = loop_of(device, population.median_user())
    centre = stable(alone, k, b, workers=1)[0]
    ends = [largest_stiffness(alone, float(d), 10 * float(stiffness[-1]))[0][0] for d in damping]
    weights = population.weights(users, populations)
    effective = 1 / np.sum(weights**2, axis=1)
    share = np.clip(weights @ found, 0.0, 1.0)
    rng = np.random.default_rng(seed)
    draws = rng.beta(0.5 + effective[:, None] * share, 0.5 + effective[:, None] * (1 - share))
    low, middle, high = np.quantile(draws, INTERVAL, axis=0)
    return StabilityMap(
        device=device,
        stiffness=stiffness,
        damping=damping,
        users=users,
        stable=found.reshape(len(users), *shape),
        probability=middle.reshape(shape),
        low=low.reshape(shape),
        high=high.reshape(shape),
        mean_user=centre.reshape(shape),
        mean_user_limit=np.array(ends),
        classical=device.classical_stiffness(damping),
        effective_users=float(np.median(effective)),
    )


def limit_of(
    population: UserPopulation,
    users: Users,
    device: Device,
    damping: float,
    *,
    share: float = 0.99,
    highest: float = 1e6,
    seed: int = 1,
    populations: int = POPULATIONS,
) -> Limit:
    """Stiffness up to which the loop is stable for a share of the users.

    Parameters
    ----------
    population : UserPopulation
    users : Users
        Drawn from it; their own limits are reported. The limit of the share does not depend on them.
    device : Device
    damping : float
        Virtual damping B in N s/m.
    share : float
        Share of users, between 0 and 1.
    highest : float
        Largest stiffness in N/m that is considered.
    seed : int
        For drawing the users from whom the limit of the share is computed.
    populations : int
        Number of posterior draws used.
    """
    each, frequency = largest_stiffness(loop_of(device, users), damping, highest)
    own, own_hz = largest_stiffness(loop_of(device, population.median_user()), damping, highest)
    of_populations = limits_of_populations(
        population, device, damping, share, highest=highest, seed=seed, populations=populations
    )
    low, middle, high = np.quantile(of_populations, INTERVAL)
    return Limit(
        damping=damping,
        share=share,
        stiffness=float(middle),
        low=float(low),
        high=float(high),
        mean_user=float(own[0]),
        mean_user_hz=float(own_hz[0]),
        classical=float(device.classical_stiffness(damping)),
        each=each,
        each_hz=frequency,
        worst=int(np.argmin(each)),
    )


def reason(
    population: UserPopulation, users: Users, row: int, device: Device, damping: float, highest: float = 1e6
) -> Reason:
    """Elements that make one user's limit differ from that of the population's centre.

    Parameters
    ----------
    population : UserPopulation
    users : Users
    row : int
        Row of the user.
    device : Device
    damping : float
        Virtual damping B in N s/m.
    highest : float
        As in :func:`limit_of`.
    """
    start, end = population.centre, users.u[row]
    n = start.size
    steps = (np.arange(_STEPS) + 0.5) / _STEPS
    on_line = start + steps[:, None] * (end - start)
    moved = on_line[:, None, None] + _DIFFERENCE * np.array([1, -1])[:, None, None] * np.eye(n)
    points = np.concatenate([moved.reshape(-1, n), start[None], end[None]])
    people = population.users([str(i) for i in range(len(points))], points)
    logs = np.log(np.maximum(largest_stiffness(loop_of(device, people), damping, highest)[0], 1e-300))
    pairs = logs[:-2].reshape(_STEPS, 2, n)
    gradient = np.mean((pairs[:, 0] - pairs[:, 1]) / (2 * _DIFFERENCE), axis=0)
    part = gradient * (end - start)
    order = np.argsort(-np.abs(part))
    names = tuple(users.elements[i] for i in order)
    change = np.log(values_of(users.network, end) / values_of(users.network, start))
    return Reason(names, change[order], part[order], float(logs[-1] - logs[-2]))
