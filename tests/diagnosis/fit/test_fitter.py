"""Refits of models with additions: equations, evidence, recovery of what was concealed, posterior of coefficients."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from experiments import (
    DISPERSION,
    MASS,
    TOY,
    Experiment,
    Serial,
    concealing,
    enlarged,
    entry,
    recovered,
    toy,
    with_mass,
)

import bayes_impedance.diagnosis.fit.coefficient_posterior as coefficients_module
import bayes_impedance.diagnosis.fit.normal_equations as equations_module
from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.coefficient_posterior import (
    coefficient_posterior,
    reported,
    verdict_on_side,
)
from bayes_impedance.diagnosis.fit.fitter import Refit, Refitter
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.normal_equations import (
    Equations,
    Population,
    Stack,
    counts,
    equations_at,
    marginal,
    owners,
    quadratic,
    weights,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import SCALE_SHAPE

# Experiments whose truth is known, with their true noise


# Equations


def test_owners_counts_and_weights() -> None:
    data = (
        *toy(*TOY, seed=1, n=2, repetitions=3).data,
        *toy(*TOY, seed=2, n=1, repetitions=1, frequency_hz=np.geomspace(2, 500, 11)).data,
    )
    assert owners(data).tolist() == [0, 0, 0, 1, 1, 1, 2]
    assert counts(data).tolist() == [123, 123, 11]
    chi = np.arange(1.0, 8.0)
    found, a = weights(data, chi), SCALE_SHAPE
    np.testing.assert_allclose(found, [(a + 123) / (a + 3), (a + 123) / (a + 7.5), (a + 11) / (a + 3.5)], rtol=1e-14)


def test_equations_are_the_residuals_and_their_slopes() -> None:
    experiment = toy(*TOY, seed=1, n=3)
    u = experiment.u + 0.1
    found = equations_at(experiment.model, Stack.of(experiment.data), u, Serial())
    for m, i in enumerate(owners(experiment.data)):
        d = experiment.data[i]
        z, dz = Kernel(experiment.model.network).derivative(u[m], d.omega / (2 * np.pi))
        sd = d.weight[m % 2] ** -0.5
        residual = (z - d.z[m % 2, 0] - 1j * d.z[m % 2, 1]) / sd
        slope = dz / sd
        np.testing.assert_allclose(found.chi[m], np.sum(np.abs(residual) ** 2), rtol=1e-10)
        np.testing.assert_allclose(found.gradient[m], (slope.conj() @ residual).real, rtol=1e-8)
        np.testing.assert_allclose(found.information[m], (slope.conj() @ slope.T).real, rtol=1e-10)


def test_in_how_many_pieces_recordings_are_lent_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two frequency grids among seven people, whose pieces end inside of people; some of the people asked again."""
    first, second = toy(*TOY, seed=1, n=4), toy(*TOY, seed=2, n=3, frequency_hz=np.geomspace(3, 900, 29), repetitions=3)
    data = (first.data[0], *second.data[:2], *first.data[1:], second.data[2])
    u = np.tile(first.u[0] + 0.1, (len(owners(data)), 1))
    u += np.random.default_rng(1).normal(0, 0.1, u.shape)
    some = np.arange(7) % 3 == 0
    found = []
    for few in (1, 4, 100):
        monkeypatch.setattr(equations_module, "_SMALL_PIECE", 1)
        monkeypatch.setattr(equations_module, "_FEW_PIECES", few)
        monkeypatch.setattr(equations_module, "_MOST_PIECES", 100)
        stack = Stack.of(data)
        assert len(stack.pieces) == min(few, len(u))
        assert sorted(np.concatenate([rows for rows, _ in stack.pieces])) == list(range(len(u)))
        whole = equations_at(first.model, stack, u, Serial())
        again = equations_at(first.model, stack, u + 0.01, Serial(), some, whole)
        found.append((whole.chi, whole.gradient, whole.information, again.chi, again.gradient, again.information))
        np.testing.assert_array_equal(again.chi == whole.chi, ~some[owners(data)])
    for other in found[1:]:
        for one, two in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, two)


FREE = 1e6 * np.eye(3)
"""A population that holds nobody."""


def two_additions(experiment: Experiment) -> Model:
    """A varying mass and, outermost and therefore last among the parameters, a shared high-pass."""
    return experiment.grown(
        Addition(effect=entry("rig.highpass"), place="port", pooling="shared"),
        Addition(effect=entry("body.mass"), place="port", pooling="varying"),
    )


