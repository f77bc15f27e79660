"""Curvature that Gauss-Newton leaves out: exact on quadratics, used where it foretells, and fits that come to rest."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit import second_order
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.normal_equations import Equations
from bayes_impedance.diagnosis.fit.second_order import SecondOrder

OWNER = np.array([0, 0, 1])
"""Two recordings of one person and one of another."""

N, P = 2, 3


class Quadratic:
    """Half of chi-square is u (H + S) u / 2 + g u, and Gauss-Newton knows H only."""

    def __init__(self, seed: int, share: float = 0.5) -> None:
        rng = np.random.default_rng(seed)
        root = rng.normal(size=(OWNER.size, P, P))
        self.h = root @ np.swapaxes(root, 1, 2) + np.eye(P)
        other = rng.normal(size=(OWNER.size, P, P))
        self.s = share * (other + np.swapaxes(other, 1, 2))
        self.g = rng.normal(size=(OWNER.size, P))
        self.rng = rng

    def at(self, u: np.ndarray) -> Equations:
        """Equations at u."""
        force = np.einsum("mpq,mq->mp", self.h + self.s, u)
        return Equations(np.sum(u * (force + 2 * self.g), axis=1), self.g + force, self.h)

    def after_steps(self, steps: int) -> SecondOrder:
        """What so many random steps teach."""
        known, u = SecondOrder.unknown(OWNER.size, P, N), np.zeros((OWNER.size, P))
        for _ in range(steps):
            there = u + self.rng.normal(size=u.shape)
            known = known.after(OWNER, there - u, self.at(u), self.at(there))
            u = there
        return known


def test_a_few_steps_teach_it_exactly() -> None:
    """On a quadratic, the update of rank one is exact in every direction that was gone."""
    truth = Quadratic(1)
    known = truth.after_steps(2 * P)
    np.testing.assert_allclose(known.matrix, truth.s, atol=1e-8)
    assert known.used.all()


def test_nothing_is_learned_where_gauss_newton_is_exact_or_nothing_moved() -> None:
    """Residuals that are linear in the parameters have no second order."""
    truth = Quadratic(2, share=0.0)
    np.testing.assert_allclose(truth.after_steps(5).matrix, 0.0, atol=1e-8)
    here = Quadratic(3).at(np.ones((OWNER.size, P)))
    known = Quadratic(3).after_steps(2)
    still = known.after(OWNER, np.zeros((OWNER.size, P)), here, here)
    np.testing.assert_array_equal(still.matrix, known.matrix)
    np.testing.assert_array_equal(still.used, known.used)


def test_nothing_is_learned_of_a_recording_that_stayed_where_the_model_is_as_good_as_infinite() -> None:
    """Its error is beyond all numbers in units of a curvature that is next to none, and its step is zero."""
    truth = Quadratic(4)
    here, step = truth.at(np.zeros((OWNER.size, P))), truth.rng.normal(size=(OWNER.size, P))
    there = truth.at(step)
    step[2] = 0.0
    there.gradient[2], there.information[2] = 1e300, 0.0
    known = SecondOrder.unknown(OWNER.size, P, N).after(OWNER, step, here, there)
    assert np.isfinite(known.matrix).all()
    assert not known.matrix[2].any()
    assert known.matrix[0].any()


def test_who_was_told_wrong_goes_without() -> None:
    """What was learned elsewhere misleads one person; the other goes on with it."""
    truth, step = Quadratic(4), np.full((OWNER.size, P), 0.3)
    wrong = truth.s.copy()
    wrong[2] += 10 * np.eye(P)
    known = SecondOrder(wrong, np.ones(N, dtype=bool))
    after = known.after(OWNER, step, truth.at(np.zeros_like(step)), truth.at(step))
    np.testing.assert_array_equal(after.used, [True, False])


def test_a_share_of_the_curvature_is_left_in_every_direction() -> None:
    """What is added is compared with eigenvalues; curvatures are of any scale."""
    rng = np.random.default_rng(5)
    root, other = rng.normal(size=(200, 4, 4)), rng.normal(size=(200, 4, 4))
    scale = 10.0 ** rng.uniform(-4, 4, 4)
    units = scale[:, None] * scale
    plain = root @ np.swapaxes(root, 1, 2) + np.eye(4)
    own = 0.6 * (other + np.swapaxes(other, 1, 2))
    inverse = np.linalg.inv(np.linalg.cholesky(plain))
    left = 1 + np.linalg.eigvalsh(inverse @ own @ np.swapaxes(inverse, 1, 2))[:, 0]
    every = np.ones(4, dtype=bool)
    known = SecondOrder(own * units, np.ones(200, dtype=bool))
    more = known.beside(plain * units, np.arange(200), np.ones(200), every)
    taken = np.any(more != 0, axis=(1, 2))
    np.testing.assert_array_equal(taken, left > second_order._FIRM)
    assert 20 < taken.sum() < 180


def test_curvature_stays_positive_definite() -> None:
    """S is added where it leaves something, and is left out of a recording that would have no bound."""
    curvature = np.tile(4.0 * np.eye(2), (3, 1, 1))
    matrix = np.array([np.diag([-1.0, 3.0, 0.0]), np.diag([-5.0, 0.0, 0.0]), np.diag([1.0, 0.0, 0.0])])
    known = SecondOrder(matrix, np.array([True, False]))
    more = known.beside(curvature, OWNER, np.full(3, 2.0), np.array([True, True, False]))
    np.testing.assert_array_equal(more[0], np.diag([-2.0, 6.0]))
    np.testing.assert_array_equal(more[1:], 0.0)


@pytest.mark.parametrize(("name", "mean"), [("body.reflex", -14286.9), ("body.reflex_velocity", -14741.2)])
def test_a_wrong_explanation_comes_to_rest(name: str, mean: float) -> None:
    """A reflex for an echo that is fifty times the noise. Gauss-Newton alone was not at rest after a hundred rounds."""

    def echo(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return z * (1 + 0.5 * np.exp(-6e-3 * s)), np.zeros(len(z))

    experiment = toy("m1|r1|n1", {"m1": 1e-3, "n1": 1e-3, "r1": 2.0}, 3, 16, hidden=echo)
    plain = experiment.fit()
    candidate = Candidate(entry(name), "port", {"latency": 5e-3, "corner": 300.0})
    model = extended(plain.model, candidate, "free", 0.1)
    fit = experiment.refitter.fit(model, *extended_start(plain, model), 40)
    assert fit.settled
    assert fit.evidence.sum() == pytest.approx(mean, abs=1.0)  # of a hundred rounds
