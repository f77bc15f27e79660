"""Recordings on the wrong side of a frequency are found, also beside an addition that all recordings share."""

from __future__ import annotations

import numpy as np
import pytest
from experiments import Experiment, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.recordings_alone import recordings_alone
from bayes_impedance.diagnosis.fit.refit import Refit

ABSORBER = ("r1|n2|(m1-n1)", {"r1": 0.8, "n2": 8e-4, "m1": 0.02, "n1": 1e-4})
"""Nothing damps m1 and n1."""

MASS, STUCK = 4e-4, 5


@pytest.fixture(scope="module")
def absorber() -> Experiment:
    return toy(
        *ABSORBER, seed=2, n=10, rho=0.02, frequency_hz=np.geomspace(5, 1000, 120),
        hidden=lambda s, z, _: (z + MASS * s, np.zeros(10)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def good(absorber: Experiment) -> Refit:
    fit = absorber.fit()
    model = extended(fit.model, Candidate(entry("rig.mass"), "port", {}), "shared", 0.0)
    return absorber.refitter.fit(model, *extended_start(fit, model), 100)


def stuck(absorber: Experiment, good: Refit) -> Refit:
    """The fit in which one recording's resonance is two gaps of the grid too high."""
    u = good.u.copy()
    u[STUCK, good.model.kernel.elements.index("n1")] -= 4 * np.log(200) / 119
    return absorber.refitter.fit(good.model, u, good.population, 30, hold_population=True, hold_additions=True)


def test_a_recording_beside_an_addition_comes_back(absorber: Experiment, good: Refit) -> None:
    wrong = stuck(absorber, good)
    assert wrong.evidence.sum() < good.evidence.sum() - 50
    again = recordings_alone(absorber.refitter, wrong)
    assert again.evidence.sum() == pytest.approx(good.evidence.sum(), abs=1.0)
    np.testing.assert_allclose(again.u[STUCK], good.u[STUCK], atol=0.05)
    shared = good.model.shared
    assert np.ptp(again.u[:, shared], axis=0) == pytest.approx(0.0)


@pytest.mark.parametrize("repetitions", [1, 2])
@pytest.mark.parametrize("added", [False, True])
def test_all_recordings_of_a_person_come_back_from_wrong_gaps(repetitions: int, added: bool) -> None:
    even = toy(*ABSORBER, seed=3, n=10, repetitions=repetitions, rho=0.02, frequency_hz=np.linspace(5, 1000, 150))
    right = even.fit()
    if added:
        model = extended(right.model, Candidate(entry("rig.mass"), "port", {}), "shared", 0.0)
        right = even.refitter.fit(model, *extended_start(right, model), 100)
    u = right.u.copy()
    u[right.owner == STUCK, right.model.kernel.elements.index("n1")] += 0.15
    wrong = even.refitter.fit(right.model, u, right.population, 30, hold_population=True, hold_additions=True)
    assert wrong.evidence.sum() < right.evidence.sum() - 20
    again = recordings_alone(even.refitter, wrong)
    assert again.evidence.sum() == pytest.approx(right.evidence.sum(), abs=1.0)


def test_nothing_changes_where_all_are_right(absorber: Experiment, good: Refit) -> None:
    assert recordings_alone(absorber.refitter, good).evidence.sum() >= good.evidence.sum() - 0.1


def test_people_who_were_recorded_once_have_no_other_recordings() -> None:
    once = toy(*ABSORBER, seed=2, n=6, repetitions=1, frequency_hz=np.geomspace(5, 1000, 120))
    fit = once.fit()
    assert recordings_alone(once.refitter, fit) is fit
