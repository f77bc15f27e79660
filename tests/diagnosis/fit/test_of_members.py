"""A layer that a third of the people have, beside a mass of the rig that everybody has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, enlarged, entry, toy

from bayes_impedance.diagnosis.fit import of_members as module
from bayes_impedance.diagnosis.fit.evidence_posterior import evidence_posterior
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.of_members import of_members
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import members
from bayes_impedance.diagnosis.selection.compare import log_evidence

NETWORK = "(n2|r2)-(m1|r1|n1)"
CENTRES = {"m1": 1.7, "n1": 3.1e-05, "n2": 0.00036, "r1": 3.7, "r2": 34.0}
N, COMPLIANCE, TIME, MASS = 36, 1.8e-6, 1.4e-3, 1.1e-3
HAS_IT = np.arange(N) % 3 == 0
LAYER, RIG = entry("body.subgroup"), entry("rig.mass")


def layer_and_mass(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Compliance and time constant of each member are correlated in the data alone: a slow layer is nearly a spring."""
    own = np.where(HAS_IT, COMPLIANCE * np.exp(0.3 * rng.normal(size=N)), 0.0)
    time = TIME * np.exp(0.2 * rng.normal(size=(N, 1, 1)))
    return 1 / (1 / z + s * own[:, None, None] / (1 + s * time)) + s * MASS, own


@pytest.fixture(scope="module")
def world() -> Experiment:
    frequency = np.geomspace(1, 800, 60)
    return toy(NETWORK, CENTRES, 6, n=N, hidden=layer_and_mass, frequency_hz=frequency, noise=0.002)


@pytest.fixture(scope="module")
def fit(world: Experiment) -> Refit:
    additions = [Addition(effect=LAYER, place="port", pooling="free", dispersion=1.3, other_dispersions=(0.2,))]
    additions.append(Addition(effect=RIG, place="port", pooling="shared"))
    model = build(world.model.network, additions, world.model.scales, [{"time_constant": TIME}, {}])
    u, population = enlarged(world.fit(rounds=0), model)  # at the truth: the network alone is a mixture
    sizes = [float(e.coefficients[0].unbounded(1.0, model.scales)) for e in (LAYER, RIG)]
    u[:, model.columns(0)[0]] = population.mu[model.n_elements] = sizes[0] * COMPLIANCE
    u[:, model.columns(1)[0]] = sizes[1] * MASS
    return world.refitter.fit(model, u, population, 80)


def test_members_are_known(fit: Refit) -> None:
    np.testing.assert_array_equal(members(fit, 0).probability > 0.5, HAS_IT)


def test_sizes_are_those_of_members_and_who_lacks_the_layer_does_not_move_the_rig(
    world: Experiment, fit: Refit
) -> None:
    assert world.coefficients is not None
    posterior = evidence_posterior(world.refitter, fit, 1)
    scales = fit.model.scales
    own = float(world.coefficients[HAS_IT].mean() / LAYER.coefficients[0].value(1.0, scales))
    time, mass = LAYER.coefficients[1].unbounded(TIME, scales), RIG.coefficients[0].unbounded(MASS, scales)
    truth = np.array([own, time, mass])
    sd = posterior.central.std(axis=0)
    np.testing.assert_array_less(np.abs(posterior.central.mean(axis=0) - truth), 2.5 * sd)
    np.testing.assert_array_less(sd, [0.15 * own, 0.15, 0.1 * truth[2]])


def test_evidence_is_that_of_each_kind_and_of_its_share_where_it_is_clear_who_has_it(
    world: Experiment, fit: Refit
) -> None:
    own = of_members(world.refitter, fit, 1)
    known, mixture = own.fit, own.mixture
    share = HAS_IT.mean()
    assert mixture is not None
    assert mixture.mixed == 0
    more = mixture.evidence - (known.evidence + np.log(np.where(HAS_IT, share, 1 - share)))
    assert np.median(np.abs(more)) < 0.02
    np.testing.assert_array_less(-0.02, more)
    np.testing.assert_array_less(more, np.log(2))  # one of them lacks it with a probability of 93 %
    assert log_evidence(mixture) > log_evidence(fit)  # which holds everybody to one normal distribution


def test_where_everybody_has_it_there_is_no_mixture(world: Experiment, fit: Refit) -> None:
    who = np.flatnonzero(HAS_IT)
    few = world.refitter.subset(who)
    own = few.fit(fit.model, fit.u[HAS_IT[fit.owner]], fit.population)
    known = of_members(few, own, 1)
    assert (known.fit, known.mixture, known.who) == (own, None, {})


def test_members_are_those_whom_their_own_distribution_makes_members(
    world: Experiment, fit: Refit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A distribution of everybody that is wide takes others for members, and misses some."""
    first = np.where(np.arange(N) % 9 == 0, ~HAS_IT, HAS_IT | (np.arange(N) % 6 == 1)).astype(float)
    assert np.sum((first > 0.5) != HAS_IT) == 10
    sure = of_members(world.refitter, fit, 1)
    monkeypatch.setattr(module, "members", lambda fit, i: replace(members(fit, i), probability=first))
    found = of_members(world.refitter, fit, 1)
    np.testing.assert_array_equal(found.who[0].probability > 0.5, HAS_IT)
    assert sure.mixture is not None
    assert found.mixture is not None
    assert found.mixture.evidence.sum() == pytest.approx(sure.mixture.evidence.sum(), abs=2.0)
