"""The command ``simulate``: virtual recordings with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json
from bayes_impedance.runtime.input_files import read_json
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    from bayes_impedance.population.simulate import VirtualPopulation

TRUTH_FILE = "truth.json"


def simulate_dataset(
    out: Path,
    population: Path | None,
    n_subjects: int,
    n_repetitions: int,
    n_points: int,
    band_hz: tuple[float, float],
    noise: float | None,
    seed: int,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write recordings of a virtual population as a dataset, with the true parameters in a separate file.

    Parameters
    ----------
    out : Path
        Folder of the new dataset.
    population : Path or None
        ``summary.json`` of a fit or ``truth.json`` of a simulation that describes the population; None for the virtual
        fingertips.
    n_subjects, n_repetitions, n_points : int
    band_hz : (float, float)
        Lowest and highest frequency.
    noise : float or None
        Relative noise; None for the population's own.
    seed : int
    overwrite : bool
        Replace a dataset that this package did not write.

    Returns
    -------
    dict
        The true parameters.
    """
    from dataclasses import replace

    import numpy as np

    from bayes_impedance.population.simulate import FINGERTIP, simulate_recordings
    from bayes_impedance.recordings.files import METADATA_FILE, RECORDINGS_FILES, SUBJECTS_FILE, write_recordings

    low, high = band_hz
    if not 0 < low < high or n_points < 3:
        raise InputError(
            f"the band is {low} to {high} Hz with {n_points} points: give 0 < low < high and at least 3 points"
        )
    people = FINGERTIP if population is None else _population(population)
    if noise is not None:
        people = replace(people, noise=noise)
    simulation = simulate_recordings(people, n_subjects, n_repetitions, np.geomspace(low, high, n_points), seed)
    with output_folder(out, (*RECORDINGS_FILES, SUBJECTS_FILE, METADATA_FILE, TRUTH_FILE), overwrite):
        write_recordings(simulation.recordings, out, significant_digits=6, compress=True)
        write_json(out / TRUTH_FILE, simulation.truth)
    return simulation.truth


def _population(file: Path) -> VirtualPopulation:
    """The population described by a fit or by an earlier simulation."""
    from bayes_impedance.population.simulate import population_from

    return population_from(read_json(file, "give a summary.json or truth.json"), str(file))
