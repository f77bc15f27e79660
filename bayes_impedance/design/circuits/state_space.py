r"""State space of networks, for many users at once.

A one-port is represented as

.. math:: z(s) = s\,m + \frac{k}{s} + D + C\,(sI - A)^{-1} B, \qquad m, k, D \ge 0,

where the poles at infinite and at zero frequency are separate from the rest, which has neither. Sums only stack states
and add m, k and D, so two masses that move together, or two springs that are stretched together, remain one mass and
one spring: there are no uncontrollable states.

Series groups need reciprocals. States are scaled so that :math:`\tfrac12 x^T x` is the stored energy. Then, with u
the flow and y = z u the force of the remaining part (or the other way round for a mobility),

.. math:: \dot x = A x + B u, \qquad A + A^T \le 0, \qquad u\,y \ge \tfrac{d}{dt}\,\tfrac12 x^T x ,

and for w = 1/z, driven by the force f:

* m > 0: the velocity becomes a state, :math:`m\dot v = f - k\int v - D v - C x`;
* m = 0, D > 0: :math:`v = (f - C x - k \int v)/D`;
* m = D = 0: a passive system then has C = B^T, so f = B^T x fixes the part of x along B: with b = B/abs(B),
  :math:`x = b\,f/|B| + N\eta`, where N spans the orthogonal complement of b, and differentiating once gives
  :math:`w = s/|B|^2 + \dots` in the states :math:`\eta` (:math:`k\int v` is among the x here).

If z(0) = 0 then w has a pole at zero, which is moved to its k. Its state is that of a constant velocity 1, :math:`p
\propto (\sqrt m,\ -A^{-1}B)`, and passivity decouples it: :math:`A p = 0` implies :math:`p^T A = 0`. Which case
applies is decided by the network's structure, never by a numerical threshold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from bayes_impedance.display import Brief
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Element, Network, Parallel, Series


@dataclass(frozen=True, kw_only=True, repr=False)
class Realisation(Brief):
    """An impedance (or a mobility, with the roles of force and velocity exchanged) of U users in state space.

    Attributes
    ----------
    high, low : int
        Power of s at infinite and at zero frequency: 1, 0 or -1. It follows from the structure, equal for all users.
    m, k, d : ndarray, shape (U,)
        Coefficients of s m + k/s + D; a mobility has a compliance in place of m and 1/mass in place of k.
    a : ndarray, shape (U, n, n)
        Matrix A, in 1/s.
    b, c : ndarray, shape (U, n)
        Vectors B and C in energy coordinates: in the square root of the impedance's unit per second.
    """

    high: int
    low: int
    m: np.ndarray
    k: np.ndarray
    d: np.ndarray
    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def order(self) -> int:
        """Number of poles, including those at zero and at infinity."""
        return int(self.a.shape[-1]) + int(self.low < 0) + int(self.high > 0)

    def __call__(self, s: npt.ArrayLike) -> np.ndarray:
        """Value at complex frequencies (rad/s), shape (S,), for every user: shape (U, S)."""
        s = np.atleast_1d(np.asarray(s, dtype=complex))
        value = s * self.m[:, None] + self.k[:, None] / s + self.d[:, None]
        n = self.a.shape[-1]
        if n:
            pencil = s[None, :, None, None] * np.eye(n) - self.a[:, None]
            states = np.linalg.solve(pencil, np.broadcast_to(self.b[:, None, :, None], (*pencil.shape[:3], 1)))
            value = value + np.einsum("un,usn->us", self.c, states[..., 0])
        return np.asarray(value)

    def __add__(self, other: Realisation) -> Realisation:
        n, o = self.a.shape[-1], other.a.shape[-1]
        a = np.zeros((self.m.size, n + o, n + o))
        a[:, :n, :n], a[:, n:, n:] = self.a, other.a
        return Realisation(
            high=max(self.high, other.high),
            low=min(self.low, other.low),
            m=self.m + other.m,
            k=self.k + other.k,
            d=self.d + other.d,
            a=a,
            b=np.concatenate([self.b, other.b], axis=1),
            c=np.concatenate([self.c, other.c], axis=1),
        )

    def scaled(self, factor: float) -> Realisation:
        """The one-port multiplied by a positive number."""
        root = np.sqrt(factor)
        m, k, d = self.m * factor, self.k * factor, self.d * factor
        return replace(self, m=m, k=k, d=d, b=self.b * root, c=self.c * root)

    def reciprocal(self) -> Realisation:
        """1/z: the mobility of an impedance."""
        whole = self._with_integrator() if self.low < 0 else self
        pole = None if self.low <= 0 else -np.linalg.solve(whole.a, whole.b[..., None])[..., 0]
        if self.high > 0:
            found, state = whole._mass_as_state(pole)
        elif self.high == 0:
            found, state = whole._resistance_inverted(pole)
        else:
            found, state = whole._force_as_input(pole)
        return found if state is None else found._without_pole_at_zero(state)

    def _with_integrator(self) -> Realisation:
        """The one-port with the term k/s turned into a state."""
        root = np.sqrt(self.k)[:, None]
        n = self.a.shape[-1]
        a = np.zeros((self.m.size, n + 1, n + 1))
        a[:, 1:, 1:] = self.a
        b, c = np.concatenate([root, self.b], axis=1), np.concatenate([root, self.c], axis=1)
        return Realisation(high=self.high, low=self.low, m=self.m, k=np.zeros_like(self.k), d=self.d, a=a, b=b, c=c)

    def _mass_as_state(self, pole: np.ndarray | None) -> tuple[Realisation, np.ndarray | None]:
        root, n = np.sqrt(self.m), self.a.shape[-1]
        a = np.zeros((self.m.size, n + 1, n + 1))
        a[:, 0, 0] = -self.d / self.m
        a[:, 0, 1:] = -self.c / root[:, None]
        a[:, 1:, 0] = self.b / root[:, None]
        a[:, 1:, 1:] = self.a
        b = np.zeros((self.m.size, n + 1))
        b[:, 0] = 1 / root
        zero = np.zeros_like(self.m)
        state = None if pole is None else np.concatenate([root[:, None], pole], axis=1)
        return Realisation(high=-1, low=-self.low, m=zero, k=zero, d=zero, a=a, b=b, c=b.copy()), state

    def _resistance_inverted(self, pole: np.ndarray | None) -> tuple[Realisation, np.ndarray | None]:
        d = self.d[:, None]
        a = self.a - self.b[:, :, None] * self.c[:, None, :] / d[..., None]
        zero = np.zeros_like(self.d)
        return Realisation(high=0, low=-self.low, m=zero, k=zero, d=1 / self.d, a=a, b=self.b / d, c=-self.c / d), pole

    def _force_as_input(self, pole: np.ndarray | None) -> tuple[Realisation, np.ndarray | None]:
        size = np.linalg.norm(self.b, axis=1)
        along = self.b / size[:, None]
        rest = _orthogonal_to(along)
        turned = np.einsum("unm,um->un", self.a, along)  # A b
        zero = np.zeros_like(self.d)
        found = Realisation(
            high=1,
            low=-self.low,
            m=1 / size**2,
            k=zero,
            d=-np.einsum("un,un->u", along, turned) / size**2,
            a=np.einsum("unp,unm,umq->upq", rest, self.a, rest),
            b=np.einsum("unp,un->up", rest, turned) / size[:, None],
            c=-np.einsum("un,unm,ump->up", along, self.a, rest) / size[:, None],
        )
        return found, None if pole is None else np.einsum("unp,un->up", rest, pole)

    def _without_pole_at_zero(self, state: np.ndarray) -> Realisation:
        """The one-port with the decoupled integrator along `state` moved to k; the other states are kept."""
        along = state / np.linalg.norm(state, axis=1)[:, None]
        rest = _orthogonal_to(along)
        k = np.einsum("un,un->u", self.c, along) * np.einsum("un,un->u", along, self.b)
        return Realisation(
            high=self.high,
            low=self.low,
            m=self.m,
            k=self.k + k,
            d=self.d,
            a=np.einsum("unp,unm,umq->upq", rest, self.a, rest),
            b=np.einsum("unp,un->up", rest, self.b),
            c=np.einsum("unp,un->up", rest, self.c),
        )


def realise(network: Network, values: Mapping[str, npt.ArrayLike]) -> Realisation:
    """Impedance of a network in state space, for many users at once.

    Parameters
    ----------
    network : Network
    values : mapping of str to array_like, shape (U,) or a number
        Value of each element in its unit.

    Returns
    -------
    Realisation
        Of the impedance; its `reciprocal` is the mobility. Its order is the degree of the transfer function.

    Raises
    ------
    InputError
        If an element has no value.
    """
    arrays = {name: np.atleast_1d(np.asarray(value, dtype=float)) for name, value in values.items()}
    size = max((a.size for a in arrays.values()), default=1)
    return _realise(network, {name: np.broadcast_to(a, (size,)) for name, a in arrays.items()})


def _realise(network: Network, values: Mapping[str, np.ndarray]) -> Realisation:
    if isinstance(network, Element):
        return _leaf(network, values)
    parts = [_realise(part, values) for part in network.parts]
    if isinstance(network, Parallel):
        return total(parts)
    assert isinstance(network, Series)  # there is no third kind of group
    return total([part.reciprocal() for part in parts]).reciprocal()


def total(parts: Sequence[Realisation]) -> Realisation:
    """Sum of one-ports: impedances in parallel or mobilities in series."""
    result = parts[0]
    for part in parts[1:]:
        result = result + part
    return result


def _leaf(element: Element, values: Mapping[str, np.ndarray]) -> Realisation:
    kind = kind_of(element.name)
    value = np.asarray(element.impedance(1.0, values))  # s = 1: the coefficient itself
    zero, none = np.zeros_like(value), np.zeros((value.size, 0))
    m, d, k = (value if kind.power == power else zero for power in (1, 0, -1))
    return Realisation(high=kind.power, low=kind.power, m=m, k=k, d=d, a=np.zeros((value.size, 0, 0)), b=none, c=none)


def _orthogonal_to(along: np.ndarray) -> np.ndarray:
    """Orthonormal columns orthogonal to unit vectors (U, n): the other columns of a Householder reflection."""
    n = along.shape[1]
    mirror = along.copy()
    mirror[:, 0] += np.where(along[:, 0] >= 0, 1.0, -1.0)  # the sign that avoids cancellation
    mirror /= np.linalg.norm(mirror, axis=1)[:, None]
    return np.asarray((np.eye(n) - 2 * mirror[:, :, None] * mirror[:, None, :])[:, :, 1:])


def zeros_and_poles(realisation: Realisation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zeros and poles in rad/s, and the leading coefficient's ratio.

    They are eigenvalues of state matrices. Roots of a polynomial would lose digits if they are close together.

    Returns
    -------
    zeros, poles : ndarray, complex, shape (U, .)
        Including a pole at zero; poles or zeros at infinity follow from the difference of the two numbers.
    gain : ndarray, shape (U,)
        z(s) = gain prod(s - zeros)/prod(s - poles).
    """
    inverse = realisation.reciprocal()
    poles, zeros = _finite_poles(realisation), _finite_poles(inverse)
    if realisation.high > 0:
        gain = realisation.m
    elif realisation.high == 0:
        gain = realisation.d
    else:
        gain = 1 / inverse.m
    return zeros, poles, gain


def _finite_poles(realisation: Realisation) -> np.ndarray:
    found = np.linalg.eigvals(realisation.a).astype(complex)
    if realisation.low < 0:
        found = np.concatenate([np.zeros((found.shape[0], 1), dtype=complex), found], axis=1)
    order = np.lexsort((found.imag, np.abs(found)), axis=-1)
    return np.asarray(np.take_along_axis(found, order, axis=-1))
