r"""Networks as SPICE sub-circuits, in both analogies.

================  ==============================  ===================================
mechanical        force-voltage (``fv``)           force-current (``fc``)
================  ==============================  ===================================
force, velocity   voltage, current                 current, voltage
mass m            inductance m                     capacitance m
compliance n      capacitance n                    inductance n
damper r          resistance r                     resistance 1/r
``|`` parallel    series connection                parallel connection
``-`` series      parallel connection              series connection
V/I at the port   impedance F/v                    mobility v/F
================  ==============================  ===================================

In the force-current analogy the circuit looks like the mechanical drawing: a mass is a capacitor to the inertial
frame, which is the sub-circuit's second node (connect it to ground). Parts that contain a mass therefore come last in a
chain.

A linear network needs no operating point, and loops of inductors or nodes between capacitors would make its equations
singular: decks contain ``.options noopac``, which is allowed for circuits of linear elements.

**Filters** of a measurement channel multiply the impedance. A copy of the port's current drives the network, its
voltage passes the filter, and a controlled source shows the result at the port. With negative coefficient, and for
the mobility, the filter is the inverse one.

**Monte Carlo.** Besides one sub-circuit per user there is one whose parameters are drawn anew for each instance,
:math:`u = c + L g` with independent standard normal g and the Cholesky factor L of the users' covariance, which
preserves the correlations. An element is exp u, an exponent lies between its bounds; the elements of ladders are
computed from these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import count

import numpy as np

from bayes_impedance.design.circuits.equivalent import Equivalent
from bayes_impedance.design.circuits.expressions import parameter_name
from bayes_impedance.design.circuits.ladders import FILTERS, coefficient
from bayes_impedance.design.users import UserPopulation, Users, free_parameters
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Element, Network, Parallel
from bayes_impedance.network.operations import Operation
from bayes_impedance.network.parameters import LOGIT
from bayes_impedance.units import ELECTRICAL_UNIT, ratio_of

ANALOGIES = ("fv", "fc")
"""Force-voltage and force-current."""

OPTIONS = ".options noopac"
"""No operating point is computed: linear circuits do not need one, and loops of inductors would make it singular."""

_CARD = {"fv": {"m": "L", "n": "C", "r": "R"}, "fc": {"m": "C", "n": "L", "r": "R"}}
"""First letter of an element's line in either analogy."""


def subcircuit(
    name: str,
    network: Network,
    values: Mapping[str, float],
    analogy: str,
    *,
    filters: Sequence[Operation] = (),
    parameters: Mapping[str, float] | None = None,
) -> str:
    """A network as a sub-circuit with two nodes, whose elements are parameters with default values.

    Parameters
    ----------
    name : str
        Of the sub-circuit.
    network : Network
    values : mapping of str to float
        Defaults, in the elements' units.
    analogy : str
        ``fv`` or ``fc``.
    filters : sequence of Operation
        At the port, see :mod:`bayes_impedance.design.circuits.ladders`.
    parameters : mapping of str to float, optional
        Of the filters.

    Raises
    ------
    InputError
        If the analogy is not known or an element has no value.
    """
    missing = [e for e in network.elements if e not in values]
    if missing:
        raise InputError(f"element '{missing[0]}' has no value: there are values for {', '.join(values) or 'none'}")
    given = " ".join(f"{parameter_name(e)}={values[e]:.17g}" for e in network.elements)
    lines = [f".subckt {name} p q params: {given}"]
    if filters:
        lines += _filtered(network, analogy, filters, dict(parameters or {}))
    else:
        lines += _cards(network, analogy, "p", "q")
    return "\n".join([*lines, f".ends {name}"]) + "\n"


_ANALOGIES_IN_WORDS = {
    False: (
        "* fv: force = voltage, velocity = current, V/I is the impedance F/v",
        "* fc: force = current, velocity = voltage, V/I is the mobility v/F; the second node goes to ground",
    ),
    True: (
        "* fv: the circuit itself, V/I is the impedance",
        "* fc: the dual circuit, V/I is the admittance; the second node goes to ground",
    ),
}
"""What the sub-circuits are, by whether the impedance is electrical."""


