r"""Compiled evaluation of impedance and its derivative for many parameter sets and frequencies.

A network alternates between two kinds of sum: impedances add in a parallel group, mobilities in a series group. Each
group is therefore one **node** that sums in its own domain and passes its sum to its parent, inverted if the domains
differ. Expressed in the node's domain a leaf is :math:`c\,(j\omega)^p` with :math:`c = e^{\pm\theta}` and
:math:`p \in \{-1, 0, 1\}`, so the leaves of a node contribute

.. math:: v = B + j\left(\omega A - C/\omega\right)

with three real numbers A, B, C for any number of leaves. Only one complex reciprocal per group remains for each
frequency: five for the fingertip's eight elements.

The derivative is computed in reverse mode by the same program. With :math:`w = 1/v` the adjoint of a node's sum is

.. math:: \bar v = \frac{\partial z}{\partial v} = -w^2\, \bar w \quad\text{(inverted)}, \qquad
          \bar v = \bar w \quad\text{(passed on)},

and a leaf's derivative with respect to its logarithm is :math:`\pm\bar v\, c\,(j\omega)^p`: no division is repeated.

An :mod:`operation <bayes_impedance.network.operations>` at a place is a node of its own: its sum is the impedance z of
the place, its output T(z), and backwards :math:`\bar z = T'(z)\,\bar T`. One that follows the motion of its place is
not holomorphic, and is in :mod:`bayes_impedance.network.own_motion`.

The program is data (:mod:`bayes_impedance.network.program`), so one compiled function serves every network; it is
compiled once per machine and cached. Real and imaginary parts are in separate contiguous arrays over frequency, a
layout that compilers can vectorise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from numba.core import types as numba_types

from bayes_impedance.display import joined, lines, short, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.operations import N_PARAMETERS, Operation
from bayes_impedance.network.own_motion import (
    OWN_MOTION,
    backward_motion_apart,
    own_motion_row_apart,
    own_motion_slopes_apart,
)
from bayes_impedance.network.parameters import Parameter
from bayes_impedance.network.program import (
    DETACHED,
    PROGRAM,
    Program,
    compile_network,
    parameter_names,
    parameter_of,
    parameters_of,
)
from bayes_impedance.network.rows import slopes_row_apart, transform_row_apart
from bayes_impedance.network.tree import Network
from bayes_impedance.runtime.compiled_functions import by_address, kept_njit

compiled: Any = kept_njit(nogil=True, error_model="numpy")
"""Decorator of every compiled function: cached on disk, releases the GIL, divides as numpy does (inf, nan)."""


@compiled
def workspace(program: Program, omega: np.ndarray, zeta: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Workspace of :func:`forward`: sums and outputs of the nodes, both (N + 1, 2, F).

    The last row of the sums holds 1/omega and 0, that of the outputs zeros, the contribution of a missing child. With a
    damping ratio zeta the network is evaluated at s = omega (j + zeta) instead, if nothing but elements is in it: the
    row then holds 1/(omega (1 + zeta^2)), so that a spring's c/s is c (zeta - j) times that, and zeta.
    """
    n_nodes = program.node_parent.size
    sums, outputs = np.empty((n_nodes + 1, 2, omega.size)), np.empty((n_nodes + 1, 2, omega.size))
    for f in range(omega.size):
        sums[n_nodes, 0, f], sums[n_nodes, 1, f] = 1.0 / (omega[f] * (1.0 + zeta * zeta)), zeta
        outputs[n_nodes, 0, f], outputs[n_nodes, 1, f] = 0.0, 0.0
    return sums, outputs


