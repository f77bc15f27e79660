r"""A network as a program: small arrays evaluated by one compiled function.

Every group of the network is a **node** that sums its parts, impedances in a parallel group and mobilities in a
series group. A leaf in its node's domain is :math:`c\,(j\omega)^p` with :math:`c = e^{\pm\theta}`. An
:mod:`operation <bayes_impedance.network.operations>` is a node of its own, above the place on which it acts; so is a
wrapper, and a power law, which adds to nothing. The program lists the nodes, parts before parents;
:mod:`bayes_impedance.network.kernel` runs it.

Parameters that are held have no place in theta: their numbers begin where theta ends, and their values are in the
program.

For an element that follows :mod:`its own motion <bayes_impedance.network.own_motion>` the program has, before all else,
a copy of the network without operations, apart from the rest, whose nodes tell how the element moves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numba.core import types as numba_types

from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.extensions import RADIAN_PER_SECOND, PowerLaw, Wrapped
from bayes_impedance.network.operations import LOGARITHMIC, N_PARAMETERS, TRAITS, Operation, code_of
from bayes_impedance.network.parameters import SIGNED, Parameter
from bayes_impedance.network.transform import transform_many
from bayes_impedance.network.tree import Element, Network, Series
from bayes_impedance.runtime.compiled_functions import kept_njit

PORT, DETACHED = -1, -2
"""Instead of a parent: of the node whose output is the port's impedance, and of the last node of a copy."""


class Program(NamedTuple):
    """A network as straight-line arithmetic.

    Attributes
    ----------
    term_node, term_element, term_exponent, term_power : ndarray of int, shape (T,)
        For each leaf: the node it is summed in, the element it is, and c = exp(exponent * theta), p in that domain.
    node_parent, node_invert : ndarray of int, shape (N,)
        For each node, parts before parents: where its sum goes (:data:`PORT`, or :data:`DETACHED`), and whether it is
        inverted first.
    node_code : ndarray of int, shape (N,)
        Operation on the node's sum; 0 for none.
    node_parameter : ndarray of int, shape (N, 3)
        Its parameters' positions in theta; -1 for none.
    node_constant : ndarray of float, shape (N, 3)
    held : ndarray, shape (H,)
        Values of the held parameters, on the scale of theta; parameter P + h is the h-th of them.
    motion : ndarray of int, shape (M, 3)
        Factors of the velocities that elements follow: node of the operation, node whose output is the factor, power.
    """

    term_node: np.ndarray
    term_element: np.ndarray
    term_exponent: np.ndarray
    term_power: np.ndarray
    node_parent: np.ndarray
    node_invert: np.ndarray
    node_code: np.ndarray
    node_parameter: np.ndarray
    node_constant: np.ndarray
    held: np.ndarray
    motion: np.ndarray


def compile_network(
    network: Network,
    operations: Sequence[Operation] = (),
    held: Mapping[str, float] | None = None,
    scales: Mapping[str, float] | None = None,
) -> Program:
    """Translate a network into a program for the compiled functions.

    Parameters
    ----------
    network : Network
        Parameters are numbered in the order of ``network.elements``.
    operations : sequence of Operation
        Those at one place are applied in this order; their parameters are numbered after the network's.
    held : mapping of str to float, optional
        Parameters that are held besides those that the network holds, on the scale of theta.
    scales : mapping of str to float, optional
        Of signed parameters: their value in their unit at theta = 1; 1 where none is given.
    """
    held, scales = dict(held or {}), dict(scales or {})
    free = [name for name in parameter_names(network, operations) if name not in held]
    index = {name: i for i, name in enumerate(free)}
    values: list[float] = []

    def position(name: str, value: float | None = None) -> int:
        if value is None and name in index:
            return index[name]
        values.append(held[name] if value is None else value)
        return len(free) + len(values) - 1

    def own_position(parameter: Parameter) -> int:
        known = parameter.symbol.value
        scale = scales.get(parameter.name, 1.0) if parameter.link == SIGNED else 1.0
        return position(parameter.name, None if known is None else float(parameter.u(known)) / scale)

    terms: list[tuple[int, int, int, int]] = []
    nodes: list[_Node] = []

    def visit(node: Network, path: tuple[int, ...], parent_is_mobility: bool, apart: tuple[int, ...] | None) -> int:
        """Append the child nodes, then this one; the caller fills in the parent's number.

        In a copy nothing acts, and the element at the path `apart` is a node of its own, as is every part on the way.
        """
        acting = operations if apart is None else ()
        here = [operation for operation in acting if operation.path == path]
        mobility = isinstance(node, Series)
        if isinstance(node, PowerLaw | Wrapped):
            child = visit(node.part, (*path, 0), False, apart) if isinstance(node, Wrapped) else None
            if child is not None:
                nodes[child].parent = len(nodes)
            positions = [own_position(parameter) for parameter in node.own_parameters]
            invert = parent_is_mobility and not here
            nodes.append(_Node(invert, *_compiled(node, scales), parameters=positions))
        else:
            parts = list(enumerate(node.parts))
            own = {apart, *(operation.path for operation in acting)}
            plain = {i for i, part in parts if isinstance(part, Element) and (*path, i) not in own}
            leaves = [node] if isinstance(node, Element) else [part for i, part in parts if i in plain]
            children = [visit(part, (*path, i), mobility, apart) for i, part in parts if i not in plain]
            number = len(nodes)
            nodes.append(_Node(invert=mobility != (parent_is_mobility and not here)))
            for child in children:
                nodes[child].parent = number
            for leaf in leaves:
                assert isinstance(leaf, Element)  # by how they were chosen
                kind, sign = kind_of(leaf.name), -1 if mobility else 1
                terms.append((number, own_position(leaf.own_parameters[0]), sign * kind.exponent, sign * kind.power))
        for i, operation in enumerate(here):
            nodes[-1].parent = len(nodes)
            last = i == len(here) - 1
            positions = [position(name) for name in operation.parameters]
            nodes.append(
                _Node(parent_is_mobility and last, operation.code, list(operation.constants), parameters=positions)
            )
            of_operation[id(operation)] = len(nodes) - 1
        if apart is not None and path == apart[: len(path)]:
            on_the_way.append(len(nodes) - 1)
        return len(nodes) - 1

    of_operation, motions = dict[int, int](), list[tuple[Operation, dict[int, int]]]()
    on_the_way: list[int] = []
    for operation in operations:
        if TRAITS[operation.name].follows_motion:
            on_the_way = []
            visit(network, (), False, operation.path)
            nodes[-1].parent = DETACHED
            motions.append((operation, _velocity(network, operation.path, on_the_way[::-1], nodes)))
    visit(network, (), False, None)
    motion = [(of_operation[id(o)], node, power) for o, powers in motions for node, power in powers.items() if power]
    columns = np.array(terms, dtype=np.int64).reshape(-1, 4).T
    padded = [(n.parameters + [-1] * N_PARAMETERS)[:N_PARAMETERS] for n in nodes]
    constants = [(n.constants + [0.0] * N_PARAMETERS)[:N_PARAMETERS] for n in nodes]
    node, element, exponent, power = (np.ascontiguousarray(column) for column in columns)
    return Program(
        node,
        element,
        exponent,
        power,
        np.array([n.parent for n in nodes], dtype=np.int64),
        np.array([n.invert for n in nodes], dtype=np.int64),
        np.array([n.code for n in nodes], dtype=np.int64),
        np.array(padded, dtype=np.int64),
        np.array(constants, dtype=float),
        np.array(values, dtype=float),
        np.array(motion, dtype=np.int64).reshape(-1, 3),
    )


