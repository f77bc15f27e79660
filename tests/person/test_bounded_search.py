"""Search by the reflection coefficient: lossless resonances are found, and the start of nothing is made worse."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person import bounded_search as search_module
from bayes_impedance.person.bounded_search import bounded_search
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import all_modes

FREQUENCY = np.geomspace(5, 2000, 120)


def recorded(network: str, theta: np.ndarray, seed: int, noise: float = 0.01) -> tuple[Kernel, Likelihood]:
    """One recording with noise of a part of its magnitude, and provisional noise of 5 %."""
    kernel = Kernel(parse(network))
    z = kernel.impedance(theta, FREQUENCY)
    rng = np.random.default_rng(seed)
    z = z + noise * np.abs(z) * (rng.normal(size=z.size) + 1j * rng.normal(size=z.size)) / np.sqrt(2)
    return kernel, Likelihood.make(FREQUENCY, z[None], 0.05 * np.abs(z[None]), np.zeros((1, theta.size)))


@pytest.mark.parametrize(
    ("network", "elements"),
    [("m1-n1-(m2|n2)", [0.28, 2.2e-3, 0.37, 1.4e-3]), ("r1|(m1-n1)|n2", [0.8, 0.02, 1e-4, 8e-4])],
)
def test_resonances_without_damping_are_found_from_random_starts(network: str, elements: list[float]) -> None:
    theta = np.log(elements)
    centre, precision = theta + 0.5, np.eye(theta.size) / 9
    rng = np.random.default_rng(3)
    for seed in range(3):
        kernel, likelihood = recorded(network, theta, seed)
        starts = centre + rng.normal(0, 2.0, (150, theta.size))
        nearer = bounded_search(kernel, likelihood, starts, centre, precision)
        _, objectives, _ = all_modes(kernel, likelihood, nearer, centre, precision, 40)
        _, best, _ = all_modes(kernel, likelihood, theta[None], centre, precision, 40)
        assert np.sum(objectives < best[0] + 0.1) >= 3


@pytest.mark.parametrize("broad", [True, False])
def test_two_resonances_are_found_by_following_them_from_where_they_overlap(
    broad: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not broad:
        monkeypatch.setattr(search_module, "DAMPINGS", ())
    network, centre = "(m1-n1-(n2|m2))|r1|(r2-n3)", np.log([0.0168, 1e-3, 4.2e-4, 0.039, 21.7, 4.4, 7.2e-5])
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        theta = centre + 0.3 * rng.normal(size=centre.size)
        kernel, likelihood = recorded(network, theta, seed, noise=0.02)
        around, precision = centre + 0.7, np.eye(theta.size) / 9
        starts = around + rng.normal(0, 2.5, (96, theta.size))
        nearer = bounded_search(kernel, likelihood, starts, around, precision)
        _, objectives, _ = all_modes(kernel, likelihood, nearer, around, precision, 40)
        _, best, _ = all_modes(kernel, likelihood, theta[None], around, precision, 40)
        found.append(int(np.sum(objectives < best[0] + 0.1)))
    assert (min(found) >= 8) if broad else (max(found) <= 2), found


def test_a_recording_is_followed_to_more_damping_by_its_own_values() -> None:
    """Poisson's integral over a band against the network itself at complex frequencies."""
    kernel, omega, zeta = Kernel(parse("m1-n1-(m2|n2)|r1")), 2 * np.pi * np.geomspace(0.1, 1e5, 2500), 0.1
    values = {"m1": 0.28, "n1": 2.2e-3, "m2": 0.37, "n2": 1.4e-3, "r1": 30.0}
    z = kernel.network.impedance(1j * omega, values)
    inside = (omega > 2 * np.pi * 5) & (omega < 2 * np.pi * 2000)
    z0 = np.abs(z)
    smooth = search_module._smoothed(omega, z, z0, zeta)
    there = kernel.network.impedance(omega * (1j + zeta), values)
    np.testing.assert_allclose(smooth[inside], ((there - z0) / (there + z0))[inside], atol=0.02)


@pytest.mark.parametrize("points", [1, 2, 20_000])
def test_one_frequency_and_very_many_are_searched(points: int) -> None:
    """All pairs of twenty thousand frequencies would take gigabytes."""
    theta, frequency = np.log([0.8, 0.02]), np.geomspace(5, 2000, points)
    kernel = Kernel(parse("r1|m1"))
    z = kernel.impedance(theta, frequency)[None]
    likelihood = Likelihood.make(frequency, z, 0.05 * np.abs(z), np.zeros((1, 2)))
    found = bounded_search(kernel, likelihood, theta[None] + 0.3, theta, np.eye(2) / 9)
    np.testing.assert_allclose(found[0], theta, atol=1e-3)


def test_an_optimum_is_kept_and_what_is_not_finite_is_left_alone() -> None:
    theta = np.log([0.8, 0.02, 1e-4, 8e-4])
    kernel, likelihood = recorded("r1|(m1-n1)|n2", theta, 1, noise=1e-6)
    starts = np.array([theta, np.full(4, 800.0)])
    found = bounded_search(kernel, likelihood, starts, theta, np.eye(4) / 9)
    np.testing.assert_allclose(found[0], theta, atol=1e-4)
    assert found.shape == starts.shape


def test_a_repetition_is_searched_with_its_deviation() -> None:
    theta, deviation = np.log([0.8, 0.02, 1e-4, 8e-4]), np.array([0.3, -0.2, 0.1, 0.0])
    kernel, one = recorded("r1|(m1-n1)|n2", theta + deviation, 1, noise=1e-6)
    both = Likelihood.make(
        FREQUENCY, np.repeat(one.z[:, 0] + 1j * one.z[:, 1], 2, axis=0), one.weight[0] ** -0.5, np.zeros((2, 4))
    ).moved(np.array([deviation, -deviation]))
    found = bounded_search(kernel, both, theta[None] + 0.1, theta, np.eye(4) / 9)
    np.testing.assert_allclose(found[0], theta, atol=1e-3)
