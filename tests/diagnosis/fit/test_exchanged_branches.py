"""Two branches of everybody that have changed places change back; branches that have not stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, toy

from bayes_impedance.diagnosis.fit.exchanged_branches import with_branches_exchanged
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