@compiled
def forward(program: Program, theta: np.ndarray, omega: np.ndarray, sums: np.ndarray, outputs: np.ndarray) -> None:
    """One parameter set: fill the nodes' sums and outputs, arrays of :func:`workspace`; the last node's output is z.

    Arrays are always fully indexed: taking a row first makes numba count references to it, which in short loops costs
    as much as the arithmetic.
    """
    n_nodes, n_frequencies = program.node_parent.size, omega.size
    zeta = sums[n_nodes, 1, 0]
    for node in range(n_nodes):
        inertial, resistive, elastic = 0.0, 0.0, 0.0
        for t in range(program.term_node.size):
            if program.term_node[t] == node:
                c = np.exp(program.term_exponent[t] * parameter_of(program, program.term_element[t], theta))
                if program.term_power[t] == 1:
                    inertial += c
                elif program.term_power[t] == 0:
                    resistive += c
                else:
                    elastic += c
        first, second, children = n_nodes, n_nodes, 0
        for child in range(node):
            if program.node_parent[child] == node:
                first, second, children = child, first, children + 1
        inverted = program.node_invert[node] == 1 and program.node_code[node] == 0
        if inverted and children <= 2 and not zeta > 0.0:  # most nodes, in one pass over the frequencies
            for f in range(n_frequencies):
                x = resistive + outputs[first, 0, f] + outputs[second, 0, f]
                y = inertial * omega[f] - elastic * sums[n_nodes, 0, f] + outputs[first, 1, f] + outputs[second, 1, f]
                scale = 1.0 / (x * x + y * y)
                outputs[node, 0, f] = x * scale
                outputs[node, 1, f] = -y * scale
            continue
        for f in range(n_frequencies):
            sums[node, 0, f] = resistive
            sums[node, 1, f] = inertial * omega[f] - elastic * sums[n_nodes, 0, f]
        if zeta > 0.0:
            for f in range(n_frequencies):
                sums[node, 0, f] += zeta * (inertial * omega[f] + elastic * sums[n_nodes, 0, f])
        for child in range(node):
            if program.node_parent[child] == node:
                for f in range(n_frequencies):
                    sums[node, 0, f] += outputs[child, 0, f]
                    sums[node, 1, f] += outputs[child, 1, f]
        if program.node_code[node] > 0:
            u, c = parameters_of(program, node, theta), program.node_constant[node]
            if program.node_code[node] == OWN_MOTION:
                own_motion_row_apart(u, c, omega, program.motion, sums, outputs, node)
            else:
                transform_row_apart(program.node_code[node], u, c, omega, sums, outputs, node)
            if program.node_invert[node] == 1:
                for f in range(n_frequencies):
                    x, y = outputs[node, 0, f], outputs[node, 1, f]
                    scale = 1.0 / (x * x + y * y)
                    outputs[node, 0, f] = x * scale
                    outputs[node, 1, f] = -y * scale
        elif inverted:
            for f in range(n_frequencies):
                x, y = sums[node, 0, f], sums[node, 1, f]
                scale = 1.0 / (x * x + y * y)
                outputs[node, 0, f] = x * scale
                outputs[node, 1, f] = -y * scale
        else:
            for f in range(n_frequencies):
                outputs[node, 0, f] = sums[node, 0, f]
                outputs[node, 1, f] = sums[node, 1, f]


@compiled
def _through_reciprocal(adjoints: np.ndarray, outputs: np.ndarray, node: int, parent: int, n: int) -> None:
    for f in range(n):
        w_real, w_imag = outputs[node, 0, f], outputs[node, 1, f]
        square_real, square_imag = w_imag * w_imag - w_real * w_real, -2.0 * w_real * w_imag
        a, b = adjoints[parent, 0, f], adjoints[parent, 1, f]
        adjoints[node, 0, f] = a * square_real - b * square_imag
        adjoints[node, 1, f] = a * square_imag + b * square_real


