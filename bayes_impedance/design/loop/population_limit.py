r"""Posterior of the stiffness up to which the loop is stable for a share of a population.

Every population r of the posterior has its own quantile: with :math:`p = 1 - \text{share}` and the largest stable
stiffness :math:`K(\theta)` of a user,

.. math:: P_{\theta \sim N(\mu_r, \Sigma_r)}\left(K(\theta) < q_r\right) = p .

The uncertainty of the population is the spread of :math:`q_r`. The reported limit and its interval are the median and
the outer quantiles of :math:`q_r`. Neither is a quantile of a sample of drawn users: few users do not determine a 1 %
quantile, and users of a few populations hold little information on the others.

**With few stability computations.** :math:`f = \ln K` is smooth in the parameters u (log elements). A quadratic
polynomial :math:`\hat f`, fitted to users of the posterior predictive distribution, takes little time to evaluate, so
that its quantile :math:`\hat q_r` is computed from thousands of users of every population. The exact f is then computed
only for users of population r whose :math:`\hat f` is close to :math:`\hat q_r`, and

.. math:: \ln q_r = \hat q_r + \operatorname{E}\left[f - \hat f \mid \hat f = \hat q_r\right],

which is the first-order change of a quantile under a change of the function [1]_; the remaining error is of the order
of :math:`\operatorname{Var}(f - \hat f)`. If f is linear, there is no error, as quadratic polynomials include linear
ones.

If some users are unstable at every stiffness, or stable at every one, a polynomial cannot approximate :math:`f`. Then
the limits of single users are computed in fewer populations.

References
----------
.. [1] C. Gourieroux, J. P. Laurent, O. Scaillet, "Sensitivity analysis of values at risk", Journal of Empirical
   Finance 7 (2000) 225-245.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.special import ndtri

from bayes_impedance.design.circuits.equivalent import realised
from bayes_impedance.design.loop.device import Device
from bayes_impedance.design.loop.sampled_loop import largest_stiffness, sampled_loop
from bayes_impedance.design.users import UserPopulation

POPULATIONS = 200
"""Number of posterior draws used. By choice: ten of them lie beyond each end of a 90 % interval."""

_BEYOND = 64
"""Virtual users of a population beyond the quantile. With quasi-random points, limits of the demo's population from
different seeds differ by 1 %, a tenth of its interval's half width."""

_LEAST, _MOST = 4096, 32768
"""Fewest and most virtual users of one population. By choice: with fewer, means are not accurate enough; the upper
limit takes seconds."""

_FOR_EACH_COEFFICIENT = 8
"""Users whose limit is computed per coefficient of the polynomial. By choice: the variance of the fitted polynomial is
then an eighth of the residual variance."""

_ASKED = 4
"""Users of each population near the quantile whose limit is computed. By choice: half the residual's standard deviation
remains as an error, far below the differences between populations."""

_HALVINGS = 16
"""Bisections of the interval that contains a limit, 0.2 wide in ln K: a width of 3e-6 remains."""

_DECIDED_POPULATIONS, _DECIDED_USERS = 100, 256
"""Numbers of populations and of users of each, if all users' limits are computed. By choice: it takes half a minute,
with a delay of many periods some minutes."""

_ROUGHLY = 4
"""Bisections in that case: a width of 1 % remains, less than the sampling error of so few users."""


