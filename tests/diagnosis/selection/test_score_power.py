"""Power of the score scan: scores of concealed effects have the size that the Fisher information predicts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Experiment, concealing, entry, people, screened, toy


def fisher(experiment: Experiment, effect_id: str) -> tuple[float, float]:
    """Size and information of a concealed effect, without the package.

    From the true elements of every recording, by central differences of the formula of ``people.py``; elements are
    free in every recording, and the noise is the true one.
    """
    case, sd = experiment.case, experiment.sd
    forms: dict[str, tuple[str, Any]] = {
        "rig.delay": ("delay", lambda s, z, x: z * np.exp(-s * x)),
        "rig.mass": ("mass", lambda s, z, x: z + s * x),
        "rig.highpass": ("corner", lambda s, z, x: z * (s / (s + 2 * np.pi * x))),
        "rig.lowpass": ("corner", lambda s, z, x: z / (1 + s / (2 * np.pi * x))),
        "rig.series_compliance": ("compliance", lambda s, z, x: 1 / (1 / z + s * x)),
    }
    own, form = forms[effect_id]
    size = case.values[own]
    if effect_id == "rig.lowpass":  # linear in 1/corner
        size, form = 1 / size, lambda s, z, x: z / (1 + s * x / (2 * np.pi))

    def curves(log_elements: np.ndarray, x: float) -> np.ndarray:
        return people.impedance(log_elements, case.frequency_hz, {"port": lambda s, z: form(s, z, x)})

    def white(change: np.ndarray) -> np.ndarray:
        return np.concatenate([change.real / sd, change.imag / sd], axis=-1)

    h, theta = 1e-4, case.log_elements
    steps = h * np.eye(theta.shape[-1])
    tangent = np.stack([white(curves(theta + e, 0) - curves(theta - e, 0)) / (2 * h) for e in steps], axis=-1)
    signature = white(curves(theta, h * size) - curves(theta, -h * size)) / (2 * h * size)
    information = 0.0
    for g, t in zip(signature.reshape(-1, signature.shape[-1]), tangent.reshape(-1, *tangent.shape[2:]), strict=True):
        coefficients = np.linalg.lstsq(t, g, rcond=None)[0]
        information += float(np.sum((g - t @ coefficients) ** 2))
    return size, information


POWER = {
    "rig.delay": (entry("rig.delay"), 0.3),
    "rig.mass": (entry("rig.mass"), 1.2),
    "rig.highpass": (entry("rig.highpass"), 0.2),
    "rig.lowpass": (entry("rig.lowpass"), 0.3),
    "rig.series_compliance": (entry("rig.series_compliance"), 0.2),
}


@pytest.mark.parametrize("name", POWER)
def test_mean_score_is_the_noncentrality_of_the_fisher_information(name: str) -> None:
    """Within 15 % over eight populations, whose standard error is about 3 %."""
    effect, strength = POWER[name]
    found, expected, sizes = [], [], []
    for seed in range(20, 28):
        experiment = concealing(name, "port", strength, seed)
        size, information = fisher(experiment, name)
        screening = screened(experiment.fit(), [effect])
        sign = np.sign(size)
        found.append(sign * screening.z[0])
        expected.append(abs(size) * np.sqrt(information))
        unit = 2 * np.pi if name == "rig.highpass" else 1 / (2 * np.pi) if name == "rig.lowpass" else 1.0
        sizes.append((screening.size[0] / (unit * size) - 1) * expected[-1])
    assert np.mean(expected) > 8  # so that one standard error of the mean is below 5 %
    assert np.mean(found) / np.mean(expected) == pytest.approx(1, abs=0.15)
    assert abs(np.mean(sizes)) < 0.15 * np.mean(expected)  # and the one-step estimate is right as well


def test_a_concealed_effect_is_named_first() -> None:
    experiment = concealing("rig.highpass", "port", 0.3, 30)
    screening = screened(experiment.fit())
    best = screening.candidates[int(np.nanargmax(np.abs(screening.z)))]
    assert best.effect.id == "rig.highpass"
    assert screening.log_p(np.nanmax(np.abs(screening.z))) < np.log(1e-6)


def varying_mass(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """As much as less, on average nothing."""
    mass = 4e-5 * np.where(np.arange(len(z)) % 2, 1.0, -1.0) * rng.uniform(0.8, 1.2, len(z))
    return z + s * mass[:, None, None], mass


def test_a_coefficient_that_varies_shows_by_its_spread() -> None:
    signed = replace(entry("body.mass"), signed=True)
    spreads, shared = [], []
    for seed in range(5):
        screening = screened(toy(*TOY, seed=seed, hidden=varying_mass).fit(), [signed])
        assert len(screening.candidates) == 1
        spreads.append(screening.spread[0])
        shared.append(abs(screening.z[0]) / np.sqrt(np.sum(screening.score[:, 0] ** 2 / screening.information[:, 0])))
        assert screening.log_p_spread[0] < np.log(1e-6)
    assert min(spreads) > 10
    assert max(shared) < 0.7  # the mean says little
    quiet = [screened(toy(*TOY, seed=seed).fit(), [signed]) for seed in range(20)]
    v = np.array([s.spread[0] for s in quiet])
    # A sum of 20 chi-squares of one degree of freedom is skew: variance 1, and that of its square 2 + 12/20.
    assert abs(v.mean()) < 4 / np.sqrt(20)
    assert np.mean(v**2) == pytest.approx(1, abs=4 * np.sqrt(2.6 / 20))


def test_overwhelming_spreads_can_still_be_compared() -> None:
    signed = replace(entry("body.mass"), signed=True)
    small, large = (
        screened(toy(*TOY, seed=1, noise=noise, hidden=varying_mass, n=60).fit(), [signed]) for noise in (0.01, 0.003)
    )
    assert large.spread[0] > 2 * small.spread[0]
    assert large.log_p_spread[0] > -1e9
    assert large.log_p_spread[0] < 2 * small.log_p_spread[0] < -200


def test_everybodys_own_share() -> None:
    """b/m is a person's own estimate of the coefficient."""
    experiment = toy(*TOY, seed=3, noise=0.003, hidden=varying_mass)
    screening = screened(experiment.fit(), [entry("body.mass")])
    own = screening.score[:, 0] / screening.information[:, 0]
    assert experiment.coefficients is not None
    assert np.corrcoef(own, experiment.coefficients)[0, 1] > 0.99
