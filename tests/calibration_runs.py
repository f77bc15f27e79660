"""Spectra that a rig with known errors measures: people, and runs with known loads."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from known_impedance import table

FREQUENCY = np.geomspace(5.0, 5000.0, 60)
PEOPLE = {"A": (1e-3, 2.0, 800.0), "B": (8e-4, 3.0, 1500.0)}
"""Mass, damper and stiffness of each."""
LOADS = {"open": 0.0, "mass=10 g": 0.01, "mass=30 g": 0.03}
"""In kg, by what the command calls them."""


@dataclass(frozen=True)
class Rig:
    """Force sensor of a gain, late by a delay, above a mass on a suspension, and a mount that gives way."""

    gain: float = 1.06
    delay_s: float = 5e-6
    mass_kg: float = 3e-3
    damper: float = 0.2
    stiffness: float = 40.0
    mount: float = 1.5e-7

    @property
    def values(self) -> list[float]:
        return [self.gain, self.delay_s, self.mass_kg, self.damper, self.stiffness, self.mount]

    def measures(self, z: np.ndarray, frequency_hz: np.ndarray = FREQUENCY) -> np.ndarray:
        """Force over velocity as the transducers see them, step by step from the load to the sensors."""
        s = 2j * np.pi * frequency_hz
        behind_mount = z / (1 + s * self.mount * z)
        total = behind_mount + s * self.mass_kg + self.damper + self.stiffness / s
        return np.asarray(self.gain * np.exp(-s * self.delay_s) * total)


def person(name: str, frequency_hz: np.ndarray = FREQUENCY) -> np.ndarray:
    s = 2j * np.pi * frequency_hz
    mass, damper, stiffness = PEOPLE[name]
    return s * mass + damper + stiffness / s


def load(name: str, frequency_hz: np.ndarray = FREQUENCY) -> np.ndarray:
    return 2j * np.pi * frequency_hz * LOADS[name]


def write(file: Path, z: np.ndarray, frequency_hz: np.ndarray = FREQUENCY, noise_sd: np.ndarray | None = None) -> str:
    columns = {"frequency_hz": frequency_hz, "z_re": z.real, "z_im": z.imag}
    file.write_text(table(columns | ({} if noise_sd is None else {"noise_sd": noise_sd})), encoding="utf-8")
    return str(file)


def circular(size: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise whose real and imaginary part have a standard deviation each."""
    return np.asarray(size * (rng.normal(size=size.shape) + 1j * rng.normal(size=size.shape)))


def write_all(folder: Path, rig: Rig, noise: float = 0.0, seed: int = 1) -> tuple[list[str], list[str]]:
    """Files of people, and runs as the command takes them; noise is relative to what is measured."""
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(seed)
    files = {}
    for name, z in {**{n: person(n) for n in PEOPLE}, **{n: load(n) for n in LOADS}}.items():
        h = rig.measures(z)
        sd = noise * np.abs(h)
        file = folder / f"{name.replace('=', '_').replace(' ', '')}.csv"
        files[name] = write(file, h + circular(sd, rng), noise_sd=sd if noise else None)
    return [files[name] for name in PEOPLE], [f"{name}:{files[name]}" for name in LOADS]
