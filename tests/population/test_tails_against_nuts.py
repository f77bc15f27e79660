"""The posterior of a Student t population equals that of NUTS, which holds a factor for every person explicitly.

Two of 16 people are far from the others in everything, so that the degrees of freedom matter. Allowances are those of
the normal population: 0.15 posterior standard deviations for a mean and 10 % for a spread, plus three standard errors.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("numpyro", reason="needs numpyro, the independent reference: pip install .[oracle]")

from nuts_model import POPULATION, compare, differing, from_fit, run_nuts, virtual_recordings

from bayes_impedance.population.fit import FitSettings, fit_population

pytestmark = pytest.mark.slow


def test_population_and_persons() -> None:
    settings = replace(FitSettings(), distribution="student_t")
    fit = fit_population(virtual_recordings(outlying=2), POPULATION.network, settings=settings, seed=3, workers=1)
    assert not fit.diagnostics.problems
    table = compare(from_fit(fit), run_nuts(fit))
    assert any(c.name == "tail" for c in table)
    assert max(c.nuts.rhat for c in table if not c.name.startswith("person")) < 1.02
    assert not differing(table)
