"""From other gaps of the grid of frequencies the optimum of a sharp resonance is found, and only of a sharp one."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.bounded_search import best_end, best_mode
from bayes_impedance.person.gaps import other_gaps
from bayes_impedance.person.likelihood import Likelihood

NETWORK = "r1|n2|(m1-n1)"
TRUE = np.log([0.8, 8e-4, 0.02, 1e-4])
GRIDS = {"linear": np.linspace(5, 1000, 250), "logarithmic": np.geomspace(5, 1000, 250)}
PRECISION, FREE = np.eye(4) / 0.3**2, np.ones(4, dtype=bool)


def recorded(kernel: Kernel, theta: np.ndarray, frequency_hz: np.ndarray) -> Likelihood:
    rng = np.random.default_rng(1)
    z = kernel.impedance(theta, frequency_hz)[None]
    sd = 0.01 * np.abs(z)
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    return Likelihood.make(frequency_hz, z, sd, np.zeros((1, theta.size)))


@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("moved", [-0.2, -0.1, 0.1, 0.2])
def test_a_resonance_many_gaps_off_is_found(grid: str, moved: float) -> None:
    kernel = Kernel(parse(NETWORK))
    data = recorded(kernel, TRUE, GRIDS[grid])
    wrong = TRUE.copy()
    wrong[3] += moved
    stuck, worse = best_mode(kernel, data, wrong[None], TRUE, PRECISION)
    starts = other_gaps(kernel, data, stuck[None], FREE)
    assert 0 < len(starts) <= 8
    found = best_end(kernel, data, np.concatenate([stuck[None], starts]), TRUE, PRECISION)
    _, better = best_mode(kernel, data, found[None], TRUE, PRECISION)
    assert better <= worse
    np.testing.assert_allclose(found, TRUE, atol=0.05)


def test_a_wide_resonance_has_no_other_gaps() -> None:
    kernel = Kernel(parse("r1|n2|(m1-n1-r2)"))
    theta = np.log([0.8, 8e-4, 0.02, 1e-4, 3.0])
    data = recorded(kernel, theta, GRIDS["linear"])
    assert other_gaps(kernel, data, theta[None], np.ones(5, dtype=bool)).shape == (0, 5)


def test_what_is_held_is_not_moved() -> None:
    kernel = Kernel(parse(NETWORK))
    data = recorded(kernel, TRUE, GRIDS["linear"])
    assert len(other_gaps(kernel, data, TRUE[None], np.zeros(4, dtype=bool))) == 0
    starts = other_gaps(kernel, data, TRUE[None], np.array([False, False, True, False]))
    np.testing.assert_array_equal(starts[:, [0, 1, 3]], np.tile(TRUE[[0, 1, 3]], (len(starts), 1)))


@pytest.mark.parametrize("person", [22, 35, 36])
def test_the_gap_beside_is_found_in_a_network_of_two_resonances(person: int) -> None:
    kernel = Kernel(parse("(m1-n1)|((n2|r1|m2)-n3-m3)"))
    centre = np.log([0.0325, 6.18e-5, 4.84e-6, 60.8, 0.759, 5.97e-5, 0.0363])
    spread = [0.49, 0.126, 0.339, 0.116, 0.4375, 0.124, 0.1367]
    true = centre + spread * np.random.default_rng(person).normal(size=7)
    frequency_hz = np.geomspace(15.03, 1268.26, 379)
    data = recorded(kernel, true, frequency_hz)
    wrong = true.copy()
    wrong[0] += 2 * np.log(frequency_hz[1] / frequency_hz[0])
    precision = np.eye(7) / 0.1**2
    stuck, worse = best_mode(kernel, data, wrong[None], true, precision)
    starts = other_gaps(kernel, data, stuck[None], np.ones(7, dtype=bool))
    found = best_end(kernel, data, np.concatenate([stuck[None], starts]), true, precision)
    _, better = best_mode(kernel, data, found[None], true, precision)
    _, best = best_mode(kernel, data, true[None], true, precision)
    assert worse > best + 1000
    assert better == pytest.approx(best, abs=0.1)


@pytest.mark.parametrize(
    ("true", "moved"),
    [
        ([-5.85, -2.53, -11.99, -10.7, -0.56, -8.01, -8.46], [0.872, 0.046]),
        ([-5.39, -2.5, -11.5, -10.51, -0.45, -8.33, -8.35], [0.785, -0.915]),
        ([-6.3, -2.32, -12.6, -10.46, -0.37, -7.7, -8.18], [0.695, -0.62]),
    ],
)
def test_a_resonance_that_no_frequency_meets_is_found(true: list[float], moved: list[float]) -> None:
    """A branch that matters at one point only: where the fit has it, in a gap, no element seems to move anything."""
    kernel = Kernel(parse("n1-((n2-m1)|(m2-r1)|n3)-m3"))
    theta, every, precision = np.array(true), np.ones(7, dtype=bool), np.eye(7)
    data = recorded(kernel, theta, np.geomspace(8, 2000, 255))
    centre, wrong = theta.copy(), theta.copy()
    centre[1:3] += [0.4, -0.1]  # of the population
    wrong[1:3] += moved
    stuck, worse = best_mode(kernel, data, wrong[None], centre, precision)
    _, best = best_mode(kernel, data, theta[None], centre, precision)
    assert worse > best + 10
    assert len(other_gaps(kernel, data, stuck[None], every)) == 0
    starts = other_gaps(kernel, data, stuck[None], every, np.full(7, 1.5))
    _, found = best_mode(kernel, data, np.concatenate([stuck[None], starts]), centre, precision)
    assert found == pytest.approx(best, abs=0.1)
