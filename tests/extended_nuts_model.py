r"""Joint posteriors of populations with power laws, delays and parameters that are the same for everybody, for NUTS.

As in `nuts_model.py` everything of every person is an explicit unknown, and now the shared parameters phi are too:

.. math:: z_{ijk} \sim CN(Z_k(\theta_i + \delta_{ij}, \phi), s_i^2 \sigma_{ijk}^2), \qquad
          \phi \sim N(c, \operatorname{diag} S^2) .

The impedances are written out below for jax. Priors are computed here from the recordings. From the fit come only the
noise estimate sigma, which is part of the data for both, and coordinates and starting points, which give NUTS speed:
x and e are expressed by the variables u and eta in which the posterior would be standard normal if the impedance were
linear around the fit's mean, in theta and in phi (change of coordinates with its exact Jacobian).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from jax.scipy.linalg import solve_triangular
from numpyro.infer import MCMC, NUTS
from numpyro.infer.util import unconstrain_fn
from nuts_model import Samples

from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.recordings.files import Recordings, Subject

Impedance = Callable[[jax.Array, jax.Array, jax.Array], jax.Array]
"""Impedance (..., F) from theta (..., V), phi (S,) and angular frequency (F,)."""


def springpot(theta: jax.Array, phi: jax.Array, omega: jax.Array) -> jax.Array:
    """``m1|r1|p1^a1@70``: a mass, a damper and a power law move together; the exponent's logit may be shared."""
    u = [theta[..., p : p + 1] for p in range(theta.shape[-1])]
    m1, r1, p1 = (jnp.exp(x) for x in u[:3])
    a1 = jax.nn.sigmoid(u[3] if len(u) == 4 else phi[0])
    # (j w/w0)^(a-1), in polar form
    x = a1 - 1
    power = jnp.exp(x * jnp.log(omega / (2 * jnp.pi * 70.0)) + 0.5j * jnp.pi * x)
    return 1j * omega * m1 + r1 + p1 * power


def delayed(theta: jax.Array, phi: jax.Array, omega: jax.Array) -> jax.Array:
    """``delay[d1*]((n3|r3)-(m2|r1|n1))``: the force of a skin in series with a tissue comes late by d1 seconds."""
    n3, r3, m2, r1, n1 = (jnp.exp(theta[..., p : p + 1]) for p in range(5))
    s = 1j * omega
    skin = 1 / (s * n3) + r3
    tissue = s * m2 + r1 + 1 / (s * n1)
    return skin * tissue / (skin + tissue) * jnp.exp(-s * phi[0])


@dataclass(frozen=True, kw_only=True)
class Case:
    """A virtual population and its network.

    Attributes
    ----------
    network : str
    impedance : Impedance
    values : dict
        Each parameter's central value; of the shared ones, the value. In the network's order.
    shared : tuple of str
    repetitions : int
    correlated : bool
        Whether the covariance between persons is estimated in full.
    noise : float
        Relative to the impedance.
    between_persons, between_repetitions : float
        Standard deviations of every u.
    """

    network: str
    impedance: Impedance
    values: dict[str, float]
    shared: tuple[str, ...] = ()
    repetitions: int = 1
    correlated: bool = False
    noise: float = 0.02
    between_persons: float = 0.2
    between_repetitions: float = 0.05
    persons: int = 20
    frequencies: int = 50

    @property
    def varying(self) -> tuple[str, ...]:
        """Parameters that differ between persons."""
        return tuple(name for name in self.values if name not in self.shared)


_SPRINGPOT = {"m1": 5e-3, "r1": 1.0, "p1": 3.0, "a1": 0.3}
_DELAYED = {"n3": 1e-4, "r3": 30.0, "m2": 1e-3, "r1": 2.0, "n1": 1e-3, "d1": 2e-4}
_DELAY, _SHARED_EXPONENT = "delay[d1*]((n3|r3)-(m2|r1|n1))", "m1|r1|p1^a1*@70"

CASES = {
    "springpot": Case(network="m1|r1|p1^a1@70", impedance=springpot, values=_SPRINGPOT, repetitions=2, correlated=True),
    "shared exponent": Case(network=_SHARED_EXPONENT, impedance=springpot, values=_SPRINGPOT, shared=("a1",)),
    "shared exponent, repeated": Case(
        network=_SHARED_EXPONENT,
        impedance=springpot,
        values=_SPRINGPOT,
        shared=("a1",),
        repetitions=2,
        correlated=True,
    ),
    "delay": Case(network=_DELAY, impedance=delayed, values=_DELAYED, shared=("d1",)),
    "delay, repeated": Case(
        network=_DELAY, impedance=delayed, values=_DELAYED, shared=("d1",), repetitions=2, correlated=True
    ),
}


