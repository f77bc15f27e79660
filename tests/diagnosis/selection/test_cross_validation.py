"""Held-out people and held-out frequencies: who is left out, what is trained without them, and what the gain says."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Experiment, Serial, entry, recovered, toy, with_mass

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import cross_validation
from bayes_impedance.diagnosis.selection.cross_validation import (
    BLOCKS,
    FOLDS,
    _people_of,
    _without,
    block_gains,
    held_out,
    people_gain,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood

FEW = 6
"""Fewer people than folds are made for."""


@cache
def compared(hidden: str, seed: int = 1, n: int = 20) -> tuple[Experiment, Refit, Refit]:
    """An experiment, its network, and the network with the effect that is hidden (with a mass if nothing is)."""
    change = {"rig.mass": with_mass(0.0), "body.mass": with_mass(0.3), "nothing": None}[hidden]
    experiment = toy(*TOY, seed=seed, n=n, hidden=change)
    effect = entry("rig.mass" if hidden == "nothing" else hidden)
    return experiment, experiment.fit(), recovered(experiment, effect, "port", effect.pooling)


# People


@pytest.mark.parametrize("hidden", ["rig.mass", "body.mass"])
def test_a_concealed_effect_gains_on_people_and_on_frequencies_that_were_left_out(hidden: str) -> None:
    experiment, before, after = compared(hidden)
    gained = held_out(experiment.refitter, before, after, seed=1)
    assert gained.people is not None
    assert gained.people_se is not None
    assert gained.people > 5 * gained.people_se > 0
    assert gained.blocks is not None
    assert gained.blocks_se is not None
    assert gained.blocks > 5 * gained.blocks_se > 0
    # The other way round it is a loss of the same size.
    lost = held_out(experiment.refitter, after, before, seed=1)
    assert lost.people == pytest.approx(-gained.people)
    assert lost.blocks == pytest.approx(-gained.blocks)


def test_a_superfluous_effect_gains_nothing_on_people_that_were_left_out() -> None:
    """Trained on other people's noise it costs half a unit on average; one unit is beyond what noise makes of it."""
    gains = []
    for seed in range(1, 9):
        experiment, before, after = compared("nothing", seed)
        gains.append(people_gain(experiment.refitter, before, after, seed=1)[0])
    assert max(gains) < 1.0
    assert np.mean(gains) < 0


def test_what_is_the_same_for_all_gains_no_more_as_something_that_differs() -> None:
    experiment, before, shared = compared("rig.mass")
    varying = recovered(experiment, entry("body.mass"), "port", "varying")
    same, _ = people_gain(experiment.refitter, before, shared, seed=1)
    differing, _ = people_gain(experiment.refitter, before, varying, seed=1)
    assert same > differing


def test_people_alone_are_held_out_on_request_and_gain_the_same() -> None:
    experiment, before, after = compared("rig.mass")
    alone = held_out(experiment.refitter, before, after, seed=3, blocks=False)
    assert (alone.people, alone.people_se) == people_gain(experiment.refitter, before, after, seed=3)
    assert alone.blocks is None
    assert alone.blocks_se is None
    assert alone.described == f"{FOLDS} subject folds"


def test_one_fit_is_held_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before, after = compared("rig.mass", 2)
    refitter, asked = experiment.refitter.subset(np.arange(20)), list[Refit]()

    def noting(refitter: Refitter, fit: Refit, fold: np.ndarray) -> np.ndarray:
        asked.append(fit)
        return _people_of(refitter, fit, fold)

    monkeypatch.setattr(cross_validation, "_people_of", noting)
    first = people_gain(refitter, before, after, 1)
    assert people_gain(refitter, before, after, 1) == first
    assert people_gain(refitter, after, before, 1)[0] == -first[0]
    assert asked == [after, before]
    assert people_gain(refitter, before, after, 2) != first  # other folds
    assert people_gain(refitter.subset(np.arange(20)), before, after, 1) == first  # the same people, asked anew
    assert asked == [after, before] * 3