def library(users: Users, name: str = "user") -> str:
    """One parametrised sub-circuit in each analogy, and one for every user that sets its parameters.

    Parameters
    ----------
    users : Users
    name : str
        Of the parametrised sub-circuits, before ``_fv`` and ``_fc``.
    """
    lines = [
        f"* {len(users)} users of the network {users.network}, unit of impedance {users.unit}",
        *_ANALOGIES_IN_WORDS[users.unit == ELECTRICAL_UNIT],
        "* units: " + ", ".join(f"{e} in {unit}" for e, unit in users.units.items()),
        "",
    ]
    first = users.of(0)
    lines += [subcircuit(f"{name}_{analogy}", users.network, first, analogy) for analogy in ANALOGIES]
    for i, who in enumerate(users.names):
        given = " ".join(f"{parameter_name(e)}={v:.17g}" for e, v in users.of(i).items())
        for analogy in ANALOGIES:
            lines.append(f".subckt {who}_{analogy} p q\nX1 p q {name}_{analogy} {given}\n.ends {who}_{analogy}")
    return "\n".join(lines) + "\n"


def sweep(users: Users, include: str, band_hz: tuple[float, float], output: str, *, points: int = 100) -> str:
    """A deck that drives every user with 1 A and writes all voltages: the impedances, in the force-voltage analogy.

    Parameters
    ----------
    users : Users
    include : str
        File with the library.
    band_hz : (float, float)
    output : str
        File that ngspice writes.
    points : int
        Per decade.
    """
    lines = [f"* impedance of every user: 1 A into its circuit fv, v(z_user) = {ratio_of(users.unit)}", OPTIONS]
    lines.append(f'.include "{include}"')
    for i, who in enumerate(users.names):
        lines += [f"I{i + 1} 0 z_{who} AC 1", f"X{i + 1} z_{who} 0 {who}_fv"]
    shown = " ".join(f"v(z_{who})" for who in users.names)
    return "\n".join([*lines, *_control(band_hz, points, output, shown), ".end"]) + "\n"


def monte_carlo(population: UserPopulation, name: str = "any_user", made: Equivalent | None = None) -> str:
    """Sub-circuits whose elements are drawn anew for every instance, correlated as the population's.

    Parameters
    ----------
    population : UserPopulation
    name : str
        Of the sub-circuits, before ``_fv`` and ``_fc``.
    made : Equivalent, optional
        Users of the population as elements; needed if its network holds more than masses, compliances and dampers.
    """
    free = free_parameters(population.network)
    centre = population.mu.mean(axis=0)
    varying = [i for i, p in enumerate(free) if p.name not in population.fixed]
    factor = np.zeros((len(free), len(varying)))
    factor[varying] = np.linalg.cholesky(population.covariance[np.ix_(varying, varying)])
    # ngspice evaluates a random parameter anew at each use of its name, but an argument of a call only once.
    numbers = " ".join(f"normal{j + 1}={{agauss(0,1,1)}}" for j in range(len(varying)))
    zeros = " ".join(f"normal{j + 1}=0" for j in range(len(varying)))
    drawn = []
    for i, p in enumerate(free):
        terms = "".join(f"{factor[i, j]:+.12g}*normal{j + 1}" for j in range(len(varying)) if factor[i, j] != 0)
        u = f"{centre[i]:.12g}{terms}"
        lowest, hertz = p.quantity.low, p.quantity.factor
        value = f"{lowest:g}+1/(1+exp(-({u})))" if p.link == LOGIT else f"exp({u})"
        drawn.append(f".param {parameter_name(p.name)}={{{value if hertz == 1 else f'{value}/{hertz:.17g}'}}}")
    network = population.network if made is None else made.users.network
    if made is not None:
        computed = ((parameter_name(name), text) for name, text in made.texts.items())
        drawn += [f".param {name}={{{text}}}" for name, text in computed if text != name]
    blocks = []
    for analogy in ANALOGIES:
        inner = f"{name}_given_{analogy}"
        cards = _cards(network, analogy, "p", "q")
        blocks.append("\n".join([f".subckt {inner} p q params: {zeros}", *drawn, *cards, f".ends {inner}"]))
        outer = f"{name}_{analogy}"
        blocks.append(f".subckt {outer} p q\nX1 p q {inner} {numbers}\n.ends {outer}")
    head = "* elements are log-normal over users: exp(centre + L normal); every instance draws its own normal numbers"
    return "\n\n".join([head, *blocks]) + "\n"


