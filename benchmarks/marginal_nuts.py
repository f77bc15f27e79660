r"""NUTS on the marginal likelihood, with the same importance draws and the same priors.

.. math:: \ln p(z\,|\,\mu,\tau,L,\rho) = \sum_i \ln \frac1K \sum_k \frac{L_i(\theta_{ik})}{q_i(\theta_{ik})}
          N(\theta_{ik};\, \mu,\, \operatorname{diag}\tau\, LL^T \operatorname{diag}\tau
          + \operatorname{diag}\rho^2/J) + \sum_g \ln p_g(\rho),

written for JAX from the package's draws and contrasts. Only the sampling is compared.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.em import estimate
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.population.recording_noise import initial_likelihoods
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.starting_fits import first_fits
from bayes_impedance.recordings.files import Recordings

_WARMUP, _DRAWS = 300, 900
_PER_PERSON = 64


def prepared(recordings: Recordings, network: str, seed: int) -> Posterior:
    """All steps before the sampling, as in :func:`bayes_impedance.fit_population`."""

    def quiet(_stage: str, _done: int, _total: int) -> None: ...

    kernel = Kernel(parse(network))
    prior = default_prior(kernel, recordings)
    seeds = np.random.SeedSequence(seed).spawn(5)
    n, p = len(recordings.subjects), len(kernel.elements)
    repetitions = np.array([len(s.repetitions) for s in recordings.subjects])
    with ThreadPoolExecutor(2) as executor:
        first = first_fits(kernel, recordings, prior, seeds[0], executor, quiet)
        likelihoods = initial_likelihoods(recordings, first.model, p, executor)
        nothing = np.zeros((n, 0))
        point = estimate(Pooling(kernel), likelihoods, first, prior, nothing, True, seeds[1], quiet)
        posterior = Posterior(repetitions, prior, True, _PER_PERSON, point, nothing)
        posterior.draw(seeds[3], executor, quiet)
    return posterior


def run_nuts_on(posterior: Posterior, centre: np.ndarray, seed: int) -> tuple[dict[str, np.ndarray], float, int]:
    """Draws (4, draws, P) of mu, log tau and log rho, seconds including compilation, and divergences."""
    import jax
    import jax.numpy as jnp
    import numpyro
    import numpyro.distributions as dist
    from numpyro.infer import MCMC, NUTS, init_to_value

    jax.config.update("jax_enable_x64", True)
    started = time.perf_counter()
    theta, log_ratio = (jnp.asarray(a) for a in posterior.marginal.gathered())
    repetitions = int(posterior.repetitions[0])
    groups = [
        (jnp.asarray(np.moveaxis(g.information, -1, 0)), jnp.asarray(g.gradient.T)) for g in posterior.point.contrasts
    ]
    p = theta.shape[-1]

    def model() -> None:
        mu = numpyro.sample("mu", dist.Normal(centre, 3.0).to_event(1))
        tau = numpyro.sample("tau", dist.HalfNormal(1.0).expand([p]).to_event(1))
        rho = numpyro.sample("rho", dist.HalfNormal(1.0).expand([p]).to_event(1))
        factor = numpyro.sample("correlation", dist.LKJCholesky(p, 2.0))
        spread = tau[:, None] * factor
        cholesky = jnp.linalg.cholesky(spread @ spread.T + jnp.diag(rho**2) / repetitions)
        u = jax.scipy.linalg.solve_triangular(cholesky, (theta - mu).reshape(-1, p).T, lower=True)
        log_density = -0.5 * jnp.sum(u**2, axis=0) - jnp.sum(jnp.log(jnp.diag(cholesky)))
        persons = jax.scipy.special.logsumexp(log_ratio + log_density.reshape(log_ratio.shape), axis=1)
        total = jnp.sum(persons)
        for information, gradient in groups:
            d = jnp.tile(rho, information.shape[-1] // p)
            k = jnp.linalg.cholesky(jnp.eye(d.size) + d[:, None] * information * d)
            y = jax.scipy.linalg.solve_triangular(k, (d * gradient)[..., None], lower=True)[..., 0]
            total += 0.5 * jnp.sum(y**2) - jnp.sum(jnp.log(jnp.diagonal(k, axis1=-2, axis2=-1)))
        numpyro.factor("marginal", total)

    point = posterior.point
    start = {
        "mu": jnp.asarray(point.mu),
        "tau": jnp.sqrt(jnp.diag(jnp.asarray(point.covariance))),
        "rho": jnp.maximum(jnp.asarray(point.between_repetitions), 1e-3),
    }
    kernel = NUTS(model, dense_mass=True, init_strategy=init_to_value(values=start))
    mcmc = MCMC(
        kernel, num_warmup=_WARMUP, num_samples=_DRAWS, num_chains=4, chain_method="vectorized", progress_bar=False
    )
    mcmc.run(jax.random.PRNGKey(seed), extra_fields=("diverging",))
    found: dict[str, Any] = {name: np.asarray(v) for name, v in mcmc.get_samples(group_by_chain=True).items()}
    divergences = int(mcmc.get_extra_fields()["diverging"].sum())
    values = {"mu": found["mu"], "tau": np.log(found["tau"]), "rho": np.log(found["rho"])}
    return values, time.perf_counter() - started, divergences
