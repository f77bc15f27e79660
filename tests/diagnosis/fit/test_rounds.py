"""Steps of people: they promise what the objective does, count recordings that move alone, are damped by success."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Experiment, toy

from bayes_impedance.diagnosis.fit.normal_equations import Population, equations_at, weights_of
from bayes_impedance.diagnosis.fit.rounds import (
    DAMPING,
    Layout,
    State,
    blocks_of,
    damped_anew,
    means_of,
    objective,
    person_steps,
)
from bayes_impedance.diagnosis.fit.second_order import SecondOrder

N = 6


def begun(damping: float = DAMPING) -> tuple[State, Experiment]:
    """A state away from the optimum, recordings apart from their person."""
    experiment = toy(*TOY, seed=3, n=N)
    refitter, rng = experiment.refitter, np.random.default_rng(4)
    u = experiment.u + 0.05 * rng.normal(size=experiment.u.shape)
    state = State(
        u=u,
        persons=means_of(u, refitter.owner, N) + 0.02 * rng.normal(size=(N, u.shape[1])),
        population=experiment.population,
        equations=equations_at(experiment.model, refitter.stack, u, refitter.executor),
        damping=np.full(N, damping),
        second_order=SecondOrder.unknown(len(u), u.shape[1], N),
    )
    return state, experiment


def value_at(experiment: Experiment, state: State, u: np.ndarray, persons: np.ndarray) -> np.ndarray:
    refitter = experiment.refitter
    chi = equations_at(experiment.model, refitter.stack, u, refitter.executor).chi
    return objective(refitter.layout, experiment.model, chi, u, persons, state.population)


@pytest.mark.parametrize("damping", [DAMPING, 10.0])
def test_a_step_promises_the_slope_of_the_objective(damping: float) -> None:
    """Along a millionth of the step, by central differences; whatever the damping is."""
    state, experiment = begun(damping)
    step = person_steps(experiment.refitter.layout, experiment.model, state, np.ones(N, dtype=bool))
    owner, part = experiment.refitter.owner, 1e-5
    assert owner.size == len(step.u)
    ends = [value_at(experiment, state, state.u + s * step.u, state.persons + s * step.v) for s in (-part, part)]
    slope = (ends[0] - ends[1]) / (2 * part)
    share = slope / step.length**2  # of the whole step that is taken
    assert np.all(share > 0)
    np.testing.assert_allclose(share * (1 - 0.5 * share) * step.length**2, step.promised, rtol=1e-4)
    np.testing.assert_allclose(share, np.minimum(share, 1.0), rtol=1e-4)


def test_some_people_step_as_they_do_among_all() -> None:
    """Whom else one asks for does not matter."""
    state, experiment = begun()
    some = np.array([True, False, False, True, True, False])
    everybody = person_steps(experiment.refitter.layout, experiment.model, state, np.ones(N, dtype=bool))
    few = person_steps(experiment.refitter.layout, experiment.model, state, some)
    np.testing.assert_allclose(few.u, everybody.u[some[experiment.refitter.owner]], rtol=1e-9)
    np.testing.assert_allclose(few.v, everybody.v[some], rtol=1e-9)
    np.testing.assert_allclose(few.length, everybody.length[some], rtol=1e-9)


def test_recordings_that_move_apart_are_a_step_of_their_person() -> None:
    """One up and one down: the person's mean stays, and the person is not at rest."""
    state, experiment = begun()
    rest = experiment.fit(hold_population=True)
    apart = rest.u.copy()
    apart[::2] += 0.005
    apart[1::2] -= 0.005
    refitter = experiment.refitter
    equations = equations_at(experiment.model, refitter.stack, apart, refitter.executor)
    state = replace(state, u=apart, persons=rest.persons, equations=equations, population=rest.population)
    step = person_steps(refitter.layout, experiment.model, state, np.ones(N, dtype=bool))
    there = value_at(experiment, state, apart, rest.persons) - value_at(experiment, state, rest.u, rest.persons)
    assert np.all(there > 1.0)
    assert np.all(np.abs(step.v) < 1e-3)
    np.testing.assert_allclose(0.5 * step.length**2, there, rtol=0.1)


def test_damping_follows_what_a_step_has_brought() -> None:
    """Less after all that was promised, as much after half, more after little, much more after none."""
    damping = damped_anew(
        np.full(4, 0.1), np.array([1.0, 0.5, 0.1, -1.0]), np.ones(4), np.array([False, False, False, True])
    )
    assert damping[0] < damping[1] == 0.1 < damping[2] < damping[3]
    hardly = damped_anew(np.array([1e-9]), np.array([-1.0]), np.ones(1), np.ones(1, dtype=bool))
    assert hardly[0] == DAMPING


@pytest.mark.parametrize("precision", [1.0, 1e2, 1e4])
@pytest.mark.parametrize("size", [1e-4, 1.0])
def test_an_addition_is_one_number_in_all_of_a_persons_recordings(size: float, precision: float) -> None:
    """Determinants are those of the density of a person's elements, of each recording's, and of one addition.

    However precisely a recording determines it, in standard deviations between people, and however small it is.
    """
    rng, elements, people, each, count = np.random.default_rng(5), 3, 4, 3, 200
    v = elements + 1
    owner = np.repeat(np.arange(people), each)
    unit = np.append(np.ones(elements), size)
    root = rng.normal(size=(owner.size, 2 * v, v)) * np.append(np.full(elements, 30.0), precision) / unit
    information = np.einsum("mkp,mkq->mpq", root, root)
    covariance = np.diag((0.3 * unit) ** 2)
    population = Population(np.zeros(v), covariance, np.append([0.03, 0.01, 0.002], 1e-3))
    layout = Layout(owner, np.full(people, count), np.ones(owner.size, dtype=bool))
    model: Any = SimpleNamespace(n_elements=elements, shared=np.zeros(v, dtype=bool))
    chi = np.full(owner.size, 2.0 * count / each)
    equations: Any = SimpleNamespace(chi=chi, information=information, gradient=np.zeros((owner.size, v)))
    zeros = np.zeros((owner.size, v)), np.zeros((people, v))
    blocks = blocks_of(layout, model, equations, *zeros, population, np.zeros(people))
    found = blocks.log_determinants(owner, model, population)

    w = weights_of(owner, layout.counts, chi)
    for i in range(people):
        joint = np.zeros((v + each * elements,) * 2)
        joint[:v, :v] = np.linalg.inv(covariance)
        for j, h in enumerate(w[i] * information[owner == i]):
            own = slice(v + j * elements, v + (j + 1) * elements)
            r = np.diag(population.rho[:elements] ** -2.0)
            joint[own, own] = h[:elements, :elements] + r
            joint[:elements, :elements] += r
            joint[own, :elements] = joint[:elements, own] = -r
            joint[elements, elements] += h[elements, elements]
            joint[own, elements] = joint[elements, own] = h[:elements, elements]
        scale = np.sqrt(np.diag(joint))
        log = np.linalg.slogdet(joint / np.outer(scale, scale))[1] + 2 * np.log(scale).sum()
        log += np.linalg.slogdet(covariance)[1] + each * 2 * np.log(population.rho[:elements]).sum()
        assert found[i] == pytest.approx(log, abs=0.01)
