"""Two branches that have changed places in everybody change back, also where one was added; others stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect, registered
from bayes_impedance.diagnosis.fit.exchanged_branches import _added, with_branches_exchanged
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import finalists

CENTRES = {"m1": 9.6, "n1": 9.5e-5, "m2": 0.048, "n2": 1.2e-4, "r1": 43.0, "m3": 1.3e-3, "n3": 7.3e-5}
PAIRS = {"m2": "m3", "m3": "m2", "n1": "n3", "n3": "n1"}


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy(
        "(m1-((n1-m2)|(n2-r1)))|(m3-n3)", CENTRES, seed=2, n=12, noise=0.004, frequency_hz=np.geomspace(1.3, 1200, 90)
    )


@pytest.fixture(scope="module")
def changed(world: Experiment) -> Refit:
    """A fit that begins with the two branches exchanged in everybody."""
    names = world.model.network.elements
    columns = [names.index(PAIRS.get(name, name)) for name in names]
    around = replace(world.population, mu=world.population.mu[columns])
    return world.refitter.fit(world.model, world.u[:, columns], around, 60)


def test_branches_that_have_changed_places_change_back(world: Experiment, changed: Refit) -> None:
    right = world.fit()
    assert right.evidence.sum() > changed.evidence.sum() + 100  # from there it does not come back
    found = with_branches_exchanged(world.refitter, changed, 60)
    assert found.evidence.sum() > right.evidence.sum() - 20  # single people are searched afterwards
    truth = np.log([CENTRES[name] for name in world.model.network.elements])
    np.testing.assert_allclose(np.median(found.persons, axis=0), truth, atol=0.4)


def test_a_finalist_has_them_back_at_their_places(world: Experiment, changed: Refit) -> None:
    found = finalists._searched(world.refitter, changed, 1)
    assert found.evidence.sum() > world.fit().evidence.sum() - 1


def test_branches_at_their_places_stay(world: Experiment) -> None:
    right = world.fit()
    assert with_branches_exchanged(world.refitter, right, 60) is right


def test_a_network_without_such_branches_is_left_alone() -> None:
    plain = toy("(n2|r2)-(m1|r1|n1)", {"n2": 0.018, "r2": 0.27, "m1": 5.7e-3, "r1": 0.69, "n1": 0.019}, seed=1, n=8)
    fit = plain.fit()
    assert with_branches_exchanged(plain.refitter, fit, 60) is fit


ABSORBER = {"m1": 0.18, "r1": 11.5, "m2": 0.012, "n2": 3.8e-5, "r2": 53.0}
RIG = {"mass": 0.018, "frequency": 2 * np.pi * 1640.0, "damping_ratio": 0.17}


def resonator(s: np.ndarray) -> np.ndarray:
    m, omega, zeta = RIG.values()
    return s * m * (omega**2 + 2 * zeta * omega * s) / (s**2 + 2 * zeta * omega * s + omega**2)


def test_the_rig_and_a_branch_of_the_body_that_have_changed_places_change_back() -> None:
    """A resonance of the rig that is in the network's branch, with that branch beside the network."""
    world = toy(
        "m1|r1|(m2-(n2|r2))",
        ABSORBER,
        seed=3,
        n=14,
        hidden=lambda s, z, _: (z + resonator(s), np.ones(len(z))),
        frequency_hz=np.geomspace(12, 6400, 80),
    )
    own = {"mass": 0.012, "frequency": (0.012 * 3.8e-5) ** -0.5, "damping_ratio": 0.5 * 53.0 * (3.8e-5 / 0.012) ** 0.5}
    names = world.model.network.elements
    right, wrong = (
        extended(world.model, Candidate(entry("rig.resonance"), "port", shape), "shared", 1.0) for shape in (RIG, own)
    )
    known = world.fit(rounds=0)

    def fitted(model, shape, elements):
        u, population = extended_start(known, model)
        mass, frequency, damping = model.columns(0)
        scale = model.additions[0].effect.coefficients[0].scale(model.scales)
        u[:, mass], u[:, frequency] = shape["mass"] / scale, np.log(shape["frequency"])
        u[:, damping] = np.log(shape["damping_ratio"])
        for name, value in elements.items():
            u[:, names.index(name)] = population.mu[names.index(name)] = np.log(value)
        return world.refitter.fit(model, u, population, 80)

    truth = fitted(right, RIG, {})
    spring = 1 / (RIG["mass"] * RIG["frequency"] ** 2)
    damper = 2 * RIG["damping_ratio"] * (RIG["mass"] / spring) ** 0.5
    astray = fitted(wrong, own, {"m2": RIG["mass"], "n2": spring, "r2": damper})
    assert truth.evidence.sum() > astray.evidence.sum() + 100  # from there it does not come back
    found = with_branches_exchanged(world.refitter, astray, 80)
    assert found.evidence.sum() > truth.evidence.sum() - 20  # single people are searched afterwards
    assert found.u[0, found.model.columns(0)[1]] == pytest.approx(np.log(RIG["frequency"]), abs=0.02)
    assert with_branches_exchanged(world.refitter, truth, 80).evidence.sum() >= truth.evidence.sum()


@pytest.mark.parametrize("effect", [e for e in registered() if e.operation], ids=lambda e: f"{e.id} {e.operation}")
def test_a_branch_of_elements_has_the_impedance_of_its_effect(effect: Effect) -> None:
    """Read from the branch's elements, the effect's parameters give the impedance that the branch has."""
    branch = _added(effect)
    elementary = {"relaxation", "resonator", "bypass", "series_layer"}
    assert (branch is not None) == (effect.operation in elementary | {"series_compliance"})
    if branch is None or effect.operation == "series_compliance":
        return
    values = dict(zip(branch.names, [0.3, 2e-4, 4.0], strict=False))
    s = 2j * np.pi * np.geomspace(3, 300, 7)
    x = np.exp(branch.powers @ np.log(list(values.values())) + branch.constant)
    z = branch.network.impedance(s, values)
    match effect.operation:
        case "relaxation":
            expected = x[0] / (1 + s * x[1])
        case "bypass":
            expected = x[0] + x[1] / s
        case "series_layer":
            expected = (1 + s * x[1]) / (s * x[0])
        case _:
            m, omega, zeta = x
            expected = s * m * (omega**2 + 2 * zeta * omega * s) / (s**2 + 2 * zeta * omega * s + omega**2)
    np.testing.assert_allclose(z, expected, rtol=1e-10)


def test_a_branch_that_was_registered_is_known_by_its_elements() -> None:
    nail = replace(entry("body.resonator"), operation="", coefficients=(), branch="m1-(n1|r1)", connection="beside")
    branch = _added(nail)
    assert branch is not None
    assert branch.names == ("m1", "n1", "r1")
    np.testing.assert_array_equal(branch.powers, np.eye(3))
