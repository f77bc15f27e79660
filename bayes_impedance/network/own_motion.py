r"""An element that follows the amplitude of its own motion.

A spring that is stiffer, or a damper that is weaker, the further it moves has at each frequency of a stepped sine
another value. If the port is driven with a force of constant amplitude, the velocity at a place is given by the
mobilities on the way to it: :math:`v/F = 1/Z` at the port, the same in every part of a parallel group, and divided
among the parts of a series group,

.. math:: \frac{v_\text{part}}{v_\text{group}} = \frac{y_\text{part}}{Y_\text{group}}.

With :math:`H = v/F` at the element, it moves by :math:`|H|/\omega` per unit of force. With :math:`a = |H|/(\omega p)`,
where p is the motion at which half of the change is reached, the element's impedance becomes

.. math:: T(z) = z\,e^{x h}, \qquad h = \frac{a^2}{1 + a^2}.

H is that of the network whose elements all keep the values that they have at rest. So the law is the first step of the
method of harmonic balance: the change that an element undergoes does not act back on its motion.

**Derivative.** Only the magnitude of H enters, so T is not holomorphic in the elements. H is a product of the outputs
o of nodes, :math:`\log H = \sum_n e_n \log o_n`, which are holomorphic, so that

.. math:: \frac{\partial T}{\partial\theta} = 2 T x h(1 - h)\,\operatorname{Re}\frac{\partial\log H}{\partial\theta}.

The program has a copy of the network for each such element, apart from the rest. Its nodes give H, and the adjoints
that begin with :math:`e_n/o_n` give the derivative of log H, in one more pass backwards.

Source: Krylov and Bogoliubov 1937 (equivalent linearisation); Worden and Tomlinson 2001, Nonlinearity in Structural
Dynamics, chapter 3 (harmonic balance).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.core import types as numba_types

from bayes_impedance.network.operations import N_PARAMETERS, TRAITS
from bayes_impedance.network.program import DETACHED, PROGRAM, Program, parameter_of, parameters_of
from bayes_impedance.network.rows import coefficient, slopes_row_apart
from bayes_impedance.network.tree import Network, Series
from bayes_impedance.runtime.compiled_functions import by_address, kept_njit

compiled: Any = kept_njit(nogil=True, error_model="numpy")

OWN_MOTION = TRAITS["own_motion"].code


def motion_per_force(
    network: Network, path: tuple[int, ...], s: npt.ArrayLike, values: Mapping[str, Any]
) -> np.ndarray:
    """How far a place moves per unit of the port's force, by plain recursion.

    Parameters
    ----------
    network : Network
    path : tuple of int
        Of the place.
    s : array_like, complex, shape (...)
        Complex frequency in rad/s.
    values : mapping of str to array_like
        Value of each parameter in its unit; broadcast against `s`.

    Returns
    -------
    ndarray, shape (...)
        Magnitude, in the unit of a compliance.
    """
    node, here = network, np.asarray(network.impedance(s, values))
    velocity = 1 / here
    for i in path:
        part = node.parts[i]
        inside = np.asarray(part.impedance(s, values))
        if isinstance(node, Series):
            velocity = velocity * here / inside
        node, here = part, inside
    return np.asarray(np.abs(velocity / np.asarray(s)))


def saturating_share(motion: npt.ArrayLike, knee: npt.ArrayLike) -> np.ndarray:
    """The h of a motion and the one at which it is a half."""
    square = (np.asarray(motion) / np.asarray(knee)) ** 2
    return np.asarray(square / (1 + square))


@compiled
def _share(motion: np.ndarray, node: int, outputs: np.ndarray, f: int, still: float) -> float:
    """The h of an operation's node at one frequency; `still` is the square of omega times the knee."""
    square = 1.0
    for k in range(motion.shape[0]):
        if motion[k, 0] == node:
            x, y = outputs[motion[k, 1], 0, f], outputs[motion[k, 1], 1, f]
            size = x * x + y * y
            for _ in range(abs(motion[k, 2])):
                square = square * size if motion[k, 2] > 0 else square / size
    return square / (square + still)


@compiled
def own_motion_row(
    u: tuple[float, float, float],
    c: np.ndarray,
    omega: np.ndarray,
    motion: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
    node: int,
) -> None:
    """Fill a node's output with T of its sum."""
    x, _ = coefficient(u[0], c[0], c[2])
    knee = np.exp(u[1])
    for f in range(omega.size):
        factor = np.exp(x * _share(motion, node, outputs, f, (omega[f] * knee) ** 2))
        outputs[node, 0, f], outputs[node, 1, f] = factor * sums[node, 0, f], factor * sums[node, 1, f]


