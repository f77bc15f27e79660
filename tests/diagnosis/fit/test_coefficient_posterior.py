"""The posterior of an addition's coefficients against closed forms and sums, and its report in units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from experiments import (
    TOY,
    entry,
    toy,
)

import bayes_impedance.diagnosis.fit.coefficient_posterior as coefficients_module
from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.coefficient_posterior import (
    coefficient_posterior,
    reported,
    verdict_on_side,
)
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.normal_equations import (
    Equations,
    Population,
)
from bayes_impedance.diagnosis.fit.refit import Refit

# Posterior of the coefficients


def supplied(monkeypatch: pytest.MonkeyPatch, model: Model, h: np.ndarray, d: np.ndarray, start: np.ndarray) -> Refit:
    """A fit whose quadratic is given."""
    monkeypatch.setattr(coefficients_module, "quadratic", lambda *_: (h, d, None))
    u = np.column_stack([np.zeros((len(h), model.n_elements)), np.broadcast_to(start, (len(h), start.size))])
    m, p = u.shape
    population = Population(np.zeros(p), np.eye(p), np.full(p, 0.1))
    equations = Equations(np.zeros(m), np.zeros((m, p)), np.zeros((m, p, p)))
    return Refit(
        model=model,
        data=(),
        u=u,
        persons=u,
        population=population,
        equations=equations,
        evidence=np.zeros(m),
        settled=True,
    )


def test_posterior_of_shared_coefficients_in_closed_form(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment = toy(*TOY, seed=1, n=1)
    model = experiment.grown(
        Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
        Addition(effect=entry("rig.damping"), place="port", pooling="shared"),
    )
    rng = np.random.default_rng(2)
    root = rng.normal(size=(7, 2, 4))
    d = root @ np.swapaxes(root, 1, 2)
    h = np.einsum("nab,b->na", d, [0.4, -1.3]) + rng.normal(size=(7, 2))
    precision = d.sum(axis=0) + np.diag([p.prior_sd**-2 for p in model.parameters])
    covariance = np.linalg.inv(precision)
    mean = covariance @ h.sum(axis=0)
    posterior = coefficient_posterior(supplied(monkeypatch, model, h, d, np.array([0.4, -1.3])), 1, 20_000)
    np.testing.assert_allclose(posterior.covariance, covariance, rtol=1e-10)
    sd = np.sqrt(np.diag(covariance))
    assert posterior.central.shape == (20_000, 2)
    assert np.all(np.abs(posterior.central.mean(axis=0) - mean) < 4 * sd / np.sqrt(20_000))
    np.testing.assert_allclose(posterior.central.std(axis=0), sd, rtol=4 / np.sqrt(40_000))
    correlation = covariance[0, 1] / sd.prod()
    assert np.corrcoef(posterior.central.T)[0, 1] == pytest.approx(correlation, abs=4 / np.sqrt(20_000))
    assert not posterior.relative_dispersion.any()


def check_summation(monkeypatch: pytest.MonkeyPatch, dispersion: float, seed: int, levels: tuple[float, ...]) -> None:
    """y_i ~ N(mu, 1/d_i + tau^2) with half-normal tau: two dimensions, summed on a fine grid."""
    experiment = toy(*TOY, seed=1, n=1)
    model = experiment.grown(Addition(effect=entry("body.mass"), place="port", pooling="varying"))
    rng, n, draws = np.random.default_rng(seed), 12, 20_000
    d = rng.uniform(4, 30, size=n)
    y = 1.0 + dispersion * rng.normal(size=n) + rng.normal(size=n) / np.sqrt(d)
    fit = supplied(monkeypatch, model, (d * y)[:, None], d[:, None, None], np.array([1.0]))
    posterior = coefficient_posterior(fit, 1, draws)

    mu, tau = np.linspace(-1, 3, 401)[:, None], np.linspace(0, 3, 1501)
    variance = 1 / d[:, None, None] + tau**2
    density = -0.5 * np.sum((y[:, None, None] - mu) ** 2 / variance + np.log(variance), axis=0)
    density += -0.5 * (mu / model.parameters[0].prior_sd) ** 2 - 0.5 * tau**2
    weight = np.exp(density - density.max())
    weight /= weight.sum()
    mean = float(np.sum(weight * mu))
    deviation = mu - mean
    sd = float(np.sqrt(np.sum(weight * deviation**2)))
    kurtosis = float(np.sum(weight * deviation**4)) / sd**4
    assert abs(posterior.central.mean() - mean) < 4 * sd / np.sqrt(draws)
    # The second term is that of a grid of steps of 10 % for tau, by Simpson's rule.
    assert posterior.central.std() == pytest.approx(sd, rel=4 * np.sqrt((kurtosis - 1) / (4 * draws)) + 0.1**2 / 12)
    found = posterior.relative_dispersion[:, 0] * np.abs(posterior.central[:, 0])
    cumulative = np.cumsum(weight.sum(axis=0))
    for level in levels:
        at = float(np.interp(level, cumulative, tau))
        # Drawn from grid points that are 10 % apart, or 0.01 near zero: half a step either way, and 4 sd of the counts.
        low, high = np.mean(found < min(at / 1.05, at - 0.005)), np.mean(found < max(at * 1.05, at + 0.005))
        noise = 4 * np.sqrt(level * (1 - level) / draws)
        assert low - noise < level < high + noise, level


def test_posterior_of_a_varying_coefficient_by_summation(monkeypatch: pytest.MonkeyPatch) -> None:
    check_summation(monkeypatch, 0.8, 3, (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98))


def test_posterior_of_a_coefficient_that_hardly_varies(monkeypatch: pytest.MonkeyPatch) -> None:
    check_summation(monkeypatch, 0.0, 3, (0.05, 0.1, 0.3, 0.5, 0.9))


# As it is reported


def posterior_at(values: list[float], dispersions: list[float]) -> coefficients_module.CoefficientPosterior:
    """Draws that are all the same."""
    return coefficients_module.CoefficientPosterior(
        central=np.tile(values, (10, 1)),
        relative_dispersion=np.tile(dispersions, (10, 1)),
        covariance=np.eye(len(values)),
    )


def report(
    effect: Effect, pooling: str, shape: dict[str, float], x: list[float], dispersion: list[float], place: str = "port"
) -> dict[str, Any]:
    """What is said of an effect whose parameters have the values x in the operation's unit."""
    experiment = toy(*TOY, seed=1, n=1)
    model = build(
        experiment.model.network,
        [Addition(effect=effect, place=place, pooling=pooling)],
        experiment.model.scales,
        [shape],
    )
    u = [c.unbounded(v, model.scales) for c, v in zip(effect.coefficients, x, strict=True)]
    said = reported(model, 0, posterior_at(u, dispersion), np.log([1e-3, 2.0]))
    return {r.name: r for r in said}


