"""The command ``simulate --signals``: raw force and acceleration of virtual persons, and of known masses, on a rig."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import replacing
from bayes_impedance.runtime.output_folder import output_folder

if TYPE_CHECKING:
    import numpy as np

    from bayes_impedance.intake.simulated_rig import SimulatedRig
    from bayes_impedance.population.simulate import Simulation, VirtualPopulation

PEOPLE, RUNS = "people", "runs"
"""Folders of the recordings and of the calibration runs."""
TRUTH_FILE, RIG_FILE = "truth.json", "rig_truth.json"
MOST_SAMPLES = 500_000_000
"""Most samples of all files. By choice: twelve bytes each are then 6 GB."""
NAMES_PATTERN = r"(?P<subject>[^_]+)_(?P<repetition>\d+)"


def simulate_signals(
    out: Path,
    people: VirtualPopulation,
    n_subjects: int,
    n_repetitions: int,
    frequency_hz: np.ndarray,
    seed: int,
    overwrite: bool = False,
    rig: SimulatedRig | None = None,
) -> list[str]:
    """Write signals of a virtual population and of the rig's known loads, with the truth.

    Parameters
    ----------
    out : Path
        Folder; recordings go to :data:`PEOPLE`, calibration runs to :data:`RUNS`.
    people : VirtualPopulation
        Its noise is not used: the rig has its own.
    n_subjects, n_repetitions : int
    frequency_hz : ndarray of float, shape (F,)
        Of the steps.
    seed : int
        The same seed gives the same bytes.
    overwrite : bool
    rig : SimulatedRig, optional

    Returns
    -------
    list of str
        Words of the command that imports them, without the name of a dataset.

    Raises
    ------
    InputError
        If there would be too much, or the folder holds other recordings.
    """
    from bayes_impedance.intake.simulated_rig import SimulatedRig

    rig = rig or SimulatedRig()
    if frequency_hz[-1] > rig.rate_hz / 4:
        raise InputError(
            f"the band ends at {frequency_hz[-1]:g} Hz, but the signals are sampled at {rig.rate_hz:g} Hz; end it at a "
            f"quarter of that, {rig.rate_hz / 4:g} Hz"
        )
    total = rig.samples(frequency_hz) * (n_subjects * n_repetitions + 1 + len(rig.masses_kg))
    if total > MOST_SAMPLES:
        raise InputError(
            f"{n_subjects} subjects with {n_repetitions} repetitions of {frequency_hz.size} steps from "
            f"{frequency_hz[0]:g} Hz are {total:.2g} samples, more than {MOST_SAMPLES:.2g}; simulate fewer, or begin "
            "at a higher frequency"
        )
    simulation = without_noise(people, n_subjects, n_repetitions, frequency_hz, seed)
    loads = loads_of(rig)
    names = [
        f"{PEOPLE}/{one.name}_{repetition}.npz"
        for one in simulation.recordings.subjects
        for repetition in one.repetitions
    ]
    runs = [f"{RUNS}/{file}" for file in loads.values()]
    _require_no_others(out, {*names, *runs})
    with output_folder(out, (*names, *runs, TRUTH_FILE, RIG_FILE), overwrite):
        for name, content in zip((*names, *runs), _files(simulation, rig, frequency_hz, seed), strict=True):
            _write(out / name, content)
        _write(out / TRUTH_FILE, _json(simulation.truth))
        _write(out / RIG_FILE, _json(asdict(rig) | {"seed": seed}))
    known = [f"{load}:{out / RUNS / file}" for load, file in loads.items()]
    return [str(out / PEOPLE), "--known-load", *known, *rig.options(), "--subject-from-name", NAMES_PATTERN]


def without_noise(
    people: VirtualPopulation, n_subjects: int, n_repetitions: int, frequency_hz: np.ndarray, seed: int
) -> Simulation:
    """The loads themselves: the same persons as in the signals of this seed."""
    from dataclasses import replace

    from bayes_impedance.population.simulate import simulate_recordings

    return simulate_recordings(replace(people, noise=0.0), n_subjects, n_repetitions, frequency_hz, seed)


def loads_of(rig: SimulatedRig) -> dict[str, str]:
    """Known loads of the runs, as ``import`` is told of them, and their files."""
    return {"open": "open.npz"} | {f"mass={1e3 * m:g} g": f"mass_{1e3 * m:g}g.npz" for m in rig.masses_kg}


def _files(simulation: Simulation, rig: SimulatedRig, frequency_hz: np.ndarray, seed: int) -> Iterator[bytes]:
    """Contents of the files one by one; each has its own random numbers."""
    import numpy as np

    impedances = [z for one in simulation.recordings.subjects for z in one.z]
    impedances += [2j * np.pi * frequency_hz * mass for mass in (0.0, *rig.masses_kg)]
    for z, own in zip(impedances, np.random.SeedSequence(seed).spawn(len(impedances)), strict=True):
        yield rig.file(rig.signals(frequency_hz, z, np.random.default_rng(own)))


def _require_no_others(out: Path, names: set[str]) -> None:
    """Refuse a folder of which an import would read other recordings too."""
    for folder in (PEOPLE, RUNS):
        for file in sorted((out / folder).glob("[!.]*")):
            if f"{folder}/{file.name}" not in names:
                raise InputError(f"{file}: is not of this simulation, but would be imported with it; name a new folder")


def _write(file: Path, content: bytes) -> None:
    with replacing(file) as temporary:
        temporary.write_bytes(content)


def _json(value: dict[str, Any]) -> bytes:
    return (json.dumps(value, indent=2) + "\n").encode()
