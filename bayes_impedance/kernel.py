r"""Impedance and its derivative for many parameter sets and frequencies at once, compiled.

A network alternates between two kinds of sum: impedances add in a parallel group, mobilities in a series group. Each
group is therefore one **node** that sums in its own domain, and passes its sum on to its parent, inverted where the
domains differ. Expressed in the node's domain a leaf is :math:`c\,(j\omega)^p` with :math:`c = e^{\pm\theta}` and
:math:`p \in \{-1, 0, 1\}`, so the leaves of a node contribute

.. math:: v = B + j\left(\omega A - C/\omega\right)

with three real numbers A, B, C whatever their count. One complex reciprocal per group is all that remains per
frequency: five for the fingertip's eight elements.

The derivative runs the same program backwards. With :math:`w = 1/v` the adjoint of a node's sum is

.. math:: \bar v = \frac{\partial z}{\partial v} = -w^2\, \bar w \quad\text{(inverted)}, \qquad
          \bar v = \bar w \quad\text{(passed on)},

and a leaf's derivative with respect to its logarithm is :math:`\pm\bar v\, c\,(j\omega)^p`: nothing is divided twice.

The program is data (small integer arrays), so one compiled function serves every network; it is compiled once per
machine and cached. Real and imaginary parts live in separate contiguous arrays over frequency, which is the layout
that compilers vectorise.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from bayes_impedance.elements import kind_of
from bayes_impedance.errors import InputError
from bayes_impedance.network import Element, Network, Series


class Program(NamedTuple):
    """A network as straight-line arithmetic.

    Attributes
    ----------
    term_node, term_element, term_exponent, term_power : ndarray of int, shape (T,)
        For each leaf: the node it is summed in, the element it is, and c = exp(exponent * theta), p in that domain.
    node_parent, node_invert : ndarray of int, shape (N,)
        For each node, parts before parents: where its sum goes (-1 for the port), and whether it is inverted first.
    """

    term_node: np.ndarray
    term_element: np.ndarray
    term_exponent: np.ndarray
    term_power: np.ndarray
    node_parent: np.ndarray
    node_invert: np.ndarray


def compile_network(network: Network) -> Program:
    """Translate a network into a program for the compiled functions.

    Parameters
    ----------
    network : Network
        Elements are numbered in the order of ``network.elements``.
    """
    index = {name: i for i, name in enumerate(network.elements)}
    terms: list[tuple[int, int, int, int]] = []
    nodes: list[tuple[int, bool]] = []

    def visit(node: Network, parent_is_mobility: bool) -> int:
        """Append the nodes below and then this one; the parent's number is filled in by the caller."""
        mobility = isinstance(node, Series)
        leaves = [node] if isinstance(node, Element) else [p for p in node.parts if isinstance(p, Element)]
        groups = [part for part in node.parts if not isinstance(part, Element)]
        children = [visit(part, mobility) for part in groups]
        number = len(nodes)
        nodes.append((-1, mobility != parent_is_mobility))
        for child in children:
            nodes[child] = (number, nodes[child][1])
        for leaf in leaves:
            kind, sign = kind_of(leaf.name), -1 if mobility else 1
            terms.append((number, index[leaf.name], sign * kind.exponent, sign * kind.power))
        return number

    visit(network, False)
    columns = np.array(terms, dtype=np.int64).T
    parent, invert = np.array(nodes, dtype=np.int64).T
    return Program(*(np.ascontiguousarray(column) for column in (*columns, parent, invert)))


compiled: Any = njit(cache=True, nogil=True, error_model="numpy")
"""Decorator of every compiled function: kept on disk, runs beside other threads, divides as numpy does (inf, nan)."""


@compiled
def forward(program: Program, theta: np.ndarray, omega: np.ndarray, sums: np.ndarray, outputs: np.ndarray) -> None:
    """One parameter set: fill the nodes' sums and outputs, arrays of shape (N, 2, F); the last output is z."""
    n_nodes, n_frequencies = program.node_parent.size, omega.size
    for node in range(n_nodes):
        inertial, resistive, elastic = 0.0, 0.0, 0.0
        for t in range(program.term_node.size):
            if program.term_node[t] == node:
                c = np.exp(program.term_exponent[t] * theta[program.term_element[t]])
                if program.term_power[t] == 1:
                    inertial += c
                elif program.term_power[t] == 0:
                    resistive += c
                else:
                    elastic += c
        real, imag = sums[node, 0], sums[node, 1]
        for f in range(n_frequencies):
            real[f] = resistive
            imag[f] = inertial * omega[f] - elastic / omega[f]
    for node in range(n_nodes):
        real, imag = sums[node, 0], sums[node, 1]
        out_real, out_imag = outputs[node, 0], outputs[node, 1]
        if program.node_invert[node] == 1:
            for f in range(n_frequencies):
                scale = 1.0 / (real[f] * real[f] + imag[f] * imag[f])
                out_real[f] = real[f] * scale
                out_imag[f] = -imag[f] * scale
        else:
            for f in range(n_frequencies):
                out_real[f] = real[f]
                out_imag[f] = imag[f]
        parent = program.node_parent[node]
        if parent >= 0:
            parent_real, parent_imag = sums[parent, 0], sums[parent, 1]
            for f in range(n_frequencies):
                parent_real[f] += out_real[f]
                parent_imag[f] += out_imag[f]


