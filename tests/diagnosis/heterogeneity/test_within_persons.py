"""Slopes within persons, over the repetitions and what was noted of them, against known truth and a t test."""

import numpy as np
import pytest
from populations_of_likelihoods import informations, mostly, names, observed, rarely, repetitions
from scipy.stats import ttest_1samp

from bayes_impedance.diagnosis.heterogeneity.gain import gain_within_persons
from bayes_impedance.diagnosis.heterogeneity.within_persons import RepetitionLikelihoods, find_within_persons
from bayes_impedance.errors import InputError


def test_two_perfect_repetitions_are_a_t_test_of_the_difference():
    rng = np.random.default_rng(14)
    data = repetitions(rng, 9, 1, 2, beta=0.03, sd=1e-5)
    deviation = np.array([b[:, 0] / h[:, 0, 0] for b, h in zip(data.linear, data.information, strict=True)])
    difference = np.diff(deviation)[:, 0]
    trend = find_within_persons(data).trends[0]
    np.testing.assert_allclose(trend.estimate, difference.mean(), rtol=1e-3)
    np.testing.assert_allclose(trend.p_value, ttest_1samp(difference, 0).pvalue, rtol=1e-2)


def test_drift_is_recovered_with_missing_repetitions():
    rng = np.random.default_rng(15)
    inside, found = 0, 0
    for _ in range(60):
        trends = find_within_persons(repetitions(rng, 30, 2, 3, beta=0.04, drop=0.2, unseen=1)).trends
        trend = next(t for t in trends if t.element == "n2")
        assert trend.covariate == "repetition"
        inside += trend.q05 < 0.04 < trend.q95
        found += trend.p_corrected < 0.005
    assert mostly(inside, 60, 0.9)
    assert rarely(
        inside, 60, 0.97
    )  # the dispersion of slopes cannot be negative, so intervals are wide where it is zero
    assert mostly(found, 60, 0.6)


@pytest.mark.parametrize("omega", [0.0, 0.1])
def test_drift_raises_no_false_alarms(omega):
    # With own slopes of 0.1 and repetitions that differ by 0.05 a test without them would fail.
    rng = np.random.default_rng(16)
    least = [
        min(
            t.p_corrected for t in find_within_persons(repetitions(rng, 6 + k % 20, 2, 3, omega=omega, drop=0.1)).trends
        )
        for k in range(60)
    ]
    assert rarely(int(np.sum(np.array(least) < 0.05)), len(least), 0.05)
    assert rarely(int(np.sum(np.array(least) <= 0.005)), len(least), 0.005)


def test_drift_of_an_unseen_element_is_not_tested():
    rng = np.random.default_rng(17)
    data = repetitions(rng, 12, 2, 3)
    dark = tuple(h * np.outer([0, 1], [0, 1]) for h in data.information)
    linear = tuple(b * [0, 1] for b in data.linear)
    found = find_within_persons(RepetitionLikelihoods(data.elements, linear, dark, data.order))
    assert [t.element for t in found.trends] == ["n2"]
    assert found.remarks == ("n1 is not determined by the repetitions",)
    once = tuple(x[:1] for x in data.linear), tuple(x[:1] for x in data.information), tuple(x[:1] for x in data.order)
    assert "0 subjects" in find_within_persons(RepetitionLikelihoods(data.elements, *once)).reason


def with_force(rng, n, p, j, slope, *, between=0.0, drift=0.0, rising=False, unknown=0.0, own=0.0):
    """Persons whose first element follows the force of each repetition; the force also differs between persons."""
    parts, forces = [], []
    for _ in range(n):
        force = np.exp(rng.normal(0, 0.3) + (0.2 * np.arange(j) if rising else rng.normal(0, 0.25, j)))
        deviation = rng.normal(0, 0.1, p) + 0.05 * rng.normal(size=(j, p))
        deviation[:, 0] += (slope + own * rng.normal()) * np.log(force) + drift * np.arange(j)
        deviation[:, 1] += between * np.log(force).mean()
        one = observed(rng, deviation, informations(rng, j, p, 0.03))
        force[rng.random(j) < unknown] = np.nan
        parts.append((one.linear, one.information, np.arange(j)))
        forces.append(force)
    linear, information, order = zip(*parts, strict=True)
    return RepetitionLikelihoods(names(p), linear, information, order, {"force_n": tuple(forces)})


def of(trends, variable, element):
    return next(t for t in trends.trends if (t.covariate, t.element) == (variable, element))


def test_an_exponent_of_force_is_recovered_within_persons():
    rng = np.random.default_rng(30)
    inside, found = 0, 0
    for _ in range(40):
        trends = find_within_persons(with_force(rng, 20, 2, 3, 0.35, unknown=0.1))
        trend = of(trends, "force_n", "n1")
        assert trend.transform == "log"
        inside += trend.q05 < 0.35 < trend.q95
        found += trend.p_corrected < 0.005
        assert of(trends, "force_n", "n2").p_corrected > 1e-4
    assert mostly(inside, 40, 0.9)
    assert mostly(found, 40, 0.95)


def test_what_differs_between_persons_only_is_not_a_slope_within_them():
    rng = np.random.default_rng(31)
    least = [
        min(t.p_corrected for t in find_within_persons(with_force(rng, 15, 2, 3, 0.0, between=1.0)).trends)
        for _ in range(40)
    ]
    assert rarely(int(np.sum(np.array(least) < 0.05)), len(least), 0.05)


def test_slopes_that_differ_between_persons_raise_no_false_alarm():
    rng = np.random.default_rng(32)
    least = [
        min(t.p_corrected for t in find_within_persons(with_force(rng, 12, 2, 3, 0.0, own=0.5)).trends)
        for _ in range(40)
    ]
    assert rarely(int(np.sum(np.array(least) < 0.05)), len(least), 0.05)


def test_a_force_that_rises_with_the_repetitions_cannot_be_told_from_a_drift():
    data = with_force(np.random.default_rng(33), 20, 2, 3, 0.35, rising=True)
    trends = find_within_persons(data)
    assert len(trends.beside) == 1
    (other,) = {"repetition", "force_n"} - set(trends.beside)
    assert not [t for t in trends.trends if t.covariate == other]
    if other == "force_n":
        assert any("'force_n'" in remark for remark in trends.remarks)


def test_force_and_drift_are_told_apart():
    trends = find_within_persons(with_force(np.random.default_rng(34), 30, 2, 4, 0.35, drift=0.06))
    assert set(trends.beside) == {"repetition", "force_n"}
    force, drift = of(trends, "force_n", "n1"), of(trends, "repetition", "n1")
    assert force.q05 < 0.35 < force.q95
    assert drift.q05 < 0.06 < drift.q95


def test_force_predicts_people_who_were_held_out():
    rng = np.random.default_rng(35)
    gain, se = gain_within_persons(with_force(rng, 20, 2, 3, 0.35), ["n1"], 1, "force_n")
    assert gain > 2 * se
    assert gain_within_persons(with_force(rng, 20, 2, 3, 0.0), ["n1"], 1, "force_n")[0] < 2.0


def test_values_of_a_circumstance_are_one_for_each_repetition():
    one = (np.zeros((2, 1)),), (np.ones((2, 1, 1)),), (np.array([0, 1]),)
    with pytest.raises(InputError, match="'force_n' has shape"):
        RepetitionLikelihoods(names(1), *one, {"force_n": (np.ones(3),)})