@compiled
def backward(
    program: Program,
    theta: np.ndarray,
    omega: np.ndarray,
    sums: np.ndarray,
    outputs: np.ndarray,
    adjoints: np.ndarray,
    derivative: np.ndarray,
) -> None:
    """After :func:`forward`: fill the derivative with respect to theta, shape (P, 2, F).

    `adjoints` is scratch of shape (N + 1, 2, F). Its last row is the derivative of a result with respect to z, real
    and imaginary part: one and zero if the result is z itself.
    """
    n_nodes, n_frequencies = program.node_parent.size, omega.size
    zeta = sums[n_nodes, 1, 0]
    slopes = np.empty((N_PARAMETERS, 2, n_frequencies if program.node_code.any() else 0))
    copied = 0  # copies of the network, whose motion an element follows, come first
    if program.motion.shape[0] > 0:
        for node in range(n_nodes):
            if program.node_parent[node] == DETACHED:
                copied = node + 1
    pulls = np.empty((n_nodes if copied > 0 else 0, 2, n_frequencies))
    for node in range(n_nodes - 1, copied - 1, -1):
        parent = program.node_parent[node]
        if parent < 0:
            parent = n_nodes
        if program.node_invert[node] == 1:
            _through_reciprocal(adjoints, outputs, node, parent, n_frequencies)
        else:
            for f in range(n_frequencies):
                adjoints[node, 0, f] = adjoints[parent, 0, f]
                adjoints[node, 1, f] = adjoints[parent, 1, f]
        if program.node_code[node] > 0:
            u, c = parameters_of(program, node, theta), program.node_constant[node]
            if program.node_code[node] == OWN_MOTION:
                own_motion_slopes_apart(u, c, omega, program.motion, sums, outputs, adjoints, node, slopes, pulls)
            else:
                slopes_row_apart(program.node_code[node], u, c, omega, sums, adjoints, node, slopes)
            for k in range(N_PARAMETERS):
                p = program.node_parameter[node, k]
                if 0 <= p < theta.size:
                    for f in range(n_frequencies):
                        derivative[p, 0, f], derivative[p, 1, f] = slopes[k, 0, f], slopes[k, 1, f]
    for t in range(program.term_node.size):
        node, element = program.term_node[t], program.term_element[t]
        if element >= theta.size or node < copied:
            continue
        exponent, power = program.term_exponent[t], program.term_power[t]
        c = exponent * np.exp(exponent * theta[element])
        if power == 0:
            for f in range(n_frequencies):
                derivative[element, 0, f] = c * adjoints[node, 0, f]
                derivative[element, 1, f] = c * adjoints[node, 1, f]
        elif power == 1:
            for f in range(n_frequencies):
                derivative[element, 0, f] = -c * omega[f] * adjoints[node, 1, f]
                derivative[element, 1, f] = c * omega[f] * adjoints[node, 0, f]
        else:
            for f in range(n_frequencies):
                derivative[element, 0, f] = c * sums[n_nodes, 0, f] * adjoints[node, 1, f]
                derivative[element, 1, f] = -c * sums[n_nodes, 0, f] * adjoints[node, 0, f]
        if zeta > 0.0 and power != 0:
            for f in range(n_frequencies):
                size = zeta * c * (omega[f] if power == 1 else sums[n_nodes, 0, f])
                derivative[element, 0, f] += size * adjoints[node, 0, f]
                derivative[element, 1, f] += size * adjoints[node, 1, f]
    if copied > 0:
        backward_motion_apart(program, theta, omega, sums, outputs, adjoints, pulls, derivative)


types: Any = numba_types  # without annotations
_LINE, _BLOCK = (types.Array(types.float64, n, "C") for n in (1, 3))
forward_apart = by_address(forward, (PROGRAM, _LINE, _LINE, _BLOCK, _BLOCK))
backward_apart = by_address(backward, (PROGRAM, _LINE, _LINE, _BLOCK, _BLOCK, _BLOCK, _BLOCK))
"""The same for functions that do not take the kernel's code into their own."""


