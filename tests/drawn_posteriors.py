"""The posterior of a population with its draws, of a fit that goes no further."""

from __future__ import annotations

import pytest

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population import fit as fitting
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.recordings.files import Recordings


class StopError(Exception):
    """Ends a fit when the posterior has been made."""


def posterior_of(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch, draws: int = 256, **settings: object
) -> Posterior:
    """The posterior with draws, of a fit that goes no further."""
    found = []

    def sampled(posterior, settings, drawing, sampling, executor, clock, progress, checkpoint):
        posterior.draw(drawing, executor, progress)
        found.append(posterior)
        raise StopError

    monkeypatch.setattr(fitting, "sampled", sampled)
    quick = FitSettings(draws=draws, sampler=SamplerSettings(ensembles=2, burn_in=(20, 20)), **settings)
    with pytest.raises(StopError):
        fit_population(recordings, settings=quick, seed=3)
    return found[0]
