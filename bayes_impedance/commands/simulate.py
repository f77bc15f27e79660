"""The command ``simulate``: virtual recordings with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json
from bayes_impedance.runtime.input_files import read_json
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    from bayes_impedance.population.simulate import VirtualPopulation

TRUTH_FILE = "truth.json"
SPECTRA, SIGNALS = (71, 401), (8, 30)
"""Default numbers of subjects and frequencies: for spectra the paper's, for signals fewer: they are 200 MB."""


def simulate_dataset(
    out: Path,
    population: Path | None,
    n_subjects: int | None,
    n_repetitions: int,
    n_points: int | None,
    band_hz: tuple[float, float],
    noise: float | None,
    seed: int,
    signals: bool = False,
    overwrite: bool = False,
) -> list[str]:
    """Write recordings of a virtual population, with the true parameters in a separate file.

    Parameters
    ----------
    out : Path
        Folder of the new dataset.
    population : Path or None
        ``summary.json`` of a fit or ``truth.json`` of a simulation that describes the population; None for the virtual
        fingertips.
    n_subjects, n_points : int or None
        None for :data:`SPECTRA` or :data:`SIGNALS`.
    n_repetitions : int
    band_hz : (float, float)
        Lowest and highest frequency.
    noise : float or None
        Relative noise of spectra; None for the population's own.
    seed : int
    signals : bool
        Write signals of a rig for ``import`` instead of a dataset of spectra.
    overwrite : bool
        Replace a dataset that this package did not write.

    Returns
    -------
    list of str
        Lines that say what was written, and the command that follows.

    Raises
    ------
    InputError
        If this cannot be simulated.
    """
    import shlex
    from dataclasses import replace

    import numpy as np

    from bayes_impedance.population.fingertip import FINGERTIP
    from bayes_impedance.population.simulate import simulate_recordings
    from bayes_impedance.recordings.files import METADATA_FILE, RECORDINGS_FILES, SUBJECTS_FILE, write_recordings
    from bayes_impedance.recordings.repetitions import MINIMUM_POINTS

    usual = SIGNALS if signals else SPECTRA
    n_subjects, n_points = n_subjects or usual[0], n_points or usual[1]
    low, high = band_hz
    if not 0 < low < high or n_points < MINIMUM_POINTS:
        raise InputError(
            f"the band is {low} to {high} Hz with {n_points} points: give 0 < low < high and at least "
            f"{MINIMUM_POINTS} points"
        )
    people = FINGERTIP if population is None else _population(population)
    frequency = np.geomspace(low, high, n_points)
    if signals:
        from bayes_impedance.commands.simulate_signals import simulate_signals

        if noise is not None:
            raise InputError("--noise is that of spectra, but signals have the noise of the rig; leave one of them out")
        words = simulate_signals(out, people, n_subjects, n_repetitions, frequency, seed, overwrite)
        return [
            f"signals of {n_subjects} virtual subjects and of known masses in {out}, the truth in {out / TRUTH_FILE}",
            f"to import them: bayes-impedance import {shlex.join(words)} -o DATASET",
        ]
    if noise is not None:
        people = replace(people, noise=noise)
    simulation = simulate_recordings(people, n_subjects, n_repetitions, frequency, seed)
    with output_folder(out, (*RECORDINGS_FILES, SUBJECTS_FILE, METADATA_FILE, TRUTH_FILE), overwrite):
        write_recordings(simulation.recordings, out, significant_digits=6, compress=True)
        write_json(out / TRUTH_FILE, simulation.truth)
    return [f"{n_subjects} virtual subjects in {out}, the truth in {out / TRUTH_FILE}"]


def _population(file: Path) -> VirtualPopulation:
    """The population described by a fit or by an earlier simulation."""
    from bayes_impedance.population.described_population import population_from

    return population_from(read_json(file, "give a summary.json or truth.json"), str(file))