def _velocity(network: Network, path: tuple[int, ...], way: Sequence[int], nodes: Sequence[_Node]) -> dict[int, int]:
    """Powers of the nodes' outputs whose product is the velocity at a path per unit of the port's force.

    `way` are the nodes from the port to the path.
    """
    powers = dict.fromkeys(way, 0)
    powers[way[0]] -= 1
    node = network
    for i, group, part in zip(path, way[:-1], way[1:], strict=True):
        if isinstance(node, Series):
            powers[part] += 1
            powers[group] += 1 if nodes[group].invert else -1
        node = node.parts[i]
    return powers


def _compiled(node: PowerLaw | Wrapped, scales: Mapping[str, float]) -> tuple[int, list[float]]:
    """Code and constants of the operation that computes a power law or a wrapper."""
    if isinstance(node, PowerLaw):
        exponent = node.own_parameters[1]
        omega = 2 * np.pi * (node.reference_hz or RADIAN_PER_SECOND)
        return code_of("power_law"), [exponent.quantity.low, omega, LOGARITHMIC]
    first = node.own_parameters[0]
    letters = [parameter.letter for parameter in node.own_parameters]
    constants = node.construct.constants(letters, first.link, scales.get(first.name, 1.0), first.quantity.factor)
    return code_of(node.construct.operation), list(constants)


def changed_by(
    node: Wrapped, u: Mapping[str, np.ndarray], omega: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What a wrapper makes of the impedance inside, and the derivative of that with respect to it.

    Parameters
    ----------
    node : Wrapped
    u : mapping of str to ndarray, shape (M,)
        The parameters that are not held.
    omega : ndarray, shape (F,)
    z : ndarray, complex, shape (M, F)

    Returns
    -------
    T, dT : ndarray, complex, shape (M, F)
    """
    code, constants = _compiled(node, {})
    own = np.zeros((len(z), N_PARAMETERS))
    for k, parameter in enumerate(node.own_parameters):
        known = parameter.symbol.value
        own[:, k] = u[parameter.name] if known is None else float(parameter.u(known))
    t = transform_many(code, own, np.array(constants), omega, np.ascontiguousarray(z))
    return t[0], t[1]


def parameter_names(network: Network, operations: Sequence[Operation]) -> tuple[str, ...]:
    """Names of all parameters that the network does not hold: its own, then those of the operations."""
    return network.elements + tuple(name for operation in operations for name in operation.parameters)


@dataclass
class _Node:
    """A node during the compilation of a program."""

    invert: bool
    code: int = 0
    constants: list[float] = field(default_factory=list)
    parameters: list[int] = field(default_factory=list)
    parent: int = PORT


types: Any = numba_types  # without annotations
_LINE, _BLOCK = (types.Array(types.float64, n, "C") for n in (1, 2))
_NUMBERS, _NUMBER_ROWS = (types.Array(types.int64, n, "C") for n in (1, 2))
PROGRAM = types.NamedTuple((*[_NUMBERS] * 7, _NUMBER_ROWS, _BLOCK, _LINE, _NUMBER_ROWS), Program)
"""numba's type of a :class:`Program`."""

_compiled_function: Any = kept_njit(nogil=True, error_model="numpy")


@_compiled_function
def parameter_of(program: Program, position: int, theta: np.ndarray) -> float:
    """A parameter by its number; zero for -1."""
    if position < 0:
        return 0.0
    return theta[position] if position < theta.size else program.held[position - theta.size]  # type: ignore[no-any-return]


@_compiled_function
def parameters_of(program: Program, node: int, theta: np.ndarray) -> tuple[float, float, float]:
    """Those of a node's operation."""
    row = program.node_parameter
    return (
        parameter_of(program, row[node, 0], theta),
        parameter_of(program, row[node, 1], theta),
        parameter_of(program, row[node, 2], theta),
    )
