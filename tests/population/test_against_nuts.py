"""The population's posterior equals that of NUTS on the full joint posterior, in which nothing is integrated out.

`nuts_model.py` shares only the data, the noise and the prior's centre with the package. Allowed are 0.15
posterior standard deviations for a mean and 10 % for a spread, plus three standard errors of the two samplers.
"""

from __future__ import annotations

import pytest

pytest.importorskip("numpyro", reason="needs numpyro, the independent reference: pip install .[oracle]")

from nuts_model import (
    POPULATION,
    Comparison,
    Samples,
    compare,
    differing,
    from_fit,
    run_nuts,
    virtual_recordings,
)

from bayes_impedance.population.fit import PopulationFit, fit_population

pytestmark = [pytest.mark.slow, pytest.mark.ci]


@pytest.fixture(scope="module")
def fit() -> PopulationFit:
    """The package's fit with its default settings."""
    return fit_population(virtual_recordings(), POPULATION.network, seed=3, workers=1)


@pytest.fixture(scope="module")
def nuts(fit: PopulationFit) -> Samples:
    """The reference; the fit gives it starts and coordinates, and so speed, nothing else."""
    return run_nuts(fit)


def of_population(fit: PopulationFit, nuts: Samples) -> list[Comparison]:
    """Centres, dispersions and correlations."""
    return [c for c in compare(from_fit(fit), nuts) if not c.name.startswith("person")]


def test_both_samplers_converged(fit: PopulationFit, nuts: Samples) -> None:
    """A comparison with a chain that has not arrived would prove nothing."""
    assert not fit.diagnostics.problems
    assert nuts.divergences == 0
    table = of_population(fit, nuts)
    assert max(c.nuts.rhat for c in table) < 1.01
    assert min(c.nuts.effective for c in table) >= 1000
    assert min(c.ours.effective for c in table) >= 1000


def test_some_elements_are_weakly_determined(fit: PopulationFit) -> None:
    """The case is a hard one: a person's own posterior is about as wide as the spread between persons."""
    own = fit.person_draws.std(axis=(0, 1)).mean(axis=0)
    ratio = own / fit.parameters.between_persons.mean(axis=0)
    assert ratio.max() > 0.4
    assert (ratio > 0.2).sum() >= 2


def test_population_posterior(fit: PopulationFit, nuts: Samples) -> None:
    """Centres, dispersions between persons and between repetitions, correlations."""
    assert not differing(of_population(fit, nuts))


def test_posterior_of_every_person(fit: PopulationFit, nuts: Samples) -> None:
    """Everybody's log elements, mean over the repetitions."""
    table = [c for c in compare(from_fit(fit), nuts) if c.name.startswith("person")]
    assert not differing(table)
