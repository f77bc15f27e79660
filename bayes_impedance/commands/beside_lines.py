"""Published values beside those of a fit, as lines for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def beside_lines(summary: Mapping[str, Any]) -> list[str]:
    """Heading, one line for each element, and the source of each published set that was asked for; else none.

    Parameters
    ----------
    summary : mapping
        Contents of ``summary.json``, whose ``beside`` names the sets.
    """
    if not summary.get("beside"):
        return []
    from bayes_impedance.datasets.beside import beside

    lines = []
    for own in beside(summary, summary["beside"]):
        lines += [
            "",
            f"published: {own.sentence}",
            f"{'':6}{'published':44}{'this fit':36}{'ratio' if own.same else ''}",
        ]
        lines += [f"{row.element:6}{row.published:44}{row.own:36}{row.ratio}".rstrip() for row in own.rows]
        lines += [own.published.source, own.published.found]
    return [line.rstrip() for line in lines]
