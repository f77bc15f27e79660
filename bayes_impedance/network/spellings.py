"""A network as it is shown: as networks are written, and of electrical recordings also as circuits are.

The one place that decides when the second spelling is shown: the unit is that of electrical recordings, and circuits
have an element for every part (:mod:`.electrical`; a delay, for example, has none). A circuit's text says what is
connected with what. Which elements are the same for everybody or held, and at which frequency a power law's size is
given, is left out of it.
"""

from __future__ import annotations

import re

from bayes_impedance.errors import InputError
from bayes_impedance.network.electrical import electrical
from bayes_impedance.network.notation import parse
from bayes_impedance.units import ELECTRICAL_UNIT

_NO_PART_OF_A_CIRCUIT = re.compile(r"\*|[=@]-?\d[\d.]*(?:e[-+]?\d+)?")
"""Marks behind names: the same for everybody, held at a value, a power law's reference frequency."""


def circuit_of(notation: str | None, unit: str) -> str:
    """The network in the spelling of circuits, or an empty text if it is not to be shown so.

    Parameters
    ----------
    notation : str or None
        Any text; what is no network has no spelling.
    unit : str
        Of the recordings' impedance.
    """
    if unit != ELECTRICAL_UNIT or not notation:
        return ""
    try:
        return electrical(parse(_NO_PART_OF_A_CIRCUIT.sub("", str(parse(notation)))))
    except InputError:
        return ""


def in_both(notation: str, unit: str) -> str:
    """The network, with its spelling as a circuit behind an equals sign where it has one.

    Examples
    --------
    >>> in_both("r0|(r1-n1)", "ohm")
    'r0|(r1-n1) = R0-p(R1,C1)'
    >>> in_both("m1|(r1-n1)", "N s/m")
    'm1|(r1-n1)'
    """
    circuit = circuit_of(notation, unit)
    return f"{notation} = {circuit}" if circuit else notation