def limits_of_populations(
    population: UserPopulation,
    device: Device,
    damping: float,
    share: float,
    *,
    highest: float,
    seed: int = 1,
    populations: int = POPULATIONS,
) -> np.ndarray:
    """Stiffness up to which the loop is stable for a share of the users, in populations of the posterior.

    Parameters
    ----------
    population : UserPopulation
    device : Device
    damping : float
        Virtual damping B in N s/m.
    share : float
        Share of users, between 0 and 1.
    highest : float
        Largest stiffness in N/m that is considered.
    seed : int
        For drawing the users.
    populations : int
        Number of populations, spread evenly over the draws of the posterior.

    Returns
    -------
    ndarray, shape (R,)
        In N/m; R is `populations`, or less if some limits are zero or `highest`.
    """

    def limits(u: np.ndarray, halvings: int = _HALVINGS) -> np.ndarray:
        people = population.users([str(i) for i in range(len(u))], u)
        loop = sampled_loop(device, realised(people))
        return largest_stiffness(loop, damping, highest, halvings=halvings)[0]

    def decided() -> np.ndarray:
        few = min(populations, _DECIDED_POPULATIONS)
        return _decided(population, lambda people: limits(people, _ROUGHLY), 1 - share, few, seeds[1])

    seeds = np.random.SeedSequence(seed).spawn(3)
    free = np.array([e not in population.fixed for e in population.network.elements])
    basis = _Quadratic(population.centre[free], np.sqrt(np.diag(population.covariance))[free])
    n = _FOR_EACH_COEFFICIENT * basis.size
    rows = np.linspace(0, len(population.mu) - 1, n).astype(int)
    normals = _normals(n, free.size, seeds[0])
    learnt = population.mu[rows] + np.einsum("spq,sq->sp", population.factor[rows], normals)
    known = limits(learnt)
    p = 1 - share
    if not known.any():  # no user is stable at any stiffness
        return np.zeros(populations)
    if not np.all((known > 0) & (known < highest)):
        return decided()

    coefficients = np.linalg.lstsq(basis(learnt[:, free]), np.log(known), rcond=None)[0]
    many = int(np.clip(_BEYOND / min(p, share), _LEAST, _MOST))
    normals = _normals(many, free.size, seeds[2])
    rows = np.unique(np.linspace(0, len(population.mu) - 1, populations).astype(int))
    quantiles, guessed, asked = np.empty(rows.size), np.empty((rows.size, _ASKED)), []
    for i, row in enumerate(rows):
        people = population.mu[row] + normals @ population.factor[row].T
        f = basis(people[:, free]) @ coefficients
        quantiles[i] = np.quantile(f, p)
        near = np.argsort(np.abs(f - quantiles[i]), kind="stable")[:_ASKED]
        guessed[i] = f[near]
        asked.append(people[near])
    exact = limits(np.concatenate(asked))
    if not np.all((exact > 0) & (exact < highest)):
        return decided()
    residual = np.log(exact).reshape(guessed.shape) - guessed
    return np.asarray(np.exp(quantiles + residual.mean(axis=1)))


class _Quadratic:
    """Monomials of the coordinates up to degree two; the coordinates are first standardised."""

    def __init__(self, centre: np.ndarray, scale: np.ndarray) -> None:
        self._centre, self._scale = centre, scale
        self._pairs = np.triu_indices(centre.size)

    @property
    def size(self) -> int:
        """Number of coefficients."""
        return 1 + self._centre.size + int(self._pairs[0].size)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (n, P) to monomials (n, size)."""
        x = (points - self._centre) / self._scale
        return np.concatenate([np.ones((len(x), 1)), x, x[:, self._pairs[0]] * x[:, self._pairs[1]]], axis=1)


def _normals(n: int, dimension: int, seed: np.random.SeedSequence) -> np.ndarray:
    """Quasi-random standard normal points, shape (n, dimension)."""
    from scipy.stats import qmc  # imported here because it takes half a second

    sequence = qmc.Sobol(dimension, rng=np.random.default_rng(seed))
    uniform = sequence.random(2 ** int(np.ceil(np.log2(n))))[:n]
    return np.asarray(ndtri(np.clip(uniform, 1e-12, 1 - 1e-12)))


def _decided(
    population: UserPopulation,
    limits: Callable[[np.ndarray], np.ndarray],
    p: float,
    populations: int,
    seed: np.random.SeedSequence,
) -> np.ndarray:
    """The p-quantile of the limits in each population, shape (R,), with the exact limit of each user."""
    rows = np.unique(np.linspace(0, len(population.mu) - 1, populations).astype(int))
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(rows.size, _DECIDED_USERS, population.mu.shape[1]))
    people = population.mu[rows, None] + np.einsum("rpq,rnq->rnp", population.factor[rows], normals)
    each = limits(people.reshape(-1, population.mu.shape[1])).reshape(rows.size, _DECIDED_USERS)
    return np.asarray(np.quantile(each, p, axis=1))
