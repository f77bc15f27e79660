"""Design inputs as files: tables that a spreadsheet, a control toolbox or a circuit simulator reads."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.design.answer import DesignAnswer
from bayes_impedance.design.circuits import spice
from bayes_impedance.design.circuits.passivity_check import passive_coefficients, passive_states, positive_elements
from bayes_impedance.design.circuits.transfer_functions import described, written
from bayes_impedance.design.representatives import Representatives
from bayes_impedance.design.users import PERCENTILES, UserPopulation, Users, percentile_curves
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_json, write_text


def write_users(
    folder: Path, population: UserPopulation, users: Users, chosen: Representatives, frequency_hz: np.ndarray
) -> list[Path]:
    """``users.csv``, ``users.json`` and ``curves.csv``.

    Parameters
    ----------
    folder : Path
        Made if it does not exist.
    population : UserPopulation
    users : Users
        Drawn from it.
    chosen : Representatives
        Those who stand for all.
    frequency_hz : ndarray, shape (F,)
        Of the curves.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If a user is not passive.
    """
    everybody = chosen.users + users
    if not positive_elements(everybody).all():
        raise InputError("a user has an element of no size or of infinite size: check the assumed values")
    header = ["user", *(f"{e} ({unit})" for e, unit in users.units.items())]
    rows = [
        [name, *map(_digits, row)] for name, row in zip(everybody.names, np.exp(everybody.log_elements), strict=True)
    ]
    elements = population.network.elements
    free = [e for e in elements if e not in population.fixed]
    deviation = np.sqrt(np.diag(population.covariance))
    table: dict[str, Any] = {
        "schema": 1,
        "network": str(users.network),
        "unit": users.unit,
        "units": users.units,
        "users": len(users),
        "assumed": list(population.fixed),
        "centre": population.median_user().of(0),
        "log_covariance": {"elements": list(elements), "matrix": population.covariance.tolist()},
        "correlation": [
            [a, b, float(population.covariance[i, j] / deviation[i] / deviation[j])]
            for i, a in enumerate(elements)
            for j, b in enumerate(elements)
            if j < i and a in free and b in free
        ],
        "representatives": [
            {"name": name, "rule": rule, "elements": chosen.users.of(i)}
            for i, (name, rule) in enumerate(zip(chosen.users.names, chosen.rules, strict=True))
        ],
        "spanning_radius": chosen.radius,
        "passive": True,
    }
    magnitude, phase = percentile_curves(users, frequency_hz)
    shown = [f"p{100 * p:02.0f}" for p in PERCENTILES]
    curves = np.column_stack([frequency_hz, magnitude.T, phase.T])
    names = ["frequency_hz", *(f"magnitude_{p}" for p in shown), *(f"phase_deg_{p}" for p in shown)]
    return [
        write_text(folder / "users.csv", _csv(header, rows)),
        write_json(folder / "users.json", table, indent=1),
        write_text(folder / "curves.csv", _csv(names, [[_digits(v) for v in row] for row in curves])),
    ]


def write_transfer(folder: Path, users: Users, chosen: Users) -> list[Path]:
    """``transfer.json`` of everybody and ``transfer.txt`` of those who stand for all.

    Raises
    ------
    InputError
        If what would be written is not passive.
    """
    everybody = chosen + users
    table = described(everybody)
    unsound = [
        n
        for n, good in zip(everybody.names, passive_states(everybody.network, everybody.values), strict=True)
        if not good
    ]
    for entry in table["users"][: len(chosen)]:
        if not passive_coefficients(entry["numerator"], entry["denominator"]):
            unsound.append(entry["name"])
    if unsound:
        raise InputError(
            f"the transfer function of {unsound[0]} is not passive to the digits of a double: its elements are too "
            "unlike each other; export SPICE, whose elements keep it passive"
        )
    return [
        write_json(folder / "transfer.json", table, indent=1),
        write_text(folder / "transfer.txt", written(chosen, range(len(chosen)))),
    ]


def write_spice(
    folder: Path, population: UserPopulation, users: Users, chosen: Users, band_hz: tuple[float, float]
) -> list[Path]:
    """``users.lib``, ``monte_carlo.lib`` and ``sweep.cir``, a deck that runs the first and writes ``sweep.txt``."""
    everybody = chosen + users
    if not positive_elements(everybody).all():
        raise InputError("a user has an element of no size or of infinite size: check the assumed values")
    return [
        write_text(folder / "users.lib", spice.library(everybody)),
        write_text(folder / "monte_carlo.lib", spice.monte_carlo(population)),
        write_text(folder / "sweep.cir", spice.sweep(everybody, "users.lib", band_hz, "sweep.txt", points=20)),
    ]


def write_stability(folder: Path, answer: DesignAnswer) -> list[Path]:
    """``stability.json``, ``stability.csv`` (the map), ``limits.csv`` (everybody) and ``transparency.csv``."""
    m, limit = answer.map, answer.limit
    rows = [
        [
            *map(_digits, (k, b, m.probability[i, j], m.low[i, j], m.high[i, j])),
            int(m.mean_user[i, j]),
            int(k < m.classical[i]),
        ]
        for i, b in enumerate(m.damping)
        for j, k in enumerate(m.stiffness)
    ]
    header = [
        "stiffness_n_per_m",
        "damping_ns_per_m",
        "share_stable",
        "q05",
        "q95",
        "mean_user_stable",
        "classical_bound",
    ]
    each = [[name, _digits(k), _digits(f)] for name, k, f in zip(m.users.names, limit.each, limit.each_hz, strict=True)]
    files = [
        write_json(folder / "stability.json", answer.described(), indent=1),
        write_text(folder / "stability.csv", _csv(header, rows)),
        write_text(folder / "limits.csv", _csv(["user", "stiffness_limit_n_per_m", "oscillation_hz"], each)),
    ]
    felt = answer.transparency
    if felt is not None:
        ratio, error = felt.band()
        shown = [f"p{100 * p:02.0f}" for p in PERCENTILES]
        names = [
            "frequency_hz",
            *(f"transmitted_by_desired_{p}" for p in shown),
            *(f"velocity_error_{p}" for p in shown),
        ]
        values = np.column_stack([felt.frequency_hz, ratio.T, error.T])
        table = _csv(names, [[_digits(v) for v in row] for row in values])
        files.append(write_text(folder / "transparency.csv", table))
    return files


def _digits(value: float) -> str:
    return f"{value:.17g}" if np.isfinite(value) else ""


def _csv(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()
