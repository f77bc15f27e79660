"""Results of fits as they are read from their folders."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.results import load_result, make_result, predict, save_result
from bayes_impedance.results.result import Result


def read_again(fits: Mapping[str, PopulationFit], folders: pytest.TempPathFactory) -> dict[str, Result]:
    """Each fit's result, saved and loaded."""
    found = {}
    for name, fit in fits.items():
        folder = folders.mktemp(name)
        save_result(make_result(fit, predict(fit, seed=1), {}), folder)
        found[name] = load_result(folder)
    return found
