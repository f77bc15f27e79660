r"""The full joint posterior of a small population, for numpyro's NUTS: a rival implementation that shares no formula.

Everybody's log elements theta_i, the deviation delta_ij of every repetition and everybody's noise scale s_i are
explicit unknowns next to the population's parameters, and the impedance is the non-linear one:

.. math:: z_{ijk} \sim CN(Z_k(\theta_i + \delta_{ij}), s_i^2 \sigma_{ijk}^2), \qquad
          \theta_i = \mu + \operatorname{diag}(\tau)\, L x_i, \qquad \delta_{ij} = \operatorname{diag}(\rho)\, e_{ij},

with standard normal x and e. NUTS does not move x and e, whose posteriors are narrow and depend on the population, but
u and eta, in which the posterior would be standard normal if the impedance were linear around an expansion point,

.. math:: x_i = m_i(\cdot) + Q_i^{-T/2} u_i, \qquad e_{ij} = n_{ij}(\cdot) + K_{ij}^{-T/2} \eta_{ij} .

That is a change of coordinates with its exact Jacobian: a poor expansion point makes NUTS slow, not wrong.

With tails the covariance of person i is multiplied by an explicit
:math:`\lambda_i \sim \operatorname{IG}(\nu/2, \nu/2)`, and 1/nu is uniform on (0, 1/2).

Dispersions are compared themselves, not their logarithms: a dispersion that may be zero has a lower tail without end in
the logarithm, which both samplers visit seldom and which decides the moments there.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax.scipy.linalg import solve_triangular
from numpyro.diagnostics import effective_sample_size, split_gelman_rubin
from numpyro.infer import MCMC, NUTS
from numpyro.infer.util import unconstrain_fn

from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings

ELEMENTS = ("n3", "r3", "m2", "r1", "n1")

POPULATION = VirtualPopulation(
    network="(n3|r3)-(m2|r1|n1)",
    central={"n3": 2e-5, "r3": 10.0, "m2": 8e-5, "r1": 4.0, "n1": 1.2e-3},
    between_persons={"n3": 0.2, "r3": 0.2, "m2": 0.15, "r1": 0.4, "n1": 0.3},
    between_repetitions={"n3": 0.08, "r3": 0.06, "m2": 0.06, "r1": 0.08, "n1": 0.05},
    correlation={("n3", "r3"): -0.5, ("n1", "r1"): -0.5, ("m2", "r1"): 0.4},
    noise=0.03,
)
"""One person's recordings determine m2, n3 and r3 little better than the spread between persons does.

