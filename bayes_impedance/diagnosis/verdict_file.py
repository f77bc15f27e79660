"""Writing a verdict as JSON (``verdict.json``) and reading it.

:func:`to_json` and :func:`from_json` are each other's inverse; ``verdict.schema.json`` beside this file is the JSON
Schema of what they write. Fields stand in the order of :mod:`bayes_impedance.diagnosis.verdict_types`, except for an
entry of the physics, whose kind says which fields it has and in which order: :data:`PHYSICS_KEYS`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from bayes_impedance.diagnosis.verdict_types import (
    Alias,
    BlockGain,
    Detectable,
    EvidenceOfEffect,
    Improvement,
    Joint,
    Kind,
    Located,
    LocatedBand,
    Pair,
    Parameter,
    ParameterDifference,
    Physics,
    Subjects,
    Verdict,
    Where,
)
from bayes_impedance.errors import InputError

SCHEMA = 1
"""Version of the format; to be raised when a field changes its meaning or goes away."""

_HEAD = ("id", "name", "place", "side")
_CATALOGUE = ("story", "formula", "look_for", "source")
_STRUCTURE = (*_HEAD, "pooling", "parameters", "aliases", *_CATALOGUE)

PHYSICS_KEYS: dict[Kind, tuple[str, ...]] = {
    "effect": (
        *_HEAD,
        "side_decided",
        "pooling",
        "subjects",
        "parameters",
        "evidence",
        "aliases",
        *_CATALOGUE,
        "dispersion_interval",
    ),
    "hum": (*_HEAD, "pooling", "parameters", "evidence", "aliases", *_CATALOGUE, "frequencies_hz"),
    "trend": (*_STRUCTURE, "covariate", "elements", "evidence"),
    "subgroup": (*_STRUCTURE, "subjects", "elements", "evidence"),
    "correlation": (*_STRUCTURE, "evidence"),
    "unknown": (*_HEAD, "pooling", "parameters", "evidence", "aliases", "network", "connection", "formula", "story"),
}
"""Fields of an entry of the physics by its kind, in the order of the file. No two kinds have the same fields."""

_OPTIONAL = ("joint", "parameters_differ", "extended_network", "start")
"""Keys that are left out where the verdict has no value; so is ``shortcomings`` where it is empty."""


def to_json(verdict: Verdict) -> dict[str, Any]:
    """Content of ``verdict.json``: dictionaries, lists, texts, and numbers; non-finite numbers become null.

    Parameters
    ----------
    verdict : Verdict
    """
    named = {field.name: getattr(verdict, field.name) for field in fields(verdict)}
    record: dict[str, Any] = {"schema": SCHEMA, "mismatch": verdict.mismatch}
    for name, value in named.items():
        if (name in _OPTIONAL and value is None) or (name == "shortcomings" and not value):
            continue
        record[name] = _plain(value)
        if name == "network":
            record["unexplained"] = _plain(verdict.unexplained)
    return record


def _plain(value: Any) -> Any:
    if isinstance(value, Physics):
        return {key: _plain(getattr(value, key)) for key in PHYSICS_KEYS[value.kind]}
    if isinstance(value, Improvement):
        return _plain_improvement(value)
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _plain_improvement(value: Improvement) -> dict[str, Any]:
    record = {}
    for field in fields(value):
        if field.name != "blocks":
            record[field.name] = _plain(getattr(value, field.name))
        elif value.blocks is not None:
            record |= {"elpd_gain_blocks": _plain(value.blocks.gain), "elpd_gain_blocks_se": _plain(value.blocks.se)}
    return record


def from_json(record: Mapping[str, Any]) -> Verdict:
    """The verdict that :func:`to_json` has written.

    Parameters
    ----------
    record : mapping
        Content of ``verdict.json``.

    Raises
    ------
    InputError
        If it is no verdict, or of another version of the format.
    """
    if not isinstance(record, Mapping) or record.get("schema") != SCHEMA:
        raise InputError(f"this is not a verdict of schema {SCHEMA}; give a verdict.json that this version wrote")
    try:
        return _verdict(record)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        text = f"'{error.args[0]}' is missing" if isinstance(error, KeyError) else str(error)
        raise InputError(f"this is not a verdict of schema {SCHEMA} ({text}); diagnose the recordings again") from None


def _verdict(record: Mapping[str, Any]) -> Verdict:
    before, after = record["network"]
    joint, differ = record.get("joint"), record.get("parameters_differ")
    return Verdict(
        summary=record["summary"],
        where=_where(record["where"]),
        located=_located(record["located"]),
        physics=tuple(_physics(entry) for entry in record["physics"]),
        improvement=None if record["improvement"] is None else _improvement(record["improvement"]),
        network=(_text(before), _text(after)),
        detectable=tuple(Detectable(**row) for row in record["detectable"]),
        not_identifiable=tuple(record["not_identifiable"]),
        elements_not_identified=tuple(record["elements_not_identified"]),
        seed=record["seed"],
        data_sha256=record["data_sha256"],
        title=record["title"],
        unit=record["unit"],
        reliable=record["reliable"],
        remarks=tuple(record["remarks"]),
        version=record["version"],
        joint=None if joint is None else Joint(tuple(joint["parameters"]), tuple(map(tuple, joint["correlation"]))),
        parameters_differ=None if differ is None else tuple(ParameterDifference(**row) for row in differ),
        shortcomings=tuple(record.get("shortcomings", ())),
        extended_network=None if "extended_network" not in record else _text(record["extended_network"]),
        start=None if "start" not in record else {_text(name): float(x) for name, x in record["start"].items()},
    )


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"a network is {value!r}, but must be a text")
    return value


def _where(record: Mapping[str, Any]) -> Where:
    bands = tuple(_pair(band) for band in record["bands_hz"])
    return Where(**{**record, "bands_hz": bands, "subjects": _subjects(record["subjects"])})


def _located(record: Mapping[str, Any]) -> Located:
    return Located(
        p_value=_number(record["p_value"]),
        bands=tuple(LocatedBand(**band) for band in record["bands"]),
        magnitude_share=record["magnitude_share"],
        subjects_p_value=_number(record["subjects_p_value"]),
    )


def _physics(record: Mapping[str, Any]) -> Physics:
    kind = next((kind for kind, keys in PHYSICS_KEYS.items() if set(keys) == set(record)), None)
    if kind is None:
        raise ValueError(f"an entry of 'physics' has the fields {', '.join(record)}, which fit no kind of entry")
    own = dict(record)
    own["parameters"] = {name: _parameter(row) for name, row in record["parameters"].items()}
    own["evidence"] = EvidenceOfEffect(**record["evidence"])
    own["aliases"] = tuple(_alias(alias) for alias in record["aliases"])
    for name in ("elements", "frequencies_hz"):
        own[name] = tuple(record.get(name, ()))
    own["subjects"] = _subjects(record.get("subjects", "all"))
    interval = record.get("dispersion_interval")
    own["dispersion_interval"] = None if interval is None else _pair(interval)
    return Physics(kind=kind, **own)


def _parameter(record: Mapping[str, Any]) -> Parameter:
    middle, low, high = (_number(record[key]) for key in ("median", "q05", "q95"))
    return Parameter(record["unit"], middle, low, high, record["dispersion"])


def _alias(record: Mapping[str, Any]) -> Alias:
    return Alias(**{**record, "elpd_behind": _number(record["elpd_behind"])})


def _improvement(record: Mapping[str, Any]) -> Improvement:
    errors = {name: _pair(record[name]) for name in ("delta_magnitude", "delta_phase_deg", "subject_rms_relative")}
    blocks = None
    if "elpd_gain_blocks" in record:
        blocks = BlockGain(record["elpd_gain_blocks"], record["elpd_gain_blocks_se"])
    return Improvement(
        **errors,
        coverage90=_pair(record["coverage90"]),
        elpd_gain=record["elpd_gain"],
        elpd_gain_se=record["elpd_gain_se"],
        blocks=blocks,
        held_out=record["held_out"],
    )


def _subjects(value: Any) -> Subjects:
    return "all" if value == "all" else tuple(value)


def _pair(values: Any) -> Pair:
    first, second = values
    return _number(first), _number(second)


def _number(value: float | None) -> float:
    """A number of the file, in which null stands for a non-finite number."""
    return math.nan if value is None else value
