"""Starts of lines on a grid of coefficients: waves are found where a start from zero does not arrive."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import entry, recovered, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.selection import level_starts
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.level_starts import MOST, best_levels, from_level, level_start

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
def inside():
    """The first standing wave is at 2 kHz, where the band ends: in half of the people it is inside."""
    return toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=4, n=18, hidden=waves(COMPLIANCE))


def candidate() -> Candidate:
    return Candidate(entry("body.free_line"), "m1", {"level": 1.0})


def test_the_grid_finds_the_compliance_and_the_refit_is_better_than_from_zero(inside) -> None:
    fit = inside.fit()
    size, gain = level_start(fit, candidate())
    assert 0.5 < size / COMPLIANCE < 2.0
    assert gain > 100
    grown = from_level(inside.refitter, fit, candidate(), size, 40)
    assert grown.settled
    from_zero = recovered(inside, entry("body.free_line"), "m1", "varying", 60)
    assert log_evidence(grown) > log_evidence(from_zero) + 100


def test_places_are_sorted_by_what_they_gain(inside) -> None:
    fit = inside.fit()
    everywhere = [candidate(), Candidate(entry("body.diffusion"), "r1", {"level": 1.0})]
    found = best_levels(fit, [*everywhere, Candidate(entry("body.mass"), "port", {})])
    assert found[0][0] == candidate()
    assert len(found) <= MOST
    assert all(c.effect.operation == "free_line" and size > 0 for c, size in found)


def test_where_there_are_no_waves_hardly_anything_is_gained() -> None:
    """People's best of so many coefficients gain by chance, a tenth of what waves gain in as many."""
    fit = toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=5, n=18).fit()
    assert level_start(fit, candidate())[1] < 10


def test_waves_far_below_the_upper_end_of_the_band_are_found() -> None:
    """The first standing wave is at 333 Hz of 2 to 2000, and two more are in the band."""
    deep = 6**2 * COMPLIANCE
    own = toy("m1|r1", {"m1": MASS, "r1": 5.0}, seed=6, n=12, hidden=waves(deep))
    fit = own.refitter.fit(own.model, own.u, own.population, 0)  # elements are near where they belong
    size, gain = level_start(fit, candidate())
    assert 0.5 < size / deep < 2.0
    assert gain > 100


def test_two_places_of_every_effect_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little the others gain: elements are as the network without the effect has left them."""
    gains = {"a": 300.0, "b": 200.0, "c": 100.0, "d": 90.0, "m1": 40.0, "m2": 5.0, "m3": -1.0}
    monkeypatch.setattr(level_starts, "level_start", lambda _, c: (1.0, gains[c.place]))
    lines = [Candidate(entry("body.line"), place, {"level": 1.0}) for place in "abcd"]
    others = [Candidate(entry("body.free_line"), place, {"level": 1.0}) for place in ("m1", "m2", "m3")]
    found = [c for c, _ in best_levels(None, [*others, *lines])]  # type: ignore[arg-type]
    assert found == [lines[0], lines[1], others[0], others[1], lines[2]]
    assert [c for c, _ in best_levels(None, others)] == others[:2]  # type: ignore[arg-type]
