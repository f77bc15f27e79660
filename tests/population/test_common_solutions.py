"""Solutions that everybody has in common, at first and when some persons have gone to another one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from conftest import SMALL
from drawn_posteriors import posterior_of

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population import em
from bayes_impedance.population.common_solutions import best_common, from_one_person
from bayes_impedance.population.order import Order
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.runtime.sharded import Kept

ONE_THREAD = ThreadPoolExecutor(1)


def people(n: int) -> Kept:
    z = np.ones((1, 3), dtype=complex)
    return Kept.of(ONE_THREAD, (Likelihood.make(np.arange(1.0, 4), z, 0.1 * np.abs(z), np.zeros((1, 1))),) * n)


class Trial:
    """Stands for the state of a population that stays where it was put."""

    def __init__(self, theta: np.ndarray, evidence: float) -> None:
        self.theta, self._evidence = theta, evidence

    def iterate(self, extra_starts: None) -> float:
        assert extra_starts is None
        return 0.0

    def align(self) -> None:
        pass

    def log_evidence(self) -> float:
        return self._evidence


def test_the_common_solution_of_highest_evidence_is_taken_and_an_exchange_is_no_rival() -> None:
    """r1 and r2 exchanged are the same explanation; one that lies farther than 0.3 in some element is another."""
    at = np.array([[0.0, 2.0], [2.0, 0.0], [0.0, 2.2], [1.0, 2.0]])
    common = np.repeat(at[:, None], 3, axis=1)
    evidences = dict(zip(map(tuple, at), (-7.0, -5.0, -6.0, -9.0), strict=True))
    first = FirstFits(common[0], np.empty((3, 0, 2)), common, None)
    data = people(3)

    def state_from(theta: np.ndarray, thinned: Kept) -> Trial:
        assert len(thinned.gathered()) == 3
        return Trial(theta, evidences[tuple(theta[0])])

    def best(network: str, order: Order) -> tuple[np.ndarray, tuple[float, ...]]:
        return best_common(Kernel(parse(network)), order, state_from, data, first, lambda *_: None)  # type: ignore[arg-type]

    begun, rivals = best("r1|r2", Order())
    np.testing.assert_array_equal(begun, common[1])
    assert rivals == (4.0,)
    # Where the two cannot be exchanged and their order is given, only what is in this order is a solution.
    rising, falling = (Order(chains=(pair,), names=(("r1", "r2"),)) for pair in ((0, 1), (1, 0)))
    np.testing.assert_array_equal(best("r1-(r2|m1=1.0)", rising)[0], common[2])
    np.testing.assert_array_equal(best("r1-(r2|m1=1.0)", falling)[0], common[1])
    np.testing.assert_array_equal(best("r1|r2", rising)[0], common[1])


@pytest.mark.parametrize("gain", [5.0, 0.5, -5.0])
def test_everybody_begins_from_one_persons_solution_if_that_is_more_probable(gain: float) -> None:
    """Of those who have gone to another one only, and of equal ones only one is tried; half a unit is no difference."""
    now = np.array([[0.0, 1.0], [0.1, 1.0], [4.0, 1.0], [4.1, 1.0], [0.0, 9.0]])
    began: list[tuple[float, ...]] = []

    def state_from(theta: np.ndarray, thinned: Kept) -> Trial:
        if np.ptp(theta, axis=0).any():
            return Trial(theta, -20.0)
        began.append(tuple(theta[0]))
        return Trial(theta, -20.0 + (gain if theta[0, 0] > 2 else -50.0))

    kernel, jumped = Kernel(parse("r1-(r2|m1=1.0)")), np.array([True, True, True, True, False])

    def found(order: Order) -> tuple[np.ndarray | None, float]:
        began.clear()
        return from_one_person(kernel, order, state_from, people(5), now, jumped, lambda *_: None)  # type: ignore[arg-type]

    begun, more = found(Order())
    assert sorted(began) == [(0.1, 1.0), (4.1, 1.0)]
    assert more == gain
    if gain > 1:
        np.testing.assert_array_equal(begun, np.tile([4.1, 1.0], (5, 1)))
    else:
        assert begun is None
    # r1 is to be below r2, as it is in the middle now, and is not there.
    assert found(Order(chains=((0, 1),), names=(("r1", "r2"),)))[0] is None


@pytest.mark.parametrize("together", [True, False])
def test_a_population_that_spans_two_optima_is_brought_together(
    together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody's search begins in the right optimum; some persons go there later, and the dispersion holds the others."""
    two = replace(
        SMALL,
        central={"n3": 2e-6, "r3": 60.0, "m2": 8e-4, "r1": 4.0, "n1": 1.2e-3},
        between_persons={"n3": 0.4, "r3": 0.3, "m2": 0.25, "r1": 0.4, "n1": 0.3},
        noise=0.025,
    )
    recordings = simulate_recordings(two, 16, 3, np.geomspace(5, 5000, 30), seed=3).recordings
    if not together:
        monkeypatch.setattr(em, "_MOST_TOGETHER", 0)
    point = posterior_of(recordings, monkeypatch).point
    everybody = np.array([mode.theta[0] for mode in point.modes])
    if together:
        assert point.mu[0] == pytest.approx(np.log(2e-6), abs=0.2)
        assert np.ptp(everybody) < 1.5
        assert max(point.rivals) > 10
    else:
        assert np.ptp(everybody) > 3
