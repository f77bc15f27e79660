r"""Two-ports: mechanical links with two sides, such as a lever or a flexible arm.

A two-port is represented by its chain matrix. The flow of the second side is counted **out** of the two-port, so that
cascaded two-ports are a matrix product,

.. math:: \begin{pmatrix} e_1 \\ f_1 \end{pmatrix} =
          \begin{pmatrix} a_{11} & a_{12} \\ a_{21} & a_{22} \end{pmatrix}
          \begin{pmatrix} e_2 \\ f_2 \end{pmatrix}, \qquad
          z_1 = \frac{a_{11} z_2 + a_{12}}{a_{21} z_2 + a_{22}} ,

with effort e (force or torque) and flow f (velocity or angular velocity), and z = e/f.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.design.loop.device import Device, Section
from bayes_impedance.display import Brief
from bayes_impedance.network.notation import parse


@dataclass(frozen=True, repr=False)
class TwoPort(Brief):
    """A linear two-port at F frequencies.

    Attributes
    ----------
    chain : ndarray, complex, shape (F, 2, 2)
        Effort and flow on the first side from those on the second.
    """

    chain: np.ndarray

    def __matmul__(self, other: TwoPort) -> TwoPort:
        """Cascade: the two-port followed by another."""
        return TwoPort(self.chain @ other.chain)

    def seen(self, load: npt.ArrayLike) -> np.ndarray:
        """Input impedance of the first side with `load` (broadcast against F) on the second."""
        a, load = self.chain, np.asarray(load)
        return np.asarray((a[:, 0, 0] * load + a[:, 0, 1]) / (a[:, 1, 0] * load + a[:, 1, 1]))


def beside(z: npt.ArrayLike) -> TwoPort:
    """An impedance between the common velocity of both sides and ground: forces add."""
    z = np.atleast_1d(np.asarray(z, dtype=complex))
    return TwoPort(_matrix(np.ones_like(z), z, np.zeros_like(z), np.ones_like(z)))


def between(z: npt.ArrayLike) -> TwoPort:
    """An impedance that transmits the force from one side to the other: velocities differ."""
    z = np.atleast_1d(np.asarray(z, dtype=complex))
    return TwoPort(_matrix(np.ones_like(z), np.zeros_like(z), 1 / z, np.ones_like(z)))


def lever(ratio: float, size: int = 1) -> TwoPort:
    """A lever or gear: the second side moves `ratio` times as fast, with a force smaller by the same factor."""
    one = np.ones(size, dtype=complex)
    return TwoPort(_matrix(ratio * one, 0 * one, 0 * one, one / ratio))


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
