"""Solutions that everybody has in common, at first and when some persons have gone to another one."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from conftest import SMALL
from drawn_posteriors import posterior_of

from bayes_impedance.diagnosis.fit.baseline import point_estimate
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population import common_solutions, em
from bayes_impedance.population.common_solutions import best_common, from_another
from bayes_impedance.population.em_state import State
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.order import Order
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.runtime.sharded import Kept

ONE_THREAD = ThreadPoolExecutor(1)


def people(n: int) -> Kept:
    z = np.ones((1, 3), dtype=complex)
    return Kept.of(ONE_THREAD, (Likelihood.make(np.arange(1.0, 4), z, 0.1 * np.abs(z), np.zeros((1, 1))),) * n)


class Trial:
    """Stands for the state of a population that stays where it was put."""

    mu, phi = np.array([1.0, 1.0]), np.empty(0)
    pooling = Pooling(Kernel(parse("r1|r2")))

    def __init__(self, theta: np.ndarray, evidence: float) -> None:
        self.theta, self._evidence, self.n_persons = theta, evidence, len(theta)

    def iterate(self, extra_starts: None) -> float:
        assert extra_starts is None
        return 0.0

    def align(self) -> None:
        pass

    def take_population(self, other: Trial) -> None:
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

    def state_from(theta: np.ndarray, thinned: Kept, persons: np.ndarray) -> Trial:
        assert len(thinned.gathered()) == persons.size == 3
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


def test_of_many_people_some_compare_and_everybody_begins_from_what_they_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven people compare by three of them, spread evenly; the solution taken is then tried with all of them."""
    monkeypatch.setattr(common_solutions, "_COMPARED", 3)
    common = np.arange(28.0).reshape(2, 7, 2)
    first = FirstFits(common[0], np.empty((7, 0, 2)), common, None)
    tried: list[tuple[list[int], float]] = []

    def state_from(theta: np.ndarray, thinned: Kept, persons: np.ndarray) -> Trial:
        assert len(thinned.gathered()) == len(theta)
        tried.append((persons.tolist(), float(theta[0, 0])))
        return Trial(theta + 0.5, theta[0, 0])  # the second is more probable

    kernel = Kernel(parse("r1-(r2|m1=1.0)"))
    begun, rivals = best_common(kernel, Order(), state_from, people(7), first, lambda *_: None)  # type: ignore[arg-type]
    assert tried == [([0, 3, 6], 0.0), ([0, 3, 6], 14.0), ([0, 1, 2, 3, 4, 5, 6], 14.0)]
    np.testing.assert_array_equal(begun, common[1] + 0.5)
    assert rivals == (14.0,)