The choice is not free: where n3 is much smaller, there is a second explanation of everybody, with a large n3 that
stands in for a part of n1, and the posterior of some persons has two modes."""


def virtual_recordings(seed: int = 3, n_subjects: int = 16, outlying: int = 0) -> Recordings:
    """Recordings with a given noise, so that neither side estimates its shape; some people are far from the others."""
    frequency = np.geomspace(5, 5000, 30)
    recordings = simulate_recordings(POPULATION, n_subjects, 3, frequency, seed).recordings
    if outlying:
        away = replace(POPULATION, central={name: 2.5 * value for name, value in POPULATION.central.items()})
        far = simulate_recordings(away, n_subjects, 3, frequency, seed + 1).recordings.subjects[:outlying]
        recordings = replace(recordings, subjects=(*far, *recordings.subjects[outlying:]))
    relative = POPULATION.noise * np.sqrt(1 + (POPULATION.noise_corner_hz / frequency) ** 4)
    subjects = tuple(replace(s, noise_sd=np.tile(relative * np.abs(s.mean), (3, 1))) for s in recordings.subjects)
    return replace(recordings, subjects=subjects)


def impedance(theta: jax.Array, omega: jax.Array) -> jax.Array:
    """Impedance of the network, written out: theta (..., 5) gives (..., F)."""
    n3, r3, m2, r1, n1 = (jnp.exp(theta[..., p : p + 1]) for p in range(5))
    s = 1j * omega
    skin = 1 / (s * n3) + r3
    tissue = s * m2 + r1 + 1 / (s * n1)
    return skin * tissue / (skin + tissue)


@dataclass(frozen=True, kw_only=True)
class Data:
    """Recordings of N persons, J repetitions and F frequencies, and their expansion in P log elements."""

    omega: jax.Array  # (F,)
    z: jax.Array  # (N, J, F)
    sigma: jax.Array  # (N, J, F)
    centre: jax.Array  # (P,), of the prior
    information: jax.Array  # (N, J, P, P)
    pull: jax.Array  # (N, J, P): information times the point where the linearised likelihood is highest


def expand(recordings: Recordings, centre: np.ndarray, points: np.ndarray) -> Data:
    """Expand every recording's likelihood around points (N, J, P)."""
    subjects = recordings.subjects
    omega = jnp.asarray(2 * np.pi * subjects[0].frequency_hz)
    z = jnp.asarray(np.array([s.z for s in subjects]))
    sigma = jnp.asarray(np.array([s.noise_sd for s in subjects]))

    def whitened(theta: jax.Array, z: jax.Array, sigma: jax.Array) -> jax.Array:
        residual = (z - impedance(theta, omega)) / sigma
        return jnp.concatenate([residual.real, residual.imag])

    def twice(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
        return jax.vmap(jax.vmap(function))

    theta = jnp.asarray(points)
    residual = twice(whitened)(theta, z, sigma)
    jacobian = -twice(jax.jacfwd(whitened))(theta, z, sigma)
    information = jnp.einsum("ijkp,ijkq->ijpq", jacobian, jacobian)
    pull = jnp.einsum("ijpq,ijq->ijp", information, theta) + jnp.einsum("ijkp,ijk->ijp", jacobian, residual)
    return Data(omega=omega, z=z, sigma=sigma, centre=jnp.asarray(centre), information=information, pull=pull)


def _transpose(matrix: jax.Array) -> jax.Array:
    return jnp.swapaxes(matrix, -1, -2)


def _down(factor: jax.Array, vector: jax.Array) -> jax.Array:
    """Solve L y = v for batches."""
    return solve_triangular(factor, vector[..., None], lower=True)[..., 0]


def _up(factor: jax.Array, vector: jax.Array) -> jax.Array:
    """Solve L^T y = v for batches."""
    return solve_triangular(factor, vector[..., None], lower=True, trans=1)[..., 0]


def _log_diagonal(factor: jax.Array) -> jax.Array:
    return jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)))


def model(data: Data, tails: bool = False) -> None:
    """The joint posterior."""
    n, j, p = data.pull.shape
    mu = numpyro.sample("mu", dist.Normal(data.centre, 3.0).to_event(1))
    tau = numpyro.sample("tau", dist.HalfNormal(1.0).expand([p]).to_event(1))
    rho = numpyro.sample("rho", dist.HalfNormal(1.0).expand([p]).to_event(1))
    correlation = numpyro.sample("correlation", dist.LKJCholesky(p, 2.0))
    s2 = numpyro.sample("s2", dist.InverseGamma(2.0, 2.0).expand([n]).to_event(1))
    u = numpyro.sample("u", dist.Normal().expand([n, p]).to_event(2))
    eta = numpyro.sample("eta", dist.Normal().expand([n, j, p]).to_event(3))

    h = data.information / s2[:, None, None, None]
    b = data.pull / s2[:, None, None]
    k = jnp.linalg.cholesky(jnp.eye(p) + rho[:, None] * h * rho)
    v = solve_triangular(k, rho[:, None] * h, lower=True)
    w = _down(k, rho * b)
    marginal_h = jnp.sum(h - _transpose(v) @ v, axis=1)
    marginal_b = jnp.sum(b - jnp.einsum("ijqp,ijq->ijp", v, w), axis=1)
    spread = jnp.broadcast_to(tau[:, None] * correlation, (n, p, p))
    if tails:
        tail = numpyro.sample("tail", dist.Uniform(0.0, 0.5))
        factor = numpyro.sample("factor", dist.InverseGamma(0.5 / tail, 0.5 / tail).expand([n]).to_event(1))
        spread = jnp.sqrt(factor)[:, None, None] * spread
    q = jnp.linalg.cholesky(jnp.eye(p) + _transpose(spread) @ marginal_h @ spread)
    x = _up(q, _down(q, jnp.einsum("ip,ipq->iq", marginal_b - marginal_h @ mu, spread)) + u)
    theta = mu + jnp.einsum("ipq,iq->ip", spread, x)
    e = _up(k, w - jnp.einsum("ijqp,ip->ijq", v, theta) + eta)
    own = theta[:, None] + rho * e

    residual = data.z - impedance(own, data.omega)
    chi = jnp.sum((residual.real**2 + residual.imag**2) / data.sigma**2, axis=(1, 2))
    likelihood = jnp.sum(-0.5 * chi / s2 - data.z[0].size * jnp.log(s2))
    prior = -0.5 * (jnp.sum(x**2) + jnp.sum(e**2))
    jacobian = -_log_diagonal(q) - _log_diagonal(k)
    instead_of = -0.5 * (jnp.sum(u**2) + jnp.sum(eta**2))
    numpyro.factor("posterior", likelihood + prior + jacobian - instead_of)
    numpyro.deterministic("mean", own.mean(axis=1))


