"""Starts of lines on a grid of coefficients: waves are found where a start from zero does not arrive."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from experiments import Experiment, Serial, entry, recovered, toy
from scipy.optimize import minimize

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.model import Addition, Model
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import level_starts
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.level_starts import FirstRecordings, LevelEvidence, best_levels, from_level
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.person.likelihood import Likelihood

MASS, COMPLIANCE = 2e-3, 8e-6


def waves(compliance: float):
    """A layer with a free surface in place of the mass of m1|r1."""

    def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        n = compliance * np.exp(0.2 * rng.normal(size=len(z)))
        mass = 1j * z.imag
        x = np.sqrt(s * mass * n[:, None, None])
        return z - mass + mass * np.tanh(x) / x, n

    return hidden


@pytest.fixture(scope="module")
def inside() -> Experiment:
    """The first standing wave is at 2 kHz, where the band ends: in half of the people it is inside."""
    return toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=4, n=18, hidden=waves(COMPLIANCE))


def candidate() -> Candidate:
    return Candidate(entry("body.free_line"), "m1", {"level": 1.0})


def levels(fit: Refit, *candidates: Candidate) -> tuple[LevelEvidence, ...]:
    return best_levels(fit, candidates or [candidate()], Serial())


def test_the_grid_finds_the_compliance_and_the_refit_is_better_than_from_zero(inside: Experiment) -> None:
    fit = inside.fit()
    (level,) = levels(fit)
    assert 0.7 < level.size / COMPLIANCE < 1.4
    assert level.spread < 0.5
    assert level.log_e > 100
    grown = from_level(inside.refitter, fit, level, 40)
    assert grown.settled
    from_zero = recovered(inside, entry("body.free_line"), "m1", "varying", 60)
    assert log_evidence(grown) > log_evidence(from_zero) + 100


def test_everybody_begins_at_the_own_coefficient(inside: Experiment) -> None:
    fit = inside.fit()
    begun: list[Any] = []
    (level,) = levels(fit)
    from_level(cast(Any, SimpleNamespace(fit=lambda *start: begun.append(start))), fit, level, 40)
    model, u, population, rounds = begun[0]
    column = model.columns(0)[0]
    size = candidate().effect.coefficients[0].scale(model.scales)
    own = u[np.searchsorted(fit.owner, range(18)), column] * size
    assert inside.coefficients is not None
    assert np.corrcoef(np.log(own), np.log(inside.coefficients))[0, 1] > 0.7
    assert population.mu[-1] == pytest.approx(u[:, column].mean())
    assert rounds == 40


def test_the_places_that_are_likelier_than_nothing_come_best_first(inside: Experiment) -> None:
    everywhere = [candidate(), Candidate(entry("body.diffusion"), "r1", {"level": 1.0})]
    found = levels(inside.fit(), *everywhere, Candidate(entry("body.mass"), "port", {}))
    assert found[0].candidate == candidate()
    assert all(level.candidate.effect.operation == "free_line" and level.log_e > 0 for level in found)
    assert [level.log_e for level in found] == sorted((level.log_e for level in found), reverse=True)


def test_where_there_are_no_waves_the_evidence_is_on_average_at_most_one() -> None:
    """Of twenty populations; with the elements where the fit has left them, not where they are."""
    evidence = []
    for seed in range(20):
        fit = toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=50 + seed, n=6).fit()
        evidence.append(level_starts.level_evidence(FirstRecordings.of(fit, range(6)), candidate()).log_e)
    assert np.mean(np.exp(evidence)) < 1.0


def test_where_elements_could_become_others_the_evidence_is_on_average_at_most_one() -> None:
    """At the elements' best values all of these twelve populations had evidence of a line, up to 6.6 units."""
    elements, grid = {"m1": MASS, "r1": 0.3, "n1": 0.5}, np.geomspace(2, 2000, 101)
    line, evidence = Candidate(entry("body.line"), "n1", {"level": 1.0}), []
    for seed in range(12):
        fit = toy("m1|r1|n1", elements, seed, 30, 1, noise=0.003, tau=0.4, frequency_hz=grid).fit()
        evidence.append(level_starts.level_evidence(FirstRecordings.of(fit, range(30)), line).log_e)
    assert np.mean(np.exp(evidence)) < 1.0


