"""Who is described much worse than most is searched alone, and found where draws of the population do not lead."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.outliers_alone import ends_of_outliers, search_alone
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

NETWORK = "r1|n2|(m1-n1)"


@pytest.fixture(scope="module")
def fitted() -> Iterator[Fitted]:
    """Twelve people with an undamped absorber, each recorded twice."""
    population = VirtualPopulation(
        network=NETWORK,
        central={"r1": 0.8, "n2": 8e-4, "m1": 0.02, "n1": 1e-4},
        between_persons=dict.fromkeys(["r1", "n2", "m1", "n1"], 0.2),
        between_repetitions={"n2": 0.01},
    )
    made = simulate_recordings(population, 12, 2, np.geomspace(5, 1000, 120), 1)
    with ThreadPoolExecutor(1) as executor:
        yield fit_network(made.recordings, NETWORK, 1, executor, lambda *_: None)


def stuck(fitted: Fitted) -> Refit:
    """The fit with the third person's resonance, which is sharp, a third too high."""
    fit = fitted.fit
    u = fit.u.copy()
    column = fit.model.kernel.elements.index("n1")
    u[fit.owner == 2, column] -= 0.6
    return fitted.refitter.fit(fit.model, u, fit.population, 30, hold_population=True)


def test_a_person_in_another_valley_is_found(fitted: Fitted) -> None:
    wrong = stuck(fitted)
    assert wrong.evidence[2] < fitted.fit.evidence[2] - 100  # it does not come back by itself
    start = ends_of_outliers(wrong, wrong.u, np.random.default_rng(1))
    np.testing.assert_allclose(start[fitted.fit.owner == 2], fitted.fit.u[fitted.fit.owner == 2], atol=0.05)
    others = ~somewhat_worse(wrong)[fitted.fit.owner]
    assert others.sum() >= 18  # of 24 recordings
    np.testing.assert_array_equal(start[others], wrong.u[others])
    assert fitted.refitter.settle(wrong, 1).evidence[2] == pytest.approx(fitted.fit.evidence[2], abs=1.0)


def somewhat_worse(fit: Refit) -> np.ndarray:
    """People who are described worse than most, whose search may move them."""
    scale = fit.weight**-0.5
    return np.asarray(scale > 1.25 * np.median(scale))


def test_nobody_who_is_described_like_most_is_moved(fitted: Fitted) -> None:
    fit = fitted.fit
    start = ends_of_outliers(fit, fit.u, np.random.default_rng(1))
    usual = ~somewhat_worse(fit)[fit.owner]
    np.testing.assert_array_equal(start[usual], fit.u[usual])


def test_where_nearly_everybody_is_described_badly_nothing_is_moved(fitted: Fitted) -> None:
    rng = np.random.default_rng(1)
    wrong, u = fitted.fit, fitted.fit.u.copy()
    column = wrong.model.kernel.elements.index("n1")
    u[wrong.owner < 7, column] -= 0.6
    wrong = fitted.refitter.fit(wrong.model, u, wrong.population, 30, hold_population=True)
    assert ends_of_outliers(wrong, wrong.u, rng) is wrong.u


HIDDEN = "(n1-m1)|n2|(m2-r1-n3)"
"""Resonances of the first branch are narrower than the frequencies are apart: each gap has an optimum."""


@pytest.fixture(scope="module")
def hidden() -> Iterator[Fitted]:
    values = {"n1": 0.019, "m1": 0.0144, "n2": 5.1e-5, "m2": 1.75e-4, "r1": 0.84, "n3": 1.25e-3}
    spreads = {"n1": 0.3, "m1": 0.5, "n2": 0.12, "m2": 0.3, "r1": 0.33, "n3": 0.38}
    population = VirtualPopulation(network=HIDDEN, central=values, between_persons=spreads, between_repetitions={})
    made = simulate_recordings(population, 12, 1, np.geomspace(5, 8300, 340), 1)
    with ThreadPoolExecutor(1) as executor:
        yield fit_network(made.recordings, HIDDEN, 1, executor, lambda *_: None)


def test_elements_that_are_lost_are_searched_with_the_others_held(hidden: Fitted) -> None:
    """Starts in which all elements differ miss the one gap of many: with them alone, 8 of 12 people stay lost."""
    fit, refitter = hidden.fit, hidden.refitter
    u = fit.u.copy()
    u[:, fit.model.kernel.elements.index("m1")] -= 13
    lost, everybody = replace(fit, u=u), np.arange(12)
    start = search_alone(lost, u, everybody, fit.population, np.random.default_rng(1), thorough=True)
    found = refitter.fit(fit.model, start, fit.population, 30, hold_population=True)
    assert np.sum(found.evidence > fit.evidence - 1) >= 10