def _unbounded(name: str, value: float) -> float:
    """The scale on which a parameter is estimated: logit of an exponent, the delay itself, else the logarithm."""
    if name[0] == "a":
        return float(np.log(value / (1 - value)))
    return value if name[0] == "d" else float(np.log(value))


def recordings_of(case: Case, seed: int = 0) -> Recordings:
    """Virtual recordings with proportional noise that the package has to estimate."""
    jax.config.update("jax_enable_x64", True)
    rng = np.random.default_rng(seed)
    frequency = np.geomspace(5, 1000, case.frequencies)
    mean = np.array([_unbounded(name, case.values[name]) for name in case.varying])
    phi = jnp.asarray([_unbounded(name, case.values[name]) for name in case.shared])
    subjects = []
    for i in range(case.persons):
        own = mean + case.between_persons * rng.normal(size=mean.size)
        own = own + case.between_repetitions * rng.normal(size=(case.repetitions, mean.size))
        exact = np.asarray(case.impedance(jnp.asarray(own), phi, jnp.asarray(2 * np.pi * frequency)))
        z = exact * (1 + case.noise * (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)))
        names = tuple(str(j + 1) for j in range(case.repetitions))
        subjects.append(Subject(name=f"P{i + 1:02d}", repetitions=names, frequency_hz=frequency, z=z, noise_sd=None))
    return Recordings(subjects=tuple(subjects), title="virtual", unit="N s/m", network=None, source=None, licence=None)


def prior_of(case: Case, recordings: Recordings) -> dict[str, tuple[float, float]]:
    """Prior mean and standard deviation of every parameter, on the scale on which it is estimated."""
    magnitude = np.median([np.mean(np.log(np.abs(s.z.mean(axis=0)))) for s in recordings.subjects])
    omega = 2 * np.pi * np.exp(np.median([np.mean(np.log(s.frequency_hz)) for s in recordings.subjects]))
    natural = {
        "m": magnitude - np.log(omega),
        "n": -magnitude - np.log(omega),
        "r": magnitude,
        "p": magnitude,
    }
    found = {}
    for name in case.values:
        if name[0] == "a":
            found[name] = 0.0, 1.5
        elif name[0] == "d":
            found[name] = 0.0, 3.0 / omega
        elif name[0] == "f":
            found[name] = 0.0, 3.0 * omega / (2 * np.pi)
        else:
            found[name] = float(natural[name[0]]), 3.0
    return found


@dataclass(frozen=True, kw_only=True)
class Data:
    """Recordings of N persons, J repetitions and F frequencies, and their expansion in V + S parameters."""

    case: Case
    omega: jax.Array  # (F,)
    z: jax.Array  # (N, J, F)
    sigma: jax.Array  # (N, J, F)
    prior: jax.Array  # (2, V): means and standard deviations
    shared_prior: jax.Array  # (2, S)
    around: jax.Array  # (S,): shared parameters of the expansion
    width: jax.Array  # (S,): unit in which NUTS moves them
    information: jax.Array  # (N, J, V, V)
    mixed: jax.Array  # (N, J, V, S)
    pull: jax.Array  # (N, J, V): information times the point where the linearised likelihood is highest


def expand(case: Case, fit: PopulationFit) -> Data:
    """Expand every recording's likelihood around the fit's posterior means."""
    subjects = fit.recordings.subjects
    omega = jnp.asarray(2 * np.pi * subjects[0].frequency_hz)
    z = jnp.asarray(np.array([s.z for s in subjects]))
    # The noise of the fit holds each person's scale, which is unknown here.
    sigma = jnp.asarray(np.array([n / s for n, s in zip(fit.noise, fit.noise_scale, strict=True)]))
    names = fit.kernel.elements
    varying = [names.index(name) for name in case.varying]
    shared = [names.index(name) for name in case.shared]
    prior = prior_of(case, fit.recordings)
    person = fit.person_draws.mean(axis=(0, 1))
    theta = jnp.asarray((person[:, None] + np.array(fit.deviations))[..., varying])
    phi = jnp.asarray(fit.parameters.mu[:, shared].mean(axis=0))

    def whitened(theta: jax.Array, phi: jax.Array, z: jax.Array, sigma: jax.Array) -> jax.Array:
        residual = (z - case.impedance(theta, phi, omega)) / sigma
        return jnp.concatenate([residual.real, residual.imag])

    def twice(function: Callable[..., jax.Array]) -> Callable[..., jax.Array]:
        own = (0, None, 0, 0)
        return jax.vmap(jax.vmap(function, own), own)

    residual = twice(whitened)(theta, phi, z, sigma)
    jacobian = -twice(jax.jacfwd(whitened, 0))(theta, phi, z, sigma)
    of_shared = -twice(jax.jacfwd(whitened, 1))(theta, phi, z, sigma)
    information = jnp.einsum("ijkp,ijkq->ijpq", jacobian, jacobian)
    pull = jnp.einsum("ijpq,ijq->ijp", information, theta) + jnp.einsum("ijkp,ijk->ijp", jacobian, residual)
    return Data(
        case=case,
        omega=omega,
        z=z,
        sigma=sigma,
        prior=jnp.asarray([prior[name] for name in case.varying]).T,
        shared_prior=jnp.asarray([prior[name] for name in case.shared]).reshape(-1, 2).T,
        around=phi,
        width=jnp.asarray(fit.parameters.mu[:, shared].std(axis=0)),
        information=information,
        mixed=jnp.einsum("ijkp,ijks->ijps", jacobian, of_shared),
        pull=pull,
    )