@pytest.mark.parametrize("bad", ["where they are without it", "where they were with all"])
def test_with_a_block_the_better_of_two_starts_counts(monkeypatch: pytest.MonkeyPatch, bad: str) -> None:
    experiment, before, after = compared("rig.mass", n=FEW)
    plain, under = block_gains(experiment.refitter, before, after), cross_validation._under

    def in_another_valley(refitter: Refitter, fit: Refit, trained: Refit, u: np.ndarray) -> np.ndarray:
        lost = fit is after and np.array_equal(u, fit.u) == (bad == "where they were with all")
        return under(refitter, fit, trained, u) - 20.0 * lost

    monkeypatch.setattr(cross_validation, "_under", in_another_valley)
    np.testing.assert_allclose(block_gains(experiment.refitter, before, after), plain, atol=0.05)


class Noting(Refitter):
    """A refitter that notes whom each fit is trained on, and of whom evidence is asked under held parameters."""

    def __init__(
        self, data: Sequence[Likelihood], executor: Executor, one_person: bool = False, notes: list | None = None
    ) -> None:
        super().__init__(data, executor, one_person)
        self.notes: list[tuple[bool, tuple[int, ...]]] = [] if notes is None else notes

    def subset(self, people: Sequence[int]) -> Noting:
        return Noting([self.data[i] for i in people], self.executor, self.one_person, self.notes)

    def fit(self, *arguments: Any, **settings: Any) -> Refit:
        held = bool(settings.get("hold_population")) and bool(settings.get("hold_additions"))
        self.notes.append((held, tuple(id(d) for d in self.data)))
        return super().fit(*arguments, **settings)


def folds_of(experiment: Experiment, before: Refit, after: Refit, seed: int) -> list[tuple[set[int], set[int]]]:
    """For every fold of each of the two models, who was trained on and who was held out."""
    refitter = Noting(experiment.data, Serial())
    people_gain(refitter, before, after, seed)
    number = {id(d): i for i, d in enumerate(experiment.data)}
    named = [(held, [number[k] for k in people]) for held, people in refitter.notes]
    assert all(len(set(people)) == len(people) for _, people in named)
    assert [held for held, _ in named] == [False, True] * (2 * FOLDS)
    return [(set(trained[1]), set(left[1])) for trained, left in zip(named[::2], named[1::2], strict=True)]


def test_folds_leave_nobody_out_and_nobody_twice() -> None:
    n = 13  # not a multiple of the number of folds
    experiment, before, after = compared("rig.mass", n=n)
    folds = folds_of(experiment, before, after, seed=1)
    for trained, left in folds:
        assert trained | left == set(range(n))
        assert not trained & left
        assert len(left) in (n // FOLDS, n // FOLDS + 1)
    ends = [sorted(i for _, left in part for i in left) for part in (folds[:FOLDS], folds[FOLDS:])]
    assert ends == [list(range(n))] * 2
    # Both models have the same folds, and another seed deals others.
    assert sorted(map(sorted, (left for _, left in folds[:FOLDS]))) == sorted(
        map(sorted, (left for _, left in folds[FOLDS:]))
    )
    assert folds_of(experiment, before, after, seed=1) == folds
    assert folds_of(experiment, before, after, seed=2) != folds


@pytest.mark.parametrize("hidden", ["rig.mass", "body.mass"])
def test_a_population_does_not_depend_on_those_it_was_trained_without(hidden: str) -> None:
    """Other recordings of one person change that person's value and those of the other folds, of nobody in the fold."""
    experiment, _, fit = compared(hidden)
    n, changed = len(experiment.data), 3
    fold = (np.arange(n) >= 5).astype(int)
    louder = list(experiment.data)
    louder[changed] = replace(louder[changed], z=1.5 * louder[changed].z)
    plain = _people_of(experiment.refitter, fit, fold)
    other = _people_of(Refitter(louder, Serial()), fit, fold)
    moved = np.abs(other - plain)
    companions = (fold == fold[changed]) & (np.arange(n) != changed)
    # Rounds end when the last person is at rest, so companions may make a few steps more or less.
    assert moved[companions].max() < 1e-3
    assert moved[changed] > 1
    assert moved[fold != fold[changed]].max() > 0.1


# Frequencies


def test_few_people_are_compared_by_frequencies_alone() -> None:
    experiment, before, after = compared("rig.mass", n=FEW)
    gained = held_out(experiment.refitter, before, after, seed=1, blocks=False)
    assert gained.people is None
    assert gained.people_se is None
    assert gained.described == f"{BLOCKS} frequency blocks"
    assert gained.blocks is not None
    assert gained.blocks_se is not None
    assert gained.blocks > 5 * gained.blocks_se > 0


def log_marginal(fit: Refit, kept: np.ndarray) -> float:
    r"""Logarithm of :math:`\int p(z_\text{kept} | u) N(u; \mu, T + R) du` of one recording, by the trapezium rule.

    Up to what depends on the data alone.
    """
    d, size = fit.data[0], fit.u.shape[1]
    frequency = d.omega[kept] / (2 * np.pi)
    z = (d.z[0, 0] + 1j * d.z[0, 1])[kept]
    spread = np.sqrt(np.diag(fit.population.covariance) + fit.population.rho**2)
    nodes = np.linspace(-5, 5, 301)
    axes = [m + s * nodes for m, s in zip(fit.population.mu, spread, strict=True)]
    u = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, size)
    curves = Kernel(fit.model.network).impedance(u, frequency)
    chi = np.sum(np.abs(curves - z) ** 2 * d.weight[0, kept], axis=1)
    log_likelihood = -(SCALE_SHAPE + kept.sum()) * np.log(SCALE_SHAPE + 0.5 * chi)
    log_prior = -0.5 * np.sum(((u - fit.population.mu) / spread) ** 2, axis=1)
    log_prior -= size * 0.5 * np.log(2 * np.pi) - size * np.log(nodes[1] - nodes[0])
    return float(np.logaddexp.reduce(log_likelihood + log_prior))


