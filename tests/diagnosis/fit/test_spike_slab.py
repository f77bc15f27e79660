"""Spike and slab: the likelihood against quadrature, the maximum against another optimiser, recovery, false alarms."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import TOY, entry, recovered, toy
from scipy.optimize import minimize
from scipy.stats import binom, norm

from bayes_impedance.diagnosis.fit.model import Addition
from bayes_impedance.diagnosis.fit.spike_slab import members, mixture


def people(seed: int, n: int, share: float, mean: float = 1.0, dispersion: float = 0.3, sd: float = 0.15):
    """Linear terms h and curvatures d (N,) of people of whom a share have the coefficient, and who they are."""
    rng = np.random.default_rng(seed)
    has = np.arange(n) < round(share * n)
    d = np.exp(rng.normal(0, 0.3, n)) / sd**2
    c = np.where(has, mean * (1 + dispersion * rng.normal(size=n)), 0.0)
    return d * c + np.sqrt(d) * rng.normal(size=n), d, has


def test_the_gain_is_the_likelihood_ratio_of_the_two_models() -> None:
    """Every person's marginal likelihood by quadrature, maximised without expectation-maximisation."""
    h, d, _ = people(1, 12, 0.5)

    def log_slab(mean: float, tau: float) -> np.ndarray:
        # The trapezoidal rule converges faster than any power for an integrand that has fallen to nothing at the ends.
        centre, sd = (h + mean / tau**2) / (d + tau**-2), 1 / np.sqrt(d + tau**-2)
        c = centre[:, None] + sd[:, None] * np.linspace(-8, 8, 65)
        log_integrand = h[:, None] * c - 0.5 * d[:, None] * c**2 + norm.logpdf(c, mean, tau)
        return np.logaddexp.reduce(log_integrand, axis=1) + np.log(sd * 0.25)

    def some(x: np.ndarray) -> float:
        share = 1 / (1 + np.exp(-x[2]))
        return -float(np.sum(np.logaddexp(np.log(share) + log_slab(x[0], np.exp(x[1])), np.log1p(-share))))

    def all_of_them(x: np.ndarray) -> float:
        return -float(np.sum(log_slab(x[0], np.exp(x[1]))))

    options = {"xatol": 1e-4, "fatol": 1e-6}
    best = minimize(some, [1.0, np.log(0.3), 0.0], method="Nelder-Mead", options=options)
    everybody = minimize(all_of_them, [0.5, np.log(0.5)], method="Nelder-Mead", options=options)
    found = mixture(h, d)
    assert found.gain == pytest.approx(everybody.fun - best.fun, abs=1e-3)
    assert found.mean == pytest.approx(best.x[0], abs=1e-2)
    assert found.dispersion == pytest.approx(np.exp(best.x[1]) / best.x[0], rel=0.03)
    assert found.fraction == pytest.approx(1 / (1 + np.exp(-best.x[2])), abs=0.01)


def test_the_gain_is_over_the_best_slab_where_those_without_are_known_best() -> None:
    """Their weighted mean is a little below zero, where a slab for all people is the best of its neighbourhood."""
    h, d, has = people(2, 60, 0.3, sd=0.02)
    h, d = np.where(has, h, h - 5 * np.sqrt(d)), np.where(has, d, 50 * d)
    found = mixture(h, d)

    def log_slab(mean: float, tau: float) -> np.ndarray:
        return (h**2 * tau**2 + 2 * h * mean - d * mean**2) / (2 * (1 + d * tau**2)) - 0.5 * np.log1p(d * tau**2)

    relative = np.linspace(0.1, 1.5, 15)
    of_all = max(log_slab(mean, r * mean).sum() for mean in np.geomspace(1e-3, 1, 40) for r in relative)
    slab = log_slab(found.mean, found.dispersion * found.mean)
    of_some = np.logaddexp(np.log(found.fraction) + slab, np.log1p(-found.fraction)).sum()
    assert found.only_some
    assert found.gain == pytest.approx(of_some - of_all, abs=1.0)  # it ends at a limit of the dispersion


@pytest.mark.parametrize("sign", [1, -1])
def test_people_with_and_without_are_told_apart(sign: int) -> None:
    covered = []
    for seed in range(8):
        h, d, has = people(seed, 60, 0.4, mean=sign)
        found = mixture(h, d)
        assert found.only_some
        assert np.mean((found.probability > 0.5) == has) > 0.93
        assert found.mean == pytest.approx(sign, abs=4 * found.mean_sd)
        assert found.mean_sd == pytest.approx(np.sqrt((0.3**2 + 0.15**2) / 24), rel=0.4)
        covered.append(found.q05 < 0.4 < found.q95)
    assert sum(covered) >= binom.ppf(1e-3, 8, 0.9)


def test_what_everybody_has_is_not_called_a_matter_of_some() -> None:
    alarms = [mixture(*people(seed, 30, 1.0)[:2]).only_some for seed in range(60)]
    assert sum(alarms) <= binom.isf(1e-3, 60, 0.05)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_matter_of_one_or_two_is_not_called_a_group(count: int) -> None:
    found = [mixture(*people(seed, 30, count / 30, sd=0.05)[:2]) for seed in range(20)]
    assert all(f.gain > 3.0 for f in found) == (count > 0)  # it is their number that forbids it
    assert not any(f.only_some for f in found)


def test_the_unit_of_the_coefficient_does_not_matter() -> None:
    h, d, _ = people(3, 40, 0.5)
    one, other = mixture(h, d), mixture(h / 1e-4, d / 1e-8)
    np.testing.assert_allclose(other.probability, one.probability, atol=1e-6)
    np.testing.assert_allclose([other.gain, other.fraction, other.mean], [one.gain, one.fraction, 1e-4 * one.mean])


def test_the_people_with_a_mass_are_found_in_recordings() -> None:
    """A third of the people carry a mass, and a high-pass that all share stands in the model before it."""
    has = np.arange(18) % 3 == 0

    def hidden(s: np.ndarray, z: np.ndarray, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        mass = 4e-4 * has
        return (z + s * mass[:, None, None]) * s / (s + 0.05), mass

    experiment = toy(*TOY, seed=5, n=18, hidden=hidden)
    alone = recovered(experiment, entry("body.mass"), "port", "varying", 60)
    found = members(alone, 0)
    assert found.only_some
    np.testing.assert_array_equal(found.probability > 0.5, has)
    scale = entry("body.mass").coefficients[0].scale(alone.model.scales)
    assert found.mean * scale == pytest.approx(4e-4, rel=0.05)

    both = experiment.grown(
        Addition(effect=entry("rig.highpass"), place="port", pooling="shared"),
        Addition(effect=entry("body.mass"), place="port", pooling="varying"),
    )
    u = np.insert(alone.u, 2, 0.0, axis=1)[:, np.argsort(_order(both))]
    fit = experiment.refitter.fit(both, u, alone.population, 60)
    np.testing.assert_array_equal(members(fit, 1).probability > 0.5, has)


def _order(model) -> list[int]:
    """Columns of elements, high-pass and mass in the kernel's order."""
    return [0, 1, *(2 + p.addition for p in model.parameters)]
