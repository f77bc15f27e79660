r"""A haptic device: the mechanics between its actuator and the finger, and the controller that renders a virtual wall.

The mechanics are a ladder of **sections** from the actuator to the finger. A section `beside` is connected between that
point and ground (the actuator's mass and damping, the mass of a handle). A section `between` transmits the force to the
next point (a belt, a flexible arm). A `lever` scales the velocity of the next point by a factor::

    Device("one arm", (Section("beside", "m1|r1", {"m1": 0.05, "r1": 0.01}), Section("between", "n1|r1", {...}),
                       Section("beside", "m1", {"m1": 0.02})), period_s=1e-3, delay_s=0.5e-3)

Seen from the actuator, the parts behind a section are its load. With load z, the input impedance of `beside` b is
b + z, of `between` b 1/(1/b + 1/z), and of a lever of ratio q (velocity behind / velocity before) q² z. So device and
user together are a single one-port; :mod:`bayes_impedance.design.circuits.state_space` gives its state space.

The controller reads the actuator's position x once a period T, and holds the force

.. math:: f_k = -K x_k - B\,\frac{x_k - x_{k-1}}{T}

from :math:`kT + \tau` on for one period. The classical condition for this wall to be passive with any user [1]_,

.. math:: b > \frac{K T}{2} + |B| ,

contains only one property of the device, its damping b. It does not consider delay or the user's impedance.

References
----------
.. [1] J. E. Colgate, G. G. Schenkel, "Passivity of a class of sampled-data systems: application to haptic interfaces",
   Journal of Robotic Systems 14 (1997) 37-47.
.. [2] T. H. Massie, J. K. Salisbury, "The PHANTOM haptic interface: a device for probing virtual objects", Proc. ASME
   Winter Annual Meeting, DSC 55-1 (1994) 295-300.
.. [3] N. Diolaiti, G. Niemeyer, F. Barbagli, J. K. Salisbury, "Stability of haptic rendering: discretization,
   quantization, time delay, and Coulomb effects", IEEE Trans. Robotics 22 (2006) 256-268.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayes_impedance.design.circuits.state_space import Realisation, realise
from bayes_impedance.display import Brief, heading, joined, lines, number, short, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Parallel, parse
from bayes_impedance.runtime.input_files import read_toml
from bayes_impedance.runtime.user_table import UserTable, choice_in, hint, number_in, shown, text_in
from bayes_impedance.units import unit_of

LONGEST_DELAY = 40
"""Longest delay in periods. By choice: each period is a state of the loop, and the cost rises with their number."""

ARRANGEMENTS = ("beside", "between", "lever")
"""How a section is connected: to ground beside the common velocity, between two velocities, or as a lever."""

LONGEST_PERIOD_S = 0.1
"""Longest sampling period in s. By choice: controllers slower than 10 Hz do not render touch, so a larger number is
probably in ms or Hz."""

SMALLEST_VALUE, LARGEST_VALUE = 1e-12, 1e12
"""Range of elements and of lever ratios, in their units. By choice: wide enough for any device; beyond it the states of
the loop differ by more than double precision can represent."""

_DEVICE_KEYS = ("name", "source", "period_s", "delay_s", "section")
_SECTION_KEYS = ("arrangement", "network", "values", "units")
_UNIT = "N s/m"


@dataclass(frozen=True, repr=False)
class Section(Brief):
    """One step from the actuator to the finger.

    Attributes
    ----------
    arrangement : str
        ``beside``, ``between`` or ``lever``.
    network : str
        Notation; empty for a lever.
    values : mapping of str to float
        Values of the elements in their units; the ``ratio`` of a lever.
    """

    arrangement: str
    network: str
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        choice_in(self.arrangement, "a section's arrangement", ARRANGEMENTS)
        lever = self.arrangement == "lever"
        text_in(self.network, "a section's network")
        section = "section 'lever'" if lever else f"section '{self.arrangement} {self.network}'"
        if lever and self.network:
            raise InputError(f"{section}: a lever has a ratio and no network; make the network a section of its own")
        wanted = ("ratio",) if lever else parse(self.network).elements
        surplus = [name for name in self.values if name not in wanted]
        missing = [name for name in wanted if name not in self.values]
        if surplus or missing:
            about = f"'{missing[0]}' has none" if missing else ""
            about = f"{shown(surplus[0])} is not used ({hint(str(surplus[0]), wanted)})" if surplus else about
            raise InputError(
                f"{section}: {about}; give a positive value for each of {', '.join(wanted)} and for nothing else"
            )
        for name in wanted:
            number_in(self.values[name], f"{section}: {name}", at_least=SMALLEST_VALUE, at_most=LARGEST_VALUE)
        object.__setattr__(self, "values", {name: float(self.values[name]) for name in wanted})

    def seen(self, load: Realisation) -> Realisation:
        """Input impedance of the section with `load` behind it."""
        if self.arrangement == "lever":
            return load.scaled(self.values["ratio"] ** 2)
        own = realise(parse(self.network), {e: np.full(load.m.shape, v) for e, v in self.values.items()})
        if self.arrangement == "beside":
            return own + load
        return (own.reciprocal() + load.reciprocal()).reciprocal()


@dataclass(frozen=True)
class Device:
    """A device with a sampled controller.

    Attributes
    ----------
    name : str
    sections : tuple of Section
        From the actuator to the finger. The first must contain a mass that moves with the actuator.
    period_s : float
        Sampling period T.
    delay_s : float
        Time from reading the position to the new force; need not be a whole number of periods.
    source : str
        Source of the numbers.
    """

    name: str
    sections: tuple[Section, ...]
    period_s: float = 1e-3
    delay_s: float = 0.0
    source: str = ""

    def __post_init__(self) -> None:
        number_in(self.period_s, f"device '{self.name}': period_s", above=0, at_most=LONGEST_PERIOD_S)
        number_in(self.delay_s, f"device '{self.name}': delay_s", at_least=0)
        if self.delay_s > LONGEST_DELAY * self.period_s:
            raise InputError(f"device '{self.name}': the delay is longer than {LONGEST_DELAY} periods; check its unit")
        first = self.sections[0] if self.sections else None
        moving = first is not None and first.arrangement == "beside" and realise(parse(first.network), first.values)
        if not moving or moving.high != 1:
            raise InputError(
                f"device '{self.name}': its first section must be beside the actuator and contain its mass, for "
                "instance m1|r1"
            )

    def __repr__(self) -> str:
        return f"<Device {short(self.name)}: {len(self.sections)} section(s), {1 / self.period_s:.4g} Hz>"

    def _repr_html_(self) -> str:
        rows = [
            (s.arrangement, s.network or "-", ", ".join(f"{name} = {number(v)}" for name, v in s.values.items()))
            for s in self.sections
        ]
        time = f"period {number(self.period_s)} s, delay {number(self.delay_s)} s"
        sections = table(["section", "network", "values in SI units"], rows)
        return joined(heading(repr(self).strip("<>")), sections, lines([time, *filter(None, [self.source])]))

    @property
    def damping(self) -> float:
        """Damping b of the actuator in the classical bound: dampers between its point and ground, or zero."""
        network = parse(self.sections[0].network)
        parts = network.parts if isinstance(network, Parallel) else (network,)
        return float(sum(self.sections[0].values[e] for e in map(str, parts) if e in network.elements and e[0] == "r"))

    def with_load(self, load: Realisation) -> Realisation:
        """Impedance at the actuator with `load` at the finger."""
        for section in reversed(self.sections):
            load = section.seen(load)
        return load

    def classical_stiffness(self, b: np.ndarray | float) -> np.ndarray:
        """Largest stiffness in N/m of the classical bound for virtual damping in N s/m; zero where there is none."""
        return np.asarray(np.maximum(2 * (self.damping - np.abs(b)) / self.period_s, 0.0))

    def described(self) -> dict[str, object]:
        """For JSON, in the form that :func:`read_device` reads as TOML."""
        return {
            "name": self.name,
            "source": self.source,
            "period_s": self.period_s,
            "delay_s": self.delay_s,
            "section": [
                {
                    "arrangement": s.arrangement,
                    "network": s.network,
                    "values": dict(s.values),
                    "units": {} if s.arrangement == "lever" else {e: kind_of(e).unit(_UNIT) for e in s.values},
                }
                for s in self.sections
            ],
        }


PHANTOM = Device(
    "PHANTOM 1.0, one axis",
    (
        Section("beside", "m1|r1", {"m1": 0.072, "r1": 0.005}),
        Section("between", "n1|r1", {"n1": 1 / 3500.0, "r1": 0.5}),
        Section("beside", "m1", {"m1": 0.003}),
    ),
    period_s=1e-3,
    delay_s=0.0,
    source="moving mass 0.072 kg and damping 0.005 N s/m of a PHANTOM 1.0: Diolaiti et al. 2006; apparent mass at the "
    "tip 0.075 kg, stiffness 3.5 N/mm and servo rate 1 kHz: SensAble's data sheet of the PHANTOM Premium 1.0 (design: "
    "Massie and Salisbury 1994). Ours: damping of the structure (0.08 of critical), the rest of the mass at the tip",
)
"""A desktop device for one finger. Its `source` states which numbers are published and which are assumed."""


def read_device(file: str | os.PathLike[str]) -> Device:
    """Read a device from a TOML file.

    The file has ``name``, ``period_s``, ``delay_s``, ``source`` and a list ``[[section]]`` of tables with
    ``arrangement``, ``network``, ``values`` and, for information, their ``units``. Only the period and a section are
    required: a stability limit is not safe if the package assumes a period that the device does not have.

    Raises
    ------
    InputError
        If the file cannot be read, does not describe a device, or has an unknown key.
    """
    file = Path(file)
    table = UserTable(read_toml(file, "a device"), str(file), _DEVICE_KEYS)
    sections = table["section"]
    if not isinstance(sections, list) or not sections:
        raise InputError(f"{file}: section is {shown(sections)}, but must be a list of tables; write [[section]]")
    try:
        return Device(
            table.text("name", file.stem),
            tuple(_section(s, f"{file}, section {i}") for i, s in enumerate(sections, 1)),
            table.number("period_s"),
            table.number("delay_s", 0.0),
            table.text("source", ""),
        )
    except InputError as error:
        told = str(error)
        raise InputError(told if told.startswith(str(file)) else f"{file}: {told}") from None


def _section(content: object, where: str) -> Section:
    table = UserTable(content, where, _SECTION_KEYS)
    values = table["values"]
    if not isinstance(values, Mapping):
        raise InputError(f"{where}: values is {shown(values)}, but must be a table such as {{m1 = 0.05, r1 = 0.01}}")
    units = table.get("units", {})
    if not isinstance(units, Mapping):
        raise InputError(f'{where}: units is {shown(units)}, but must be a table such as {{m1 = "kg"}}')
    for name, unit in units.items():
        wanted = unit_of(str(name)[:1], _UNIT) if name in values else ""
        if unit != wanted:
            remedy = f'convert its value to "{wanted}"' if wanted else "it has no value; take it out"
            raise InputError(f"{where}: the unit of {shown(name)} is {shown(unit)}; {remedy}")
    try:
        return Section(
            table.choice("arrangement", ARRANGEMENTS), table.text("network", ""), {str(k): v for k, v in values.items()}
        )
    except InputError as error:
        told = str(error)
        raise InputError(told if told.startswith(where) else f"{where}: {told}") from None
