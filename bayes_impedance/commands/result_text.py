"""A finished fit as text in the terminal: problems first, then remarks, then the table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.beside_lines import beside_lines
from bayes_impedance.commands.slope_lines import dispersion_line, group_lines, slope_lines
from bayes_impedance.commands.terminal import tell

if TYPE_CHECKING:
    from bayes_impedance.results.result import Result


def tell_result(result: Result, last: str) -> None:
    """Print the result; `last` is the last line."""
    from bayes_impedance.network.spellings import in_both
    from bayes_impedance.units import who

    summary = result.summary
    n = summary["subjects"]
    for problem in summary["problems"]:
        tell(f"NOT RELIABLE: {problem}")
    misfit = summary["adequacy"]["misfit"]
    for sentence in misfit:
        tell(f"MISFIT: {sentence}")
    for finding in summary["findings"]:
        tell(f"warning: {finding}")
    for remark in summary["remarks"]:
        if remark not in misfit:
            tell(f"note: {remark}")
    tell()
    tell(f"{n} subject{'' if n == 1 else 's'}, network {in_both(summary['network'], summary['unit'])}")
    tell()
    tell(f"{'':6}{'unit':9}{'central value (90 %)':32}{'between ' + who(summary['unit']):24}between repetitions")
    for name, element in summary["elements"].items():
        if not element["identified"]:
            tell(f"{name:6}{element['unit']:9}not determined by these recordings")
            continue
        cells = [_interval(element["central"], ".3g")]
        cells += [_interval(element[f"dispersion_between_{level}"], ".2f") for level in ("persons", "repetitions")]
        marked = name + ("*" if _is_marked(element) else "")
        tell(f"{marked:6}{element['unit']:9}{cells[0]:32}{cells[1]:24}{cells[2]}".rstrip())
    tell()
    if any(_is_marked(element) for element in summary["elements"].values()):
        tell("* may be wrong by more than its interval because of the misfit that is named above")
    tell(dispersion_line(summary))
    for line in (*group_lines(summary), *slope_lines(summary), *beside_lines(summary)):
        tell(line)
    if summary.get("prior", {}).get("given"):
        tell("with the prior that was given (--priors)")
    tell()
    tell(f"{'error of one curve for all (eq. 5)':36}{'|z|, ' + summary['unit']:>16}{'phase, deg':>14}")
    for key, label in (
        ("population_network", "population network"),
        ("lookup_mean", "look-up table of the mean"),
        ("lookup_median", "look-up table of the median"),
    ):
        error = summary["errors"][key]
        tell(f"{label:36}{error['delta_magnitude']:16.3g}{error['delta_phase_deg']:14.3g}")
    tell()
    tell(f"{last}")


def _interval(values: dict[str, float | None], style: str) -> str:
    if values["median"] is None:
        return "-"
    return "{} ({} to {})".format(*(format(values[k], style) for k in ("median", "q05", "q95")))


def _is_marked(element: dict[str, Any]) -> bool:
    """Whether a number is shown that depends on the misfit: what is withheld needs no mark."""
    return bool(element["marked"] and element["central"]["median"] is not None)