def most_probable(first: FirstRecordings, larger: Model, values: np.ndarray) -> np.ndarray:
    """What is promised, with elements found by a general minimiser, (N, K)."""
    scale, result = larger.additions[0].effect.coefficients[0].scale(larger.scales), []
    for u, data in zip(first.u, first.data, strict=True):

        def minus_log(e: np.ndarray, x: float, data: Likelihood = data) -> float:
            return -float(first.with_elements_free(larger, np.append(e, x / scale)[None], data)[0][0])

        least = [minimize(minus_log, u, (x,), "Nelder-Mead").fun for x in (0.0, *values)]
        result.append(least[0] - np.array(least[1:]))
    return np.array(result)


def test_no_coefficient_is_promised_more_than_its_most_probable_elements_have(inside: Experiment) -> None:
    """Beside narrow poles: the expansion of one step promises up to hundreds that are not there."""
    fit, values = inside.fit(), np.geomspace(0.3, 8, 84) * COMPLIANCE
    first = FirstRecordings.of(fit, range(6))
    gains = level_starts._gains(first, candidate(), values)
    larger = inside.grown(Addition(effect=entry("body.free_line"), place="m1", pooling="varying"))
    exact = most_probable(first, larger, values)
    assert np.all(gains < np.maximum(exact, exact.max(axis=1, keepdims=True) - 10) + 1)


def test_waves_far_below_the_upper_end_of_the_band_are_found() -> None:
    """The first standing wave is at 333 Hz of 2 to 2000, and two more are in the band."""
    deep = 6**2 * COMPLIANCE
    own = toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=6, n=12, hidden=waves(deep))
    fit = own.refitter.fit(own.model, own.u, own.population, 0)  # elements are near where they belong
    (level,) = levels(fit)
    assert 0.7 < level.size / deep < 1.4
    assert level.log_e > 100


def test_poles_that_are_elsewhere_in_everybody_are_significant_though_no_score_is() -> None:
    """The first standing wave of a spring's mass is at 1.6 kHz, and between 0.9 and 2.7 kHz in most people."""
    spring, mass = 1e-3, 1e-4

    def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = mass * np.exp(0.5 * rng.normal(size=len(z)))
        x = s * np.sqrt(own * spring)[:, None, None]
        return z - 1 / (s * spring) + x / np.tanh(x) / (s * spring), own

    elements = {"m1": MASS, "r1": 50.0, "n1": spring}
    fit = toy("m1|r1|n1", elements, 8, n=14, repetitions=1, noise=0.03, tau=0.1, rho=1e-3, hidden=hidden).fit()
    residuals = tuple(person_residuals(fit, [str(i) for i in range(14)]))
    screening = screen(fit, residuals, [entry("body.line")], 1, Serial())
    assert screening.levels[0].candidate.place == "n1"
    assert 0.7 < screening.levels[0].size / mass < 1.4
    step = Step(before=fit, residuals=residuals, screening=screening)
    assert step.log_p == screening.log_p_levels < np.log(1e-20)
    assert replace(step, screening=replace(screening, levels=())).log_p > np.log(0.05)


@pytest.fixture(scope="module")
def heavy() -> Experiment:
    """Recordings with a line whose mass is 0.3 of that in front of it."""

    def line(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = 0.07 * np.exp(0.1 * rng.normal(size=len(z)))
        x = np.sqrt(s * own[:, None, None] / z)
        return z * x / np.tanh(x), own

    elements, grid = {"m1": 0.2353, "r1": 24.0, "n1": 1.3e-5}, np.geomspace(12, 3000, 150)
    return toy("m1|r1|n1", elements, 3, 14, 1, noise=0.03, tau=0.4, hidden=line, frequency_hz=grid)


def test_with_further_steps_of_the_elements_the_evidence_is_nearly_the_refits(heavy: Experiment) -> None:
    """One step of the elements says 0.8 of the refit's gain."""
    fit = heavy.fit()
    (level,) = levels(fit, Candidate(entry("body.line"), "port", {}))
    gain = log_evidence(from_level(heavy.refitter, fit, level, 60)) - log_evidence(fit)
    assert gain > 100
    assert 0.93 * gain < level.log_e < gain


def test_further_steps_arrive_at_the_most_probable_elements(heavy: Experiment) -> None:
    values = np.geomspace(0.03, 0.15, 12)
    first, line = FirstRecordings.of(heavy.fit(), range(6)), Candidate(entry("body.line"), "port", {})
    larger = heavy.grown(Addition(effect=line.effect, place="port", pooling="varying"))
    exact = most_probable(first, larger, values)
    near = exact > exact.max(axis=1, keepdims=True) - 3
    gains = level_starts._gains(first, line, values)
    np.testing.assert_allclose(gains[near], exact[near], atol=0.1)
