"""What stands below the table of elements in the terminal: what dispersions are, groups, and slopes of covariates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def dispersion_line(summary: Mapping[str, Any]) -> str:
    """What dispersions are; a Student t population has scales in place of standard deviations between persons."""
    from bayes_impedance.results.distribution import is_student_t
    from bayes_impedance.units import who

    if is_student_t(summary):
        between = f"between {who(summary['unit'])}"
        return f"dispersions of the natural logarithm: {between} scales of a Student t, else standard deviations"
    return "dispersions are standard deviations of the natural logarithm"


def group_lines(summary: Mapping[str, Any]) -> list[str]:
    """How the two groups of people differ, with a heading; none if the fit has no groups or gives no numbers."""
    from bayes_impedance.population.two_components import MIXTURE

    groups = summary.get("distribution") or {}
    if groups.get("name") != MIXTURE or groups["distance"]["median"] is None:
        return []
    share, distance = ("{:.2f} ({:.2f} to {:.2f})".format(*groups[key].values()) for key in _OF_GROUPS)
    rows = [
        f"{name:6}{'{:+.2f} ({:+.2f} to {:+.2f})'.format(*own.values())}"
        for name, own in groups["difference"].items()
        if own["median"] is not None
    ]
    head = f"{'':6}ln(element) of the second group less that of the first"
    return ["", f"two groups: share of the second {share}, distance {distance} standard deviations", head, *rows]


_OF_GROUPS = ("second_group_share", "distance")


def slope_lines(summary: Mapping[str, Any]) -> list[str]:
    """One line for each element and covariate, with a heading; none if the fit has no covariates.

    Parameters
    ----------
    summary : mapping
        Contents of ``summary.json``.
    """
    rows = []
    for name, element in summary["elements"].items():
        for covariate, slope in element.get("slopes", {}).items():
            if slope["median"] is None:
                continue
            clear = " clear of zero" if slope["q05"] * slope["q95"] > 0 else ""
            text = "{:+.2f} ({:+.2f} to {:+.2f})".format(*(slope[key] for key in ("median", "q05", "q95")))
            rows.append(f"{name:6}{covariate:24}{text:26}{clear}".rstrip())
    if not rows:
        return []
    sds = ", ".join(f"{name} {own['sd']:.3g}" for name, own in summary["covariates"].items())
    head = f"{'':6}{'covariate':24}change of ln(element) for one standard deviation ({sds})"
    return ["", head, *rows]
