"""Equal parts of a network are named alike in everybody."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.equal_parts import named_alike, steps_of
from bayes_impedance.population.fit import prior_for
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.settings import FitSettings
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

TWO = Kernel(parse("(n1-m1)|(n2-m2)"))


def _prior():
    population = VirtualPopulation(
        network="(n1-m1)|(n2-m2)",
        central={"n1": 1e-3, "m1": 1e-3, "n2": 1e-4, "m2": 1e-3},
        between_persons=dict.fromkeys(("n1", "m1", "n2", "m2"), 0.2),
        between_repetitions=dict.fromkeys(("n1", "m1", "n2", "m2"), 0.01),
    )
    recordings = simulate_recordings(population, 3, 2, np.geomspace(5, 500, 20), 1).recordings
    return prior_for(TWO, recordings, FitSettings())


@pytest.mark.parametrize("exchanged", [1, 4, 10, 15, 19])
def test_people_arranged_the_other_way_are_turned_to_the_others(exchanged: int) -> None:
    rng = np.random.default_rng(exchanged)
    at = {name: k for k, name in enumerate(TWO.elements)}
    centre = np.zeros(4)
    centre[at["m2"]], centre[at["n2"]] = 4.0, -0.3
    truth = centre + 0.3 * rng.normal(size=(20, 4))
    swap = [at["n2"], at["m2"], at["n1"], at["m1"]]
    swap = [swap[["n1", "m1", "n2", "m2"].index(name)] for name in TWO.elements]
    given = truth.copy()
    rows = rng.permutation(20)[:exchanged]
    given[rows] = truth[rows][:, swap]
    found = named_alike(given, steps_of(TWO, _prior()))
    assert any(np.array_equal(found, whole) for whole in (truth, truth[:, swap]))


def test_three_equal_parts_come_into_one_order() -> None:
    kernel = Kernel(parse("(n1-m1)|(n2-m2)|(n3-m3)"))
    rng = np.random.default_rng(2)
    prior = Prior(centre=np.zeros(6))
    masses = [kernel.elements.index(f"m{k}") for k in (1, 2, 3)]
    springs = [kernel.elements.index(f"n{k}") for k in (1, 2, 3)]
    given = 0.2 * rng.normal(size=(15, 6))
    for row in given:
        order = rng.permutation(3)
        for k in range(3):
            row[masses[k]] += 2.0 * order[k]
            row[springs[k]] -= 1.0 * order[k]
    found = named_alike(given, steps_of(kernel, prior))
    assert np.all(found.std(axis=0) < 0.4)


def test_nothing_is_exchanged_where_the_prior_tells_the_parts_apart() -> None:
    prior = _prior()
    centre = prior.centre.copy()
    centre[TWO.elements.index("m1")] += 1.0
    assert not steps_of(TWO, replace(prior, centre=centre))
    assert not steps_of(Kernel(parse("m1|r1|n1")), Prior(centre=np.zeros(3)))
