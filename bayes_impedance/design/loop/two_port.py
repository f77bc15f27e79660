r"""Two-ports: what is linked with two sides, such as a motor, a lever or a flexible arm (eq. 2 of the paper).

Everything here is kept as the chain matrix with the second side's flow **out** of the two-port, so that a chain is a
product,

.. math:: \begin{pmatrix} e_1 \\ f_1 \end{pmatrix} =
          \begin{pmatrix} a_{11} & a_{12} \\ a_{21} & a_{22} \end{pmatrix}
          \begin{pmatrix} e_2 \\ f_2 \end{pmatrix}, \qquad
          z_1 = \frac{a_{11} z_2 + a_{12}}{a_{21} z_2 + a_{22}} ,

with effort e (force, torque or voltage) and flow f (velocity, angular velocity or current), and z = e/f. The other
forms follow by exchanging what is given and what follows. With the flow :math:`f_2' = -f_2` *into* the second side,

.. math:: \begin{pmatrix} e_1 \\ e_2 \end{pmatrix} = Z \begin{pmatrix} f_1 \\ f_2' \end{pmatrix},\quad
          \begin{pmatrix} e_1 \\ f_2' \end{pmatrix} = H \begin{pmatrix} f_1 \\ e_2 \end{pmatrix}.

Eq. 2 gives a motor's mechanical side from its electrical one, differential coordinate (voltage, angular velocity)
before flux coordinate (current, torque):

.. math:: \begin{pmatrix} \Omega \\ M \end{pmatrix} = h \begin{pmatrix} u \\ i \end{pmatrix} ,

so on a mechanical side the velocity comes first. It is the inverse of the chain matrix with its rows (and, for a
mechanical first side, its columns) exchanged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.design.loop.device import Device, Section
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse


@dataclass(frozen=True)
class TwoPort:
    """A linear two-port at F frequencies.

    Attributes
    ----------
    chain : ndarray, complex, shape (F, 2, 2)
        Effort and flow on the first side from those on the second.
    """

    chain: np.ndarray

    def __matmul__(self, other: TwoPort) -> TwoPort:
        """A chain: the two-port followed by another."""
        return TwoPort(self.chain @ other.chain)

    @property
    def determinant(self) -> np.ndarray:
        """Of the chain matrix, shape (F,): one for everything reciprocal."""
        return np.asarray(np.linalg.det(self.chain))

    def seen(self, load: npt.ArrayLike) -> np.ndarray:
        """Impedance of the first side with `load` (broadcast against F) on the second."""
        a, load = self.chain, np.asarray(load)
        return np.asarray((a[:, 0, 0] * load + a[:, 0, 1]) / (a[:, 1, 0] * load + a[:, 1, 1]))

    def reversed(self) -> TwoPort:
        """The same seen from its second side."""
        a, det = self.chain, self.determinant[:, None, None]
        return TwoPort(np.stack([a[:, 1, 1], a[:, 0, 1], a[:, 1, 0], a[:, 0, 0]], -1).reshape(-1, 2, 2) / det)

    def impedance(self) -> np.ndarray:
        """Z: efforts from flows into both sides, shape (F, 2, 2).

        Raises
        ------
        InputError
            If there is none: the two sides move as one, or as by a lever.
        """
        a, det = self.chain, self.determinant
        if np.any(a[:, 1, 0] == 0):
            raise InputError("this two-port has no impedance matrix: its sides move together; use the chain matrix")
        return np.asarray(_matrix(a[:, 0, 0], det, np.ones_like(det), a[:, 1, 1]) / a[:, 1, 0][:, None, None])

    def hybrid(self) -> np.ndarray:
        """H: first effort and second flow from first flow and second effort, shape (F, 2, 2).

        Raises
        ------
        InputError
            If there is none.
        """
        a, det = self.chain, self.determinant
        if np.any(a[:, 1, 1] == 0):
            raise InputError(
                "this two-port has no hybrid matrix: a gyrator turns flow into effort; use the chain matrix"
            )
        return np.asarray(_matrix(a[:, 0, 1], det, -np.ones_like(det), a[:, 1, 0]) / a[:, 1, 1][:, None, None])

    def forward(self, *, first_mechanical: bool = True) -> np.ndarray:
        """The matrix of eq. 2: velocity and force of the second side from the first side's, shape (F, 2, 2).

        Parameters
        ----------
        first_mechanical : bool
            Whether the first side is given as velocity and force, or (a motor) as voltage and current.
        """
        inverse = np.linalg.inv(self.chain)[:, ::-1]
        return np.asarray(inverse[:, :, ::-1] if first_mechanical else inverse)

    @classmethod
    def from_impedance(cls, z: np.ndarray) -> TwoPort:
        """From Z, shape (F, 2, 2), with z21 not zero."""
        det = np.linalg.det(z)
        return cls(_matrix(z[:, 0, 0], det, np.ones_like(det), z[:, 1, 1]) / z[:, 1, 0][:, None, None])

    @classmethod
    def from_hybrid(cls, h: np.ndarray) -> TwoPort:
        """From H, shape (F, 2, 2), with h21 not zero."""
        det = np.linalg.det(h)
        return cls(-_matrix(det, h[:, 0, 0], h[:, 1, 1], np.ones_like(det)) / h[:, 1, 0][:, None, None])

    @classmethod
    def from_forward(cls, h: np.ndarray, *, first_mechanical: bool = True) -> TwoPort:
        """From the matrix of eq. 2, the inverse of :meth:`forward`."""
        turned = h[:, :, ::-1] if first_mechanical else h
        return cls(np.linalg.inv(turned[:, ::-1]))


def beside(z: npt.ArrayLike) -> TwoPort:
    """An impedance between the common velocity of both sides and ground: forces add."""
    z = np.atleast_1d(np.asarray(z, dtype=complex))
    return TwoPort(_matrix(np.ones_like(z), z, np.zeros_like(z), np.ones_like(z)))


def between(z: npt.ArrayLike) -> TwoPort:
    """An impedance that passes on the force from side to side: velocities differ."""
    z = np.atleast_1d(np.asarray(z, dtype=complex))
    return TwoPort(_matrix(np.ones_like(z), np.zeros_like(z), 1 / z, np.ones_like(z)))


def lever(ratio: float, size: int = 1) -> TwoPort:
    """A lever or gear: the second side moves `ratio` times as fast, with a force as many times smaller."""
    one = np.ones(size, dtype=complex)
    return TwoPort(_matrix(ratio * one, 0 * one, 0 * one, one / ratio))


def transducer(constant: float, size: int = 1) -> TwoPort:
    """An electrodynamic conversion: force = constant x current, voltage = constant x velocity (N/A = V s/m)."""
    one = np.ones(size, dtype=complex)
    return TwoPort(_matrix(0 * one, constant * one, one / constant, 0 * one))


def motor(s: npt.ArrayLike, resistance: float, inductance: float, constant: float, inertia: npt.ArrayLike) -> TwoPort:
    """The motor of eq. 2: winding, conversion and what its rotor is by itself.

    Parameters
    ----------
    s : array_like, complex, shape (F,)
        In rad/s.
    resistance, inductance : float
        In ohm and H.
    constant : float
        In N m/A, or N/A for a linear motor.
    inertia : array_like, shape (F,)
        Impedance of rotor and bearings in the mechanical unit.
    """
    s = np.atleast_1d(np.asarray(s, dtype=complex))
    # A winding is in series with the terminals: it takes voltage, as what stands beside takes force.
    return (
        beside(resistance + s * inductance) @ transducer(constant, s.size) @ beside(np.broadcast_to(inertia, s.shape))
    )


def of_section(section: Section, s: npt.ArrayLike) -> TwoPort:
    """A section of a device at complex frequencies s, shape (F,)."""
    s = np.atleast_1d(np.asarray(s, dtype=complex))
    if section.arrangement == "lever":
        return lever(section.values["ratio"], s.size)
    z = np.broadcast_to(parse(section.network).impedance(s, section.values), s.shape)
    return beside(z) if section.arrangement == "beside" else between(z)


def of_device(device: Device, s: npt.ArrayLike) -> TwoPort:
    """A device from its actuator to the finger at complex frequencies s, shape (F,)."""
    parts = [of_section(section, s) for section in device.sections]
    result = parts[0]
    for part in parts[1:]:
        result = result @ part
    return result


def _matrix(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    return np.stack([np.stack([a, b], -1), np.stack([c, d], -1)], -2)
