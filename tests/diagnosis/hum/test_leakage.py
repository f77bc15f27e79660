"""Hum through an averaging window: found with its line and size, and never in noise that is merely uneven."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals
from bayes_impedance.diagnosis.hum import leakage as leakage_module
from bayes_impedance.diagnosis.hum.leakage import find_skirts, pattern
from bayes_impedance.diagnosis.hum.line import affected_points

FREQUENCY = np.geomspace(5, 5000, 121)


def leakage(frequency_hz: np.ndarray, line: float, periods: float, phase: np.ndarray) -> np.ndarray:
    """What a lock-in over some periods takes of cos(2 pi line t + phase), by summation over time."""
    result = np.empty((*phase.shape[:-1], frequency_hz.size), dtype=complex)
    for k, f in enumerate(frequency_hz):
        t = (np.arange(400) + 0.5) / 400 * periods / f
        # Only the part that turns with the excitation: the mirrored one is small where it matters.
        turning = np.exp(2j * np.pi * (line - f) * t).mean()
        result[..., k] = np.exp(1j * phase[..., k]) * turning
    return result


FALLING = tuple(1 / h for h in range(1, 11))
"""Strengths of harmonics that fall as their number grows."""


def people(
    seed: int,
    line: float = 0.0,
    size: float = 0.0,
    periods: float = 5.0,
    n: int = 24,
    spread: float = 0.3,
    strengths: tuple[float, ...] = FALLING,
    curve: np.ndarray | float = 1.0,
) -> list[PersonResiduals]:
    """Residuals of noise that is threefold below 12 Hz, with hum of a part of the impedance at its first harmonic.

    The impedance is constant, or changes over frequency by a `curve` (F,).
    """
    rng = np.random.default_rng(seed)
    found = []
    for i in range(n):
        z = np.exp(rng.normal(0, spread)) * np.broadcast_to(4.0 * curve + 0j, (3, FREQUENCY.size))
        own = 0.01 * np.exp(rng.normal(0, 0.2)) * np.where(FREQUENCY < 12, 3.0, 1.0)
        sd = np.broadcast_to(own, z.shape) * np.abs(z)
        noise = sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
        for h, strength in enumerate(strengths, 1):
            if line:
                phase = rng.uniform(0, 2 * np.pi, z.shape)
                noise = noise + size * strength * leakage(FREQUENCY, h * line, periods, phase)
        basis = np.linalg.qr(rng.normal(size=(3, 2 * FREQUENCY.size, 5)))[0]
        white = np.concatenate([noise.real / sd, noise.imag / sd], axis=1)
        found.append(PersonResiduals(name=f"P{i}", frequency_hz=FREQUENCY, model=z, sd=sd, white=white, basis=basis))
    return found


@pytest.mark.long
def test_the_size_is_right_where_people_and_harmonics_differ_much() -> None:
    """Mean squares over people are those of the few with a small impedance, and no pattern has these harmonics."""
    at = float(np.abs(leakage(FREQUENCY, 50.0, 10.0, np.zeros(FREQUENCY.size))).max())
    hums = [find_skirts(people(600 + seed, 50.0, 0.06, 10.0, 24, 1.2, (1.0, 0.3, 0.5))) for seed in range(10)]
    found = [hum for hum in hums if hum is not None]
    assert len(found) == 10
    true = 0.06 * at / np.sqrt(2)
    assert sum(hum.q05 <= true <= hum.q95 for hum in found) >= 7
    assert np.mean([hum.amplitude for hum in found]) == pytest.approx(true, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize(("line", "periods"), [(50.0, 5.0), (60.0, 5.0), (50.0, 10.0)])
def test_hum_is_found_with_its_line_and_size(line: float, periods: float) -> None:
    covered = []
    for seed in range(6):
        hum = find_skirts(people(seed, line, 0.06, periods))
        assert hum is not None
        assert hum.line_hz == line
        assert not hum.coherent
        assert 1 in hum.harmonics
        # Each part of the hum has half of its power; the nearest point is not quite on the line.
        nearest = float(pattern(FREQUENCY, line, periods, 1.0).max())
        covered.append(hum.q05 <= 0.06 * np.sqrt(nearest / 2) <= hum.q95)
        assert hum.amplitude == pytest.approx(0.06 * np.sqrt(nearest / 2), rel=0.3)
        assert affected_points(FREQUENCY, hum).sum() < 0.3 * FREQUENCY.size
    assert sum(covered) >= 4


def test_noise_that_is_merely_uneven_is_no_hum() -> None:
    assert sum(find_skirts(people(100 + seed)) is not None for seed in range(30)) <= 1


def test_a_bump_of_noise_elsewhere_is_no_hum() -> None:
    found = [find_skirts(people(200 + seed, 41.0, 0.06)) for seed in range(4)]
    assert found == [None] * 4


def once(some: list[PersonResiduals]) -> list[PersonResiduals]:
    """The first repetition of everybody alone."""
    return [replace(p, model=p.model[:1], sd=p.sd[:1], white=p.white[:1], basis=p.basis[:1]) for p in some]


@pytest.mark.long
@pytest.mark.parametrize(
    ("line", "periods", "size", "n"), [(50.0, 5.0, 0.25, 36), (60.0, 10.0, 0.25, 36), (50.0, 5.0, 0.6, 12)]
)
def test_hum_is_found_where_everybody_was_recorded_once(line: float, periods: float, size: float, n: int) -> None:
    found = [find_skirts(once(people(300 + seed, line, size, periods, n=n))) for seed in range(6)]
    hums = [hum for hum in found if hum is not None]
    assert len(hums) >= 5
    assert {(hum.line_hz, hum.coherent, hum.harmonics[0]) for hum in hums} == {(line, False, 1)}
    amplitude = size * np.sqrt(float(pattern(FREQUENCY, line, periods, 1.0).max()) / 2)
    assert sum(hum.q05 <= amplitude <= hum.q95 for hum in hums) >= 4


def test_hum_of_one_force_is_found_where_the_impedance_is_small_at_some_frequencies() -> None:
    """An antiresonance at 80 Hz and a resonance at 320 Hz: a thirtieth of the impedance, and ten times it."""
    f = FREQUENCY / 80
    curve = np.abs((1 - f**2 + 0.03j * f) / (1 - (f / 4) ** 2 + 0.1j * f / 4))
    for seed in range(3):
        everybody = once(people(300 + seed, 60.0, 0.1, 10.0, 30, curve=curve))
        hum = find_skirts(everybody)
        assert hum is not None
        assert hum.line_hz == 60.0
        assert find_skirts(once(people(400 + seed, n=30, curve=curve))) is None


@pytest.mark.parametrize("size", [0.0, 0.01])
def test_hum_of_no_size_is_none(size: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(leakage_module, "_mean_squares", lambda *_: np.array([size**2, 0.0, 1.0]))
    hum = find_skirts(people(1, 50.0, 0.06))
    assert hum is None if size == 0.0 else hum is not None


@pytest.mark.long
@pytest.mark.parametrize("n", [9, 18, 36])
def test_uneven_noise_and_bumps_elsewhere_are_no_hum_where_everybody_was_recorded_once(n: int) -> None:
    assert sum(find_skirts(once(people(400 + seed, n=n))) is not None for seed in range(30)) <= 1
    found = [find_skirts(once(people(500 + seed, 41.0, 0.06, n=n))) for seed in range(4)]
    assert found == [None] * 4


def resonating(person: PersonResiduals, size: float, at_hz: float) -> PersonResiduals:
    """With a resonance of Q = 20 that the network lacks: `size` times the impedance."""
    wrong = size / (1 + 2j * 20 * np.log(FREQUENCY / at_hz)) * person.model / person.sd
    return replace(person, white=person.white + np.concatenate([wrong.real, wrong.imag], axis=1))


@pytest.mark.parametrize("n", [9, 18, 36])
@pytest.mark.parametrize(("spread", "size"), [(0.0, 0.5), (0.1, 0.5), (0.2, 0.2)])
def test_a_resonance_that_the_network_lacks_is_no_hum_where_everybody_was_recorded_once(
    spread: float, size: float, n: int
) -> None:
    rng = np.random.default_rng(5)
    found = []
    for seed in range(4):
        some = once(people(600 + seed, n=n))
        at = 50.0 * np.exp(spread * rng.normal(size=n))
        found.append(find_skirts([resonating(p, size, f) for p, f in zip(some, at, strict=True)]))
    assert found == [None] * 4


def test_on_different_frequencies_or_of_few_recorded_once_nothing_is_said() -> None:
    some = people(1, 50.0, 0.1)
    assert find_skirts(once(some[:1])) is None
    assert find_skirts(once(some[:5])) is None
    moved = replace(some[0], name="P", frequency_hz=FREQUENCY * 1.01)
    assert find_skirts([*some[1:], moved]) is None


def still(person: PersonResiduals) -> PersonResiduals:
    """Repetitions that are equal: constant recordings, or exact curves."""
    return replace(person, white=np.zeros_like(person.white))


@pytest.mark.parametrize("take", [lambda some: some, once], ids=["repeated", "once"])
def test_people_without_scatter_say_nothing_of_hum(take: Callable[..., list[PersonResiduals]]) -> None:
    """Neither a warning of a division by zero, nor the weight of all others."""
    some = take(people(0, 50.0, 0.25))
    assert find_skirts([still(p) for p in some]) is None
    mixed = find_skirts([*some[:-2], *map(still, some[-2:])])
    alone = find_skirts(some[:-2])
    assert mixed is not None
    assert alone is not None
    assert (mixed.line_hz, mixed.amplitude) == (alone.line_hz, pytest.approx(alone.amplitude))