@compiled
def _impedance(program: Program, theta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    n_nodes = program.node_parent.size
    sums, outputs = workspace(program, omega)
    z = np.empty((theta.shape[0], omega.size), dtype=np.complex128)
    for i in range(theta.shape[0]):
        forward_apart(program, theta[i], omega, sums, outputs)
        for f in range(omega.size):
            z[i, f] = complex(outputs[n_nodes - 1, 0, f], outputs[n_nodes - 1, 1, f])
    return z


@compiled
def _derivative(program: Program, theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n_nodes = program.node_parent.size
    n_sets, n_elements = theta.shape
    sums, outputs = workspace(program, omega)
    adjoints = np.empty((n_nodes + 1, 2, omega.size))
    adjoints[n_nodes, 0], adjoints[n_nodes, 1] = 1.0, 0.0
    one = np.empty((n_elements, 2, omega.size))
    z = np.empty((n_sets, omega.size), dtype=np.complex128)
    dz = np.empty((n_sets, n_elements, omega.size), dtype=np.complex128)
    for i in range(n_sets):
        forward_apart(program, theta[i], omega, sums, outputs)
        backward_apart(program, theta[i], omega, sums, outputs, adjoints, one)
        for f in range(omega.size):
            z[i, f] = complex(outputs[n_nodes - 1, 0, f], outputs[n_nodes - 1, 1, f])
        for p in range(n_elements):
            for f in range(omega.size):
                dz[i, p, f] = complex(one[p, 0, f], one[p, 1, f])
    return z, dz


class Kernel:
    """A network ready for computation.

    Parameters
    ----------
    network : Network
        Any network.
    operations : sequence of Operation
        Operations on the impedance at places of the network.
    held : mapping of str to float, optional
        Parameters that are held besides those that the network itself holds: name and u.
    scales : mapping of str to float, optional
        Of signed parameters: their value at u = 1, in their unit. With 1, which is the default, u is the value.

    Attributes
    ----------
    network : Network
    elements : tuple of str
        The order of parameters in every array, P of them; parameters of the operations come after the network's.
        What is said of log elements below holds for them all, on the scale of u of
        :class:`bayes_impedance.network.parameters.Parameter`.
    program : Program
        The network in the form used by the compiled functions.
    """

    def __init__(
        self,
        network: Network,
        operations: Sequence[Operation] = (),
        held: Mapping[str, float] | None = None,
        scales: Mapping[str, float] | None = None,
    ) -> None:
        self.network = network
        self.operations = tuple(operations)
        self.held, self.scales = dict(held or {}), dict(scales or {})
        self.elements = tuple(name for name in parameter_names(network, operations) if name not in self.held)
        self.program = compile_network(network, operations, self.held, self.scales)

    def __repr__(self) -> str:
        return f"<Kernel of {short(str(self.network))}: {len(self.elements)} parameters>"

    def _repr_html_(self) -> str:
        rows = [(p.name, p.quantity.name, p.link, "everybody" if p.shared else "each person") for p in self.parameters]
        added = [name for name in self.elements if name not in {row[0] for row in rows}]
        more = [f"of operations: {', '.join(added)}"] if added else []
        more += [f"held: {', '.join(self.held)}"] if self.held else []
        return joined(
            self.network._repr_html_(), table(["parameter", "quantity", "scale", "the same for"], rows), lines(more)
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The network's own parameters among :attr:`elements`, in their order."""
        return tuple(p for p in self.network.parameters if not p.held and p.name not in self.held)

    def holding(self, values: Mapping[str, float]) -> Kernel:
        """The same network with some more parameters held: name and u."""
        return Kernel(self.network, self.operations, self.held | dict(values), self.scales)

    def impedance(self, log_elements: npt.ArrayLike, frequency_hz: npt.ArrayLike) -> np.ndarray:
        """Impedance of many parameter sets.

        Parameters
        ----------
        log_elements : array_like, shape (..., P)
            Natural logarithms of the elements' values in their units.
        frequency_hz : array_like, shape (F,)
            Frequencies in Hz, positive.

        Returns
        -------
        ndarray, complex, shape (..., F)
            z in the recordings' unit.

        Raises
        ------
        InputError
            If the last axis of `log_elements` does not match the number of elements.
        """
        theta, omega, lead = self._prepare(log_elements, frequency_hz)
        return np.asarray(_impedance(self.program, theta, omega).reshape(*lead, omega.size))

    def derivative(self, log_elements: npt.ArrayLike, frequency_hz: npt.ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Impedance and its exact derivative with respect to the logarithm of every element.

        Parameters
        ----------
        log_elements, frequency_hz
            As in :meth:`impedance`.

        Returns
        -------
        z : ndarray, complex, shape (..., F)
        dz : ndarray, complex, shape (..., P, F)
        """
        theta, omega, lead = self._prepare(log_elements, frequency_hz)
        z, dz = _derivative(self.program, theta, omega)
        return z.reshape(*lead, omega.size), dz.reshape(*lead, len(self.elements), omega.size)

    def _prepare(
        self, log_elements: npt.ArrayLike, frequency_hz: npt.ArrayLike
    ) -> tuple[np.ndarray, np.ndarray, tuple[int, ...]]:
        theta = np.asarray(log_elements, dtype=float)
        if theta.shape[-1:] != (len(self.elements),):
            raise InputError(
                f"log_elements has shape {theta.shape}: its last axis must be the {len(self.elements)} elements "
                f"{', '.join(self.elements)}"
            )
        lead = theta.shape[:-1]
        omega = 2 * np.pi * np.ascontiguousarray(frequency_hz, dtype=float)
        return np.ascontiguousarray(theta.reshape(math.prod(lead), theta.shape[-1])), omega, lead
