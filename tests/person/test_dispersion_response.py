"""How draws' likelihoods change with dispersions between repetitions: against determinants written out."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel, workspace
from bayes_impedance.network.notation import parse
from bayes_impedance.person.dispersion_response import response_of, responses
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, normal_equations
from bayes_impedance.person.marginal_likelihood import begun, find_ridge, settled
from bayes_impedance.person.noise import contrasts

KERNEL = Kernel(parse("r1|n1|m1"))
CENTRE = np.log([1.0, 1e-3, 5e-3])
RHO = np.array([0.1, 0.05, 0.2])
NODES = RHO[:, None] * np.array([0.1, 0.5, 1.0, 2.0, 10.0])


def log_likelihood(information: np.ndarray, gradient: np.ndarray, rho: np.ndarray) -> float:
    """Of contrasts N(0, R): the Gaussian integral, without the logarithm of R that all draws have in common."""
    prior = np.diag(np.tile(rho**-2.0, gradient.size // rho.size))
    solved = np.linalg.solve(information + prior, gradient)
    return 0.5 * gradient @ solved - 0.5 * np.linalg.slogdet(information + prior)[1]


def expected(information: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    found = np.empty(NODES.shape)
    for p, own in enumerate(NODES):
        for m, value in enumerate(own):
            rho = RHO.copy()
            rho[p] = value
            found[p, m] = log_likelihood(information, gradient, rho) - log_likelihood(information, gradient, RHO)
    return found


@pytest.mark.parametrize("n_contrasts", [1, 2, 4])
def test_one_dispersion_at_a_time(n_contrasts: int) -> None:
    rng = np.random.default_rng(n_contrasts)
    size = 3 * n_contrasts
    a = rng.normal(size=(size, 2 * size))
    information, gradient = 100 * a @ a.T / size, 30 * rng.normal(size=size)
    found = response_of(information, gradient, RHO, NODES)
    assert np.abs(found - expected(information, gradient)).max() < 1e-9
    assert np.all(found[:, 2] == 0.0)  # where nothing changes


def test_each_draw_has_its_own_curvature() -> None:
    rng = np.random.default_rng(2)
    frequency = np.geomspace(5, 500, 20)
    people = CENTRE + 0.1 * rng.normal(size=(3, 3))
    z = KERNEL.impedance(people, frequency)
    z = z * (1 + 0.05 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)))
    centre = people.mean(axis=0)
    deviations = people - centre
    likelihood = Likelihood.make(frequency, z, 0.05 * np.abs(z), deviations)
    ridge = find_ridge(KERNEL, likelihood, centre, 1.0, RHO)
    theta = centre + 0.2 * rng.normal(size=(4, 3))
    found = responses(KERNEL, likelihood, ridge, theta, NODES)
    rows = contrasts(3)
    for t, changes in zip(theta, found, strict=True):
        own, exponent = likelihood, SCALE_SHAPE + z.size
        data = own.omega, own.z, own.weight, exponent, own.beta
        moved, work = np.empty((3, 3)), workspace(KERNEL.program, own.omega)
        begun(KERNEL.program, t, ridge.theta, ridge.slope, deviations, RHO, *data, *work, moved)
        settled(KERNEL.program, t, moved, RHO, *data, np.empty((3, 3, 3)), np.empty((3, 3)))
        equations = [
            normal_equations(KERNEL.program, t + d, likelihood.omega, likelihood.z[j], likelihood.weight[j])
            for j, d in enumerate(moved)
        ]
        w = (SCALE_SHAPE + z.size) / (SCALE_SHAPE + 0.5 * sum(chi for chi, _, _ in equations))
        information = w * sum(np.kron(np.outer(rows[:, j], rows[:, j]), h) for j, (_, _, h) in enumerate(equations))
        gradient = w * sum(np.kron(rows[:, j], h @ moved[j] - g) for j, (_, g, h) in enumerate(equations))
        assert np.abs(changes - expected(information, gradient)).max() < 1e-8
    assert np.abs(found - found[0]).max() > 0.1