@pytest.mark.parametrize("gain", [5.0, 0.5, -5.0])
def test_everybody_begins_from_another_solution_if_that_is_more_probable(
    gain: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those who have gone to another one only, and of equal ones only one is tried; half a unit is no difference."""
    now = np.array([[0.0, 1.0], [0.1, 1.0], [4.0, 1.0], [4.1, 1.0], [0.0, 9.0]])
    jumped = np.array([True, True, True, True, False])
    monkeypatch.setattr(common_solutions, "_left_open", lambda _: np.empty((0, 2)))

    def found(order: Order) -> tuple[Trial | None, float, set[tuple[float, ...]]]:
        return tried_from(now, jumped, lambda theta: -20.0 + (gain if theta[0] > 2 else -50.0), order)

    begun, more, tried = found(Order())
    assert tried == {(0.1, 1.0), (4.1, 1.0)}
    assert more == gain
    if gain > 1:
        assert begun is not None
        np.testing.assert_array_equal(begun.theta, np.tile([4.1, 1.0], (5, 1)))
    else:
        assert begun is None
    # r1 is to be below r2, as it is in the middle now, and is not there.
    assert found(Order(chains=((0, 1),), names=(("r1", "r2"),)))[0] is None


@pytest.mark.parametrize("nearest", [True, False])
def test_elements_that_recordings_leave_open_are_changed_to_either_side(
    nearest: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only these, from the centre of the population, if nobody has gone elsewhere; what ends nearby is no other one."""
    now, jumped = np.tile([1.0, 1.0], (5, 1)), np.zeros(5, dtype=bool)
    monkeypatch.setattr(common_solutions, "_left_open", lambda _: np.array([[0.0, 1.0]]))
    if nearest:
        monkeypatch.setattr(common_solutions, "APART", 5.0)
    begun, more, tried = tried_from(now, jumped, lambda theta: -20.0 + 7.0 * (theta[1] == -3.0), Order())
    assert tried == {(1.0, 3.0), (1.0, -1.0), (1.0, 5.0), (1.0, -3.0)}
    assert more == 7.0
    if nearest:
        assert begun is None
    else:
        assert begun is not None
        np.testing.assert_array_equal(begun.theta, np.tile([1.0, -3.0], (5, 1)))
    monkeypatch.setattr(common_solutions, "_left_open", lambda _: np.empty((0, 2)))
    assert tried_from(now, jumped, lambda _: 0.0, Order()) == (None, 0.0, set())


def tried_from(
    now: np.ndarray, jumped: np.ndarray, evidence: Callable[[np.ndarray], float], order: Order
) -> tuple[Trial | None, float, set[tuple[float, ...]]]:
    """What is found beside a population of evidence -20, its gain, and what was tried for everybody."""
    began: set[tuple[float, ...]] = set()

    def state_from(theta: np.ndarray, data: Kept, persons: np.ndarray) -> Trial:
        if np.array_equal(theta, now):
            return Trial(theta, -20.0)
        began.add(tuple(theta[0]))
        return Trial(theta, evidence(theta[0]))

    kernel, state = Kernel(parse("r1-(r2|m1=1.0)")), Trial(now, -20.0)
    begun, gain = from_another(kernel, order, state_from, people(len(now)), state, jumped, lambda *_: None)  # type: ignore[arg-type]
    return begun, gain, began  # type: ignore[return-value]


@pytest.mark.long
@pytest.mark.parametrize("changed", [True, False])
def test_what_no_person_determines_is_searched_for_everybody(changed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Above 50 Hz a fingertip leaves its skin's spring open; one a hundred times as large is less likely."""
    band = np.geomspace(50, 2000, 60)
    recordings = simulate_recordings(replace(FINGERTIP, noise=0.03), 30, 2, band, seed=4).recordings
    if not changed:
        monkeypatch.setattr(common_solutions, "_KICKS", ())
    kernel = Kernel(parse(FINGERTIP.network))
    point = point_estimate(recordings, kernel, default_prior(kernel, recordings), 1, ONE_THREAD, lambda *_: None)
    spring, damper = point.mu[:2] - np.log([FINGERTIP.central["n3"], FINGERTIP.central["r3"]])
    if changed:
        assert spring < 2
        assert damper < 0.4
        assert max(point.rivals) > 10
    else:
        assert spring > 4
        assert damper > 0.5


@pytest.mark.parametrize("together", [True, False])
def test_a_population_that_spans_two_optima_is_brought_together(
    together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not everybody's search ends in the right optimum, and the dispersion holds those who are elsewhere."""
    two = replace(
        SMALL,
        central={"n3": 2e-6, "r3": 60.0, "m2": 8e-4, "r1": 4.0, "n1": 1.2e-3},
        between_persons={"n3": 0.4, "r3": 0.3, "m2": 0.25, "r1": 0.4, "n1": 0.3},
        noise=0.025,
    )
    recordings = simulate_recordings(two, 16, 3, np.geomspace(5, 5000, 30), seed=8).recordings
    if not together:
        monkeypatch.setattr(em, "_MOST_TOGETHER", 0)
    point = posterior_of(recordings, monkeypatch).point
    everybody = np.array([mode.theta[0] for mode in point.modes])
    if together:
        assert point.mu[0] == pytest.approx(np.log(2e-6), abs=0.2)
        assert np.ptp(everybody) < 1.5
        assert max(point.rivals) > 10
    else:
        assert np.ptp(everybody) > 2
        assert point.mu[0] > np.log(2e-6) + 0.3


@pytest.mark.parametrize("better", [True, False])
def test_who_is_far_from_most_begins_under_the_population_of_the_others(
    better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody has gone elsewhere and nothing is open: all begin with those who are far where the median is."""
    theta = np.column_stack([0.1 * np.arange(8.0), np.ones(8)])
    theta[7, 0] = 9.0
    others = []

    class Gathered(Trial):
        def take_population_of(self, theta: np.ndarray) -> None:
            others.append(theta)

    def state_from(own: np.ndarray, _: Kept, __: np.ndarray) -> Trial:
        far = bool(np.any(own[:, 0] > 2))
        return Gathered(own, -20.0 if far else (-5.0 if better else -30.0))

    monkeypatch.setattr(common_solutions, "_left_open", lambda _: np.empty((0, 2)))
    now, nobody = Gathered(theta, -20.0), np.zeros(8, dtype=bool)
    begun, gain = from_another(
        Trial.pooling.kernel, Order(), state_from, people(8), cast(State, now), nobody, lambda *_: None
    )
    assert gain == (15.0 if better else -10.0)
    np.testing.assert_array_equal(others, [theta[:7]])
    if better:
        assert begun is not None
        np.testing.assert_array_equal(begun.theta[:7], theta[:7])
        np.testing.assert_array_equal(begun.theta[7], np.median(theta, axis=0))
    else:
        assert begun is None


def test_populations_with_sharp_resonances_have_the_dispersions_of_their_people() -> None:
    """Whoever's resonance is missed at first is gathered or found in another gap of the frequencies."""
    central = {"m1": 0.03, "n1": 1.0, "r1": 0.11, "n2": 4.45e-3, "m2": 0.3, "n3": 0.027}
    spread = {"m1": 0.346, "n1": 0.464, "r1": 0.498, "n2": 0.172, "m2": 0.152, "n3": 0.335}
    people = VirtualPopulation(
        network="(m1-n1-r1)|n2|(m2-n3)",
        central=central,
        between_persons=spread,
        between_repetitions=dict.fromkeys(central, 0.015),
        noise=0.01,
    )
    recordings = simulate_recordings(people, 24, 2, np.geomspace(0.9, 360, 60), seed=6).recordings
    kernel = Kernel(parse(people.network))
    point = point_estimate(recordings, kernel, default_prior(kernel, recordings), 1, ONE_THREAD, lambda *_: None)
    m2, n3 = (np.sqrt(point.covariance[k, k]) for k in (4, 5))
    assert 0.5 < m2 / spread["m2"] < 2
    assert 0.5 < n3 / spread["n3"] < 2