def _transpose(matrix: jax.Array) -> jax.Array:
    return jnp.swapaxes(matrix, -1, -2)


def _down(factor: jax.Array, vector: jax.Array) -> jax.Array:
    return solve_triangular(factor, vector[..., None], lower=True)[..., 0]


def _up(factor: jax.Array, vector: jax.Array) -> jax.Array:
    return solve_triangular(factor, vector[..., None], lower=True, trans=1)[..., 0]


def _log_diagonal(factor: jax.Array) -> jax.Array:
    return jnp.sum(jnp.log(jnp.diagonal(factor, axis1=-2, axis2=-1)))


def model(data: Data) -> None:
    """The joint posterior."""
    n, j, p = data.pull.shape
    repeated = j > 1
    mu = numpyro.sample("mu", dist.Normal(*data.prior).to_event(1))
    tau = numpyro.sample("tau", dist.HalfNormal(1.0).expand([p]).to_event(1))
    correlation = jnp.eye(p)
    if data.case.correlated:
        correlation = numpyro.sample("correlation", dist.LKJCholesky(p, 2.0))
    s2 = numpyro.sample("s2", dist.InverseGamma(2.0, 2.0).expand([n]).to_event(1))
    u = numpyro.sample("u", dist.Normal().expand([n, p]).to_event(2))
    phi = data.around
    if data.around.size:
        real = dist.ImproperUniform(dist.constraints.real, (), (data.around.size,))
        phi = data.around + data.width * numpyro.sample("moved", real)
        numpyro.factor("shared", dist.Normal(*data.shared_prior).log_prob(phi).sum())
        numpyro.deterministic("phi", phi)

    h = data.information / s2[:, None, None, None]
    b = (data.pull - data.mixed @ (phi - data.around)) / s2[:, None, None]
    spread = tau[:, None] * correlation
    marginal_h, marginal_b = h[:, 0], b[:, 0]
    if repeated:
        rho = numpyro.sample("rho", dist.HalfNormal(1.0).expand([p]).to_event(1))
        eta = numpyro.sample("eta", dist.Normal().expand([n, j, p]).to_event(3))
        k = jnp.linalg.cholesky(jnp.eye(p) + rho[:, None] * h * rho)
        v = solve_triangular(k, rho[:, None] * h, lower=True)
        w = _down(k, rho * b)
        marginal_h = jnp.sum(h - _transpose(v) @ v, axis=1)
        marginal_b = jnp.sum(b - jnp.einsum("ijqp,ijq->ijp", v, w), axis=1)
    q = jnp.linalg.cholesky(jnp.eye(p) + spread.T @ marginal_h @ spread)
    x = _up(q, _down(q, (marginal_b - marginal_h @ mu) @ spread) + u)
    theta = mu + x @ spread.T
    own = theta[:, None]
    change = -0.5 * jnp.sum(x**2) - _log_diagonal(q) + 0.5 * jnp.sum(u**2)
    if repeated:
        e = _up(k, w - jnp.einsum("ijqp,ip->ijq", v, theta) + eta)
        own = own + rho * e
        change += -0.5 * jnp.sum(e**2) - _log_diagonal(k) + 0.5 * jnp.sum(eta**2)

    residual = data.z - data.case.impedance(own, phi, data.omega)
    chi = jnp.sum((residual.real**2 + residual.imag**2) / data.sigma**2, axis=(1, 2))
    numpyro.factor("posterior", jnp.sum(-0.5 * chi / s2 - data.z[0].size * jnp.log(s2)) + change)
    numpyro.deterministic("mean", own.mean(axis=1))


