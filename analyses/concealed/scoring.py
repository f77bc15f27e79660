"""Comparison of a verdict with the truth: detection, name, place and size, and intervals of such rates.

A verdict is the content of ``verdict.json``. "First or undecided" is the main measure: the concealed effect comes
first, or is among the aliases from which the first explanation is not separated (``separated`` false). Places are
compared as networks and not as words: an addition beside one part of a parallel group is beside all of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from forms import same_places

OTHER_NAMES = {"corner": "corner_hz", "frequency": "frequency_hz", "loss": "loss_factor"}
"""Names that a verdict may give to a parameter of the truth; extend here when names change."""

YES_NO = ("detected", "first", "first_or_undecided", "side", "band", "visible_band", "place")
"""What is counted for every concealed effect, in the order of the table."""

VISIBLE = 6.0
"""Standard errors from which an effect should be detected: p = 2e-9, which stays small after a thousand tests."""


def score(verdict: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, Any]:
    """Compare one verdict with the truth.

    Parameters
    ----------
    verdict : mapping
        Content of ``verdict.json``.
    truth : mapping
        Of ``effects.concealed``.

    Returns
    -------
    dict
        ``detected`` (a mismatch was claimed), ``said`` (id of the first explanation or None). Where something was
        concealed also ``first, first_or_undecided, side, band, visible_band, place``; ``listed`` (right id anywhere
        among the physics); ``visible`` (of the truth); ``parameters`` (for each number of which verdict and truth both
        speak, whether its interval covers; empty unless the right id is first); ``people`` (None, or hits and false
        alarms among the subjects); ``covariate`` (None, or whether the right one is named); ``elpd_gain`` and
        ``elpd_gain_se`` (None if not given).
    """
    physics = list(verdict.get("physics") or [])
    first = physics[0] if physics else {}
    said = first.get("id")
    result: dict[str, Any] = {"detected": bool(verdict["mismatch"]), "said": said}
    if not truth["mismatch"]:
        return result
    undecided = [alias for alias in first.get("aliases") or [] if not alias.get("separated", True)]
    accounts = [first, *undecided] if first else []
    where = verdict.get("where") or {}
    improvement = verdict.get("improvement") or {}
    right = said == truth["id"]
    return result | {
        "first": right,
        "first_or_undecided": any(a["id"] == truth["id"] for a in accounts),
        "listed": any(p["id"] == truth["id"] for p in physics),
        "side": (first.get("side") or where.get("side")) == truth["side"],
        "band": overlap(where.get("bands_hz") or [], truth["bands_hz"]),
        "visible_band": overlap(where.get("bands_hz") or [], truth["visible_bands_hz"]),
        "visible": truth["visible"],
        "place": any(_same_place(a, truth) for a in accounts),
        "parameters": _covered(first, truth) if right else {},
        "people": _people(where.get("subjects"), truth["subjects"]),
        "covariate": None if truth["covariate"] is None else where.get("covariate") == truth["covariate"],
        "elpd_gain": improvement.get("elpd_gain"),
        "elpd_gain_se": improvement.get("elpd_gain_se"),
    }


def overlap(bands: Iterable[Sequence[float]], others: Iterable[Sequence[float]]) -> bool:
    """Whether any interval (low, high) of one list meets any of the other."""
    others = list(others)
    return any(a[0] <= b[1] and b[0] <= a[1] for a in bands for b in others)


def _same_place(account: Mapping[str, Any], truth: Mapping[str, Any]) -> bool:
    """Whether an explanation names the place or an equivalent one.

    Equivalent places depend on the effect: the truth's list holds for the right id only.
    """
    place = account.get("place")
    if account.get("id") == truth["id"]:
        return place in truth["places"]
    return place is not None and truth["place"] in same_places(str(account.get("id")), place)


def _covered(first: Mapping[str, Any], truth: Mapping[str, Any]) -> dict[str, bool]:
    """For each reported parameter that the truth knows, whether its 90 % interval contains the true value."""
    reported = {OTHER_NAMES.get(name, name): found for name, found in (first.get("parameters") or {}).items()}
    known = truth["also"] | truth["parameters"]
    replaced = "coefficient" not in reported or "becomes" in str(first.get("formula"))
    if truth["id"] == "body.springpot" and replaced:
        return {}  # a springpot in place of a spring: its exponent is not that of one beside the spring
    covered = {}
    for name in (n for n in reported if n in known):
        low, high = reported[name].get("q05"), reported[name].get("q95")
        if low is not None and high is not None:
            covered[name] = bool(low <= _expected(known[name], reported[name], first.get("place")) <= high)
    return covered


def _expected(true: Mapping[str, Any], found: Mapping[str, Any], place: str | None) -> float:
    """True value as the verdict defines it: a slope may be per standard deviation, and is negative for a compliance."""
    per_sd = "per_sd" in true and any(word in str(found.get("unit")) for word in ("sd", "standard deviation"))
    sign = true.get("signs", {}).get(place, 1)
    return float(sign * (true["per_sd"] if per_sd else true["value"]))


def _people(said: Any, true: Any) -> dict[str, int] | None:
    """Numbers of named people in and outside of the subgroup; None where the effect concerns everybody."""
    if true == "all":
        return None
    named = set() if said in (None, "all") else set(said)
    return {"concerned": len(true), "hits": len(named & set(true)), "false": len(named - set(true))}


def clopper_pearson(hits: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Clopper-Pearson interval of a rate from `hits` of n: coverage is at least nominal, also near 0 and 1."""
    from scipy.stats import beta

    if n == 0:
        return 0.0, 1.0
    tail = (1 - level) / 2
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, n - hits + 1))
    high = 1.0 if hits == n else float(beta.ppf(1 - tail, hits + 1, n - hits))
    return low, high


def tally(scores: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Counts over some cases of concealed effects.

    Returns
    -------
    dict
        ``cases``, a count for each of :data:`YES_NO`, ``intervals`` and ``covered`` (parameters with an interval, of
        cases whose right id is first), ``unreported`` (such cases without any), medians ``visible, elpd_gain,
        seconds`` (NaN if none).
    """
    parameters = [value for s in scores for value in s["parameters"].values()]
    return {
        "cases": len(scores),
        **{name: sum(bool(s[name]) for s in scores) for name in YES_NO},
        "intervals": len(parameters),
        "covered": sum(parameters),
        "unreported": sum(bool(s["first"]) and not s["parameters"] for s in scores),
        **{name: _median([s.get(name) for s in scores]) for name in ("visible", "elpd_gain", "seconds")},
    }


def _median(values: Iterable[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else float("nan")
