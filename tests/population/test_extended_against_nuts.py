"""Power laws, delays and parameters that are the same for everybody: the posterior equals that of NUTS.

`extended_nuts_model.py` shares the data and the estimated noise with the package, nothing else: impedances and priors
are its own. Allowed are 0.15 posterior standard deviations for a mean and 10 % for a spread, plus three standard
errors of the two samplers.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("numpyro", reason="needs numpyro, the independent reference: pip install .[oracle]")

from extended_nuts_model import CASES, Case, from_fit, prior_of, recordings_of, run_nuts
from nuts_model import Comparison, compare, differing

from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population

pytestmark = pytest.mark.slow

FEWEST = 700
"""Effective draws of both samplers, so that the errors stay below the allowances."""


def compared(case: Case, warmup: int = 600, draws: int = 1500) -> tuple[PopulationFit, list[Comparison]]:
    """Fit with default settings, and NUTS; both have arrived."""
    settings = FitSettings(covariance="full" if case.correlated else "diagonal")
    fit = fit_population(recordings_of(case), case.network, settings=settings, seed=3, workers=1)
    assert not fit.diagnostics.problems
    nuts = run_nuts(case, fit, warmup, draws)
    assert nuts.divergences == 0
    table = compare(from_fit(case, fit), nuts)
    assert max(c.nuts.rhat for c in table) < 1.01
    assert min(min(c.nuts.effective, c.ours.effective) for c in table) >= FEWEST
    return fit, table


def require_equal(fit: PopulationFit, case: Case, table: list[Comparison]) -> None:
    """Every number of the population and of every person."""
    for name, (centre, sd) in prior_of(case, fit.recordings).items():
        p = fit.kernel.elements.index(name)
        assert fit.prior.centre[p] == pytest.approx(centre, abs=1e-9 * sd)
        assert fit.prior.centre_sds[p] == pytest.approx(sd, rel=1e-9)
    assert not differing(table)
    assert {f"shared {name}" for name in case.shared} <= {c.name for c in table}


@pytest.mark.parametrize("name", CASES)
def test_equals_nuts(name: str) -> None:
    """Twenty people."""
    fit, table = compared(CASES[name])
    require_equal(fit, CASES[name], table)


@pytest.mark.ci
def test_few_people_equal_nuts() -> None:
    """A shared exponent, ten people and thirty frequencies: less than a minute."""
    case = replace(CASES["shared exponent"], persons=10, frequencies=30, noise=0.05)
    fit, table = compared(case, 400, 1000)
    require_equal(fit, case, table)
