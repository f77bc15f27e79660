"""The two groups of people of a mixture on the page of a run, as plain text for the template."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.plots.access import needed, subjects
from bayes_impedance.population.two_components import MIXTURE
from bayes_impedance.results.meanings import MEMBER
from bayes_impedance.results.result import Result

_LIKELY = 0.5
"""Probability from which on somebody is counted to the second group: more probable than not."""


@dataclass(frozen=True)
class GroupTable:
    """Two groups of people.

    Attributes
    ----------
    share, distance : str
        Medians with 90 % intervals.
    members : tuple of str
        Subjects that more probably belong to the second group.
    rows : tuple of (str, str, str)
        Element, ratio of the central values (second group to first), and its 90 % interval.
    """

    share: str
    distance: str
    members: tuple[str, ...]
    rows: tuple[tuple[str, str, str], ...]


def group_table(result: Result) -> GroupTable | None:
    """The groups; None if the fit has none, or its numbers must not be used."""
    groups = result.summary.get("distribution") or {}
    if groups.get("name") != MIXTURE or groups["distance"]["median"] is None:
        return None
    middle, low, high = (100 * groups["second_group_share"][key] for key in ("median", "q05", "q95"))
    distance = "{:.2g} ({:.2g} to {:.2g})".format(*(groups["distance"][key] for key in ("median", "q05", "q95")))
    probability = needed(result, MEMBER)
    rows = []
    for name, own in groups["difference"].items():
        if own["median"] is not None:
            ratio, least, most = (float(np.exp(own[key])) for key in ("median", "q05", "q95"))
            rows.append((name, f"×{ratio:.2f}", f"{least:.2f} to {most:.2f}"))
    return GroupTable(
        share=f"{middle:.0f} % ({low:.0f} to {high:.0f} %)",
        distance=distance,
        members=tuple(name for name, p in zip(subjects(result), probability, strict=True) if p > _LIKELY),
        rows=tuple(rows),
    )