def test_frequencies_are_reported_in_hertz() -> None:
    corner = report(entry("rig.highpass"), "shared", {}, [2 * np.pi * 0.3], [0.0])["corner"]
    assert corner.median == pytest.approx(0.3)
    assert (corner.unit, corner.dispersion) == ("Hz", 0.0)
    said = report(entry("rig.lowpass"), "shared", {}, [1e-5], [0.0])
    assert said["time_constant"].median == pytest.approx(1e-5)
    assert said["corner"].median == pytest.approx(1 / (2 * np.pi * 1e-5))


def test_positive_coefficients_are_log_normal_with_the_same_moments() -> None:
    """Median and sd of the logarithm, from mean 3e-5 and sd 1.2e-5; of a signed one the relative dispersion."""
    mass = report(entry("body.mass"), "varying", {}, [3e-5], [0.4])["mass"]
    s2 = np.log(1.16)
    assert mass.median == pytest.approx(3e-5 * np.exp(-s2 / 2))
    assert mass.dispersion == pytest.approx(np.sqrt(s2))
    draws = mass.median * np.exp(mass.dispersion * np.random.default_rng(1).normal(size=400_000))
    assert draws.mean() == pytest.approx(3e-5, rel=4 * 0.4 / np.sqrt(400_000))
    assert draws.std() == pytest.approx(1.2e-5, rel=0.01)
    signed = report(entry("rig.mass"), "varying", {}, [-3e-5], [0.4])["mass"]
    assert signed.median == pytest.approx(-3e-5)
    assert signed.dispersion == pytest.approx(0.4)


def test_what_a_reader_would_have_to_compute() -> None:
    said = report(entry("body.relaxation"), "shared", {"time_constant": 0.01}, [2.0, 0.01], [0.0, 0.0])
    assert said["compliance"].median == pytest.approx(0.005)  # t = r n
    assert said["compliance"].unit == "m/N"
    shape = {"frequency": 100.0, "damping_ratio": 0.1}
    said = report(entry("rig.resonance"), "shared", shape, [1e-3, 100.0, 0.1], [0.0] * 3)
    assert said["frequency"].median == pytest.approx(100 / (2 * np.pi))
    assert said["compliance"].median == pytest.approx(0.1)
    assert said["damping"].median == pytest.approx(0.02)
    shape = {"time_constant": 1e-3}
    said = report(entry("body.subgroup"), "shared", shape, [1e-4, 1e-3], [0.0, 0.0])
    assert said["damping"].median == pytest.approx(10.0)
    said = report(entry("body.bypass"), "shared", {"ratio": 1.0}, [0.5, 300.0], [0.0, 0.0])
    assert said["damping"].median == pytest.approx(0.5)
    assert (said["stiffness"].median, said["stiffness"].unit) == (pytest.approx(300.0), "N/m")
    assert said["compliance"].median == pytest.approx(1 / 300)


def test_power_laws_are_reported_per_second() -> None:
    """c s^(a-1): what stands there is the same as in the operation, which counts s from the middle of the band."""
    s = 2j * np.pi * 37.0
    said = report(entry("body.springpot", "beside_power"), "shared", {"exponent": 0.3}, [4.0, 0.3], [0.0, 0.0])
    middle = toy(*TOY, seed=1, n=1).model.scales.middle
    found = said["coefficient"].median * s ** (said["exponent"].median - 1)
    assert found == pytest.approx(4.0 * (s / middle) ** (0.3 - 1))
    said = report(entry("body.springpot", "power"), "shared", {}, [0.2], [0.0], "n1")
    found = said["coefficient"].median * s ** (said["exponent"].median - 1)
    assert found == pytest.approx((s / middle) ** 0.2 / (s * 1e-3))


def test_side_from_draws_of_the_dispersion() -> None:
    rng = np.random.default_rng(1)
    assert verdict_on_side(np.abs(0.05 * rng.normal(size=2000))) == "rig"
    assert verdict_on_side(0.4 + 0.05 * rng.normal(size=2000)) == "body"
    assert verdict_on_side(np.abs(0.4 * rng.normal(size=2000))) == "undecided"
