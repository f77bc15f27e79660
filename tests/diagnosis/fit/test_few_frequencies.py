"""Recordings that are summed up on the way of a fit do not change where it ends."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from experiments import Experiment, toy

from bayes_impedance.diagnosis.fit.baseline import Fitted, fit_network
from bayes_impedance.diagnosis.fit.few_frequencies import few_frequencies, worth_it
from bayes_impedance.diagnosis.fit.normal_equations import equations_at
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

DAMPED = (
    "m2|r1|n1|(m1-(n2|r2))",
    {"m2": 7.9e-4, "r1": 1.5, "n1": 1.15e-3, "m1": 0.05, "n2": 4.7e-3, "r2": 3.8},
)


@pytest.fixture(scope="module")
def experiment() -> Experiment:
    """Twelve people, twice 240 frequencies in three decades."""
    return toy(*DAMPED, seed=3, n=12, repetitions=2, noise=0.01, frequency_hz=np.geomspace(5, 5000, 240))


def test_the_normal_equations_at_the_place_are_those_of_all_frequencies(experiment: Experiment) -> None:
    refitter, model, u = experiment.refitter, experiment.model, experiment.u
    small = few_frequencies(model, refitter.stack, u, refitter.executor)
    assert small is not None
    sizes = {omega.size for _, lent in small.pieces for omega, _, _ in lent.data}
    assert max(sizes) < 0.5 * 240
    whole = equations_at(model, refitter.stack, u, refitter.executor)
    few = equations_at(model, small, u, refitter.executor)
    np.testing.assert_allclose(few.chi, whole.chi, rtol=1e-9)
    sd = np.sqrt(np.einsum("mpp->mp", whole.information))
    np.testing.assert_allclose(few.gradient / sd, whole.gradient / sd, atol=0.02)
    np.testing.assert_allclose(
        few.information / sd[:, :, None] / sd[:, None], _correlation(whole.information), atol=1e-3
    )


def test_chi_square_changes_as_that_of_all_frequencies(experiment: Experiment) -> None:
    """At steps of several standard deviations: a change of hundreds is off by less than one."""
    refitter, model, u = experiment.refitter, experiment.model, experiment.u
    small = few_frequencies(model, refitter.stack, u, refitter.executor)
    assert small is not None
    there = u + 0.03 * np.random.default_rng(1).normal(size=u.shape)
    whole = equations_at(model, refitter.stack, there, refitter.executor).chi
    before = equations_at(model, refitter.stack, u, refitter.executor).chi
    few = equations_at(model, small, there, refitter.executor).chi
    assert np.median(np.abs(whole - before)) > 100
    assert np.all(np.abs(few - whole) < 0.01 * np.abs(whole - before) + 0.5)


def test_a_fit_ends_where_it_ends_with_all_frequencies(experiment: Experiment, monkeypatch: pytest.MonkeyPatch) -> None:
    refitter = experiment.refitter
    assert refitter.many_frequencies
    start = experiment.u + 0.3
    few = refitter.fit(experiment.model, start, experiment.population, 600, tolerance=1e-3)
    monkeypatch.setattr(refitter, "many_frequencies", False)
    whole = refitter.fit(experiment.model, start, experiment.population, 600, tolerance=1e-3)
    assert few.settled
    assert whole.settled
    np.testing.assert_allclose(few.evidence, whole.evidence, atol=0.05)
    np.testing.assert_allclose(few.population.mu, whole.population.mu, atol=0.05 * 0.2 / np.sqrt(12))
    # With all frequencies at the end, chi-square is that of the place, not of the sums.
    exact = equations_at(few.model, refitter.stack, few.u, refitter.executor).chi
    np.testing.assert_allclose(few.equations.chi, exact, rtol=1e-12)


def test_few_frequencies_are_not_summed_up() -> None:
    few = toy(*DAMPED, seed=3, n=4, frequency_hz=np.geomspace(5, 5000, 60)).refitter
    assert not worth_it(few.stack)
    assert not few.many_frequencies


@pytest.fixture(scope="module")
def sharp() -> Iterator[Fitted]:
    """Resonances narrower than the nodes are apart."""
    values = {"n1": 0.019, "m1": 0.0144, "m2": 1.75e-4, "r1": 0.84, "n3": 1.25e-3}
    population = VirtualPopulation(
        network="(n1-m1)|(m2-r1-n3)", central=values, between_persons=dict.fromkeys(values, 0.2), between_repetitions={}
    )
    made = simulate_recordings(population, 8, 1, np.geomspace(5, 8300, 340), 2)
    with ThreadPoolExecutor(1) as executor:
        yield fit_network(made.recordings, "(n1-m1)|(m2-r1-n3)", 1, executor, lambda *_: None)


def test_nobody_is_led_to_another_gap_by_sums_that_do_not_hold(sharp: Fitted, monkeypatch: pytest.MonkeyPatch) -> None:
    """From half a gap beside the resonance: the same ends as with all frequencies."""
    refitter, fit = sharp.refitter, sharp.fit
    assert refitter.many_frequencies
    start = fit.u.copy()
    start[:, fit.model.kernel.elements.index("m1")] += 0.02
    few = refitter.fit(fit.model, start, fit.population, 40, hold_population=True)
    monkeypatch.setattr(refitter, "many_frequencies", False)
    whole = refitter.fit(fit.model, start, fit.population, 40, hold_population=True)
    np.testing.assert_allclose(few.evidence, whole.evidence, atol=0.1)


def _correlation(information: np.ndarray) -> np.ndarray:
    sd = np.sqrt(np.einsum("mpp->mp", information))
    return np.asarray(information / sd[:, :, None] / sd[:, None])