def test_a_blocks_predictive_density_is_the_evidence_with_it_less_that_without() -> None:
    """Of one person, whose population is given, and by quadrature: a damper alone against one with a spring."""
    experiment = toy(*TOY, seed=5, n=1, repetitions=1, noise=0.1)
    refitter = Refitter(experiment.data, Serial(), one_person=True)
    fits = []
    for notation, columns in (("r1", [1]), ("n1|r1", [0, 1])):
        model = build(parse(notation), (), experiment.model.scales, ())
        p = experiment.population
        population = Population(p.mu[columns], p.covariance[np.ix_(columns, columns)], p.rho[columns])
        fits.append(refitter.fit(model, experiment.u[:, columns], population, 80))
    before, after = fits
    gained = held_out(refitter, before, after, seed=1)
    omega = np.log(experiment.data[0].omega)
    block = np.minimum((BLOCKS * (omega - omega[0]) / (omega[-1] - omega[0])).astype(int), BLOCKS - 1)
    everything = np.ones(omega.size, dtype=bool)
    exact = [sum(log_marginal(fit, everything) - log_marginal(fit, block != k) for k in range(BLOCKS)) for fit in fits]
    assert exact[1] - exact[0] > 20
    assert gained.blocks == pytest.approx(exact[1] - exact[0], abs=0.5)
    assert gained.blocks_se is None  # there is no scatter over one person


def one_person(points: int) -> Likelihood:
    """Two recordings whose values are their own positions."""
    z = np.arange(2 * points).reshape(2, points) * (1 + 2j)
    return Likelihood.make(np.arange(1.0, points + 1), z, 1 / np.sqrt(1.0 + np.arange(points)), np.zeros((2, 1)))


def test_a_block_of_frequencies_is_taken_out_with_its_weights_and_its_count() -> None:
    d = one_person(10)
    rest = _without(d, float(np.log(d.omega[4])), float(np.log(d.omega[7])))  # the upper edge is the next block's
    kept = [0, 1, 2, 3, 7, 8, 9]
    np.testing.assert_array_equal(rest.omega, d.omega[kept])
    np.testing.assert_array_equal(rest.z, d.z[:, :, kept])
    np.testing.assert_array_equal(rest.weight, d.weight[:, kept])
    assert rest.count == d.count - 2 * 3


@pytest.mark.parametrize(("points", "left"), [(6, 3), (5, 5), (4, 4)])
def test_three_points_or_more_are_left_of_everybody(points: int, left: int) -> None:
    """Three frequencies of each are in the block: where fewer than three others are left, none is taken out."""
    d = one_person(points)
    rest = _without(d, float(np.log(d.omega[1])) - 1e-9, float(np.log(d.omega[3])) + 1e-9)
    assert rest.omega.size == left
    assert rest.z.shape == (2, 2, left)
    assert rest.count >= 1