@compiled
def backward(
    program: Program,
    theta: np.ndarray,
    omega: np.ndarray,
    outputs: np.ndarray,
    adjoints: np.ndarray,
    derivative: np.ndarray,
) -> None:
    """After :func:`forward`: fill dz/dtheta, shape (P, 2, F); `adjoints` is scratch of shape (N, 2, F)."""
    n_nodes, n_frequencies = program.node_parent.size, omega.size
    for node in range(n_nodes - 1, -1, -1):
        parent = program.node_parent[node]
        real, imag = adjoints[node, 0], adjoints[node, 1]
        w_real, w_imag = outputs[node, 0], outputs[node, 1]
        if parent < 0:
            for f in range(n_frequencies):
                real[f] = 1.0
                imag[f] = 0.0
        else:
            parent_real, parent_imag = adjoints[parent, 0], adjoints[parent, 1]
            for f in range(n_frequencies):
                real[f] = parent_real[f]
                imag[f] = parent_imag[f]
        if program.node_invert[node] == 1:
            for f in range(n_frequencies):
                square_real = w_imag[f] * w_imag[f] - w_real[f] * w_real[f]
                square_imag = -2.0 * w_real[f] * w_imag[f]
                a, b = real[f], imag[f]
                real[f] = a * square_real - b * square_imag
                imag[f] = a * square_imag + b * square_real
    for t in range(program.term_node.size):
        element = program.term_element[t]
        exponent = program.term_exponent[t]
        c = exponent * np.exp(exponent * theta[element])
        real, imag = adjoints[program.term_node[t], 0], adjoints[program.term_node[t], 1]
        d_real, d_imag = derivative[element, 0], derivative[element, 1]
        power = program.term_power[t]
        if power == 0:
            for f in range(n_frequencies):
                d_real[f] = c * real[f]
                d_imag[f] = c * imag[f]
        elif power == 1:
            for f in range(n_frequencies):
                d_real[f] = -c * omega[f] * imag[f]
                d_imag[f] = c * omega[f] * real[f]
        else:
            for f in range(n_frequencies):
                d_real[f] = c / omega[f] * imag[f]
                d_imag[f] = -c / omega[f] * real[f]


@compiled
def _impedance(program: Program, theta: np.ndarray, omega: np.ndarray) -> np.ndarray:
    n_nodes = program.node_parent.size
    sums = np.empty((n_nodes, 2, omega.size))
    outputs = np.empty((n_nodes, 2, omega.size))
    z = np.empty((theta.shape[0], omega.size), dtype=np.complex128)
    for i in range(theta.shape[0]):
        forward(program, theta[i], omega, sums, outputs)
        for f in range(omega.size):
            z[i, f] = complex(outputs[n_nodes - 1, 0, f], outputs[n_nodes - 1, 1, f])
    return z


@compiled
def _derivative(program: Program, theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n_nodes = program.node_parent.size
    n_sets, n_elements = theta.shape
    sums = np.empty((n_nodes, 2, omega.size))
    outputs = np.empty((n_nodes, 2, omega.size))
    adjoints = np.empty((n_nodes, 2, omega.size))
    one = np.empty((n_elements, 2, omega.size))
    z = np.empty((n_sets, omega.size), dtype=np.complex128)
    dz = np.empty((n_sets, n_elements, omega.size), dtype=np.complex128)
    for i in range(n_sets):
        forward(program, theta[i], omega, sums, outputs)
        backward(program, theta[i], omega, outputs, adjoints, one)
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
        Any network of masses, compliances and dampers.

    Attributes
    ----------
    network : Network
    elements : tuple of str
        The order of elements in every array, P of them.
    program : Program
        What the compiled functions take.
    """

    def __init__(self, network: Network) -> None:
        self.network = network
        self.elements = network.elements
        self.program = compile_network(network)

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
        return np.ascontiguousarray(theta.reshape(-1, theta.shape[-1])), omega, lead
