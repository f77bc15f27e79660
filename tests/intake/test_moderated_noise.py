"""Noise of few degrees of freedom is moderated by its neighbours, and no longer gives weight to chance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import polygamma

from bayes_impedance.intake.moderated_noise import moderated
from bayes_impedance.intake.spectrum import Spectrum

FREQUENCY = np.geomspace(5.0, 500.0, 60)
TRUE = 0.02 * FREQUENCY**0.7


def recordings(degrees: float, sd: np.ndarray = TRUE, count: int = 40) -> list[Spectrum]:
    rng = np.random.default_rng(1)
    return [
        Spectrum(
            subject=f"P{i}",
            repetition="1",
            frequency_hz=FREQUENCY,
            z=FREQUENCY**0.7 * np.exp(0.3j * rng.normal(size=60)),
            unit="N s/m",
            source="a",
            noise_sd=sd * np.sqrt(rng.chisquare(degrees, 60) / degrees),
            degrees_of_freedom=degrees,
        )
        for i in range(count)
    ]


def noise(spectra: list[Spectrum]) -> np.ndarray:
    return np.array([one.noise_sd for one in spectra])


@pytest.mark.parametrize("degrees", [2.0, 8.0, 20.0])
def test_smooth_noise_is_as_certain_as_its_degrees_of_freedom_say(degrees: float) -> None:
    found, told = moderated(recordings(degrees))
    assert len(told) == 1
    total = found[0].degrees_of_freedom
    assert total is not None
    assert 6 * degrees < total < 9.5 * degrees
    ratio = noise(found)[:, 4:-4] ** 2 / TRUE[4:-4] ** 2  # at the ends there are fewer neighbours
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.05)
    assert np.var(np.log(ratio)) == pytest.approx(polygamma(1, total / 2), rel=0.3)


def test_weights_no_longer_go_with_chance() -> None:
    """The variance of a weighted mean over what its weights say: (d - 2)/(d - 4) of chi-square weights, here 1.5."""
    rng = np.random.default_rng(2)
    given = recordings(8.0, count=400)
    for spectra, low, high in ((given, 1.35, 1.75), (moderated(given)[0], 0.9, 1.2)):
        weight = TRUE**2 / noise(spectra) ** 2
        error = np.sum(weight * rng.normal(size=weight.shape), axis=1) / np.sum(weight, axis=1)
        scale = np.mean(weight)  # the noise scale that a fit infers
        assert low < np.mean(error**2) * 60 * np.mean(weight) / scale < high


def test_noise_that_differs_from_point_to_point_is_kept() -> None:
    uneven = TRUE * np.exp(0.5 * np.random.default_rng(3).normal(size=60))
    found, _ = moderated(recordings(8.0, uneven))
    total = found[0].degrees_of_freedom
    assert total is not None
    assert total < 12
    error = [np.mean(np.abs(np.log(noise(one) / uneven))) for one in (found, recordings(8.0, uneven))]
    assert error[0] < 1.1 * error[1]


def test_what_is_known_well_or_not_at_all_remains() -> None:
    many, few = recordings(1000.0, count=2), recordings(8.0, count=1)
    short = Spectrum(
        subject="a",
        repetition="1",
        frequency_hz=FREQUENCY[:10],
        z=few[0].z[:10],
        unit="N s/m",
        source="a",
        noise_sd=TRUE[:10],
        degrees_of_freedom=4.0,
    )
    found, told = moderated([*many, short])
    assert not told
    smooth = [replace(one, noise_sd=TRUE) for one in few]  # smoother than eight degrees of freedom
    assert moderated(smooth) == (smooth, [])
    np.testing.assert_array_equal(noise(found[:2]), noise(many))
    assert found[2] is short