@dataclass(frozen=True)
class Samples:
    """Draws of named scalars, each of shape (chains, draws), and the seconds that they took."""

    values: dict[str, np.ndarray]
    seconds: float
    divergences: int = 0


def run_nuts(fit: PopulationFit, warmup: int = 800, draws: int = 2400, seed: int = 1) -> Samples:
    """Four chains, from places twice as far apart as the posterior of the fit is wide."""
    jax.config.update("jax_enable_x64", True)
    started = time.perf_counter()
    person = fit.person_draws.mean(axis=(0, 1))
    data = expand(fit.recordings, fit.prior.centre, person[:, None] + np.array(fit.deviations))
    n, j, p = data.pull.shape
    rng = np.random.default_rng(seed)
    starts, tails = [], fit.parameters.tail is not None
    for row in rng.integers(0, fit.parameters.mu.shape[0], 4):
        some = fit.parameters
        start = {
            "mu": 2 * some.mu[row] - some.mu.mean(axis=0),
            "tau": some.between_persons[row] ** 2 / some.between_persons.mean(axis=0),
            "rho": np.maximum(some.between_repetitions[row], 1e-3),
            "correlation": some.correlation_cholesky[row],
            "s2": rng.uniform(0.5, 2, n),
            "u": rng.normal(size=(n, p)),
            "eta": rng.normal(size=(n, j, p)),
        }
        if some.tail is not None:
            start |= {"tail": some.tail[row], "factor": np.ones(n)}
        starts.append(unconstrain_fn(model, (data, tails), {}, {name: jnp.asarray(v) for name, v in start.items()}))
    stacked = {name: jnp.stack([s[name] for s in starts]) for name in starts[0]}
    dense = [("mu", "tau", "rho", "correlation", *(("tail", "factor") if tails else ()))]
    kernel = NUTS(model, dense_mass=dense, target_accept_prob=0.9)
    mcmc = MCMC(
        kernel, num_warmup=warmup, num_samples=draws, num_chains=4, chain_method="vectorized", progress_bar=False
    )
    mcmc.run(jax.random.PRNGKey(seed), data, tails, init_params=stacked, extra_fields=("diverging",))
    found: dict[str, Any] = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    factor = found["correlation"]
    values = _named(found["mu"], found["tau"], found["rho"], factor @ np.swapaxes(factor, -1, -2), found["mean"])
    if tails:
        values["tail"] = found["tail"]
    divergences = int(mcmc.get_extra_fields()["diverging"].sum())
    return Samples(values, time.perf_counter() - started, divergences)