def _control(band_hz: tuple[float, float], points: int, output: str, shown: str) -> list[str]:
    low, high = band_hz
    return [
        ".control",
        "set numdgt=15",
        "set wr_singlescale",
        f"ac dec {points} {low:.17g} {high:.17g}",
        f"wrdata {output} {shown}",
        "quit",
        ".endc",
    ]


def _cards(network: Network, analogy: str, first: str, second: str) -> list[str]:
    """Lines of all elements between two nodes."""
    if analogy not in ANALOGIES:
        raise InputError(f"analogy is '{analogy}': choose fv (force-voltage) or fc (force-current)")
    return list(_between(network, analogy, first, second, count(1)))


def _between(network: Network, analogy: str, first: str, second: str, nodes: Iterator[int]) -> Iterator[str]:
    if isinstance(network, Element):
        letter, parameter = network.name[0], parameter_name(network.name)
        value = f"1/{parameter}" if analogy == "fc" and letter == "r" else parameter
        yield f"{_CARD[analogy][letter]}_{parameter} {first} {second} {{{value}}}"
        return
    chained = isinstance(network, Parallel) == (analogy == "fv")
    # A stable sort: the order is otherwise as written.
    parts = sorted(network.parts, key=_has_mass) if chained and analogy == "fc" else network.parts
    ends = [first, *(f"i{next(nodes)}" for _ in parts[1:]), second]
    for i, part in enumerate(parts):
        a, b = (ends[i], ends[i + 1]) if chained else (first, second)
        yield from _between(part, analogy, a, b, nodes)


def _has_mass(network: Network) -> bool:
    return any(e[0] == "m" for e in network.elements)


def _filtered(
    network: Network, analogy: str, filters: Sequence[Operation], parameters: Mapping[str, float]
) -> list[str]:
    """The network behind filters: a copy of the current drives it, a source gives the filtered voltage."""
    lines = ["Vsense p shown 0", "Fcopy 0 f0 Vsense 1", *_cards(network, analogy, "f0", "0")]
    node = "f0"
    for i, operation in enumerate(filters, 1):
        if operation.name not in FILTERS:
            raise InputError(f"'{operation.name}' is not a filter: build it from elements")
        x = coefficient(operation, parameters)
        out = f"f{i}"
        # The mobility has the inverse filter, and so has a negative coefficient.
        inverse = (x < 0) != (analogy == "fc")
        size = f"{abs(x):.17g}"
        if x == 0:
            lines.append(f"Ef{i} {out} 0 {node} 0 1")
        elif not inverse:
            lines.append(f"Eb{i} b{i} 0 {node} 0 1")
            high = operation.name == "highpass"
            cards = (f"b{i} {out}", f"{out} 0") if high else (f"{out} 0", f"b{i} {out}")
            value = f"{{1/{size}}}" if high else size
            lines += [f"Cf{i} {cards[0]} {value}", f"Rf{i} {cards[1]} 1"]
        else:
            store = f"Cf{i} s{i} 0 {{1/{size}}}" if operation.name == "highpass" else f"Lf{i} s{i} 0 {size}"
            lines += [f"Gs{i} 0 s{i} {node} 0 1", store, f"Ea{i} {out} h{i} {node} 0 1", f"Eb{i} h{i} 0 s{i} 0 1"]
        node = out
    return [*lines, f"Eout shown q {node} 0 1"]