_ACCEPTED = 0.95
"""Acceptance to which NUTS adapts its steps. By choice: up to 35 of 6000 steps diverged with 0.8, and 3 to
27 now (with a delay and repetitions, by where chains begin)."""


def run_nuts(case: Case, fit: PopulationFit, warmup: int = 600, draws: int = 1500, seed: int = 1) -> Samples:
    """Four chains, from places twice as far apart as the posterior of the fit is wide."""
    jax.config.update("jax_enable_x64", True)
    started = time.perf_counter()
    data = expand(case, fit)
    n, j, p = data.pull.shape
    rng = np.random.default_rng(seed)
    chosen = np.array([fit.kernel.elements.index(name) for name in case.varying])
    some = fit.parameters
    starts = []
    for row in rng.integers(0, len(some.mu), 4):
        start = {
            "mu": (2 * some.mu[row] - some.mu.mean(axis=0))[chosen],
            "tau": some.between_persons[row, chosen] ** 2 / some.between_persons.mean(axis=0)[chosen],
            "s2": rng.uniform(0.5, 2, n),
            "u": rng.normal(size=(n, p)),
        }
        if case.shared:
            start["moved"] = 2 * rng.normal(size=len(case.shared))
        if case.correlated:
            start["correlation"] = some.correlation_cholesky[row][np.ix_(chosen, chosen)]
        if case.repetitions > 1:
            start["rho"] = np.maximum(some.between_repetitions[row, chosen], 1e-3)
            start["eta"] = rng.normal(size=(n, j, p))
        starts.append(unconstrain_fn(model, (data,), {}, {name: jnp.asarray(v) for name, v in start.items()}))
    stacked = {name: jnp.stack([s[name] for s in starts]) for name in starts[0]}
    dense = tuple(name for name in ("mu", "tau", "rho", "correlation", "moved") if name in stacked)
    mcmc = MCMC(
        NUTS(model, dense_mass=[dense], target_accept_prob=_ACCEPTED),
        num_warmup=warmup,
        num_samples=draws,
        num_chains=4,
        chain_method="vectorized",
        progress_bar=False,
    )
    mcmc.run(jax.random.PRNGKey(seed), data, init_params=stacked, extra_fields=("diverging",))
    found: dict[str, Any] = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    factor = found.get("correlation")
    values = _named(
        case,
        found["mu"],
        found.get("phi"),
        found["tau"],
        found.get("rho"),
        None if factor is None else factor @ np.swapaxes(factor, -1, -2),
        found["mean"],
    )
    divergences = int(mcmc.get_extra_fields()["diverging"].sum())
    return Samples(values, time.perf_counter() - started, divergences)


def from_fit(case: Case, fit: PopulationFit) -> Samples:
    """The package's own draws, ensembles as chains."""
    some, names = fit.parameters, fit.kernel.elements
    v, s = [names.index(name) for name in case.varying], [names.index(name) for name in case.shared]

    def chains(block: np.ndarray) -> np.ndarray:
        return block.reshape(fit.n_ensembles, -1, *block.shape[1:])

    return Samples(
        _named(
            case,
            chains(some.mu[:, v]),
            chains(some.mu[:, s]) if s else None,
            chains(some.between_persons[:, v]),
            chains(some.between_repetitions[:, v]) if case.repetitions > 1 else None,
            chains(some.correlation[:, np.array(v)[:, None], v]) if case.correlated else None,
            fit.person_draws[..., v],
        ),
        sum(fit.seconds.values()),
    )


def _named(
    case: Case,
    mu: np.ndarray,
    phi: np.ndarray | None,
    tau: np.ndarray,
    rho: np.ndarray | None,
    correlation: np.ndarray | None,
    mean: np.ndarray,
) -> dict[str, np.ndarray]:
    names = case.varying
    values = {f"mu {e}": mu[..., p] for p, e in enumerate(names)}
    if phi is not None:
        values |= {f"shared {e}": phi[..., p] for p, e in enumerate(case.shared)}
    values |= {f"log tau {e}": np.log(tau[..., p]) for p, e in enumerate(names)}
    if rho is not None:
        values |= {f"log rho {e}": np.log(rho[..., p]) for p, e in enumerate(names)}
    if correlation is not None:
        for p, e in enumerate(names):
            values |= {f"corr {names[q]} {e}": correlation[..., p, q] for q in range(p)}
    for i in range(mean.shape[2]):
        values |= {f"person {i + 1} {e}": mean[:, :, i, p] for p, e in enumerate(names)}
    return values
