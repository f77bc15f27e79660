"""Starts that forget where a wrong model has left people, and people who belong where the others are."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from experiments import TOY, Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.cold_start import beside_the_leader, cold_start, driven_away, lost_alone
from bayes_impedance.diagnosis.fit.extend import extended_start
from bayes_impedance.diagnosis.fit.majority import joined
from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.trial import from_cold, trial_of
from bayes_impedance.network.elements import band_scale

# Another optimum: the two branches change places. A dispersion of 0.1 tells them apart where everybody agrees.
TWINS = ("(n1-r1)|(n2-r2)", {"n1": 3e-5, "r1": 2.0, "n2": 1e-3, "r2": 1.0})


@cache
def toys() -> Experiment:
    return toy(*TOY, seed=3)


@cache
def twins() -> Experiment:
    return toy(*TWINS, seed=4, tau=0.1)


def with_sd(fit: Refit, sd: tuple[float, ...]) -> Refit:
    return replace(fit, population=replace(fit.population, covariance=np.diag(np.square(sd))))


def test_elements_are_driven_away_if_people_differ_more_than_people_do() -> None:
    fit = toys().fit()
    assert not driven_away(fit).any()
    assert driven_away(with_sd(fit, (0.9, 0.3))).tolist() == [True, False]


def test_a_cold_start_is_the_median_person_and_the_middle_of_the_band() -> None:
    experiment = toys()
    fit = with_sd(experiment.fit(), (1.2, 0.3))
    model = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    grown = experiment.refitter.fit(model, *extended_start(fit, model), 5)
    u, population = cold_start(fit, grown)
    scales = model.scales
    expected = [band_scale("n1", scales.z_middle, scales.middle / (2 * np.pi)), np.median(fit.persons[:, 1])]
    np.testing.assert_allclose(u[:, :2], np.tile(expected, (len(u), 1)))
    np.testing.assert_array_equal(u[:, 2], grown.u[:, 2])  # the addition stays where it is
    np.testing.assert_allclose(population.mu, expected)
    assert np.all(np.diag(population.covariance) > 0)
    again = experiment.refitter.fit(model, u, population, 80)
    assert again.evidence.sum() == pytest.approx(grown.evidence.sum(), abs=3)


def test_the_lost_alone_begin_anew_and_everybody_keeps_the_others() -> None:
    experiment = toys()
    fit = with_sd(experiment.fit(), (1.2, 0.3))
    model = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    grown = experiment.refitter.fit(model, *extended_start(fit, model), 5)
    u, population = lost_alone(fit, grown)
    lost = band_scale("n1", model.scales.z_middle, model.scales.middle / (2 * np.pi))
    np.testing.assert_allclose(u[:, 0], lost)
    np.testing.assert_array_equal(u[:, 1], fit.u[:, 1])
    np.testing.assert_array_equal(u[:, 2], grown.u[:, 2])
    np.testing.assert_allclose(population.mu, [lost, fit.population.mu[1]])
    np.testing.assert_allclose(population.covariance, np.diag([0.3**2, 0.3**2]))
    assert fit.population.covariance[0, 0] == pytest.approx(1.2**2)  # nothing else was changed


def test_where_everybody_has_a_resonance_of_their_own_only_the_lost_elements_begin_anew() -> None:
    """An undamped branch resonates elsewhere in each person; another one has been driven away."""
    delay = 2e-3
    experiment = toy(
        "(m1-n1)|(m2-r2)|n2",
        {"m1": 4.0, "n1": 1e-4, "m2": 0.5, "r2": 20.0, "n2": 1e-3},
        seed=4,
        n=12,
        noise=0.003,
        rho=0.001,
        frequency_hz=np.geomspace(0.7, 30, 61),
        hidden=lambda s, z, _: (z * np.exp(-s * delay), np.full(12, delay)),
    )
    fit, refitter = experiment.fit(), experiment.refitter
    model = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    right = refitter.fit(model, *extended_start(fit, model), 60).evidence.sum()
    names = list(fit.model.network.elements)
    away = [names.index("m2"), names.index("r2")]
    u, sd = fit.u.copy(), np.sqrt(np.diag(fit.population.covariance))
    u[:, away], sd[away] = u[:, away] + 12.0, 1.5
    lost = replace(with_sd(fit, tuple(sd)), u=u)
    candidate = Candidate(entry("rig.delay"), "port", {})
    warm = trial_of(candidate, "shared", refitter.fit(model, *extended_start(lost, model), 30), fit)
    everything, alone = (
        refitter.fit(model, *start(lost, warm.fit), 30).evidence.sum() for start in (cold_start, lost_alone)
    )
    assert warm.fit.evidence.sum() < right - 1000
    assert everything < right - 1000
    assert alone == pytest.approx(right, abs=3)
    assert from_cold(refitter, lost, warm, 30).fit.evidence.sum() == alone


def test_beside_the_leader_are_its_elements_and_the_own_addition() -> None:
    experiment = toys()
    delay = experiment.grown(Addition(effect=entry("rig.delay"), place="port", pooling="shared"))
    mass = experiment.grown(Addition(effect=entry("body.mass"), place="port", pooling="varying"))
    own = experiment.refitter.fit(mass, *extended_start(experiment.fit(), mass), 3)
    leader = experiment.refitter.fit(delay, *extended_start(experiment.fit(), delay), 3)
    moved = replace(leader, u=leader.u + 0.5, population=replace(leader.population, mu=leader.population.mu + 0.5))
    u, population = beside_the_leader(own, moved)
    np.testing.assert_array_equal(u[:, :2], moved.u[:, :2])
    np.testing.assert_array_equal(u[:, 2], own.u[:, 2])
    np.testing.assert_array_equal(population.mu, [*moved.population.mu[:2], own.population.mu[2]])
    np.testing.assert_array_equal(population.covariance[:2, :2], leader.population.covariance[:2, :2])
    assert population.covariance[2, 2] == own.population.covariance[2, 2]
    np.testing.assert_array_equal(population.covariance[2, :2], 0.0)


def in_the_other_optimum(fit: Refit, people: np.ndarray) -> Refit:
    """The fit with the branches of some people exchanged: the same curves from elements that nobody else has."""
    names = fit.model.network.elements
    other = [names.index(name) for name in ("n2", "r2", "n1", "r1")]
    own = [names.index(name) for name in ("n1", "r1", "n2", "r2")]
    u = fit.u.copy()
    rows = people[fit.owner]
    u[np.ix_(rows, own)] = fit.u[np.ix_(rows, other)]
    return twins().refitter.fit(fit.model, u, fit.population, 80)


@pytest.mark.parametrize("known", [True, False], ids=["the group is told", "the others are told"])
def test_people_in_another_optimum_are_no_group(known: bool) -> None:
    good = twins().fit()
    some = np.arange(20) < 5
    apart = in_the_other_optimum(good, some)
    assert apart.evidence.sum() < good.evidence.sum() - 20
    assert np.ptp(apart.persons[:, 0]) > 2  # they look like a group
    together = joined(twins().refitter, apart, some if known else ~some)
    assert together.evidence.sum() == pytest.approx(good.evidence.sum(), abs=1)
    assert np.ptp(together.persons[:, 0]) < 1


def test_people_who_do_differ_stay_apart() -> None:
    def changed(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        group = np.arange(len(z)) < 6
        z = z.copy()
        z[group] += 10.0  # a much larger damper
        return z, group.astype(float)

    experiment = toy(*TOY, seed=5, hidden=changed)
    fit = experiment.fit()
    group = np.arange(20) < 6
    after = joined(experiment.refitter, fit, group)
    assert after.evidence.sum() >= fit.evidence.sum()
    np.testing.assert_allclose(after.persons, fit.persons, atol=0.01)
