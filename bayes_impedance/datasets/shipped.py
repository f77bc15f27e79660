"""Datasets of the package, by name.

In the repository they are the folder ``data``; a wheel carries the same files beside this module. The population of the
virtual fingertips is a finished fit of ``data/fingertip_71`` with default options: 1000 of its draws, without what only
pictures need, made by ``analyses/fingertip_71/population.py``. A designer draws users from it without a fit::

    from bayes_impedance.datasets import fingertip_population

    users = fingertip_population().draw(1000, seed=1)

These fingertips are simulated, not measured: they show what a result looks like, and are no substitute for recordings.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.errors import InputError

if TYPE_CHECKING:
    from bayes_impedance.design.users import UserPopulation
    from bayes_impedance.recordings.dataset import Recordings
    from bayes_impedance.results.result import Result

SHIPPED = ("fingertip_71", "appendix_a")
"""Names of the shipped datasets."""

POPULATION = "population"
"""Folder of a shipped dataset that holds its finished fit."""


def folder_of(name: str) -> Path:
    """Folder of a shipped dataset.

    Parameters
    ----------
    name : str
        From :data:`SHIPPED`.

    Raises
    ------
    InputError
        If there is no such dataset, or its files are missing.
    """
    if name not in SHIPPED:
        raise InputError(f"'{name}' is not a dataset of the package: choose {', '.join(SHIPPED)}")
    here = Path(__file__).resolve()
    for data in (here.with_name("data"), here.parents[2] / "data"):
        if (data / name / "dataset.toml").is_file():
            return data / name
    raise InputError(f"the files of '{name}' are missing from this installation: install the package again")


def fingertip_folder() -> Path:
    """Folder of the recordings of 71 virtual fingertips, with their truth."""
    return folder_of("fingertip_71")


def fingertip_recordings() -> Recordings:
    """Recordings of 71 virtual fingertips: three repetitions, 401 frequencies from 5 Hz to 5 kHz."""
    from bayes_impedance.recordings.files import read_recordings

    return read_recordings(fingertip_folder())


def fingertip_result() -> Result:
    """The finished fit of these recordings: its summary, and 1000 draws of the population's parameters.

    It has no predictive bands, persons or residuals, which pictures and reports need: fit the recordings for those.
    """
    from bayes_impedance.results.result import load_result

    return load_result(fingertip_folder() / POPULATION)


def fingertip_population() -> UserPopulation:
    """The population of these fingertips, from which virtual users are drawn."""
    from bayes_impedance.design.users import population_of

    return population_of(fingertip_result())


def published_curves() -> Recordings:
    """The two curves that the paper publishes in its appendix A; they are fitted curves without noise."""
    from bayes_impedance.recordings.files import read_recordings

    return read_recordings(folder_of("appendix_a"))
