"""People in another valley are no group: they are searched around the others, and join them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.majority import joined
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
