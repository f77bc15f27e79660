"""The refit's equations against direct evaluation: gradients, information, marginal densities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import (
    TOY,
    Serial,
    entry,
    toy,
    two_additions,
)
from scipy.stats import multivariate_normal

import bayes_impedance.diagnosis.fit.normal_equations as equations_module
from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended
from bayes_impedance.diagnosis.fit.normal_equations import (
    Stack,
    counts,
    equations_at,
    log_densities,
    marginal,
    owners,
    quadratic,
    weights,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.likelihood import SCALE_SHAPE


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


def test_of_two_additions_of_one_curve_the_sum_is_known() -> None:
    """One differs between people, the other does not. In single numbers what tells them apart is lost to rounding."""
    model, size = two_additions(toy(*TOY, seed=1, n=1)), 1e18
    d, h = np.full((3, 2, 2), size), np.full((3, 2), 1e-3 * size)
    d[:, 0, 0] *= np.array([1.0, 0.9, 1.1])
    d[:, 0, 1] = d[:, 1, 0] = d[:, 1, 1] = d[:, 0, 0]
    h *= np.array([[1.0], [0.9], [1.1]])
    tau = np.column_stack([np.geomspace(1e-9, 1e-6, 20), np.zeros(20)])
    assert np.isfinite(log_densities(model, h, d, tau)).all()
    assert marginal(model, h, d, tau[0]).mean.sum() == pytest.approx(1e-3, rel=1e-3)


def test_what_is_known_to_a_thousand_millionth_leaves_the_dispersions_of_others() -> None:
    """A resonance's frequency, everybody's the same: what dispersions gain does not depend on where its zero is."""
    model = two_additions(toy(*TOY, seed=1, n=1))
    rng, n = np.random.default_rng(6), 8
    d = np.zeros((n, 2, 2))
    d[:, 0, 0], d[:, 1, 1] = rng.uniform(1e3, 2e3, n), rng.uniform(1e16, 2e16, n)
    d[:, 0, 1] = d[:, 1, 0] = 0.3 * np.sqrt(d[:, 0, 0] * d[:, 1, 1])
    own = np.column_stack([rng.normal(0.2, 0.1, n), np.zeros(n)])
    tau = np.column_stack([np.geomspace(0.01, 1.0, 20), np.zeros(20)])
    found = []
    for zero in (0.0, 2.7):
        h = np.einsum("nab,nb->na", d, own + np.array([0.0, zero]))
        found.append(np.diff(log_densities(model, h, d, tau)))
    assert np.abs(found[0]).max() > 1
    np.testing.assert_allclose(found[1], found[0], atol=1e-3)


def test_dispersions_are_compared_with_the_shapes_held() -> None:
    """With the shapes at given values everybody's estimate of the coefficient is normal, whatever trades with it."""
    experiment = toy(*TOY, seed=1, n=1)
    candidate = Candidate(entry("body.resonator"), "port", {"frequency": 300.0, "damping_ratio": 0.1})
    model = extended(experiment.model, candidate, "varying", 0.1)
    held = np.array([7.0, *(p.centre + 0.3 for p in model.parameters[1:])])
    rng, n = np.random.default_rng(4), 9
    root = rng.normal(size=(n, 3, 3)) * np.array([30.0, 9.0, 4.0])
    d = root @ np.swapaxes(root, 1, 2)
    h = np.einsum("nab,nb->na", d, held + rng.normal(size=(n, 3)) * [0.5, 0.2, 0.2])
    tau = np.zeros((6, 3))
    tau[:, 0] = np.geomspace(0.1, 3, 6)
    estimates = (h[:, 0] - d[:, 0, 1:] @ held[1:]) / d[:, 0, 0]
    wide = model.parameters[0].prior_sd ** 2
    exact = [multivariate_normal.logpdf(estimates, cov=np.diag(1 / d[:, 0, 0] + t**2) + wide) for t in tau[:, 0]]
    found = log_densities(model, h, d, tau, held)
    np.testing.assert_allclose(np.diff(found), np.diff(exact), rtol=1e-8)
    assert np.abs(np.diff(log_densities(model, h, d, tau)) - np.diff(exact)).max() > 0.3
