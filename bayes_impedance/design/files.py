"""Design inputs as files for spreadsheets, control toolboxes and circuit simulators."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.design.answer import DesignAnswer
from bayes_impedance.design.circuits import matlab, modelica, spice
from bayes_impedance.design.circuits.equivalent import Equivalent, equivalent
from bayes_impedance.design.circuits.passivity_check import passive_coefficients, passive_states, positive_elements
from bayes_impedance.design.circuits.transfer_functions import described, parameters_of, tabulated, written
from bayes_impedance.design.percentiles import PERCENTILES, percentile_curves
from bayes_impedance.design.representatives import Representatives
from bayes_impedance.design.users import UserPopulation, Users, free_parameters
from bayes_impedance.errors import InputError
from bayes_impedance.network.passivity import known_passive
from bayes_impedance.runtime.atomic_files import write_bytes, write_json, write_text
from bayes_impedance.units import ratio_of

if TYPE_CHECKING:
    import pandas as pd


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
        Representative users.
    frequency_hz : ndarray, shape (F,)
        Frequencies of the curves.

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
        raise InputError("an element of some user is zero or infinite: check the values of --assume")
    with_units = {e: f"{e} ({unit})" if unit else e for e, unit in users.units.items()}
    elements = population.network.elements
    free = [e for e in elements if e not in {*population.fixed, *population.shared}]
    deviation = np.sqrt(np.diag(population.covariance))
    table: dict[str, Any] = {
        "schema": 2,
        "network": str(users.network),
        "unit": users.unit,
        "units": users.units,
        "users": len(users),
        "scales": {p.name: p.link for p in free_parameters(users.network)},
        "assumed": list(population.fixed),
        "taken_out": list(population.removed),
        "centre": population.median_user().of(0),
        "covariance": {"elements": list(elements), "matrix": population.covariance.tolist()},
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
        "passive": known_passive(users.network) or None,
    }
    magnitude, phase = percentile_curves(users, frequency_hz)
    shown = [f"p{100 * p:02.0f}" for p in PERCENTILES]
    curves = np.column_stack([magnitude.T, phase.T])
    names = [*(f"magnitude_{p}" for p in shown), *(f"phase_deg_{p}" for p in shown)]
    return [
        write_text(folder / "users.csv", _csv(everybody.to_dataframe().rename(columns=with_units))),
        write_json(folder / "users.json", table, indent=1),
        write_text(folder / "curves.csv", _csv(_over_frequency(frequency_hz, curves, names))),
    ]


def write_transfer(folder: Path, users: Users, chosen: Users, made: Equivalent | None = None) -> list[Path]:
    """``transfer.json`` of all users and ``transfer.txt`` of the representative ones.

    Parameters
    ----------
    folder : Path
    users, chosen : Users
    made : Equivalent, optional
        Both as masses, compliances and dampers, those that are chosen first.

    Raises
    ------
    InputError
        If a transfer function to be written is not passive.
    """
    everybody = chosen + users
    made = equivalent(everybody) if made is None else made
    table = described(everybody, made)
    plain = made.users
    unsound = [n for n, good in zip(plain.names, passive_states(plain.network, plain.values), strict=True) if not good]
    for entry in table["users"][: len(chosen)]:
        if "numerator" in entry and not passive_coefficients(entry["numerator"], entry["denominator"]):
            unsound.append(entry["name"])
    if unsound:
        raise InputError(
            f"the transfer function of {unsound[0]} is not passive in double precision, because its elements differ by "
            "too many orders of magnitude; export SPICE, whose elements keep it passive"
        )
    return [
        write_json(folder / "transfer.json", table, indent=1),
        write_text(folder / "transfer.txt", written(everybody, range(len(chosen)), made)),
    ]


def write_tables(folder: Path, users: Users, chosen: Users, frequency_hz: np.ndarray, why: str) -> list[Path]:
    """The same files for users without a finite state space: impedances over frequency.

    Parameters
    ----------
    folder : Path
    users, chosen : Users
    frequency_hz : ndarray, shape (F,)
    why : str
        Why there is none.
    """
    z = chosen.impedance(frequency_hz)
    blocks = [
        f"impedance z = {ratio_of(users.unit)} in {users.unit} at frequencies in Hz; {why}",
        f"network {users.network}",
    ]
    for i, name in enumerate(chosen.names):
        rows = [f"  {f:.6g}  {x.real:.8g} {x.imag:+.8g}j" for f, x in zip(frequency_hz, z[i], strict=True)]
        blocks.append("\n".join([f"{name}: {parameters_of(chosen, i)}", *rows]))
    return [
        write_json(folder / "transfer.json", tabulated(chosen + users, frequency_hz, why), indent=1),
        write_text(folder / "transfer.txt", "\n\n".join(blocks) + "\n"),
    ]


def write_spice(
    folder: Path,
    population: UserPopulation,
    users: Users,
    chosen: Users,
    band_hz: tuple[float, float],
    made: Equivalent | None = None,
) -> list[Path]:
    """``users.lib``, ``monte_carlo.lib`` and ``sweep.cir``, a deck that runs the first and writes ``sweep.txt``."""
    made = equivalent(chosen + users) if made is None else made
    everybody = made.users
    if not positive_elements(everybody).all():
        raise InputError("an element of some user is zero or infinite: check the values of --assume")
    return [
        write_text(folder / "users.lib", spice.library(everybody)),
        write_text(folder / "monte_carlo.lib", spice.monte_carlo(population, made=made)),
        write_text(folder / "sweep.cir", spice.sweep(everybody, "users.lib", band_hz, "sweep.txt", points=20)),
    ]


def write_mat(
    folder: Path, users: Users, chosen: Users, frequency_hz: np.ndarray, made: Equivalent | None
) -> list[Path]:
    """``users.mat`` of all users, those that are chosen first; without state spaces if `made` is None."""
    content = matlab.variables(chosen + users, frequency_hz, made)
    return [write_bytes(folder / "users.mat", matlab.mat_bytes(content))]


def write_modelica(folder: Path, users: Users, chosen: Users, made: Equivalent | None = None) -> list[Path]:
    """``Users.mo``, a Modelica package with a model of every user, those that are chosen first."""
    made = equivalent(chosen + users) if made is None else made
    return [write_text(folder / "Users.mo", modelica.package(made.users))]


def write_stability(folder: Path, answer: DesignAnswer) -> list[Path]:
    """``stability.json``, ``stability.csv`` (the map), ``limits.csv`` (each user) and ``transparency.csv``."""
    import pandas as pd

    m, limit = answer.map, answer.limit
    gains = {
        "stiffness_n_per_m": np.tile(m.stiffness, m.damping.size),
        "damping_ns_per_m": np.repeat(m.damping, m.stiffness.size),
    }
    stable = {
        "share_stable": m.probability,
        "q05": m.low,
        "q95": m.high,
        "mean_user_stable": m.mean_user.astype(int),
        "classical_bound": (m.stiffness < m.classical[:, None]).astype(int),
    }
    table = pd.DataFrame(gains | {name: values.ravel() for name, values in stable.items()})
    each = pd.DataFrame(
        {"stiffness_limit_n_per_m": limit.each, "oscillation_hz": limit.each_hz},
        index=pd.Index(m.users.names, name="user", dtype=object),
    )
    files = [
        write_json(folder / "stability.json", answer.described(), indent=1),
        write_text(folder / "stability.csv", _csv(table)),
        write_text(folder / "limits.csv", _csv(each)),
    ]
    felt = answer.transparency
    if felt is not None:
        ratio, error = felt.band()
        shown = [f"p{100 * p:02.0f}" for p in PERCENTILES]
        names = [
            *(f"transmitted_by_desired_{p}" for p in shown),
            *(f"velocity_error_{p}" for p in shown),
        ]
        felt_by = _over_frequency(felt.frequency_hz, np.column_stack([ratio.T, error.T]), names)
        files.append(write_text(folder / "transparency.csv", _csv(felt_by)))
    return files


_COMMENT = {".lib": "* ", ".cir": "* ", ".csv": "# ", ".mo": "// "}
"""Prefix of a comment line in these files; other text files have no comments."""


def warned(file: Path, warnings: Sequence[str]) -> Path:
    """Write warnings into a file of design inputs, where programs and people that read it find them.

    Parameters
    ----------
    file : Path
        Complete.
    warnings : sequence of str
        Reasons why its numbers must be used with care or not at all.

    Returns
    -------
    Path
        The file.
    """
    if file.suffix == ".mat":
        return write_bytes(file, matlab.with_warnings(file.read_bytes(), list(warnings)))
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".json":
        return write_json(file, {"warnings": list(warnings)} | json.loads(text), indent=1)
    told = "".join(f"{_COMMENT.get(file.suffix, '')}WARNING: {warning}\n" for warning in warnings)
    # SPICE takes the first line of a deck as its title, whatever it contains.
    title, rest = text.split("\n", 1) if file.suffix == ".cir" else ("", text)
    return write_text(file, f"{title}\n{told}{rest}" if title else told + rest)


def _over_frequency(frequency_hz: np.ndarray, values: np.ndarray, names: list[str]) -> pd.DataFrame:
    """Columns of values (F, C) over frequencies (F,)."""
    import pandas as pd

    return pd.DataFrame(values, index=pd.Index(frequency_hz, name="frequency_hz"), columns=names)


def _csv(table: pd.DataFrame) -> str:
    """CSV text with all digits of double precision; values that are not finite are empty cells."""
    named = table if table.index.name is None else table.reset_index()
    finite = named.replace([np.inf, -np.inf], np.nan)
    return finite.to_csv(index=False, float_format="%.17g", lineterminator="\n")
