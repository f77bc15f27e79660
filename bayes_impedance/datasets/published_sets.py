"""Published values of networks, to lay beside those of one's own recordings.

They come from other people, apparatus and conditions, which each set names with its source in full. A value that was
not found in a source is not in the table (``published_values.toml``); that some well-known publication is missing says
nothing of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.input_files import read_toml
from bayes_impedance.runtime.user_table import hint, shown

if TYPE_CHECKING:
    import pandas as pd

_FILE = Path(__file__).with_name("published_values.toml")


@dataclass(frozen=True, repr=False)
class PublishedValue(Brief):
    """A published value of one element.

    Attributes
    ----------
    element : str
        In the set's network.
    value : float
        In `unit`.
    unit : str
        That of the element in this package: a published stiffness is given as a compliance, m/N.
    limits : (float, float) or None
        Between which 95 % of what the source measured lie; None if it is not known.
    """

    element: str
    value: float
    unit: str
    limits: tuple[float, float] | None


@dataclass(frozen=True, kw_only=True, repr=False)
class PublishedSet(Brief):
    """Published values of one network.

    Attributes
    ----------
    name : str
        By which it is asked for.
    title : str
    network : str
        Notation.
    people : int
        Number of people who were measured.
    conditions : str
    source : str
        In full.
    found : str
        Where the numbers were read, if not in the source itself.
    values : tuple of PublishedValue
        In the network's order.
    """

    name: str
    title: str
    network: str
    people: int
    conditions: str
    source: str
    found: str
    values: tuple[PublishedValue, ...]

    def __repr__(self) -> str:
        return f"<PublishedSet {self.name}: {self.network}, {self.people} people>"

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each element, which is the index: value, low, high (NaN if not known) and unit."""
        import pandas as pd

        rows = {
            own.element: {
                "value": own.value,
                "low": own.limits[0] if own.limits else float("nan"),
                "high": own.limits[1] if own.limits else float("nan"),
                "unit": own.unit,
            }
            for own in self.values
        }
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("element")


@cache
def published_values() -> tuple[PublishedSet, ...]:
    """All published sets.

    >>> [own.name for own in published_values()]
    ['pen_grip_x', 'pen_grip_y', 'pen_grip_z']
    """
    table = read_toml(_FILE, "a table of published values")
    return tuple(_set_of(name, table[own["like"]] | own if "like" in own else own) for name, own in table.items())


def published_set(name: str) -> PublishedSet:
    """The published set with this name.

    Raises
    ------
    InputError
        If there is none.
    """
    sets = {own.name: own for own in published_values()}
    if name not in sets:
        raise InputError(f"{shown(name)} is not a set of published values; {hint(name, sets)}")
    return sets[name]


def _set_of(name: str, own: Mapping[str, Any]) -> PublishedSet:
    from bayes_impedance.network.notation import parse

    values = own["values"]
    return PublishedSet(
        name=name,
        title=own["title"],
        network=own["network"],
        people=own["people"],
        conditions=own["conditions"],
        source=own["source"],
        found=own["found"],
        values=tuple(_value_of(element, values[element]) for element in parse(own["network"]).elements),
    )


def _value_of(element: str, own: Mapping[str, Any]) -> PublishedValue:
    value, unit, limits = float(own["printed"]), str(own["unit"]), own.get("limits")
    if element.startswith("n") and unit == "N/m":
        turned = None if limits is None else (1 / limits[1], 1 / limits[0])
        return PublishedValue(element, 1 / value, "m/N", turned)
    return PublishedValue(element, value, unit, None if limits is None else (float(limits[0]), float(limits[1])))
