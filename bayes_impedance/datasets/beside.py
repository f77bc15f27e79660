"""Published values beside those of a fit: rows for the terminal and for the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bayes_impedance.datasets.published_sets import PublishedSet, published_set
from bayes_impedance.display import number

UNIT = "N s/m"
"""Of the impedance in all published sets."""


@dataclass(frozen=True)
class BesideRow:
    """A published value and the fit's own.

    Attributes
    ----------
    element : str
        In the published network.
    published : str
        Value and unit, with limits if there are any.
    own : str
        Element and central value of the fit with its 90 % interval; empty if the fit has no such element.
    ratio : str
        The fit's value over the published one; empty if there is none.
    """

    element: str
    published: str
    own: str
    ratio: str


@dataclass(frozen=True)
class Beside:
    """A published set beside a fit.

    Attributes
    ----------
    published : PublishedSet
    same : bool
        Whether the fitted network is the published one but for names, so that elements correspond.
    rows : tuple of BesideRow
    """

    published: PublishedSet
    same: bool
    rows: tuple[BesideRow, ...]

    @property
    def sentence(self) -> str:
        """What is laid beside the fit, and whether its elements may be compared."""
        own = self.published
        said = f"{own.title} ({own.name}): {own.people} people; {own.conditions}."
        if self.same:
            return said
        return f"{said} It is another network, {own.network}: its elements are not those of this fit."


def beside(summary: Mapping[str, Any], names: Sequence[str]) -> tuple[Beside, ...]:
    """Published sets beside a fit.

    Parameters
    ----------
    summary : mapping
        Contents of ``summary.json``.
    names : sequence of str
        Of published sets.

    Raises
    ------
    InputError
        If there is no set of a name.
    """
    return tuple(_laid(published_set(name), summary) for name in names)


def _laid(own: PublishedSet, summary: Mapping[str, Any]) -> Beside:
    from bayes_impedance.network.notation import parse
    from bayes_impedance.network.symmetry import corresponding

    elements = summary["elements"]
    pairs = corresponding(parse(own.network), parse(summary["network"])) if summary["unit"] == UNIT else None
    rows = []
    for value in own.values:
        said = f"{number(value.value)} {value.unit}"
        if value.limits is not None:
            said += f" (95 %: {number(value.limits[0])} to {number(value.limits[1])})"
        mine, ratio = "", ""
        if pairs is not None:
            name = pairs[value.element]
            central = elements[name]["central"]
            if elements[name]["identified"] and central["median"] is not None:
                interval = "{} ({} to {})".format(*(number(central[key]) for key in ("median", "q05", "q95")))
                mine, ratio = f"{name} {interval}", number(central["median"] / value.value)
            else:
                mine = f"{name} has no number"
        rows.append(BesideRow(value.element, said, mine, ratio))
    return Beside(own, pairs is not None, tuple(rows))
