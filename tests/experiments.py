"""Experiments whose truth is known, an executor without processes, and other things that several test files share."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from conftest import DATA

from bayes_impedance.diagnosis.catalogue.effect import Effect, Scales, registered
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.score_scan import Screening, screen
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.person.likelihood import Likelihood

PAPER = parse(PAPER_NETWORK)


def printed_eq4(s, v):
    return 1 / (s * v["n3"] / (s * v["r2"] * v["n3"] + 1) + 1 / printed_tissue(s, v))


def random_elements(n=200):
    """Elements over many orders of magnitude."""
    for row in np.random.default_rng(4).normal(0, 3, (n, 8)):
        yield dict(zip(PAPER.elements, np.exp(row), strict=True))


def die_at_once(_connection: Any) -> None:
    """What a process does instead of its work."""
    os._exit(1)


sys.path.insert(0, str(DATA.parent / "analyses" / "concealed"))  # its scripts import each other by name
people, cases = (importlib.import_module(name) for name in ("people", "cases"))


class Serial(Executor):
    """One after the other, so that a failure points at its line."""

    def map(self, fn: Callable[..., Any], *iterables: Iterable[Any], **_: Any) -> Iterator[Any]:
        return map(fn, *iterables)

    def submit(self, fn: Callable[..., Any], /, *arguments: Any, **named: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(fn(*arguments, **named))
        return done


def entry(effect_id: str, operation: str = "") -> Effect:
    """An effect of the catalogue."""
    return next(e for e in registered() if e.id == effect_id and operation in ("", e.operation))


@dataclass(frozen=True)
class Experiment:
    """Recordings of N persons, M in all, and what they were made from.

    Attributes
    ----------
    model : Model
        The network without additions.
    data : tuple of Likelihood
    u : ndarray, shape (M, P)
        True log elements.
    population : Population
    sd : ndarray, shape (N, J, F)
        Noise.
    case : Case or None
        Of ``analyses/concealed``.
    coefficients : ndarray, shape (N,)
        What was concealed, person by person.
    """

    model: Model
    data: tuple[Likelihood, ...]
    u: np.ndarray
    population: Population
    sd: np.ndarray
    case: Any = None
    coefficients: np.ndarray | None = None

    @property
    def refitter(self) -> Refitter:
        return Refitter(self.data, Serial())

    def fit(self, **settings: Any) -> Refit:
        return self.refitter.fit(self.model, self.u, self.population, **{"rounds": 80, **settings})

    def grown(self, *additions: Addition) -> Model:
        return build(self.model.network, additions, self.model.scales, [{} for _ in additions])


def likelihoods(frequency_hz: np.ndarray, z: np.ndarray, sd: np.ndarray, n_elements: int) -> tuple[Likelihood, ...]:
    deviations = np.zeros((z.shape[1], n_elements))
    return tuple(Likelihood.make(frequency_hz, z[i], sd[i], deviations) for i in range(len(z)))


def scales_at(frequency_hz: np.ndarray, z: np.ndarray) -> Scales:
    """Of curves (..., F)."""
    low, middle, high = 0, len(frequency_hz) // 2, -1
    sizes = np.median(np.abs(z).reshape(-1, len(frequency_hz)), axis=0)
    omega = 2 * np.pi * frequency_hz
    names = ("low", "middle", "high", "z_low", "z_middle", "z_high")
    values = [float(a[k]) for a in (omega, sizes) for k in (low, middle, high)]
    return Scales(**dict(zip(names, values, strict=True)), unit="N s/m")


def concealing(
    effect_id: str, place: str | None, strength: float, seed: int, n: int = 16, repetitions: int = 2, points: int = 61
) -> Experiment:
    """Virtual fingertips of ``analyses/concealed`` with their true noise, which nobody has to estimate."""
    case = cases.prepare(effect_id, place, strength, seed, n, repetitions, points)
    z, sd = people.record(case.concealed, case.frequency_hz, case.conditions, cases.stream(seed, "noise"))
    p = case.population
    covariance = np.outer(p.between_persons, p.between_persons) * p.correlation
    model = build(parse(people.NETWORK), (), scales_at(case.frequency_hz, z), ())
    return Experiment(
        model,
        likelihoods(case.frequency_hz, z, sd, 8),
        case.log_elements.reshape(-1, 8),
        Population(p.log_centre, covariance, p.between_repetitions),
        sd,
        case,
    )


def toy(
    notation: str,
    centre: dict[str, float],
    seed: int,
    n: int = 20,
    repetitions: int = 2,
    noise: float = 0.01,
    tau: float = 0.2,
    rho: float = 0.05,
    hidden: Callable[[np.ndarray, np.ndarray, np.random.Generator], tuple[np.ndarray, np.ndarray]] | None = None,
    frequency_hz: np.ndarray | None = None,
) -> Experiment:
    """A network of few elements; hidden(s, z, rng) changes the curves (N, J, F) and says by how much, (N,)."""
    rng = np.random.default_rng(seed)
    network = parse(notation)
    frequency_hz = np.geomspace(2, 2000, 41) if frequency_hz is None else frequency_hz
    mu = np.log([centre[e] for e in network.elements])
    v = mu + tau * rng.normal(size=(n, 1, mu.size)) + rho * rng.normal(size=(n, repetitions, mu.size))
    z = Kernel(network).impedance(v, frequency_hz)
    coefficients = None
    if hidden is not None:
        z, coefficients = hidden(2j * np.pi * frequency_hz, z, rng)
    sd = noise * np.abs(z)
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    model = build(network, (), scales_at(frequency_hz, z), ())
    population = Population(mu, tau**2 * np.eye(mu.size), np.full(mu.size, rho))
    data = likelihoods(frequency_hz, z, sd, mu.size)
    return Experiment(model, data, v.reshape(-1, mu.size), population, sd, None, coefficients)


TOY = ("n1|r1", {"n1": 1e-3, "r1": 2.0})


def recovered(experiment: Experiment, effect: Effect, place: str, pooling: str, rounds: int = 200) -> Refit:
    """The network fitted without, then with the effect: its coefficient begins at zero."""
    refitter, fit = experiment.refitter, experiment.fit()
    shared = experiment.grown(Addition(effect=effect, place=place, pooling="shared"))
    grown = refitter.fit(shared, *enlarged(fit, shared), rounds=60)
    if pooling == "shared":
        return grown
    varying = experiment.grown(Addition(effect=effect, place=place, pooling=pooling))
    _, population = enlarged(fit, varying)
    n = fit.model.n_elements
    population.mu[n:] = grown.u[0, n:]
    return refitter.fit(varying, grown.u, replace(population, rho=np.append(grown.population.rho, 0.0)), rounds)


MASS, DISPERSION = 4e-5, 0.3


def with_mass(dispersion: float) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        mass = MASS * np.exp(dispersion * rng.normal(size=len(z)))
        return z + s * mass[:, None, None], mass

    return hidden


def printed_tissue(s, v):
    """The second bracket of eq. 4 as it is printed, inverted once less."""
    limb = 1 / (1 / (s * v["m1"]) + s * v["n2"] / (s * v["n2"] * v["r2"] + 1))
    return (-(s**2) * v["m2"] * v["n1"] + s * v["n1"] * v["r1"] + 1) / (s * v["n1"]) + limb


def enlarged(fit: Refit, model: Model) -> tuple[np.ndarray, Population]:
    """Where the refit of a model with additions to a fitted one begins."""
    start = np.array([p.start for p in model.parameters])
    varying = ~model.shared[model.n_elements :]
    size = fit.population.mu.size + int(varying.sum())
    covariance = np.eye(size)
    covariance[: fit.population.mu.size, : fit.population.mu.size] = fit.population.covariance
    mu, rho = np.append(fit.population.mu, start[varying]), np.append(fit.population.rho, np.zeros(varying.sum()))
    u = np.column_stack([fit.u, np.broadcast_to(start, (len(fit.u), start.size))])
    return u, Population(mu, covariance, rho)


def two_additions(experiment: Experiment) -> Model:
    """A varying mass and, outermost and therefore last among the parameters, a shared high-pass."""
    return experiment.grown(
        Addition(effect=entry("rig.highpass"), place="port", pooling="shared"),
        Addition(effect=entry("body.mass"), place="port", pooling="varying"),
    )


def residuals_of(fit: Refit) -> list[PersonResiduals]:
    return person_residuals(fit, [str(i) for i in range(len(fit.data))])


def screened(fit: Refit, effects: Sequence[Effect] | None = None, seed: int = 1) -> Screening:
    return screen(fit, residuals_of(fit), registered() if effects is None else effects, seed, Serial())
