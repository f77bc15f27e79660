r"""Users as Modelica models, for multi-body and control simulations.

A package holds one model whose elements are parameters, and one model for every user that sets them. The model has one
flange, ``finger``, of the Modelica Standard Library's translational mechanics, to which a device is connected; springs
and dampers are those of that library. A parallel group is between the same two points, a chain is a row of points.

A mass acts between its point and the inertial frame. As in the force-current analogy of
:mod:`bayes_impedance.design.circuits.spice`, parts with masses come last in a chain, at the fixed end. If a chain has
two, the first mass acts between two moving points; ``Inertia`` of the package allows this, since it is defined by its
relative acceleration, :math:`f = m\,\ddot s_\text{rel}`.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

from bayes_impedance.design.users import Users
from bayes_impedance.network.notation import Element, Network, Parallel

_KEYWORDS = frozenset({"model", "not", "redeclare", "replaceable", "return"})
"""Words of the language that begin with the letter of an element."""

_LIBRARY = "Modelica.Mechanics.Translational"
_TYPES = {"m": "Modelica.Units.SI.Mass", "n": 'Real(unit="m/N")', "r": 'Real(unit="N.s/m")'}
_PARTS = {
    "m": "Inertia {name}(m={value})",
    "n": _LIBRARY + ".Components.Spring {name}(c=1/{value})",
    "r": _LIBRARY + ".Components.Damper {name}(d={value})",
}

_INERTIA = f"""\
  model Inertia "Mass between a point and the inertial frame; flange_b is fixed"
    extends {_LIBRARY}.Interfaces.PartialCompliant;
    parameter Modelica.Units.SI.Mass m;
    Modelica.Units.SI.Velocity v_rel;
  equation
    v_rel = der(s_rel);
    f = m*der(v_rel);
  end Inertia;
"""


def package(users: Users, name: str = "Users") -> str:
    """Text of a Modelica package.

    Parameters
    ----------
    users : Users
        Of a network of masses, compliances and dampers (:func:`bayes_impedance.design.circuits.equivalent.equivalent`),
        with impedances in N s/m.
    name : str
        Of the package.
    """
    network = users.network
    first = users.of(0)
    parts, connections = [], []
    for element, a, b in _between(network, "finger", "ground.flange", count(1)):
        part = f"{element}_part"
        parts.append(_PARTS[element[0]].format(name=part, value=identifier(element)))
        connections += [f"connect({a}, {part}.flange_a);", f"connect({part}.flange_b, {b});"]
    points = sorted({end for line in connections for end in _points(line)})
    lines = [
        f'package {name} "{len(users)} users of the network {network}"',
        "  // z = F/v at finger; masses in kg, compliances in m/N, dampers in N.s/m",
        _INERTIA,
        '  model User "Elements are parameters"',
        *(f"    parameter {_TYPES[e[0]]} {identifier(e)}={v:.17g};" for e, v in first.items()),
        f'    {_LIBRARY}.Interfaces.Flange_a finger "Where the device is held";',
        "  protected",
        f"    {_LIBRARY}.Components.Fixed ground;",
        *(f"    {_LIBRARY}.Interfaces.Flange_a {point};" for point in points),
        *(f"    {part};" for part in parts),
        "  equation",
        *(f"    {line}" for line in connections),
        "  end User;",
        "",
    ]
    for i, who in enumerate(users.names):
        given = ", ".join(f"{identifier(e)}={v:.17g}" for e, v in users.of(i).items())
        lines.append(f"  model {who} = User({given});")
    return "\n".join([*lines, f"end {name};"]) + "\n"


def identifier(name: str) -> str:
    """Name of an element, in quotation marks if it is a word of the language."""
    return f"'{name}'" if name in _KEYWORDS else name


def _points(connection: str) -> list[str]:
    ends = connection.removeprefix("connect(").removesuffix(");").split(", ")
    return [end for end in ends if end.startswith("point_")]


def _between(network: Network, first: str, second: str, numbers: Iterator[int]) -> Iterator[tuple[str, str, str]]:
    """Every element with the two points that it is between."""
    if isinstance(network, Element):
        yield network.name, first, second
    elif isinstance(network, Parallel):
        for part in network.parts:
            yield from _between(part, first, second, numbers)
    else:
        parts = sorted(network.parts, key=lambda part: any(e[0] == "m" for e in part.elements))
        ends = [first, *(f"point_{next(numbers)}" for _ in parts[1:]), second]
        for part, a, b in zip(parts, ends[:-1], ends[1:], strict=True):
            yield from _between(part, a, b, numbers)
