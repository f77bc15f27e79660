"""Point estimates by R's nlme (nonlinear mixed effects) on the recordings of the population benchmark.

nlme maximises a restricted likelihood of the linearised model. It has one noise scale for all people where ours has one
for each, no priors, and elements that vary independently of each other. So the two estimates are close, not equal.
Nothing is compared where R or its package is not installed.
"""

from __future__ import annotations

import csv
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.population.fit import PopulationFit

SCRIPT = Path(__file__).with_name("nlme.R")
_LONGEST = 900.0
"""Seconds after which nlme is stopped."""


def compare_with_nlme(fit: PopulationFit) -> dict[str, Any] | None:
    """How far nlme's estimates are from ours in our posterior's standard deviations; None without R's nlme.

    Parameters
    ----------
    fit : PopulationFit
        Of the network (n3|r3)-(m2|r1|n1), to recordings that state their noise.
    """
    if shutil.which("Rscript") is None:
        return None
    known = subprocess.run(["Rscript", "-e", "library(nlme)"], capture_output=True, check=False)
    if known.returncode != 0:
        return None
    p = fit.parameters
    names = fit.kernel.elements
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open(folder / "recordings.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["person", "repetition", "omega", "part", "value", "sd"])
            for subject in fit.recordings.subjects:
                assert subject.noise_sd is not None  # stated
                for j, repetition in enumerate(subject.repetitions):
                    for part, values in enumerate((subject.z[j].real, subject.z[j].imag)):
                        for f, value, sd in zip(subject.frequency_hz, values, subject.noise_sd[j], strict=True):
                            writer.writerow([subject.name, repetition, 2 * np.pi * f, part, value, sd])
        with open(folder / "start.csv", "w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows([("element", "mu"), *zip(names, np.round(p.mu.mean(axis=0), 1), strict=True)])
        done = subprocess.run(
            ["Rscript", str(SCRIPT), "recordings.csv", "start.csv", "estimates.csv"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            timeout=_LONGEST,
        )
        if done.returncode != 0:
            return {"failed": done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "without a word"}
        with open(folder / "estimates.csv", newline="", encoding="utf-8") as file:
            rows = {row["element"]: row for row in csv.DictReader(file)}
    said = dict(line.split(maxsplit=1) for line in done.stdout.splitlines() if " " in line)
    ours = {"mu": p.mu, "tau": p.between_persons, "rho": p.between_repetitions}
    away: dict[str, float] = {}
    for i, element in enumerate(names):
        for what, draws in ours.items():
            value = float(rows[element][what])
            away[f"{what} {element}"] = float((value - draws[:, i].mean()) / draws[:, i].std())
    return {
        "seconds": float(said["seconds"]),
        "version": said["version"].strip(),
        "estimates": {e: {k: float(v) for k, v in rows[e].items() if k != "element"} for e in names},
        "standard deviations from our mean": away,
    }