def test_quadratic_is_the_likelihood_with_the_elements_free() -> None:
    """One person's -w chi^2/2 at the best elements of each recording, by brute force, at additions nearby."""
    from scipy.optimize import least_squares

    experiment = toy(*TOY, seed=3, n=1, noise=0.003)
    model, d = two_additions(experiment), experiment.data[0]
    frequency = d.omega / (2 * np.pi)

    def residuals(theta: np.ndarray, y: np.ndarray, j: int) -> np.ndarray:
        z = model.kernel.impedance(np.append(theta, y), frequency)
        r = (z - d.z[j, 0] - 1j * d.z[j, 1]) * np.sqrt(d.weight[j])
        return np.concatenate([r.real, r.imag])

    def best(y: np.ndarray) -> tuple[float, np.ndarray]:
        options = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
        ends = [least_squares(residuals, experiment.u[j], args=(y, j), **options) for j in range(2)]
        return sum(2 * end.cost for end in ends), np.array([end.x for end in ends])

    centre = np.zeros(2)
    _, elements = best(centre)
    u = np.column_stack([elements, np.tile(centre, (2, 1))])
    equations = equations_at(model, Stack.of(experiment.data), u, Serial())
    h, information, response = quadratic(model, experiment.data, u, equations, FREE)
    w = weights(experiment.data, equations.chi)[0]
    factor = np.linalg.cholesky(np.linalg.inv(information[0]))
    for direction in ([1, 0], [0, 1], [-1, 0], [0.5, -1]):
        y = factor @ direction
        chi, moved = best(y)
        gained = h[0] @ y - 0.5 * y @ information[0] @ y
        # Gauss and Newton: the curvature of the model itself is left out, which is of the order of the noise.
        assert gained == pytest.approx(-0.5 * w * (chi - best(centre)[0]), abs=0.01)
        np.testing.assert_allclose(response @ y, moved - elements, atol=0.02 * np.abs(moved - elements).max())


def test_quadratic_does_not_care_where_the_elements_are() -> None:
    """A step of the elements is part of it, so that a population that pulls at them does not bias the additions."""
    experiment = toy(*TOY, seed=4, n=6, noise=0.003)
    model = two_additions(experiment)
    start = np.column_stack([experiment.u, np.zeros((len(experiment.u), 2))])
    answers = []
    for shift in (0.0, 0.003, -0.003):
        u = start.copy()
        u[:, :2] += shift
        equations = equations_at(model, Stack.of(experiment.data), u, Serial())
        # The weights depend on where we are; we ask about the rest.
        fixed = replace(equations, chi=np.full(len(u), 82.0))
        h, information, _ = quadratic(model, experiment.data, u, fixed, FREE)
        total = information.sum(axis=0)
        answers.append((np.linalg.solve(total, h.sum(axis=0)), np.sqrt(np.diag(np.linalg.inv(total)))))
    sd = answers[0][1]
    assert np.all(np.abs(answers[1][0] - answers[0][0]) < 0.1 * sd)
    assert np.all(np.abs(answers[2][0] - answers[0][0]) < 0.1 * sd)


