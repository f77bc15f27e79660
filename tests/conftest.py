"""Fixtures that several files share: one small virtual population and its fit."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.simulate import Simulation, VirtualPopulation, simulate_recordings

SMALL = VirtualPopulation(
    network="skin:(n3|r3)-tissue:(m2|r1|n1)",
    central={"n3": 8e-6, "r3": 61.4, "m2": 7.9e-4, "r1": 5.0, "n1": 1.15e-3},
    between_persons={"n3": 0.3, "r3": 0.3, "m2": 0.2, "r1": 0.3, "n1": 0.3},
    between_repetitions={"n3": 0.05, "r3": 0.05, "m2": 0.03, "r1": 0.06, "n1": 0.04},
    correlation={("n3", "r3"): -0.5, ("r1", "n1"): -0.4},
)

THREE_ELEMENTS = VirtualPopulation(
    network="m1|r1|n1",
    central={"m1": 1e-4, "r1": 3.0, "n1": 1e-3},
    between_persons={"m1": 0.2, "r1": 0.3, "n1": 0.2},
    between_repetitions={"m1": 0.05, "r1": 0.05, "n1": 0.05},
)
"""For what does not depend on the network, in a second."""

SHORT = FitSettings(
    draws=128,
    sampler=SamplerSettings(ensembles=2, burn_in=(30, 40, 60), chunk=60, longest=600, effective=400.0, rhat=1.02),
)
"""Enough for a small population in a few seconds."""

DATA = Path(__file__).parents[1] / "data"


def published(name: str, sign: int = -1) -> TransferFunction:
    """A function of appendix A, ``sit`` or ``vf_median``, without imaginary dirt; sign 1 is as printed."""
    entry = tomllib.loads((DATA / "appendix_a" / "coefficients.toml").read_text(encoding="utf-8"))[name]
    return TransferFunction.from_coefficients([sign * c for c in entry["numerator"]], entry["denominator"])


@pytest.fixture(scope="session")
def small_simulation() -> Simulation:
    """Fifteen people, three repetitions, 40 frequencies, five elements."""
    return simulate_recordings(SMALL, 15, 3, np.geomspace(5, 5000, 40), seed=5)


@pytest.fixture(scope="session")
def small_fit(small_simulation: Simulation) -> PopulationFit:
    """Their fit."""
    return fit_population(small_simulation.recordings, settings=SHORT, seed=3)


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of real recordings, which are not part of the repository."""
    folder = os.environ.get("BAYES_IMPEDANCE_REAL_DATA", "")
    if not folder:
        pytest.skip("BAYES_IMPEDANCE_REAL_DATA is not set: no real recordings here")
    return Path(folder)


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with a dataset, ``data``, and its finished fit, ``out``."""
    from tiny_fits import fit_arguments, tiny_dataset

    from bayes_impedance.commands.cli import main

    folder = tmp_path_factory.mktemp("tiny")
    assert main(fit_arguments(tiny_dataset(folder / "data"), folder / "out")) == 0
    return folder
