"""Universal files with data sets 58 (functions at nodal degrees of freedom) by pyuff: ASCII and binary.

A frequency response has in its header what numerator and denominator are (displacement 8, velocity 11, acceleration 12,
force 9 or 13) and at which node and in which direction each is. The unit exponents of a data set 164 are not applied by
most programs, so the labels of the axes are taken where they are units, else SI. A driving point has response and
reference at the same node and in the same direction (the sign of the direction apart: both are then negative along it).
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.formats.optional_libraries import damaged, library
from bayes_impedance.intake.quantities import channel_of, is_response_unit
from bayes_impedance.runtime.user_table import shown

_MARK = b"    -1"
"""Line before and after every data set."""
_SEARCHED = 4096
"""Bytes at both ends of a file in which marks are looked for. By choice: more than a header and blank lines have."""
_TIME, _RESPONSE, _COHERENCE = 1, 4, 6
"""Function types of dataset 58: time response, frequency response function, coherence."""
_SI = {8: "m", 9: "N", 11: "m/s", 12: "m/s^2", 13: "N"}


def read(file: Path, record: str | None) -> list[Contents]:
    """One record for each driving point, or one with all signals if the file has signals of time only."""
    pyuff = library("pyuff", "pyuff", file)
    _require_end(file)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about data sets that are not needed
            content = pyuff.UFF(str(file))
            kinds = np.asarray(content.get_set_types())
            sets = [content.read_sets(int(i)) for i in np.flatnonzero(kinds == 58)]
    except Exception as error:  # pyuff raises many kinds of errors on damaged files
        raise damaged(file, "a universal file", error) from error
    if not sets:
        raise InputError(f"{file}: there is no data set 58 in it; export frequency responses or signals as UFF 58")
    responses = [s for s in sets if int(s["func_type"]) == _RESPONSE]
    signals = [s for s in sets if int(s["func_type"]) == _TIME]
    if responses:
        return _driving_points(responses, [s for s in sets if int(s["func_type"]) == _COHERENCE], file, record)
    if signals:
        variables = [_signal(s, i) for i, s in enumerate(signals)]
        return [Contents(file=str(file), variables=tuple(variables))]
    raise InputError(f"{file}: it has neither frequency responses nor signals of time; export one of them")


def _require_end(file: Path) -> None:
    """Refuse a file that does not end with the mark of a data set's end: pyuff leaves its last data set out."""
    with file.open("rb") as stream:
        beginning = stream.read(_SEARCHED)
        stream.seek(max(0, stream.seek(0, os.SEEK_END) - _SEARCHED))
        end = stream.read()
    if _MARK in beginning and not end.rstrip(b" \r\n\t\x00\x1a").endswith(_MARK):
        raise InputError(f"{file}: its last data set has no end: the file is cut short; export or copy it again")


def _driving_points(
    responses: list[dict[str, Any]], coherences: list[dict[str, Any]], file: Path, record: str | None
) -> list[Contents]:
    own = [s for s in responses if s["rsp_node"] == s["ref_node"] and s["rsp_dir"] == s["ref_dir"]]
    wanted = own
    if record is not None:
        wanted = [s for i, s in enumerate(responses) if record in (str(i + 1), _place(s))]
        if not wanted:
            places = ", ".join(dict.fromkeys(_place(s) for s in responses[:10]))
            raise InputError(f"{file}: there is no record {shown(record)}; there are {places}, or give its number")
    if not wanted:
        raise InputError(
            f"{file}: none of its {len(responses)} frequency responses is a driving point (the first is "
            f"{_place(responses[0])}); an impedance needs force and motion at one point, or name a record with --record"
        )
    notes: tuple[str, ...] = ()
    if record is None and len(own) < len(responses):
        notes = (
            f"{file}: {len(own)} of {len(responses)} frequency responses are driving points; the others are not used",
        )
    if any(_unit(one) and not is_response_unit(_label(one)) for one in wanted):
        notes += (
            f"{file}: units are taken to be SI, as the header says which quantities they are; --unit says otherwise",
        )
    found = []
    for i, one in enumerate(wanted):
        variables = [
            Variable(name="frequency", values=np.asarray(one["x"], dtype=np.float64), unit="Hz"),
            Variable(name="response", values=np.asarray(one["data"], dtype=np.complex128), unit=_unit(one)),
        ]
        same = [c for c in coherences if _place(c) == _place(one) and np.size(c["data"]) == np.size(one["data"])]
        if len(same) == 1:
            variables.append(Variable(name="coherence", values=np.real(same[0]["data"]).astype(np.float64)))
        part = "" if len(wanted) == 1 else str(i + 1)
        found.append(Contents(file=str(file), variables=tuple(variables), part=part, notes=notes))
    return found


def _place(one: dict[str, Any]) -> str:
    """Response and reference as in ``3+2/3+2`` (node, direction)."""
    return "/".join(f"{int(one[f'{k}_node'])}{int(one[f'{k}_dir']):+d}" for k in ("rsp", "ref"))


def _unit(one: dict[str, Any]) -> str:
    """Unit of a response: by the labels of both axes, else SI by what the header says they are; empty if unknown."""
    labels = [str(one.get(f"{k}_axis_units_lab") or "").strip() for k in ("ordinate", "orddenom")]
    if is_response_unit(labels[0]):
        return labels[0]
    kinds = [int(one.get(f"{k}_spec_data_type") or 0) for k in ("ordinate", "orddenom")]
    units = [label if channel_of(label) else _SI.get(kind, "") for label, kind in zip(labels, kinds, strict=True)]
    return f"({units[0]})/({units[1]})" if all(units) else ""


def _label(one: dict[str, Any]) -> str:
    """Unit of a response by the labels of its axes alone."""
    labels = [str(one.get(f"{k}_axis_units_lab") or "").strip() for k in ("ordinate", "orddenom")]
    return labels[0] if is_response_unit(labels[0]) else f"({labels[0]})/({labels[1]})"


def _signal(one: dict[str, Any], index: int) -> Variable:
    label = str(one.get("ordinate_axis_units_lab") or "").strip()
    unit = label if channel_of(label) else _SI.get(int(one.get("ordinate_spec_data_type") or 0), "")
    step = float(np.mean(np.diff(one["x"]))) if np.size(one["x"]) > 1 else 0.0
    name = str(one.get("id1") or "").strip()
    return Variable(
        name=name if name not in ("", "NONE") else f"signal {index + 1}",
        values=np.real(one["data"]).astype(np.float64),
        unit=unit,
        rate_hz=1 / step if step > 0 else None,
    )
