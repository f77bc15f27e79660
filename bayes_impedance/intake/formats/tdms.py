"""NI TDMS files by npTDMS: the channels of one group, with their units and step of time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Contents, Variable
from bayes_impedance.intake.formats.optional_libraries import damaged, library
from bayes_impedance.runtime.user_table import hint, shown


def read(file: Path, record: str | None) -> list[Contents]:
    """One record for each group with channels of numbers, or the group named by `record`."""
    nptdms = library("nptdms", "npTDMS", file)
    try:
        groups = {group.name: group.channels() for group in nptdms.TdmsFile.read(file).groups()}
        if record is not None and record not in groups:
            raise InputError(f"{file}: there is no group {shown(record)}; {hint(record, groups)}")
        wanted = {name: channels for name, channels in groups.items() if record in (None, name)}
        found = {name: _variables(channels) for name, channels in wanted.items()}
    except InputError:
        raise
    except Exception as error:  # npTDMS raises whatever the damaged bytes lead to
        raise damaged(file, "a TDMS file", error) from error
    found = {name: variables for name, variables in found.items() if variables}
    if not found:
        raise InputError(f"{file}: there are no channels of numbers in it; export it again")
    single = len(found) == 1
    return [
        Contents(file=str(file), variables=variables, part="" if single else name) for name, variables in found.items()
    ]


def _variables(channels: list) -> tuple[Variable, ...]:
    found = []
    for channel in channels:
        values = np.asarray(channel[:])
        if values.dtype.kind not in "iufc" or values.size < 2:
            continue
        step = float(channel.properties.get("wf_increment", 0.0) or 0.0)
        unit = str(channel.properties.get("unit_string", "") or "")
        kind = np.complex128 if np.iscomplexobj(values) else np.float64
        found.append(
            Variable(name=channel.name, values=values.astype(kind), unit=unit, rate_hz=1 / step if step > 0 else None)
        )
    return tuple(found)
