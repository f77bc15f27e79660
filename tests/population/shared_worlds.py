"""People made by hand whose network has parameters that are the same for everybody, and their moved draws."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.importance_draws import Draws, Reference, draw
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.marginal_likelihood import Ridge, find_ridge
from bayes_impedance.population.e_step import PersonFit, expect
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.shared import Placed, Pooling, SharedEquations, shared_equations
from bayes_impedance.population.shared_draws import Sharing, moved

VALUES = {"m1": 2e-3, "r1": 2.0, "n1": 1e-3, "d1": 2e-4, "m9": 1e-3}
ONE, TWO = "delay[d1*](r1|n1)", "delay[d1*](m9*|(r1-n1))"
FREQUENCY = np.geomspace(5, 500, 30)


@dataclass(frozen=True)
class World:
    """Persons whose population is known: the mean (V,), dispersions (V,) and shared parameters (S,)."""

    pooling: Pooling
    phi: np.ndarray
    mean: np.ndarray
    tau: np.ndarray
    rho: np.ndarray
    likelihoods: tuple[Likelihood, ...]

    @property
    def covariance(self) -> np.ndarray:
        """Of the means over a person's repetitions."""
        return np.diag(self.tau**2 + self.rho**2 / len(self.likelihoods[0].z))


def world(network: str, repetitions: int, persons: int, noise: float = 0.05, seed: int = 0) -> World:
    """Persons, and repetitions of different noise; without noise each person is the population's mean."""
    kernel = Kernel(parse(network), scales={"d1": 1e-3})
    pooling, rng = Pooling.of(kernel), np.random.default_rng(seed)
    u = np.array([p.u(VALUES[p.name]) for p in kernel.parameters])
    u[[e == "d1" for e in kernel.elements]] /= 1e-3
    mean, phi = u[pooling.varying], u[pooling.shared]
    tau, rho = np.full(mean.size, 0.2), np.full(mean.size, 0.08 * (repetitions > 1))
    likelihoods = []
    for _ in range(persons):
        own = mean + (noise > 0) * tau * rng.normal(size=mean.size)
        own = own + (noise > 0) * rho * rng.normal(size=(repetitions, mean.size))
        z = kernel.impedance(pooling.whole(own, phi), FREQUENCY)
        relative = max(noise, 0.05) * np.linspace(1, 0.6, repetitions)[:, None]
        errors = rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)
        noisy = z * (1 + (noise > 0) * relative * errors)
        likelihoods.append(Likelihood.make(FREQUENCY, noisy, relative * np.abs(z), np.zeros_like(own)))
    return World(pooling, phi, mean, tau, rho, tuple(likelihoods))


def fitted(w: World, phi: np.ndarray, likelihood: Likelihood) -> PersonFit:
    """A person's mode and that of the deviations."""
    fit: Placed | PersonFit = Placed(w.mean, likelihood.deviations)
    for _ in range(60):
        before = fit
        fit = expect(
            w.pooling.at(phi), np.linalg.inv(w.covariance), w.rho, likelihood, fit, w.mean, np.zeros((0, w.mean.size))
        )
        if np.abs(fit.deviations - before.deviations).max() < 1e-10:
            break
    assert isinstance(fit, PersonFit)
    return fit


def equations(w: World, phi: np.ndarray, likelihood: Likelihood, fit: PersonFit) -> SharedEquations:
    """A person's equations at the mode."""
    precision, mode = np.linalg.inv(w.covariance), fit.mode
    return shared_equations(w.pooling, phi, precision, w.rho, likelihood, mode.theta, mode.scale, fit.deviations)


def drawn(
    w: World, phi: np.ndarray, likelihood: Likelihood, fit: PersonFit, n: int, seed: int
) -> tuple[Draws, Ridge, Reference, Likelihood]:
    """Importance draws of one person at shared parameters (S,)."""
    kernel, here = w.pooling.at(phi), likelihood.moved(fit.deviations)
    ridge = find_ridge(kernel, here, fit.theta, fit.mode.scale, w.rho)
    reference = Reference(w.mean, 1.3 * w.covariance)
    return draw(kernel, here, fit.mode, ridge, reference, n, np.random.SeedSequence(seed)), ridge, reference, here


@dataclass(frozen=True)
class MovedWorld:
    """A world's moved draws: what a fit would keep."""

    sharing: Sharing
    marginal: ImportanceLikelihood
    constants: np.ndarray
    draws: int
    draws_of_persons: list[Draws]


def moved_world(w: World, n: int) -> MovedWorld:
    """Draws of everybody at the true shared parameters, to be moved as far as the recordings of all leave open."""
    fits = [fitted(w, w.phi, own) for own in w.likelihoods]
    told = [equations(w, w.phi, own, fit) for own, fit in zip(w.likelihoods, fits, strict=True)]
    weak = 1e-6 * np.eye(w.phi.size + w.mean.size)
    covariance = np.linalg.inv(np.sum([e.curvature for e in told], axis=0) + weak)[: w.phi.size, : w.phi.size]
    sharing = Sharing.around(w.pooling, w.phi, covariance, range(w.phi.size))
    draws, how = [], []
    for i, (own, fit, e) in enumerate(zip(w.likelihoods, fits, told, strict=True)):
        mine, ridge, reference, here = drawn(w, w.phi, own, fit, n, i)
        mine, along = moved(sharing, e, here, ridge, reference, mine)
        draws.append(mine)
        how.append(along)
    persons, repetitions = len(draws), len(w.likelihoods[0].z)
    marginal = ImportanceLikelihood(
        draws,
        np.tile(w.mean, (persons, 1)),
        1.3 * w.covariance,
        np.full(persons, repetitions),
        np.zeros((persons, 0)),
        (),
        sharing,
        how,
    )
    return MovedWorld(sharing, marginal, np.array([d.log_ratio.max() for d in draws]), n, draws)


def populations(w: World, sharing: Sharing, t: np.ndarray, seed: int = 5) -> PopulationParameters:
    """Shared parameters at t (W, S), each with a population of its own near the true one."""
    rng, size = np.random.default_rng(seed), (len(t), w.mean.size)
    return PopulationParameters(
        mu=w.mean + 0.05 * rng.normal(size=size),
        between_persons=w.tau * np.exp(0.1 * rng.normal(size=size)),
        correlation_cholesky=np.tile(np.eye(w.mean.size), (len(t), 1, 1)),
        between_repetitions=np.tile(w.rho, (len(t), 1)),
        slopes=np.zeros((*size, 0)),
        shared=sharing.origin + t @ sharing.factor.T,
    )


def directions(size: int) -> np.ndarray:
    """Values of t up to two standard deviations away."""
    far = np.array([-2.0, -1.3, -0.6, 0.0, 0.45, 1.1, 2.0])[:, None]
    if size == 1:
        return far
    return np.vstack([far * [1, 0], far * [0, 1], far * [0.6, 0.8], far * [0.6, -0.8]])
