"""A layer in a third of the people, which the network without it describes by elements that nobody has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.fit.cold_start import driven_away
from bayes_impedance.diagnosis.fit.evidence_posterior import evidence_posterior
from bayes_impedance.diagnosis.fit.measured import measured
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import members
from bayes_impedance.diagnosis.selection.compare import log_evidence
from bayes_impedance.diagnosis.selection.in_some_people import among_the_described, described, in_some_people
from bayes_impedance.diagnosis.selection.trial import Trial

NETWORK = "(m1-n1-r1)|m2"
CENTRES = {"m1": 0.03, "n1": 0.12, "r1": 0.13, "m2": 0.1}
COMPLIANCE, TIME = 9e-4, 0.086
N, WITH_LAYER = 24, np.arange(24) % 3 == 0


def layer(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    compliance = np.where(WITH_LAYER, COMPLIANCE * np.exp(0.3 * rng.normal(size=N)), 0.0)
    return 1 / (1 / z + s * compliance[:, None, None] / (1 + s * TIME)), compliance


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy(NETWORK, CENTRES, seed=3, n=N, noise=0.005, frequency_hz=np.linspace(0.7, 38, 80), hidden=layer)


@pytest.fixture(scope="module")
def fit(world: Experiment) -> Refit:
    return world.refitter.settle(world.fit(), 1)


@pytest.fixture(scope="module")
def best(world: Experiment, fit: Refit) -> Trial:
    return max(in_some_people(world.refitter, fit, registered(), (), 1), key=lambda t: t.gain)


def test_the_network_alone_is_a_mixture_and_those_who_lack_the_layer_are_described(fit: Refit) -> None:
    assert driven_away(fit).any()
    np.testing.assert_array_equal(fit.weight**-0.5 > 1.5, WITH_LAYER)


def test_everybody_is_put_among_those_who_are_described(world: Experiment, fit: Refit) -> None:
    begin = among_the_described(world.refitter, fit, described(fit, ()), 1)
    assert begin is not None
    np.testing.assert_allclose(begin.population.mu, np.log(list(CENTRES.values())), atol=0.2)
    off = np.abs(begin.persons - begin.population.mu) / np.sqrt(np.diag(begin.population.covariance))
    assert off[~WITH_LAYER].max() < 4
    assert begin.evidence[WITH_LAYER].sum() < fit.evidence[WITH_LAYER].sum() - 100


def test_the_layer_is_found_with_its_size_and_in_whom_it_is(world: Experiment, fit: Refit, best: Trial) -> None:
    assert best.effect.id == "body.subgroup"
    assert best.physical
    assert best.gain > 1000
    assert best.gain == log_evidence(best.fit) - log_evidence(fit)
    np.testing.assert_array_equal(members(best.fit, 0).probability > 0.5, WITH_LAYER)
    assert world.coefficients is not None
    size, time = (c.value(1.0, best.fit.model.scales) for c in entry("body.subgroup").coefficients)
    posterior = evidence_posterior(world.refitter, measured(world.refitter, best.fit, 1), 1)
    truth = np.array([world.coefficients[WITH_LAYER].mean() / size, np.log(TIME) - np.log(time) + 1.0])
    np.testing.assert_array_less(np.abs(posterior.central.mean(axis=0) - truth), 3 * posterior.central.std(axis=0))
    # Compliance and time constant of one person are hardly told apart, and both may differ between the eight.
    np.testing.assert_array_less(posterior.central.std(axis=0), [0.35 * truth[0], 0.3])
    own = best.fit.persons[:, len(CENTRES)] * size
    np.testing.assert_allclose(own[WITH_LAYER], world.coefficients[WITH_LAYER], rtol=0.4)
    assert np.abs(own[~WITH_LAYER]).max() < 0.1 * COMPLIANCE


def test_nothing_is_tried_where_everybody_is_described(world: Experiment, fit: Refit, best: Trial) -> None:
    assert among_the_described(world.refitter, best.fit, described(best.fit, ()), 1) is None
    assert in_some_people(world.refitter, best.fit, registered(), (), 1) == []
    assert in_some_people(world.refitter, fit, [entry("rig.mass")], (), 1) == []


def test_who_gains_by_something_is_not_described_however_small_the_residuals_are(
    fit: Refit, best: Trial, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No scale of the residuals shows a few percent of the noise, which are many units of log evidence."""
    monkeypatch.setattr("bayes_impedance.diagnosis.selection.in_some_people.MISFIT_SCALE", np.inf)
    assert described(fit, ()).all()
    np.testing.assert_array_equal(described(fit, (best,)), ~WITH_LAYER)
    assert described(fit, (replace(best, gain=np.nan),)).all()
