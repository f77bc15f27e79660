"""H1, H2, Hv, coherence and their noise: against pyFRF, closed forms, and coverage."""

import numpy as np
import pytest
from simulated_signals import mobility_at, random_response, share_within

from bayes_impedance.intake.averaged_spectra import (
    averaged_spectra,
    independent_averages,
    ratio_of,
    segments_of,
)
from bayes_impedance.intake.hammer import hits_of, is_double, is_overloaded
from bayes_impedance.intake.local_polynomial import local_polynomial

RATE = 8000.0


@pytest.mark.parametrize("window", ["hann", "hamming", "blackman", "boxcar"])
@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_estimators_and_coherence_are_those_of_pyfrf(window: str, estimator: str) -> None:
    pyfrf = pytest.importorskip("pyFRF")
    force, velocity = random_response(40_000, RATE, 0.3, seed=1)
    other = pyfrf.FRF(
        sampling_freq=int(RATE),
        exc=force,
        resp=velocity,
        exc_type="f",
        resp_type="v",
        window="none" if window == "boxcar" else window,
        nperseg=1000,
        noverlap=500,
        fft_len=1000,
    )
    spectra = averaged_spectra(segments_of(force, 1000, 0.5), segments_of(velocity, 1000, 0.5), RATE, window, 0.5)
    theirs = other.get_FRF(frf_estimator=estimator, frf_form="mobility")[0, 0]
    inside = slice(1, -1)
    np.testing.assert_allclose(spectra.frequency_hz, other.get_f_axis())
    np.testing.assert_allclose(spectra.response(estimator)[inside], theirs[inside], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(spectra.coherence[inside], other.get_coherence()[0][inside], rtol=1e-10)


def test_hits_are_averaged_as_in_pyfrf() -> None:
    pyfrf = pytest.importorskip("pyFRF")
    rng = np.random.default_rng(2)
    force = np.exp(-(((np.arange(2000) - 50) / 4.0) ** 2)) * rng.uniform(1, 2, size=(5, 1))
    motion = np.array([np.convolve(f, np.exp(-np.arange(300) / 40.0))[:2000] for f in force])
    motion += 0.01 * rng.normal(size=motion.shape)
    other = pyfrf.FRF(int(RATE), exc=force, resp=motion, exc_type="f", resp_type="a", window="none", fft_len=2000)
    spectra = averaged_spectra(force, motion, RATE)
    theirs = other.get_FRF(frf_estimator="H1", frf_form="accelerance")[0, 0]
    np.testing.assert_allclose(spectra.response()[1:-1], theirs[1:-1], rtol=1e-9)


def test_a_gain_is_exact_and_estimators_are_ordered() -> None:
    force, velocity = random_response(30_000, RATE, 0.5, seed=3)
    exact = averaged_spectra(segments_of(force, 500, 0.0), segments_of(force * -0.5, 500, 0.0), RATE)
    for estimator in ("H1", "H2", "Hv"):
        np.testing.assert_allclose(exact.response(estimator), -0.5, atol=1e-12)
    spectra = averaged_spectra(segments_of(force, 500, 0.0), segments_of(velocity, 500, 0.0), RATE)
    sizes = [np.abs(spectra.response(estimator)[1:]) for estimator in ("H1", "Hv", "H2")]
    assert np.all(sizes[0] <= sizes[1] * (1 + 1e-12))
    assert np.all(sizes[1] <= sizes[2] * (1 + 1e-12))
    np.testing.assert_allclose(sizes[0] / sizes[2], spectra.coherence[1:])


def test_overlapping_segments_count_less() -> None:
    from scipy.signal import get_window

    hann = get_window("hann", 1000)
    assert independent_averages(hann, 20, 0.0) == 20
    # Harris 1978, table 1: rho of the Hann window at half overlap is 1/6.
    assert independent_averages(hann, 20, 0.5) == pytest.approx(20 / (1 + 2 * 19 / 20 / 36), rel=1e-3)
    assert 1.9 < independent_averages(np.ones(1000), 3, 0.5) < 3


@pytest.mark.long
@pytest.mark.parametrize(("window", "overlap"), [("hann", 0.0), ("hann", 0.5), ("boxcar", 0.0)])
def test_intervals_hold_the_truth(window: str, overlap: float) -> None:
    share = []
    for seed in range(6):
        force, velocity = random_response(80_000, RATE, 0.3, seed=seed)
        cut = [segments_of(signal, 4000, overlap) for signal in (force, velocity)]
        ratio = ratio_of(averaged_spectra(*cut, RATE, window, overlap))
        inside = (ratio.frequency_hz > 50) & (ratio.frequency_hz < 0.4 * RATE)
        truth = mobility_at(ratio.frequency_hz[inside], RATE)
        assert ratio.noise_sd is not None
        assert ratio.degrees_of_freedom is not None
        sd = ratio.noise_sd[inside]
        share.append(share_within(ratio.value[inside], truth, sd, ratio.degrees_of_freedom))
    # Some 20 000 parts, of which neighbours under a window are correlated: half a percent covers four deviations.
    assert np.mean(share) == pytest.approx(0.95, abs=0.006)


def test_local_polynomials_have_no_leakage_and_true_intervals() -> None:
    force, velocity = random_response(30_000, RATE, 0.0, seed=4)
    exact = local_polynomial(force, velocity, RATE)
    inside = (exact.frequency_hz > 20) & (exact.frequency_hz < 0.4 * RATE)
    truth = mobility_at(exact.frequency_hz, RATE)
    np.testing.assert_allclose(exact.value[inside], truth[inside], rtol=2e-5)
    plain = np.fft.rfft(velocity) / np.fft.rfft(force)
    assert np.abs(plain[7:-7] / truth - 1)[inside].max() > 1e-3  # what leakage does without the model
    force, velocity = random_response(30_000, RATE, 0.3, seed=5)
    noisy = local_polynomial(force, velocity, RATE)
    assert noisy.noise_sd is not None
    share = share_within(noisy.value[inside], truth[inside], noisy.noise_sd[inside], 14.0)
    assert share == pytest.approx(0.95, abs=0.01)


def _pulses(places: list[int], size: int = 4000) -> np.ndarray:
    t = np.arange(size)
    return sum(np.exp(-(((t - place) / 5.0) ** 2)) for place in places) + 1e-4 * np.sin(t)


def test_hits_are_found_and_what_cannot_be_used_is_left_out() -> None:
    rng = np.random.default_rng(6)
    force = _pulses([500, 1500, 1560, 2500, 3900])
    motion = 1e-3 * rng.normal(size=force.size)
    motion[2600:2605] = 0.5
    hits = hits_of(force, motion, 800)
    assert hits.force.shape == (1, 800)
    assert (hits.doubles, hits.overloads, hits.incomplete) == (1, 1, 1)
    assert np.argmax(hits.force[0]) == pytest.approx(15, abs=3)  # a hundredth of the record, and half of the pulse


def test_double_hits_and_overloads() -> None:
    assert not is_double(_pulses([500]))
    assert is_double(_pulses([500, 900]))
    assert is_double(0.3 * _pulses([500]) + _pulses([900]))
    assert is_overloaded(np.clip(_pulses([500]), None, 0.7))
    assert not is_overloaded(_pulses([500]))
