"""NI TDMS files by npTDMS: the channels of one group, with their units and step of time."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
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
        with _complaints("nptdms") as complaints:
            groups = {group.name: group.channels() for group in nptdms.TdmsFile.read(file).groups()}
        if complaints:
            raise ValueError(complaints[0])  # it reads what there is of a file that is cut short
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


@contextmanager
def _complaints(library_name: str) -> Iterator[list[str]]:
    """Warnings that a library writes to its log meanwhile, in place of showing them."""
    said: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    loggers = [logging.getLogger(n) for n in list(logging.root.manager.loggerDict) if n.split(".")[0] == library_name]
    before = [(logger, logger.propagate, logger.handlers) for logger in loggers]
    for logger in loggers:
        logger.propagate, logger.handlers = False, [handler]
    try:
        yield said
    finally:
        for logger, propagate, handlers in before:
            logger.propagate, logger.handlers = propagate, handlers


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
