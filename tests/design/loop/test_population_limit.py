"""The limit of a share of the population: its posterior, against one that is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from bayes_impedance.design.loop.device import Device, Section
from bayes_impedance.design.loop.population_limit import limits_of_populations
from bayes_impedance.design.loop.sampled_loop import largest_stiffness
from bayes_impedance.design.loop.stability import limit_of, loop_of
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.network.notation import parse

PERIOD, DRAWS = 1e-3, 400
HEAVY = Device("heavy", (Section("beside", "m1|r1", {"m1": 10.0, "r1": 1e-9}),), PERIOD)
"""So slow that its limit is the user's damping over half a period (Gil et al. 2004, Colgate 1997)."""


def population(spread: float = 0.12) -> UserPopulation:
    """Users with a damper that matters and a mass that does not."""
    rng = np.random.default_rng(3)
    mu = np.column_stack([np.full(DRAWS, np.log(1e-4)), np.log(2.0) + spread * rng.normal(size=DRAWS)])
    factor = np.zeros((DRAWS, 2, 2))
    factor[:, 0, 0] = 0.2
    factor[:, 1, 0], factor[:, 1, 1] = 0.3 * np.exp(spread * rng.normal(size=(2, DRAWS)))
    return UserPopulation(
        network=parse("m1|r1"), unit="N s/m", mu=mu, factor=factor, between_repetitions=np.zeros_like(mu)
    )


def closed_form(p: UserPopulation, share: float) -> np.ndarray:
    """Limits of the populations: ln r is normal."""
    deviation = np.linalg.norm(p.factor[:, 1], axis=1)
    return np.exp(p.mu[:, 1] + norm.ppf(1 - share) * deviation) / (PERIOD / 2)


@pytest.mark.parametrize("share", [0.5, 0.99])
def test_limit_and_interval_are_of_the_posterior_of_the_quantile(share: float) -> None:
    p = population()
    low, middle, high = np.quantile(closed_form(p, share), (0.05, 0.5, 0.95))
    found = limit_of(p, p.draw(40, seed=1), HEAVY, 0.0, share=share, populations=DRAWS)
    np.testing.assert_allclose([found.low, found.stiffness, found.high], [low, middle, high], rtol=0.02)


def test_each_population_has_its_own() -> None:
    p = population()
    found = limits_of_populations(p, HEAVY, 0.0, 0.99, highest=1e6, populations=DRAWS)
    np.testing.assert_allclose(found, closed_form(p, 0.99), rtol=0.03)


@pytest.mark.parametrize("users", [2, 10, 40, 300])
def test_the_limit_lies_in_its_interval_and_does_not_depend_on_who_was_drawn(users: int) -> None:
    p = population()
    found = [limit_of(p, p.draw(users, seed=s), HEAVY, 0.0, populations=50) for s in (1, 2)]
    assert found[0].low < found[0].stiffness < found[0].high
    assert [f.stiffness for f in found] == [found[0].stiffness] * 2
    assert found[0].each.size == users


def test_an_element_that_is_assumed_is_the_same_for_everybody() -> None:
    p = population()
    factor = p.factor.copy()
    factor[:, 0] = 0.0
    mu = p.mu.copy()
    mu[:, 0] = np.log(1e-4)
    fixed = UserPopulation(
        network=p.network, unit=p.unit, mu=mu, factor=factor, between_repetitions=p.between_repetitions, fixed=("m1",)
    )
    found = limits_of_populations(fixed, HEAVY, 0.0, 0.9, highest=1e6, populations=DRAWS)
    np.testing.assert_allclose(found, closed_form(fixed, 0.9), rtol=0.03)


def test_where_some_are_stable_at_every_stiffness_all_are_decided_one_by_one() -> None:
    p = population()
    highest = 4500.0  # above the limit of about two thirds of the users
    found = np.quantile(limits_of_populations(p, HEAVY, 0.0, 0.8, highest=highest), (0.05, 0.5, 0.95))
    known = np.quantile(closed_form(p, 0.8), (0.05, 0.5, 0.95))
    np.testing.assert_allclose(found, known, rtol=0.06)
    never = limits_of_populations(p, HEAVY, 1e6, 0.8, highest=highest, populations=10)
    assert (never == 0).all()


def test_few_halvings_are_the_same_limit_less_exactly() -> None:
    p = population()
    loop = loop_of(HEAVY, p.draw(5, seed=1))
    exact, rough = (largest_stiffness(loop, 0.0, 1e6, halvings=n)[0] for n in (40, 8))
    np.testing.assert_allclose(rough, exact, rtol=0.2 / 2**8 * 1.01)
    assert np.all(rough <= exact)
    assert isinstance(p.draw(1, seed=1), Users)