def test_marginal_is_a_gaussian_integral() -> None:
    """Everybody's own coefficients and the common values integrated out of one large normal distribution."""
    from scipy.stats import multivariate_normal

    experiment = toy(*TOY, seed=1, n=1)
    model = two_additions(experiment)
    rng, n = np.random.default_rng(5), 4
    root = rng.normal(size=(n, 2, 5))
    d = root @ np.swapaxes(root, 1, 2)
    y = rng.normal(size=(n, 2))
    h = np.einsum("nab,nb->na", d, y)
    prior_sd, centre = np.array([[p.prior_sd, p.centre] for p in model.parameters]).T
    expected, found = [], []
    for tau in (0.0, 0.2, 1.0, 3.0):
        spread = np.diag([tau**2, 0.0])
        noise = np.linalg.inv(d)
        covariance = np.tile(np.diag(prior_sd**2), (n, n))
        for i in range(n):
            covariance[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += noise[i] + spread
        expected.append(multivariate_normal(np.tile(centre, n), covariance).logpdf(y.ravel()))
        result = marginal(model, h, d, np.array([tau, 7.0]))
        found.append(result.log_density)
        gain = np.tile(np.diag(prior_sd**2), (1, n)) @ np.linalg.inv(covariance)
        np.testing.assert_allclose(result.mean, centre + gain @ (y.ravel() - np.tile(centre, n)), rtol=1e-8)
        rest = np.diag(prior_sd**2) - gain @ np.tile(np.diag(prior_sd**2), (1, n)).T
        np.testing.assert_allclose(np.linalg.inv(result.precision), rest, rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-9)


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


# Recovery

SHARED = {
    "rig.delay": (entry("rig.delay"), "delay", 0.1),
    "rig.highpass": (entry("rig.highpass"), "corner", 0.05),
    "rig.mass": (entry("rig.mass"), "mass", 0.6),
}


@dataclass(frozen=True)
class Estimate:
    """An estimate with its posterior sd and 90 % interval, all in units of the operation."""

    true: float
    estimate: float
    draws: np.ndarray

    @property
    def z(self) -> float:
        return float((self.estimate - self.true) / self.draws.std())

    @property
    def covered(self) -> bool:
        low, high = np.quantile(self.draws, (0.05, 0.95))
        return bool(low < self.true < high)


@pytest.fixture(scope="module")
def shared_estimates() -> dict[str, list[Estimate]]:
    result: dict[str, list[Estimate]] = {}
    for name, (effect, own, strength) in SHARED.items():
        for seed in range(10):
            experiment = concealing(name, "port", strength, seed)
            fit = recovered(experiment, effect, "port", "shared")
            assert fit.settled, (name, seed)
            coefficient, scales = effect.coefficients[0], fit.model.scales
            true = experiment.case.values[own] * (2 * np.pi if coefficient.unit == "Hz" else 1.0)
            draws = coefficient.value(coefficient_posterior(fit, seed).central[:, 0], scales)
            estimate = float(coefficient.value(fit.shared_value[0], scales))
            result.setdefault(name, []).append(Estimate(true, estimate, draws))
    return result


@pytest.mark.parametrize("name", SHARED)
def test_shared_coefficients_are_recovered(name: str, shared_estimates: dict[str, list[Estimate]]) -> None:
    from scipy.stats import chi2

    z = np.array([e.z for e in shared_estimates[name]])
    assert np.abs(z).max() < 3.5  # of ten: 0.5 %
    assert chi2.ppf(0.001, 10) < np.sum(z**2) < chi2.ppf(0.999, 10)
    assert abs(z.mean()) < 3.1 / np.sqrt(10)
    # And they are not found because the prior says so: all are far from zero.
    assert min(abs(e.true) / e.draws.std() for e in shared_estimates[name]) > 3


def test_intervals_cover_as_often_as_they_say(shared_estimates: dict[str, list[Estimate]]) -> None:
    from scipy.stats import binom

    covered = [e.covered for estimates in shared_estimates.values() for e in estimates]
    assert binom.ppf(0.001, len(covered), 0.9) <= sum(covered) <= binom.ppf(0.999, len(covered), 0.9)
    for estimates in shared_estimates.values():
        for e in estimates:  # the draws are around the estimate
            assert abs(e.draws.mean() - e.estimate) < 0.2 * e.draws.std()


@pytest.fixture(scope="module")
def varying_masses() -> list[tuple[Experiment, Refit, Any]]:
    result = []
    for seed in range(10):
        experiment = toy(*TOY, seed=seed, n=30, hidden=with_mass(DISPERSION))
        fit = recovered(experiment, entry("body.mass"), "port", "varying")
        assert fit.settled
        posterior = coefficient_posterior(fit, seed)
        result.append((experiment, fit, reported(fit.model, 0, posterior, fit.population.mu[:2])[0]))
    return result


def test_varying_coefficient_has_its_median_and_dispersion(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    """Ten populations of thirty people: the centre and the dispersion of the masses that they were given."""
    from scipy.stats import binom

    medians = np.array([[r.q05, r.median, r.q95] for _, _, r in varying_masses])
    spreads = np.array([[r.dispersion_q05, r.dispersion, r.dispersion_q95] for _, _, r in varying_masses])
    least = binom.ppf(0.001, 10, 0.9)
    assert np.sum((medians[:, 0] < MASS) & (medians[:, 2] > MASS)) >= least
    assert np.sum((spreads[:, 0] < DISPERSION) & (spreads[:, 2] > DISPERSION)) >= least
    # Sampling 30 people: ln of the median has sd 0.3/sqrt(30), the dispersion 0.3/sqrt(60).
    assert abs(np.log(medians[:, 1] / MASS).mean()) < 3 * DISPERSION / np.sqrt(300)
    assert abs(spreads[:, 1].mean() - DISPERSION) < 3 * DISPERSION / np.sqrt(600)
    widths = np.log(medians[:, 2] / medians[:, 0]) / 3.29
    np.testing.assert_allclose(widths.mean(), DISPERSION / np.sqrt(30), rtol=0.25)


def test_a_varying_coefficient_comes_to_rest_in_a_few_rounds() -> None:
    """A search allows 30 rounds; with own coefficients that follow as far as they are free three are enough."""
    for seed in range(3):
        assert recovered(
            toy(*TOY, seed=seed, n=30, hidden=with_mass(DISPERSION)), entry("body.mass"), "port", "varying", 15
        ).settled


def test_everybodys_own_coefficient(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    for experiment, fit, _ in varying_masses[:3]:
        own = entry("body.mass").coefficients[0].value(fit.persons[:, 2], fit.model.scales)
        assert experiment.coefficients is not None
        assert np.corrcoef(own, experiment.coefficients)[0, 1] > 0.95
        assert not np.any(np.ptp(fit.u[:, 2].reshape(-1, 2), axis=1) > 0.02 * np.abs(fit.persons[:, 2]))


def test_rig_or_body_from_the_dispersion(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    sides = []
    for dispersion in (0.0, DISPERSION):
        experiment = toy(*TOY, seed=3, n=30, hidden=with_mass(dispersion))
        fit = recovered(experiment, entry("body.mass"), "port", "varying")
        sides.append(verdict_on_side(coefficient_posterior(fit, 1).relative_dispersion[:, 0]))
    assert sides == ["rig", "body"]


def test_a_varying_mass_in_the_fingertip_is_recovered() -> None:
    experiment = concealing("body.mass", "port", 1.0, 4, n=30, repetitions=2, points=121)
    fit = recovered(experiment, entry("body.mass"), "port", "varying")
    assert fit.settled
    mass = reported(fit.model, 0, coefficient_posterior(fit, 1), fit.population.mu[:8])[0]
    true = experiment.case.values["mass"]
    assert abs(mass.median - true) < 3 * (mass.q95 - mass.q05) / 3.29
    assert mass.q05 > 0.2 * true
    assert mass.dispersion_q05 < 0.4 < mass.dispersion_q95
    assert (mass.name, mass.unit) == ("mass", "kg")


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


# Posterior of the coefficients


def supplied(monkeypatch: pytest.MonkeyPatch, model: Model, h: np.ndarray, d: np.ndarray, start: np.ndarray) -> Refit:
    """A fit whose quadratic is given."""
    monkeypatch.setattr(coefficients_module, "quadratic", lambda *_: (h, d, None))
    u = np.column_stack([np.zeros((len(h), model.n_elements)), np.broadcast_to(start, (len(h), start.size))])
    m, p = u.shape
    population = Population(np.zeros(p), np.eye(p), np.full(p, 0.1))
    equations = Equations(np.zeros(m), np.zeros((m, p)), np.zeros((m, p, p)))
    return Refit(
        model=model,
        data=(),
        u=u,
        persons=u,
        population=population,
        equations=equations,
        evidence=np.zeros(m),
        settled=True,
    )


def test_posterior_of_shared_coefficients_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = toy(*TOY, seed=1, n=1)
    model = experiment.grown(
        Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
        Addition(effect=entry("rig.damping"), place="port", pooling="shared"),
    )
    rng = np.random.default_rng(2)
    root = rng.normal(size=(7, 2, 4))
    d = root @ np.swapaxes(root, 1, 2)
    h = np.einsum("nab,b->na", d, [0.4, -1.3]) + rng.normal(size=(7, 2))
    precision = d.sum(axis=0) + np.diag([p.prior_sd**-2 for p in model.parameters])
    covariance = np.linalg.inv(precision)
    mean = covariance @ h.sum(axis=0)
    posterior = coefficient_posterior(supplied(monkeypatch, model, h, d, np.array([0.4, -1.3])), 1, 20_000)
    np.testing.assert_allclose(posterior.covariance, covariance, rtol=1e-10)
    sd = np.sqrt(np.diag(covariance))
    assert posterior.central.shape == (20_000, 2)
    assert np.all(np.abs(posterior.central.mean(axis=0) - mean) < 4 * sd / np.sqrt(20_000))
    np.testing.assert_allclose(posterior.central.std(axis=0), sd, rtol=4 / np.sqrt(40_000))
    correlation = covariance[0, 1] / sd.prod()
    assert np.corrcoef(posterior.central.T)[0, 1] == pytest.approx(correlation, abs=4 / np.sqrt(20_000))
    assert not posterior.relative_dispersion.any()


def check_summation(monkeypatch: pytest.MonkeyPatch, dispersion: float, seed: int, levels: tuple[float, ...]) -> None:
    """y_i ~ N(mu, 1/d_i + tau^2) with half-normal tau: two dimensions, summed on a fine grid."""
    experiment = toy(*TOY, seed=1, n=1)
    model = experiment.grown(Addition(effect=entry("body.mass"), place="port", pooling="varying"))
    rng, n, draws = np.random.default_rng(seed), 12, 20_000
    d = rng.uniform(4, 30, size=n)
    y = 1.0 + dispersion * rng.normal(size=n) + rng.normal(size=n) / np.sqrt(d)
    fit = supplied(monkeypatch, model, (d * y)[:, None], d[:, None, None], np.array([1.0]))
    posterior = coefficient_posterior(fit, 1, draws)

    mu, tau = np.linspace(-1, 3, 401)[:, None], np.linspace(0, 3, 1501)
    variance = 1 / d[:, None, None] + tau**2
    density = -0.5 * np.sum((y[:, None, None] - mu) ** 2 / variance + np.log(variance), axis=0)
    density += -0.5 * (mu / model.parameters[0].prior_sd) ** 2 - 0.5 * tau**2
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    mean = float(np.sum(weight * mu))
    deviation = mu - mean
    sd = float(np.sqrt(np.sum(weight * deviation**2)))
    kurtosis = float(np.sum(weight * deviation**4)) / sd**4
    assert abs(posterior.central.mean() - mean) < 4 * sd / np.sqrt(draws)
    # The second term is that of a grid of steps of 10 % for tau, by Simpson's rule.
    assert posterior.central.std() == pytest.approx(sd, rel=4 * np.sqrt((kurtosis - 1) / (4 * draws)) + 0.1**2 / 12)
    found = posterior.relative_dispersion[:, 0] * np.abs(posterior.central[:, 0])
    cumulative = np.cumsum(weight.sum(axis=0))
    for level in levels:
        at = float(np.interp(level, cumulative, tau))
        # Drawn from grid points that are 10 % apart, or 0.01 near zero: half a step either way, and 4 sd of the counts.
        low, high = np.mean(found < min(at / 1.05, at - 0.005)), np.mean(found < max(at * 1.05, at + 0.005))
        noise = 4 * np.sqrt(level * (1 - level) / draws)
        assert low - noise < level < high + noise, level


def test_posterior_of_a_varying_coefficient_by_summation(monkeypatch: pytest.MonkeyPatch) -> None:
    check_summation(monkeypatch, 0.8, 3, (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98))


def test_posterior_of_a_coefficient_that_hardly_varies(monkeypatch: pytest.MonkeyPatch) -> None:
    check_summation(monkeypatch, 0.0, 3, (0.05, 0.1, 0.3, 0.5, 0.9))


def test_posterior_is_the_same_for_the_same_seed(varying_masses: list[tuple[Experiment, Refit, Any]]) -> None:
    fit = varying_masses[0][1]
    one, again, other = (coefficient_posterior(fit, seed, 200) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.central, again.central)
    assert not np.array_equal(one.central, other.central)


# As it is reported


def posterior_at(values: list[float], dispersions: list[float]) -> coefficients_module.CoefficientPosterior:
    """Draws that are all the same."""
    return coefficients_module.CoefficientPosterior(
        np.tile(values, (10, 1)), np.tile(dispersions, (10, 1)), np.eye(len(values))
    )


def report(
    effect: Effect, pooling: str, shape: dict[str, float], x: list[float], dispersion: list[float], place: str = "port"
) -> dict[str, Any]:
    """What is said of an effect whose parameters have the values x in the operation's unit."""
    experiment = toy(*TOY, seed=1, n=1)
    model = build(
        experiment.model.network,
        [Addition(effect=effect, place=place, pooling=pooling)],
        experiment.model.scales,
        [shape],
    )
    u = [c.unbounded(v, model.scales) for c, v in zip(effect.coefficients, x, strict=True)]
    said = reported(model, 0, posterior_at(u, dispersion), np.log([1e-3, 2.0]))
    return {r.name: r for r in said}


def test_frequencies_are_reported_in_hertz() -> None:
    corner = report(entry("rig.highpass"), "shared", {}, [2 * np.pi * 0.3], [0.0])["corner"]
    assert corner.median == pytest.approx(0.3)
    assert (corner.unit, corner.dispersion) == ("Hz", 0.0)
    said = report(entry("rig.lowpass"), "shared", {}, [1e-5], [0.0])
    assert said["time_constant"].median == pytest.approx(1e-5)
    assert said["corner"].median == pytest.approx(1 / (2 * np.pi * 1e-5))


def test_positive_coefficients_are_log_normal_with_the_same_moments() -> None:
    """Median and sd of the logarithm, from mean 3e-5 and sd 1.2e-5; of a signed one the relative dispersion."""
    mass = report(entry("body.mass"), "varying", {}, [3e-5], [0.4])["mass"]
    s2 = np.log(1.16)
    assert mass.median == pytest.approx(3e-5 * np.exp(-s2 / 2))
    assert mass.dispersion == pytest.approx(np.sqrt(s2))
    draws = mass.median * np.exp(mass.dispersion * np.random.default_rng(1).normal(size=400_000))
    assert draws.mean() == pytest.approx(3e-5, rel=4 * 0.4 / np.sqrt(400_000))
    assert draws.std() == pytest.approx(1.2e-5, rel=0.01)
    signed = report(entry("rig.mass"), "varying", {}, [-3e-5], [0.4])["mass"]
    assert signed.median == pytest.approx(-3e-5)
    assert signed.dispersion == pytest.approx(0.4)


def test_what_a_reader_would_have_to_compute() -> None:
    said = report(entry("body.relaxation"), "shared", {"time_constant": 0.01}, [2.0, 0.01], [0.0, 0.0])
    assert said["compliance"].median == pytest.approx(0.005)  # t = r n
    assert said["compliance"].unit == "m/N"
    shape = {"frequency": 100.0, "damping_ratio": 0.1}
    said = report(entry("rig.resonance"), "shared", shape, [1e-3, 100.0, 0.1], [0.0] * 3)
    assert said["frequency"].median == pytest.approx(100 / (2 * np.pi))
    assert said["compliance"].median == pytest.approx(0.1)
    assert said["damping"].median == pytest.approx(0.02)
    shape = {"time_constant": 1e-3}
    said = report(entry("body.subgroup"), "shared", shape, [1e-4, 1e-3], [0.0, 0.0])
    assert said["damping"].median == pytest.approx(10.0)
    said = report(entry("body.bypass"), "shared", {"ratio": 1.0}, [0.5, 300.0], [0.0, 0.0])
    assert said["damping"].median == pytest.approx(0.5)
    assert (said["stiffness"].median, said["stiffness"].unit) == (pytest.approx(300.0), "N/m")
    assert said["compliance"].median == pytest.approx(1 / 300)


def test_power_laws_are_reported_per_second() -> None:
    """c s^(a-1): what stands there is the same as in the operation, which counts s from the middle of the band."""
    s = 2j * np.pi * 37.0
    said = report(entry("body.springpot", "beside_power"), "shared", {"exponent": 0.3}, [4.0, 0.3], [0.0, 0.0])
    middle = toy(*TOY, seed=1, n=1).model.scales.middle
    found = said["coefficient"].median * s ** (said["exponent"].median - 1)
    assert found == pytest.approx(4.0 * (s / middle) ** (0.3 - 1))
    said = report(entry("body.springpot", "power"), "shared", {}, [0.2], [0.0], "n1")
    found = said["coefficient"].median * s ** (said["exponent"].median - 1)
    assert found == pytest.approx((s / middle) ** 0.2 / (s * 1e-3))


def test_side_from_draws_of_the_dispersion() -> None:
    rng = np.random.default_rng(1)
    assert verdict_on_side(np.abs(0.05 * rng.normal(size=2000))) == "rig"
    assert verdict_on_side(0.4 + 0.05 * rng.normal(size=2000)) == "body"
    assert verdict_on_side(np.abs(0.4 * rng.normal(size=2000))) == "undecided"
