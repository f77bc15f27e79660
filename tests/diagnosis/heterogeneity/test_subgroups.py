"""Subgroups: false alarms, recovery of members and shift, what is no group."""

from __future__ import annotations

import numpy as np
import pytest
from populations_of_likelihoods import covariance, informations, mostly, observed, population, rarely

from bayes_impedance.diagnosis.heterogeneity.subgroups import find_subgroup


@pytest.mark.long
def test_subgroups_raise_no_false_alarms():
    # Full correlations, persons fourfold different, an element that every other person does not see.
    rng = np.random.default_rng(24)
    p_values = []
    for k in range(40):
        n, t = 15 + k, covariance(3, r=0.8 * (k % 2))
        people = observed(rng, population(rng, n, t), informations(rng, n, 3, 0.15, unseen=k % 2))
        p_values.append(find_subgroup(people, np.full(3, -5.0), t, k, 80).p_corrected)
    assert rarely(int(np.sum(np.array(p_values) < 0.05)), len(p_values), 0.05)
    assert rarely(int(np.sum(np.array(p_values) <= 0.005)), len(p_values), 0.005)


def test_a_group_is_found_with_its_members():
    rng = np.random.default_rng(25)
    t = covariance(4, r=0.3)
    right, count = np.zeros(3, dtype=int), 8
    for k in range(count):
        member = np.arange(71) < 20
        theta = population(rng, 71, t) + np.outer(member, [0, 1.5, 0, 0])  # five standard deviations
        group = find_subgroup(observed(rng, theta, informations(rng, 71, 4, 0.08)), np.full(4, -5.0), t, k, 80)
        assert group.p_corrected < 0.005
        assert np.mean((group.membership > 0.5) == member) > 0.95
        assert group.separation > 4
        right += [
            group.shift_q05[1] < 1.5 < group.shift_q95[1],
            group.share_q05 < 20 / 71 < group.share_q95,
            group.element == "n2",  # not if the other elements differ, too, at the level of 1 %
        ]
    assert np.all([mostly(int(k), count, p) for k, p in zip(right, (0.85, 0.9, 0.97), strict=True)])


def test_a_group_that_differs_in_several_elements_is_found():
    rng = np.random.default_rng(26)
    t, member = covariance(4, r=0.0), np.arange(71) >= 45
    shift = np.array([1.1, -1.1, 1.1, 0.0])  # 3.7 standard deviations each
    people = observed(rng, population(rng, 71, t) + np.outer(member, shift), informations(rng, 71, 4, 0.08))
    group = find_subgroup(people, np.full(4, -5.0), t, 1)
    assert group.p_corrected < 0.005
    assert group.element == ""
    assert np.mean((group.membership > 0.5) == member) > 0.95
    assert np.all(np.abs(group.shift - shift) < 0.3)  # more than three standard errors of 0.09
    assert np.all(group.shift_q05[:3] * group.shift_q95[:3] > 0)


def test_a_known_cause_is_no_group():
    # Two contact forces make two groups, unless the means follow the force.
    rng = np.random.default_rng(27)
    t, means = covariance(2), -5 + np.outer(np.arange(50) % 2, [1.5, 0])
    people = observed(rng, population(rng, 50, t, 0.0) + means, informations(rng, 50, 2))
    assert find_subgroup(people, np.full(2, -5.0), t, 0).p_corrected < 0.005
    assert find_subgroup(people, means, t, 0).p_corrected > 0.05


def test_a_group_cannot_be_found_in_an_element_that_nobody_sees():
    rng = np.random.default_rng(28)
    people = observed(rng, population(rng, 30, covariance(2)), np.zeros((30, 2, 2)))
    group = find_subgroup(people, np.full(2, -5.0), covariance(2), 0)
    assert group.reason == "no element is determined"
    h = informations(rng, 30, 2)
    h[:, 0], h[:, :, 0] = 0, 0
    group = find_subgroup(observed(rng, population(rng, 30, covariance(2)), h), np.full(2, -5.0), covariance(2), 0)
    assert group.tried == 2
    assert group.remarks == ("n1 is not determined by the recordings",)
    assert np.all(np.isfinite(group.membership))
