"""Refits of models with additions: evidence against integrals, several optima, subsets and order of persons."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import (
    TOY,
    Experiment,
    Serial,
    enlarged,
    entry,
    toy,
    two_additions,
    with_mass,
)

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.fit.normal_equations import (
    Population,
)
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.person.likelihood import SCALE_SHAPE

# Evidence


@pytest.mark.parametrize("repetitions", [1, 2])
@pytest.mark.parametrize("offset", [0.0, 2.0])
def test_evidence_against_quadrature(repetitions: int, offset: float) -> None:
    """One damper, one person: the integral over v_ij and v_i by summation; the prior up to two sd off."""
    tau, rho, frequency = 0.15, 0.08, np.geomspace(1, 100, 656)
    experiment = toy("r1", {"r1": 2.0}, 6, 1, repetitions, noise=0.3, tau=tau, rho=rho, frequency_hz=frequency)
    mu = float(experiment.u.mean() + offset * tau)
    population = Population(np.array([mu]), np.array([[tau**2]]), np.array([rho]))
    fit = experiment.refitter.fit(experiment.model, experiment.u, population, 100, hold_population=True, tolerance=1e-6)
    assert fit.settled
    grid = mu + np.linspace(-6 * tau, 6 * tau, 1201)
    d, step = experiment.data[0], grid[1] - grid[0]
    z = d.z[:, 0] + 1j * d.z[:, 1]
    chi = [np.sum(d.weight[j] * np.abs(z[j] - np.exp(grid)[:, None]) ** 2, axis=1) for j in range(repetitions)]
    total = chi[0] if repetitions == 1 else chi[0][:, None] + chi[1]
    covariance = np.full((repetitions, repetitions), tau**2) + rho**2 * np.eye(repetitions)
    points = np.stack(np.meshgrid(*[grid] * repetitions, indexing="ij"), axis=-1) - mu
    log_prior = -0.5 * np.einsum("...a,ab,...b->...", points, np.linalg.inv(covariance), points)
    log_prior -= 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    exponent = SCALE_SHAPE + repetitions * frequency.size
    values = log_prior - exponent * np.log(SCALE_SHAPE + 0.5 * total) + repetitions * np.log(step)
    exact = values.max() + np.log(np.sum(np.exp(values - values.max())))
    # Laplace's method: for (b + x^2/2)^-a in k dimensions the next term is k (k + 2)/(8 a); as much again for the rest.
    assert fit.evidence.shape == (1,)
    assert fit.evidence[0] == pytest.approx(exact, abs=repetitions * (repetitions + 2) / (4 * exponent))


def test_evidence_prefers_the_truth() -> None:
    """A population that is where people are is worth what the normal distribution says it is."""
    experiment = toy(*TOY, seed=7, n=30)
    here = experiment.fit(hold_population=True)
    away = replace(experiment.population, mu=experiment.population.mu + np.array([0.2, 0.0]))
    there = experiment.refitter.fit(experiment.model, experiment.u, away, 80, hold_population=True)
    assert here.settled
    assert there.settled
    v = experiment.u[:, 0].reshape(-1, 2).mean(axis=1) - experiment.population.mu[0]
    variance = 0.2**2 + 0.05**2 / 2
    expected = np.sum((v - 0.2) ** 2 - v**2) / (2 * variance)
    assert here.evidence.sum() - there.evidence.sum() == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("size", [1e-5, 1e-3, 0.1])
def test_a_coefficient_that_is_nearly_the_same_in_all_is_worth_what_a_shared_one_is(size: float) -> None:
    """However small it is, it does not differ between the recordings of a person."""

    def hidden(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return z + s * size * 2e-3, np.full(len(z), size)

    experiment = toy("n1|r1", {"n1": 1e-3, "r1": 2.0}, 3, 12, noise=size, hidden=hidden)
    effect, plain = entry("body.mass"), experiment.fit()
    shared = experiment.grown(Addition(effect=effect, place="port", pooling="shared"))
    one = experiment.refitter.fit(shared, *enlarged(plain, shared), rounds=100)
    varying = experiment.grown(Addition(effect=effect, place="port", pooling="varying", dispersion=0.01))
    _, population = enlarged(plain, varying)
    population.mu[plain.model.n_elements :] = one.u[0, plain.model.n_elements :]
    own = experiment.refitter.fit(varying, one.u, population, rounds=100)
    assert one.settled
    assert own.settled
    assert one.u[0, -1] > 0
    assert own.evidence.sum() == pytest.approx(one.evidence.sum(), abs=1.0)


@pytest.mark.parametrize("rho", [0.0, 0.05])
def test_the_dispersion_between_repetitions_is_where_the_evidence_is_largest(rho: float) -> None:
    """No prior keeps it from zero: a network whose elements stay the same would lose against what cannot change."""
    experiment = toy(*TOY, seed=11, n=20, repetitions=3, rho=rho)
    begun = replace(experiment.population, rho=np.full(2, 0.05))
    fit = experiment.refitter.fit(experiment.model, experiment.u, begun, 100)
    assert fit.settled
    steps = (0.8, 1.0, 1.25) if rho else (1.0, 2.0, 4.0)
    evidence = []
    for factor in steps:
        held = replace(fit.population, rho=fit.population.rho * factor)
        there = experiment.refitter.fit(experiment.model, fit.u, held, 100, hold_population=True)
        evidence.append(float(there.evidence.sum()))
    assert int(np.argmax(evidence)) == (1 if rho else 0)
    if rho:
        np.testing.assert_allclose(fit.population.rho, rho, rtol=0.3)
    else:
        assert np.all(fit.population.rho < 2e-3)  # a recording determines an element to 2e-3


def test_what_a_mass_absorbs_gains_nothing_where_elements_are_the_same_in_all_repetitions() -> None:
    """It has no dispersion between repetitions, and beside an element that has to have one it would gain 8."""
    still = toy("m1|r1|n1", {"m1": 2e-3, "r1": 5.0, "n1": 1e-4}, 3, 12, 3, noise=1e-3, rho=1e-6)
    fit = still.refitter.fit(still.model, still.u, still.population, 200)
    effect = entry("body.mass")
    model = extended(fit.model, Candidate(effect, "port", {}), "varying", 1e-3)
    u, population = extended_start(fit, model)
    mu = population.mu.copy()
    (column,) = model.columns(0)
    u[:, column] = 0.8 * np.exp(u[:, 0]) / effect.coefficients[0].scale(model.scales)
    u[:, 0] += np.log(0.2)
    mu[0], mu[-1] = mu[0] + np.log(0.2), u[:, column].mean()
    grown = still.refitter.fit(model, u, replace(population, mu=mu), 200)
    assert grown.equations.chi.sum() == pytest.approx(fit.equations.chi.sum(), rel=0.01)
    assert log_evidence(grown) < log_evidence(fit)


# Optima

TWO_PATHS = ("(r1-n1)|(r2-n2)|r3", {"r1": 3.0, "n1": 1e-2, "r2": 8.0, "n2": 1e-4, "r3": 0.5})


@pytest.fixture(scope="module")
def misled() -> tuple[Experiment, Refit, Refit]:
    """Everybody fitted from the truth, and with two persons who begin with their paths exchanged."""
    experiment = toy(*TWO_PATHS, seed=8, n=12)
    good = experiment.fit()
    u = good.u.copy()
    wrong = np.isin(experiment.refitter.owner, [2, 7])
    u[wrong] = u[wrong][:, [2, 3, 0, 1, 4]]
    bad = experiment.refitter.fit(experiment.model, u, good.population, 80, hold_population=True)
    return experiment, good, bad


def test_settle_rescues_persons_in_a_wrong_optimum(misled: tuple[Experiment, Refit, Refit]) -> None:
    experiment, good, bad = misled
    lost = bad.evidence < good.evidence - 10
    assert np.flatnonzero(lost).tolist() == [2, 7]  # a fit alone does not find the way back
    np.testing.assert_allclose(bad.evidence[~lost], good.evidence[~lost], atol=0.05)
    rescued = experiment.refitter.settle(bad, seed=1)
    assert rescued.settled
    np.testing.assert_allclose(rescued.evidence.sum(), good.evidence.sum(), atol=0.3)
    # The shared rest tolerance of the rounds is 2 % of a posterior sd; elements are known to about 1 %.
    np.testing.assert_allclose(rescued.u, good.u, atol=0.02)


def test_settle_leaves_a_good_fit_alone(misled: tuple[Experiment, Refit, Refit]) -> None:
    experiment, good, _ = misled
    assert experiment.refitter.settle(good, seed=2) is good


def test_the_start_does_not_matter() -> None:
    experiment = toy(*TOY, seed=9, n=10)
    model = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    ends = []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        u = np.column_stack([experiment.u + 0.2 * rng.normal(size=experiment.u.shape), np.zeros(len(experiment.u))])
        ends.append(experiment.refitter.fit(model, u, experiment.population, 200, tolerance=1e-4))
    assert all(end.settled for end in ends)
    np.testing.assert_allclose(ends[0].u, ends[1].u, atol=1e-4)
    np.testing.assert_allclose(ends[0].evidence, ends[1].evidence, atol=1e-3)


# Some of the people, in any order


def test_subset_is_a_refit_of_these_people() -> None:
    experiment = toy(*TOY, seed=10, n=8)
    model = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    some = np.array([6, 1, 3])
    rows = np.concatenate([np.flatnonzero(experiment.refitter.owner == i) for i in some])
    u = np.column_stack([experiment.u, np.zeros(len(experiment.u))])
    subset = experiment.refitter.subset(some).fit(model, u[rows], experiment.population)
    alone = Refitter([experiment.data[i] for i in some], Serial()).fit(model, u[rows], experiment.population)
    np.testing.assert_array_equal(subset.u, alone.u)
    np.testing.assert_array_equal(subset.evidence, alone.evidence)
    assert subset.evidence.shape == (3,)
    assert subset.owner.tolist() == [0, 0, 1, 1, 2, 2]
    # With the population held nobody depends on the others.
    everybody = experiment.fit(hold_population=True, tolerance=1e-5)
    few = experiment.refitter.subset(some).fit(
        experiment.model, experiment.u[rows], experiment.population, 80, hold_population=True, tolerance=1e-5
    )
    np.testing.assert_allclose(few.u, everybody.u[rows], atol=1e-6)
    np.testing.assert_allclose(few.evidence, everybody.evidence[some], atol=1e-6)


def test_order_of_persons_does_not_matter() -> None:
    experiment = toy(*TOY, seed=11, n=9, hidden=with_mass(0.3))
    model = two_additions(experiment)
    order = np.random.default_rng(1).permutation(9)
    rows = np.concatenate([np.flatnonzero(experiment.refitter.owner == i) for i in order])
    u, population = enlarged(experiment.fit(), model)
    first = experiment.refitter.fit(model, u, population)
    second = experiment.refitter.subset(order).fit(model, u[rows], population)
    np.testing.assert_allclose(second.u, first.u[rows], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(second.persons, first.persons[order], rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(second.evidence, first.evidence[order], rtol=1e-9)
    np.testing.assert_allclose(second.population.covariance, first.population.covariance, rtol=1e-6, atol=1e-12)
    assert second.settled == first.settled


def test_what_is_held_stays() -> None:
    experiment = toy(*TOY, seed=12, n=6)
    model = two_additions(experiment)
    u, population = enlarged(experiment.fit(), model)
    u[:, 2:], population.mu[2] = [0.02, 0.01], 0.02
    held = experiment.refitter.fit(model, u, population, 20, hold_population=True, hold_additions=True)
    assert np.all(held.shared_value == 0.01)
    np.testing.assert_array_equal(held.population.mu, population.mu)
    np.testing.assert_array_equal(held.population.covariance[:2, :2], population.covariance[:2, :2])
    free = experiment.refitter.fit(model, u, population, 20)
    assert abs(free.shared_value[0]) < 0.005
    assert not np.array_equal(free.population.mu, population.mu)


def test_one_person_has_no_population() -> None:
    experiment = toy(*TOY, seed=13, n=1, repetitions=4, rho=0.1)
    fit = Refitter(experiment.data, Serial(), one_person=True).fit(
        experiment.model, experiment.u, experiment.population, 80
    )
    assert fit.settled
    np.testing.assert_array_equal(fit.population.mu, experiment.population.mu)
    np.testing.assert_array_equal(fit.population.covariance, experiment.population.covariance)
    assert not np.array_equal(fit.population.rho, experiment.population.rho)


def test_population_of_the_elements_is_found() -> None:
    """Forty people, from a start that is three times too wide and off its centre."""
    experiment = toy(*TOY, seed=14, n=40)
    start = Population(experiment.population.mu + 0.5, 0.36 * np.eye(2), np.full(2, 0.2))
    fit = experiment.refitter.fit(experiment.model, experiment.u, start, 100)
    assert fit.settled
    true = experiment.u.reshape(40, 2, 2)
    own = true.mean(axis=1)
    np.testing.assert_allclose(fit.population.mu, own.mean(axis=0), atol=0.01)
    # The prior counts for two persons of the present dispersion, so its fixed point is the sample's own.
    np.testing.assert_allclose(np.sqrt(np.diag(fit.population.covariance)), own.std(axis=0), rtol=0.05)
    within = np.sqrt(np.mean(np.ptp(true, axis=1) ** 2, axis=0) / 2)
    np.testing.assert_allclose(fit.population.rho, within, rtol=0.1)
