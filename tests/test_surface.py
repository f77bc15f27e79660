"""Posterior of the body's additions from everybody's evidence, where the quadratic expansion says the wrong thing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from test_refit import DISPERSION, MASS, TOY, Serial, concealing, entry, recovered, toy, with_mass

from bayes_impedance.mismatch import surface
from bayes_impedance.mismatch.coefficients import CoefficientPosterior, coefficient_posterior, reported
from bayes_impedance.mismatch.confirm import extended_start
from bayes_impedance.mismatch.model import Addition, build
from bayes_impedance.mismatch.refit import Refit, Refitter
from bayes_impedance.mismatch.surface import FEWEST, from_evidence
from bayes_impedance.mismatch.surrogate import Explored, explored


def both(fit: Refit, seed: int = 1) -> tuple[CoefficientPosterior, CoefficientPosterior]:
    """The posterior from the expansion, and from the evidence."""
    quadratic = coefficient_posterior(fit, seed)
    return quadratic, from_evidence(Refitter(fit.data, Serial()), fit, quadratic, seed)


def test_masses_of_people_are_covered_as_the_closed_form_covers_them() -> None:
    """Coefficients that the recordings determine well: the expansion is right, and the evidence says the same."""
    covered = 0
    for seed in range(10):
        experiment = toy(*TOY, seed=seed, n=30, hidden=with_mass(DISPERSION))
        fit = recovered(experiment, entry("body.mass"), "port", "varying")
        quadratic, evidence = both(fit, seed)
        assert evidence is not quadratic
        one, other = (reported(fit.model, 0, p, fit.population.mu[:2])[0] for p in (quadratic, evidence))
        sd = (one.q95 - one.q05) / 3.29
        # Medians under a normal and under a log-normal expansion differ by a part of the dispersion's error.
        assert abs(other.median - one.median) < 0.7 * sd
        assert 0.7 < (other.q95 - other.q05) / (one.q95 - one.q05) < 1.4
        assert other.dispersion_q05 < DISPERSION < 1.3 * other.dispersion_q95  # type: ignore[operator]
        covered += bool(other.q05 < MASS < other.q95)
    assert covered >= binom.ppf(0.001, 10, 0.9)


def test_relaxing_skin_is_not_said_to_be_known_better_than_it_is() -> None:
    """Another stiffness imitates one half of it: the expansion is up to four standard deviations off here."""
    z: list[float] = []
    for seed in (1, 2, 3, 4):
        experiment = concealing("body.relaxation", "skin", 0.3, seed, n=24, repetitions=2, points=61)
        true, alone = experiment.case.values, experiment.fit()
        seconds = true["damping"] * true["compliance"]
        addition = Addition(entry("body.relaxation"), "skin", "shared")
        model = build(alone.model.network, [addition], alone.model.scales, [{"time_constant": seconds}])
        fit = experiment.refitter.fit(model, *extended_start(alone, model), rounds=60)
        _, evidence = both(fit, seed)
        damping, time, *_ = reported(fit.model, 0, evidence, fit.population.mu[:8])
        for row, value in ((damping, true["damping"]), (time, seconds)):
            z.append((np.log(row.median) - np.log(value)) / (np.log(row.q95 / row.q05) / 3.29))
    assert np.all(np.abs(z) < 3.5)
    assert np.sum(np.abs(z) < 1.645) >= binom.ppf(0.001, len(z), 0.9)


@pytest.mark.parametrize(("name", "n", "pooling"), [("body.mass", FEWEST - 1, "varying"), ("rig.mass", 16, "shared")])
def test_too_few_people_and_the_rig_keep_their_expansion(name: str, n: int, pooling: str) -> None:
    fit = recovered(toy(*TOY, seed=1, n=n, hidden=with_mass(DISPERSION)), entry(name), "port", pooling)
    quadratic, evidence = both(fit)
    assert evidence is quadratic


def test_the_same_seed_gives_the_same_draws() -> None:
    fit = recovered(toy(*TOY, seed=1, n=16, hidden=with_mass(DISPERSION)), entry("body.mass"), "port", "varying")
    (_, one), (_, again), (_, other) = both(fit, 1), both(fit, 1), both(fit, 2)
    np.testing.assert_array_equal(one.central, again.central)
    assert not np.array_equal(one.central, other.central)


def test_it_is_said_whether_the_exploration_came_to_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    fit = recovered(toy(*TOY, seed=1, n=16, hidden=with_mass(DISPERSION)), entry("body.mass"), "port", "varying")
    assert both(fit)[1].settled

    def endless(*arguments: object) -> Explored:
        return replace(explored(*arguments), rests=False)  # type: ignore[arg-type]

    monkeypatch.setattr(surface, "explored", endless)
    assert not both(fit)[1].settled
