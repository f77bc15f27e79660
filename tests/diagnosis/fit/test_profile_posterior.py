"""The posterior of an addition from profile evidence, in cases where the quadratic expansion is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import DISPERSION, MASS, TOY, Serial, concealing, entry, recovered, toy, with_mass
from scipy.stats import binom

from bayes_impedance.diagnosis.fit import profile_posterior
from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior, coefficient_posterior, reported
from bayes_impedance.diagnosis.fit.extend import extended_start
from bayes_impedance.diagnosis.fit.fitter import Refitter, _with_dispersions
from bayes_impedance.diagnosis.fit.interpolated_density import Explored, explored
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.profile_posterior import MINIMUM_PERSONS, from_evidence
from bayes_impedance.diagnosis.fit.refit import Refit


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
        addition = Addition(effect=entry("body.relaxation"), place="skin", pooling="shared")
        model = build(alone.model.network, [addition], alone.model.scales, [{"time_constant": seconds}])
        fit = experiment.refitter.fit(model, *extended_start(alone, model), rounds=60)
        _, evidence = both(fit, seed)
        damping, time, *_ = reported(fit.model, 0, evidence, fit.population.mu[:8])
        for row, value in ((damping, true["damping"]), (time, seconds)):
            z.append((np.log(row.median) - np.log(value)) / (np.log(row.q95 / row.q05) / 3.29))
    assert np.all(np.abs(z) < 3.5)
    assert np.sum(np.abs(z) < 1.645) >= binom.ppf(0.001, len(z), 0.9)


@pytest.mark.parametrize(
    ("name", "n", "pooling"), [("body.mass", MINIMUM_PERSONS - 1, "varying"), ("rig.mass", 16, "shared")]
)
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

    monkeypatch.setattr(profile_posterior, "explored", endless)
    assert not both(fit)[1].settled


@pytest.mark.parametrize("correlation", [-0.8, 0.0, 0.8])
def test_coefficient_and_shape_that_go_together_are_weighed_so(correlation: float) -> None:
    """People with a Maxwell element beside a spring and a damper; who has much of it relaxes slowly, or fast."""
    damping, seconds, spread = 1.0, 1 / (2 * np.pi * 60), 0.3
    factor = np.linalg.cholesky([[1.0, correlation], [correlation, 1.0]])
    found: list[float] = []
    z: list[float] = []
    for seed in range(4):

        def hidden(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
            own = spread * rng.normal(size=(len(z), 2)) @ factor.T
            d, t = (x * np.exp(o)[:, None, None] for x, o in zip((damping, seconds), own.T, strict=True))
            return z + d / (1 + s * t), d.ravel()

        experiment = toy(*TOY, seed=seed, n=24, hidden=hidden)
        alone = experiment.fit()
        addition = Addition(effect=entry("body.relaxation"), place="port", pooling="free")
        model = build(alone.model.network, [addition], alone.model.scales, [{"time_constant": seconds}])
        fit = experiment.refitter.fit(model, *extended_start(alone, model), rounds=60)
        of = profile_posterior._Surface.of(experiment.refitter, fit)
        assert of is not None
        _, weights, _ = of.with_covariances(of.base_values())
        assert [w.correlates for w in of.weighed] == [False, False, True]
        found.append(float(np.sum(weights[-1] * of.weighed[-1].grid)))
        _, evidence = both(fit, seed)
        rows = reported(fit.model, 0, evidence, fit.population.mu[:2])
        for row, value in zip(rows[:2], (damping, seconds), strict=True):
            z.append((np.log(row.median) - np.log(value)) / (np.log(row.q95 / row.q05) / 3.29))
    assert np.mean(found) == pytest.approx(correlation, abs=0.3)
    assert np.all(np.abs(z) < 3.5)
    assert np.sum(np.abs(z) < 1.645) >= binom.ppf(0.001, len(z), 0.9)


def test_a_correlation_is_part_of_the_populations_covariance() -> None:
    fit = recovered(toy(*TOY, seed=1, n=16, hidden=with_mass(DISPERSION)), entry("body.mass"), "port", "varying")
    addition = Addition(
        effect=entry("body.relaxation"),
        place="port",
        pooling="free",
        dispersion=0.2,
        shape_dispersions=(0.1,),
        correlation=0.6,
    )
    free, varying = (
        build(fit.model.network, [replace(addition, pooling=p)], fit.model.scales, [{"time_constant": 1e-3}])
        for p in ("free", "varying")
    )
    for sign in (1.0, -1.0):  # a coefficient may be negative; its dispersion is relative to its size
        covariance = _with_dispersions(free, 0.04 * np.eye(4), np.r_[fit.population.mu[:2], sign * 2.0, 0.0])
        among = [[0.4**2, sign * 0.6 * 0.4 * 0.1], [sign * 0.6 * 0.4 * 0.1, 0.1**2]]
        np.testing.assert_allclose(covariance[2:, 2:], among)
        assert not covariance[:2, 2:].any()
    alone = _with_dispersions(varying, 0.04 * np.eye(3), np.r_[fit.population.mu[:2], 2.0])  # no shape to go with
    np.testing.assert_allclose(alone, np.diag([0.04, 0.04, 0.4**2]))
