"""A verdict as a table: what is missing, one row for each parameter of each effect."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayes_impedance.display import heading, joined, lines, table

if TYPE_CHECKING:
    import pandas as pd

COLUMNS = ("id", "name", "place", "side", "pooling", "parameter", "unit", "median", "q05", "q95", "dispersion")
"""Of the table of a verdict; ``elpd_gain`` and ``elpd_gain_se`` follow."""


def rows_of(verdict: Any) -> list[dict[str, Any]]:
    """One row for each parameter of each entry of the physics; an entry without parameters has one row too."""
    found = []
    for entry in verdict.physics:
        same = {name: getattr(entry, name) for name in COLUMNS[:5]}
        gain = {"elpd_gain": entry.evidence.elpd_gain, "elpd_gain_se": entry.evidence.elpd_gain_se}
        for name, parameter in entry.parameters.items() or [("", None)]:
            own = {key: getattr(parameter, key, None) for key in COLUMNS[6:]}
            found.append(same | {"parameter": name} | own | gain)
    return found


def dataframe_of(verdict: Any) -> pd.DataFrame:
    """The rows as a DataFrame."""
    import pandas as pd

    return pd.DataFrame(rows_of(verdict), columns=[*COLUMNS, "elpd_gain", "elpd_gain_se"])


def html_of(verdict: Any) -> str:
    """The verdict's sentence and its table."""
    columns = [*COLUMNS, "elpd_gain", "elpd_gain_se"]
    rows = [[row[name] for name in columns] for row in rows_of(verdict)]
    shown = table([name.replace("_", " ") for name in columns], rows) if rows else ""
    return joined(heading(verdict.summary), shown, lines(verdict.remarks))
