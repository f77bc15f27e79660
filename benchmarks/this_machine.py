"""The machine and the versions that the numbers of a benchmark belong to."""

from __future__ import annotations

import os
import platform
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

_PACKAGES = ("bayes_impedance", "numpy", "scipy", "numba", "emcee", "jax", "numpyro", "impedance", "lmfit")


def machine() -> dict[str, Any]:
    """Description of the machine and the versions that the numbers belong to."""
    names = [
        line.split(":")[1].strip()
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        if line.startswith("model name")
    ]
    installed = {}
    for package in _PACKAGES:
        try:
            installed[package] = version(package)
        except PackageNotFoundError:
            installed[package] = "not installed"
    return {
        "processor": names[0] if names else platform.processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        "packages": installed,
        "date": date.today().isoformat(),
    }
