"""Recordings behind a calibration that is not exact: its error is in the intervals of the population."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.errors import InputError
from bayes_impedance.network import parse
from bayes_impedance.population.calibrated import inseparable_given, known_of, prior_of, within_rig
from bayes_impedance.population.fit import QUICK_SETTINGS, PopulationFit, fit_population
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.calibration import CommonError
from bayes_impedance.recordings.files import Recordings

SPREAD = dict.fromkeys(("m1", "r1", "n1"), 0.05)
ALIKE = replace(THREE_ELEMENTS, between_persons=SPREAD, between_repetitions=dict.fromkeys(SPREAD, 0.02), noise=0.01)
FREQUENCY_HZ = np.geomspace(10, 1000, 30)


def left(gain_sd: float, mass_sd: float = 1e-5, correlation: float = 0.0) -> CommonError:
    """A gain and a mass that are known so far."""
    return CommonError(
        network="gain[g_rig*](offset[m_rig*](NETWORK))",
        parameters=("g_rig", "m_rig"),
        mean=np.array([1.0, 0.0]),
        sd=np.array([gain_sd, mass_sd]),
        correlation=np.array([[1.0, correlation], [correlation, 1.0]]),
        share=1.0,
    )


def gain_alone(sd: float) -> CommonError:
    return CommonError(
        network="gain[g_rig*](NETWORK)",
        parameters=("g_rig",),
        mean=np.ones(1),
        sd=np.array([sd]),
        correlation=np.eye(1),
        share=1.0,
    )


def people(error: CommonError | None) -> Recordings:
    recordings = simulate_recordings(ALIKE, 16, 2, FREQUENCY_HZ, 1).recordings
    return replace(recordings, calibration=error)


def fitted(error: CommonError | None) -> PopulationFit:
    fit = fit_population(people(error), settings=QUICK_SETTINGS, seed=1, workers=1)
    assert fit.identified.all()
    return fit


def spread(fit: PopulationFit, name: str) -> float:
    return float(fit.parameters.mu[:, fit.kernel.elements.index(name)].std())


@pytest.mark.long
def test_an_uncertain_gain_is_in_the_interval_of_every_element() -> None:
    """All elements of the network scale with the gain: that is their only error in common with it."""
    exact, carried = fitted(None), fitted(gain_alone(0.03))
    for name in parse(str(people(None).network)).elements:
        expected = np.hypot(spread(exact, name), 0.03)
        assert spread(carried, name) == pytest.approx(expected, rel=0.15), name
    assert spread(carried, "g_rig") == pytest.approx(0.03, rel=0.15)
    columns = carried.parameters.mu[:, [carried.kernel.elements.index(e) for e in ("g_rig", "m1", "n1")]]
    correlation = np.corrcoef(columns.T)
    assert correlation[0, 1] < -0.8 < 0.8 < correlation[0, 2]


def test_the_prior_is_the_calibrations() -> None:
    recordings = people(left(0.03, 2e-4, 0.6))
    model = checked_model(recordings, within_rig(recordings, None))
    prior = prior_of(model.kernel, recordings)
    rows = [model.kernel.elements.index(name) for name in ("g_rig", "m_rig")]
    unit = np.array([1.0, model.kernel.scales["m_rig"]])
    np.testing.assert_allclose(prior.centre[rows] * unit, [0.0, 0.0])
    covariance = prior.covariance[np.ix_(rows, rows)] * np.outer(unit, unit)
    np.testing.assert_allclose(covariance, [[9e-4, 3.6e-6], [3.6e-6, 4e-8]])
    assert prior.known.tolist() == [name in ("g_rig", "m_rig") for name in model.kernel.elements]
    assert inseparable_given(model.kernel, prior) == ()
    assert set(inseparable_given(model.kernel, replace(prior, informed=None))) == set(model.kernel.elements)


def test_a_correlated_prior_is_consistent() -> None:
    rng = np.random.default_rng(0)
    own = rng.normal(size=(3, 6))
    covariance = own @ own.T
    sd = np.sqrt(np.diag(covariance))
    prior = Prior(centre=np.zeros(3), centre_sd=sd, correlation=covariance / np.outer(sd, sd))
    np.testing.assert_allclose(prior.covariance, covariance)
    np.testing.assert_allclose(prior.factor @ prior.factor.T, covariance)
    np.testing.assert_allclose(prior.precision @ covariance, np.eye(3), atol=1e-12)
    at = rng.normal(size=3)
    assert prior.misfit(at) == pytest.approx(0.5 * at @ np.linalg.solve(covariance, at))
    some = np.array([2, 0])
    np.testing.assert_allclose(prior.of(some).covariance, covariance[np.ix_(some, some)])


def test_a_network_that_is_within_the_rig_stays_there() -> None:
    recordings = people(left(0.03))
    inside = within_rig(recordings, "m1|r1|n1")
    assert str(inside) == "gain[g_rig*](offset[m_rig*](m1|r1|n1))"
    assert str(within_rig(recordings, inside)) == str(inside)
    assert within_rig(people(None), "m1") == "m1"
    with pytest.raises(InputError, match="the network has a parameter g_rig, but so has the rig"):
        within_rig(recordings, "gain[g_rig](m1|r1)")


def test_parameters_that_the_rig_does_not_share_are_refused() -> None:
    error = replace(left(0.03), network="gain[g_rig](offset[m_rig*](NETWORK))")
    with pytest.raises(InputError, match="g_rig is no parameter of the rig that is the same for all"):
        within_rig(people(error), "m1|r1")


def test_a_fit_with_another_calibration_is_another_fit() -> None:
    assert known_of(people(None)) == ()
    assert known_of(people(left(0.03))) != known_of(people(left(0.04)))


def test_one_person_has_the_calibrations_error_too() -> None:
    recordings = replace(people(gain_alone(0.1)), subjects=people(None).subjects[:1])
    fit = fit_population(recordings, settings=QUICK_SETTINGS, seed=1, workers=1)
    assert fit.identified.all()
    assert spread(fit, "g_rig") == pytest.approx(0.1, rel=0.2)
    assert spread(fit, "m1") > 0.09


@pytest.mark.long
def test_what_the_network_has_beside_the_rig_is_as_uncertain_as_the_calibration() -> None:
    """A delay of the load, beside one of the rig: only their sum is seen, and the rig's is known to 10 us."""
    error = CommonError(
        network="delay[d_rig*](NETWORK)",
        parameters=("d_rig",),
        mean=np.zeros(1),
        sd=np.array([1e-5]),
        correlation=np.eye(1),
        share=1.0,
    )
    given = people(error)
    s, late = 2j * np.pi * FREQUENCY_HZ, 3e-5
    given = replace(given, subjects=tuple(replace(one, z=one.z * np.exp(-late * s)) for one in given.subjects))
    fit = fit_population(given, "delay[d1*](m1|r1|n1)", settings=QUICK_SETTINGS, seed=1, workers=1)
    assert fit.identified.all()
    # The recordings know the sum to 1 us.
    assert spread(fit, "d1") == pytest.approx(1e-5, rel=0.2)
    assert fit.parameters.mu[:, fit.kernel.elements.index("d1")].mean() == pytest.approx(late, abs=1e-5)
