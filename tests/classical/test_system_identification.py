"""System identification: exact on clean data, near the statistical limit on noisy data, always stable there."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.classical.system_identification import identify
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.rational import TransferFunction

TYPICAL = {"n3": 6.7e-7, "r3": 60.0, "m2": 7.6e-4, "r1": 1.5, "n1": 1.2e-3, "m1": 0.05, "n2": 4.9e-3, "r2": 3.7}
TRUE = parse(PAPER_NETWORK).transfer_function(TYPICAL).normalised()
FREQUENCY_HZ = np.geomspace(5, 5000, 401)
CLEAN = TRUE(2j * np.pi * FREQUENCY_HZ)


def noisy(relative, seed, shape=()):
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, *shape, FREQUENCY_HZ.size))
    return CLEAN * (1 + relative * (parts[0] + 1j * parts[1]))


def test_clean_data_give_the_coefficients_back():
    found = identify(FREQUENCY_HZ, CLEAN)
    assert found.converged
    assert found.relative_rms < 1e-12
    np.testing.assert_allclose(found.transfer.numerator, TRUE.numerator, rtol=1e-9)
    np.testing.assert_allclose(found.transfer.denominator, TRUE.denominator, rtol=1e-9)
    assert found.transfer.denominator[-1] == 0.0  # exactly: the pole at 0 is kept


@pytest.mark.parametrize("orders", [(1, 1), (2, 1), (2, 3), (4, 4)])
def test_other_orders(orders):
    rng = np.random.default_rng(sum(orders))
    poles, zeros = (-2 * np.pi * np.exp(rng.uniform(np.log(10), np.log(3000), n)) for n in orders[::-1])
    true = TransferFunction.from_coefficients(3 * np.poly(zeros), np.poly(poles))
    found = identify(FREQUENCY_HZ, true(2j * np.pi * FREQUENCY_HZ), *orders, pole_at_zero=False)
    np.testing.assert_allclose(found.transfer.numerator, true.numerator, rtol=1e-6)
    np.testing.assert_allclose(found.transfer.denominator, true.denominator, rtol=1e-6)


def test_noisy_data_reach_the_statistical_limit_with_stable_poles():
    """An efficient estimate of 10 parameters from 802 numbers is off by sqrt(10/802) of the noise."""
    errors = []
    for seed in range(12):
        found = identify(FREQUENCY_HZ, noisy(0.02, seed))
        assert np.all(found.transfer.poles().real <= 0)
        model = found.transfer(2j * np.pi * FREQUENCY_HZ)
        errors.append(np.mean(np.abs(model / CLEAN - 1) ** 2))
    limit = 2 * 0.02**2 * 10 / 802
    assert 0.6 * limit < np.mean(errors) < 1.5 * limit


def test_the_known_noise_is_the_better_weight():
    rng = np.random.default_rng(4)
    sd = np.abs(CLEAN) * np.where(FREQUENCY_HZ < 30, 0.2, 0.002)
    z = CLEAN + sd * (rng.normal(size=401) + 1j * rng.normal(size=401))

    def error(**options):
        model = identify(FREQUENCY_HZ, z, **options).transfer(2j * np.pi * FREQUENCY_HZ)
        return np.sqrt(np.mean(np.abs(model / CLEAN - 1)[FREQUENCY_HZ > 100] ** 2))

    assert error(noise_sd=sd) < 0.5 * error()


def test_several_curves_count_as_their_mean():
    z = noisy(0.05, 3, (7,))
    together = identify(FREQUENCY_HZ, z, weighting="none")
    mean = identify(FREQUENCY_HZ, z.mean(axis=0), weighting="none")
    np.testing.assert_allclose(together.transfer.numerator, mean.transfer.numerator, rtol=1e-6)
    missing = np.vstack([z, np.where(FREQUENCY_HZ < 100, np.nan, 1.0) * z[:1]])
    assert np.all(np.isfinite(identify(FREQUENCY_HZ, missing).transfer.numerator))


def test_coefficients_are_real_numbers():
    found = identify(FREQUENCY_HZ, noisy(0.02, 9))
    assert np.isrealobj(found.transfer.numerator)
    assert np.isrealobj(found.transfer.denominator)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"weighting": "some"}, "none or relative"),
        ({"n_zeros": 7}, "at most one zero more than poles"),
        ({"n_poles": 0}, "at least as many poles"),
    ],
)
def test_refuses_what_cannot_be(options, message):
    with pytest.raises(InputError, match=message):
        identify(FREQUENCY_HZ, CLEAN, **options)


def test_refuses_too_little_data():
    with pytest.raises(InputError, match="too few for 10 coefficients"):
        identify(FREQUENCY_HZ[:4], CLEAN[:4])
    with pytest.raises(InputError, match="401 frequencies, but there are 400"):
        identify(FREQUENCY_HZ[1:], CLEAN)
    with pytest.raises(InputError, match="a frequency without any data"):
        identify(FREQUENCY_HZ, np.where(FREQUENCY_HZ < 6, np.nan, CLEAN))