@compiled
def own_motion_slopes(
    u: tuple[float, float, float],
    c: np.ndarray,
    omega: np.ndarray,
    motion: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
    adjoints: np.ndarray,
    node: int,
    slopes: np.ndarray,
    pulls: np.ndarray,
) -> None:
    """Fill slopes (3, 2, F) and pulls (N, 2, F), and turn a node's adjoint of T into that of its sum.

    A pull is the derivative of the result with respect to log abs(H).
    """
    x, slope = coefficient(u[0], c[0], c[2])
    knee = np.exp(u[1])
    for f in range(omega.size):
        h = _share(motion, node, outputs, f, (omega[f] * knee) ** 2)
        inner = np.exp(x * h)
        change = inner * complex(adjoints[node, 0, f], adjoints[node, 1, f])
        adjoints[node, 0, f], adjoints[node, 1, f] = change.real, change.imag
        change *= complex(sums[node, 0, f], sums[node, 1, f])
        slopes[0, 0, f], slopes[0, 1, f] = slope * h * change.real, slope * h * change.imag
        change *= 2.0 * x * h * (1.0 - h)
        slopes[1, 0, f], slopes[1, 1, f] = -change.real, -change.imag
        slopes[2, 0, f], slopes[2, 1, f] = 0.0, 0.0
        pulls[node, 0, f], pulls[node, 1, f] = change.real, change.imag


@compiled
def backward_motion(
    program: Program,
    theta: np.ndarray,
    omega: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
    adjoints: np.ndarray,
    pulls: np.ndarray,
    derivative: np.ndarray,
) -> None:
    """Add to the derivative (P, 2, F) what comes through the motion, for every copy of the network in the program."""
    n_nodes, n_frequencies = program.node_parent.size, omega.size
    slopes = np.empty((N_PARAMETERS, 2, n_frequencies))
    start = 0
    for root in range(n_nodes):
        if program.node_parent[root] != DETACHED:
            continue
        follower = -1
        for k in range(program.motion.shape[0]):
            if start <= program.motion[k, 1] <= root:
                follower = program.motion[k, 0]
        for node in range(root, start - 1, -1):
            _adjoint_of_log(program, node, outputs, adjoints)
            if program.node_code[node] > 0:
                u, c = parameters_of(program, node, theta), program.node_constant[node]
                slopes_row_apart(program.node_code[node], u, c, omega, sums, adjoints, node, slopes)
                for k in range(N_PARAMETERS):
                    p = program.node_parameter[node, k]
                    if 0 <= p < theta.size:
                        for f in range(n_frequencies):
                            derivative[p, 0, f] += pulls[follower, 0, f] * slopes[k, 0, f]
                            derivative[p, 1, f] += pulls[follower, 1, f] * slopes[k, 0, f]
        for t in range(program.term_node.size):
            node, element = program.term_node[t], program.term_element[t]
            if start <= node <= root and element < theta.size:
                exponent, power = program.term_exponent[t], program.term_power[t]
                c = exponent * np.exp(exponent * parameter_of(program, element, theta))
                for f in range(n_frequencies):
                    if power == 0:
                        change = c * adjoints[node, 0, f]
                    elif power == 1:
                        change = -c * omega[f] * adjoints[node, 1, f]
                    else:
                        change = c / omega[f] * adjoints[node, 1, f]
                    derivative[element, 0, f] += pulls[follower, 0, f] * change
                    derivative[element, 1, f] += pulls[follower, 1, f] * change
        start = root + 1


@compiled
def _adjoint_of_log(program: Program, node: int, outputs: np.ndarray, adjoints: np.ndarray) -> None:
    """Derivative of log H with respect to a node's sum, or to what its operation makes of the sum."""
    parent = program.node_parent[node]
    power = 0
    for k in range(program.motion.shape[0]):
        if program.motion[k, 1] == node:
            power = program.motion[k, 2]
    for f in range(outputs.shape[2]):
        o = complex(outputs[node, 0, f], outputs[node, 1, f])
        bar = power / o
        if parent != DETACHED:
            bar += complex(adjoints[parent, 0, f], adjoints[parent, 1, f])
        if program.node_invert[node] == 1:
            bar *= -o * o
        adjoints[node, 0, f], adjoints[node, 1, f] = bar.real, bar.imag


types: Any = numba_types  # without annotations
_LINE, _BLOCK = (types.Array(types.float64, n, "C") for n in (1, 3))
_OF_NODE = (types.UniTuple(types.float64, 3), _LINE, _LINE, types.Array(types.int64, 2, "C"), _BLOCK, _BLOCK)
own_motion_row_apart = by_address(own_motion_row, (*_OF_NODE, types.int64))
own_motion_slopes_apart = by_address(own_motion_slopes, (*_OF_NODE, _BLOCK, types.int64, _BLOCK, _BLOCK))
backward_motion_apart = by_address(backward_motion, (PROGRAM, *[_LINE] * 2, *[_BLOCK] * 5))
"""The same for the kernel, which does not take their code into its own: most networks have no such element."""
