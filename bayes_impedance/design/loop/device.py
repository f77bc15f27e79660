r"""A haptic device: what moves between its actuator and the finger, and the controller that shows a virtual wall.

The mechanics are a ladder of **sections** from the actuator to the finger. What is `beside` shares the velocity of
that point and has its other end at ground (the actuator's mass and damping, the mass of a handle); what is `between`
passes the force on to the next point (a belt, a flexible arm); a `lever` makes the next point move by a factor::

    Device("one arm", (Section("beside", "m1|r1", {"m1": 0.05, "r1": 0.01}), Section("between", "n1|r1", {...}),
                       Section("beside", "m1", {"m1": 0.02})), period_s=1e-3, delay_s=0.5e-3)

Looking from the actuator, whatever stands behind a section is its load: with load z, `beside` b shows b + z,
`between` b shows 1/(1/b + 1/z), and a lever of ratio q (velocity behind / velocity before) q² z. So device and user
together are one one-port, of which :mod:`bayes_impedance.design.circuits.state_space` makes states.

The controller reads the actuator's position x once a period T, and holds the force

.. math:: f_k = -K x_k - B\,\frac{x_k - x_{k-1}}{T}

from :math:`kT + \tau` on for one period. The classical condition that this wall be passive, whoever holds the device
[1]_,

.. math:: b > \frac{K T}{2} + |B| ,

knows one number of the device, its damping b, no delay, and nothing of the user.

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

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from bayes_impedance.design.circuits.state_space import Realisation, realise
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Parallel, parse

LONGEST_DELAY = 40
"""Periods: each of them is a state."""

ARRANGEMENTS = ("beside", "between", "lever")
"""How a section is connected: to ground beside the common velocity, between two velocities, or as a lever."""


@dataclass(frozen=True)
class Section:
    """One step from the actuator to the finger.

    Attributes
    ----------
    arrangement : str
        ``beside``, ``between`` or ``lever``.
    network : str
        Notation; empty for a lever.
    values : mapping of str to float
        Of the elements in their units; of a lever its ``ratio``.
    """

    arrangement: str
    network: str
    values: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.arrangement not in ARRANGEMENTS:
            raise InputError(f"a section is one of {', '.join(ARRANGEMENTS)}, not '{self.arrangement}'")
        wanted = {"ratio"} if self.arrangement == "lever" else set(parse(self.network).elements)
        if set(self.values) != wanted or any(not (np.isfinite(v) and v > 0) for v in self.values.values()):
            raise InputError(
                f"section '{self.arrangement} {self.network}': give a positive value for each of "
                f"{', '.join(sorted(wanted))} and for nothing else"
            )

    def seen(self, load: Realisation) -> Realisation:
        """Impedance before the section, with `load` behind it."""
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
        From reading the position to the new force, any number of periods.
    source : str
        Where the numbers come from.
    """

    name: str
    sections: tuple[Section, ...]
    period_s: float = 1e-3
    delay_s: float = 0.0
    source: str = ""

    def __post_init__(self) -> None:
        if not self.period_s > 0 or not self.delay_s >= 0:
            raise InputError(f"device '{self.name}': the period must be positive and the delay not negative")
        if self.delay_s > LONGEST_DELAY * self.period_s:
            raise InputError(f"device '{self.name}': the delay is longer than {LONGEST_DELAY} periods; check its unit")
        first = self.sections[0] if self.sections else None
        moving = first is not None and first.arrangement == "beside" and realise(parse(first.network), first.values)
        if not moving or moving.high != 1:
            raise InputError(
                f"device '{self.name}': its first section must be beside the actuator and contain its mass, for "
                "instance m1|r1"
            )

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
                    "units": {e: kind_of(e).unit("N s/m") for e in s.values if s.arrangement != "lever"},
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
"""A desktop device for one finger, from published numbers."""


def read_device(file: Path) -> Device:
    """Read a device from a TOML file.

    The file has ``name``, ``period_s``, ``delay_s``, ``source`` and a list ``[[section]]`` of tables with
    ``arrangement``, ``network`` and ``values``.

    Raises
    ------
    InputError
        If it cannot be read or is no device.
    """
    try:
        with file.open("rb") as stream:
            table = tomllib.load(stream)
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such file; give a device as TOML") from None
    except (tomllib.TOMLDecodeError, OSError) as error:
        raise InputError(f"{file}: cannot be read as TOML ({error})") from None
    try:
        sections = tuple(
            Section(str(s["arrangement"]), str(s.get("network", "")), {k: float(v) for k, v in s["values"].items()})
            for s in table["section"]
        )
        return Device(
            str(table.get("name", file.stem)),
            sections,
            float(table.get("period_s", 1e-3)),
            float(table.get("delay_s", 0.0)),
            str(table.get("source", "")),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"{file}: is no device ({error}); see bayes_impedance.design.loop.device for an example"
        ) from None
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
