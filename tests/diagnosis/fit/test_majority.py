"""People in another valley are no group: they are searched around the others, and join them."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from bayes_impedance.diagnosis.fit import baseline
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.majority import gathered, joined
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings


def test_people_whose_sharp_resonance_was_missed_join_the_others_and_who_differs_does_not() -> None:
    names = ["r1", "n2", "m1", "n1"]
    population = VirtualPopulation(
        network="r1|n2|(m1-n1)",
        central={"r1": 0.8, "n2": 8e-4, "m1": 0.02, "n1": 1e-4},
        between_persons=dict.fromkeys(names, 0.2),
        between_repetitions={"n2": 0.01},
    )
    made = simulate_recordings(population, 14, 1, np.geomspace(5, 1000, 120), 3)
    with ThreadPoolExecutor(1) as executor:
        fitted = fit_network(made.recordings, "r1|n2|(m1-n1)", 1, executor, lambda *_: None)
        fit, refitter = fitted.fit, fitted.refitter
        group = np.arange(14) < 3
        u = fit.u.copy()
        u[np.ix_(group[fit.owner], [fit.model.kernel.elements.index("n1")])] -= 0.6
        wrong = refitter.fit(fit.model, u, fit.population)
        assert wrong.evidence[group].sum() < fit.evidence[group].sum() - 300
        found = joined(refitter, wrong, group)
        # Who is where he belongs stays there, whatever group he is said to be of.
        stayed = joined(refitter, fit, group)
    np.testing.assert_allclose(found.u[group[fit.owner]], fit.u[group[fit.owner]], atol=0.02)
    np.testing.assert_allclose(stayed.u, fit.u, atol=1e-3)


EXCHANGEABLE = "r1|(m1-n1)|((m2|n3)-m3)"
"""Either branch can have either resonance."""


def exchanged(elements: Sequence[str], u: np.ndarray) -> np.ndarray:
    r"""Log elements (M, P) of the same impedance with the resonances of both branches exchanged.

    In :math:`z = r_1 + sc + s k_1/(s^2 + \omega_1^2) + s k_2/(s^2 + \omega_2^2)` the first branch has
    :math:`k_1 = 1/n_1`, :math:`\omega_1^2 = 1/(m_1n_1)`, and the second :math:`\omega_2^2 = 1/((m_2 + m_3)n_3)`,
    :math:`c = m_2m_3/(m_2 + m_3)` and :math:`c + k_2/\omega_2^2 = m_3`.
    """
    at = {name: np.exp(u[:, k]) for k, name in enumerate(elements)}
    c = at["m2"] * at["m3"] / (at["m2"] + at["m3"])
    first, second = 1 / (at["m1"] * at["n1"]), 1 / ((at["m2"] + at["m3"]) * at["n3"])
    own = {"r1": at["r1"], "m1": at["m3"] - c, "m3": c + at["m1"]}
    own |= {"n1": 1 / (second * own["m1"]), "m2": c * own["m3"] / at["m1"]}
    own["n3"] = 1 / ((own["m2"] + own["m3"]) * first)
    return np.stack([np.log(own[name]) for name in elements], axis=1)


def test_people_with_exchanged_resonances_are_gathered_with_all_their_repetitions() -> None:
    names = ["r1", "m1", "n1", "m2", "n3", "m3"]
    population = VirtualPopulation(
        network=EXCHANGEABLE,
        central={"r1": 0.5, "m1": 5e-3, "n1": 1e-3, "m2": 0.01, "n3": 0.14, "m3": 0.09},
        between_persons=dict.fromkeys(names, 0.25),
        between_repetitions=dict.fromkeys(names, 0.02),
    )
    frequency = np.geomspace(0.5, 300, 200)
    made = simulate_recordings(population, 16, 3, frequency, 3)
    with ThreadPoolExecutor(2) as executor:
        fitted = fit_network(made.recordings, EXCHANGEABLE, 1, executor, lambda *_: None)
        fit, refitter, kernel = fitted.fit, fitted.refitter, fitted.fit.model.kernel
        rows = fit.owner % 4 == 0
        u = fit.u.copy()
        u[rows] = exchanged(kernel.elements, u[rows])
        np.testing.assert_allclose(kernel.impedance(u, frequency), kernel.impedance(fit.u, frequency), rtol=1e-6)
        wrong = refitter.fit(fit.model, u, fit.population)
        found = gathered(refitter, wrong)
        assert gathered(refitter, fit) is fit
    assert wrong.evidence.sum() < fit.evidence.sum() - 50
    assert np.sqrt(np.diag(wrong.population.covariance)).max() > 0.8
    np.testing.assert_allclose(found.u, fit.u, atol=0.01)
    assert found.evidence.sum() > fit.evidence.sum() - 0.5


def test_the_first_fit_of_a_network_has_its_people_gathered(monkeypatch: pytest.MonkeyPatch) -> None:
    begun, seen = [], []

    def remembered(refitter: Refitter, fit: Refit) -> Refit:
        begun.append(fit)
        seen.append(gathered(refitter, fit))
        return seen[-1]

    monkeypatch.setattr(baseline, "gathered", remembered)
    population = VirtualPopulation(
        network="m1|r1|n1",
        central={"m1": 5e-3, "r1": 0.5, "n1": 1e-3},
        between_persons=dict.fromkeys(["m1", "r1", "n1"], 0.25),
        between_repetitions=dict.fromkeys(["m1", "r1", "n1"], 0.02),
    )
    made = simulate_recordings(population, 6, 2, np.geomspace(0.5, 300, 60), 3)
    with ThreadPoolExecutor(2) as executor:
        assert fit_network(made.recordings, population.network, 1, executor, lambda *_: None).fit is seen[0]
    assert begun[0].settled
