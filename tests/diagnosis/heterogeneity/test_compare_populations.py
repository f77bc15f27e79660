"""Two populations compared: standard errors in closed form, recovery of a difference, calibration."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import TOY, toy
from scipy.stats import binom, norm

from bayes_impedance.diagnosis.heterogeneity.compare_populations import compare_populations

UNIT = "N s/m"


def test_with_perfect_recordings_errors_are_those_of_a_normal_sample() -> None:
    ours = toy(*TOY, seed=1, n=30, noise=1e-5, rho=1e-6).fit()
    theirs = toy(*TOY, seed=2, n=20, noise=1e-5, rho=1e-6).fit()
    rows = {(r.element, r.what): r for r in compare_populations(theirs, ours, UNIT)}
    assert len(rows) == 4
    for p, element in enumerate(("n1", "r1")):
        ours_tau, theirs_tau = (np.sqrt(f.population.covariance[p, p]) for f in (ours, theirs))
        central = rows[element, "central"]
        sd = np.hypot(ours_tau / np.sqrt(30), theirs_tau / np.sqrt(20))
        assert central.ratio == pytest.approx(np.exp(ours.population.mu[p] - theirs.population.mu[p]))
        assert np.log(central.q95 / central.q05) == pytest.approx(2 * norm.isf(0.05) * sd, rel=1e-2)
        assert (central.recordings, central.simulation) == pytest.approx(
            (np.exp(ours.population.mu[p]), np.exp(theirs.population.mu[p]))
        )
        dispersion = rows[element, "dispersion_between_persons"]
        assert dispersion.unit == ""
        assert dispersion.ratio == pytest.approx(ours_tau / theirs_tau)
        assert np.log(dispersion.q95 / dispersion.q05) == pytest.approx(
            2 * norm.isf(0.05) * np.sqrt(1 / 60 + 1 / 40), rel=1e-2
        )
    assert [rows["n1", "central"].unit, rows["r1", "central"].unit] == ["m/N", "N s/m"]


def test_the_element_that_differs_comes_first_with_its_ratio() -> None:
    claimed = toy(*TOY, seed=3).fit()
    recorded = toy("n1|r1", {"n1": 1e-3, "r1": 3.0}, seed=4).fit()
    found = compare_populations(claimed, recorded, UNIT)
    first = found[0]
    assert (first.element, first.what) == ("r1", "central")
    assert first.p_value < 0.01
    assert first.q05 < 1.5 < first.q95
    assert [r.p_value for r in found] == sorted(r.p_value for r in found)
    assert min(r.p_value for r in found[1:]) > 0.05


def test_a_dispersion_that_differs_is_found() -> None:
    found = compare_populations(toy(*TOY, seed=5, n=40, tau=0.1).fit(), toy(*TOY, seed=6, n=40, tau=0.4).fit(), UNIT)
    changed = {r.element: r for r in found if r.what == "dispersion_between_persons"}
    for row in changed.values():
        assert row.p_value < 0.01
        assert row.q05 < 4 < row.q95


def test_an_element_that_the_band_does_not_see_is_not_compared() -> None:
    # The spring's impedance is a millionth of the damper's, far below noise of one per cent.
    soft = ("n1|r1", {"n1": 1e5, "r1": 2.0})
    found = compare_populations(toy(*soft, seed=7).fit(), toy(*soft, seed=8).fit(), UNIT)
    assert {r.element for r in found if r.what == "central"} == {"r1"}


def test_equal_populations_differ_as_rarely_as_promised() -> None:
    smallest = [
        min(r.p_value for r in compare_populations(toy(*TOY, seed=2 * k).fit(), toy(*TOY, seed=2 * k + 1).fit(), UNIT))
        for k in range(50, 74)
    ]
    assert np.sum(np.array(smallest) < 0.05) <= binom.isf(1e-3, len(smallest), 0.05)