def from_fit(fit: PopulationFit) -> Samples:
    """The package's own draws, ensembles as chains."""
    some, e = fit.parameters, fit.n_ensembles
    blocks = (some.mu, some.between_persons, some.between_repetitions, some.correlation)
    split = [b.reshape(e, -1, *b.shape[1:]) for b in blocks]
    values = _named(*split, fit.person_draws)
    if some.tail is not None:
        values["tail"] = some.tail.reshape(e, -1)
    return Samples(values, sum(fit.seconds.values()))


def _named(
    mu: np.ndarray, tau: np.ndarray, rho: np.ndarray, correlation: np.ndarray, mean: np.ndarray
) -> dict[str, np.ndarray]:
    values = {f"mu {e}": mu[..., p] for p, e in enumerate(ELEMENTS)}
    values |= {f"tau {e}": tau[..., p] for p, e in enumerate(ELEMENTS)}
    values |= {f"rho {e}": rho[..., p] for p, e in enumerate(ELEMENTS)}
    for p in range(len(ELEMENTS)):
        values |= {f"corr {ELEMENTS[q]} {ELEMENTS[p]}": correlation[..., p, q] for q in range(p)}
    for i in range(mean.shape[2]):
        values |= {f"person {i + 1} {e}": mean[:, :, i, p] for p, e in enumerate(ELEMENTS)}
    return values


@dataclass(frozen=True, kw_only=True)
class Moments:
    """Mean and standard deviation of one quantity, with standard errors."""

    mean: float
    mean_error: float
    sd: float
    sd_error: float
    effective: float
    rhat: float

    @classmethod
    def of(cls, chains: np.ndarray) -> Moments:
        """From draws of shape (chains, draws)."""
        square = (chains - chains.mean()) ** 2
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # constant chains: the NaN fails the comparison
            effective, of_square = float(effective_sample_size(chains)), float(effective_sample_size(square))
            rhat = float(split_gelman_rubin(chains))
        sd = float(chains.std())
        variance_error = float(square.std()) / np.sqrt(of_square)
        return cls(
            mean=float(chains.mean()),
            mean_error=sd / np.sqrt(effective),
            sd=sd,
            sd_error=variance_error / (2 * sd),
            effective=effective,
            rhat=rhat,
        )


@dataclass(frozen=True)
class Comparison:
    """One quantity, ours against NUTS."""

    name: str
    ours: Moments
    nuts: Moments

    @property
    def shift(self) -> float:
        """Difference of the means in posterior standard deviations."""
        return (self.ours.mean - self.nuts.mean) / self.nuts.sd

    @property
    def shift_error(self) -> float:
        """Standard error of the shift."""
        return float(np.hypot(self.ours.mean_error, self.nuts.mean_error)) / self.nuts.sd

    @property
    def spread(self) -> float:
        """Ratio of the standard deviations."""
        return self.ours.sd / self.nuts.sd

    @property
    def spread_error(self) -> float:
        """Standard error of the ratio."""
        return self.spread * float(np.hypot(self.ours.sd_error / self.ours.sd, self.nuts.sd_error / self.nuts.sd))


def compare(ours: Samples, nuts: Samples) -> list[Comparison]:
    """Every quantity in both."""
    return [Comparison(name, Moments.of(ours.values[name]), Moments.of(nuts.values[name])) for name in nuts.values]


MEAN, SPREAD, ERRORS = 0.15, 0.10, 3.0
"""Allowances: posterior standard deviations of a mean, relative for a spread, and standard errors beside them."""


def differing(table: Sequence[Comparison]) -> list[str]:
    """Quantities beyond the allowances, one line each."""
    found = []
    for c in table:
        if not abs(c.shift) < MEAN + ERRORS * c.shift_error:
            found.append(f"{c.name}: mean off by {c.shift:.3f} +- {c.shift_error:.3f} sd")
        if not abs(c.spread - 1) < SPREAD + ERRORS * c.spread_error:
            found.append(f"{c.name}: spread ratio {c.spread:.3f} +- {c.spread_error:.3f}")
    return found
