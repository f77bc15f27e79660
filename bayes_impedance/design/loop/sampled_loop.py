r"""Stability of a sampled loop, determined exactly from its poles.

Between samples device and user are the linear system :math:`\dot x = A x + B f` of
:mod:`bayes_impedance.design.circuits.state_space`, and the force is constant except for one step at the delay. So the
motion from one sample to the next is known exactly. With the delay :math:`\tau = dT + \varepsilon`, :math:`0 \le
\varepsilon < T` (the modified z-transform, [1]_),

.. math:: x_{k+1} = e^{AT} x_k + \Gamma_0 f_{k-d} + \Gamma_1 f_{k-d-1}, \qquad
          \Gamma_0 = \int_0^{T-\varepsilon} e^{At} dt\, B, \quad
          \Gamma_1 = e^{A(T-\varepsilon)} \int_0^{\varepsilon} e^{At} dt\, B,

and with :math:`f_k = -(K + B_w/T)\,p_k + (B_w/T)\,p_{k-1}` of the position p the state :math:`(x_k, p_{k-1}, f_{k-1},
\dots, f_{k-d-1})` is multiplied by one matrix per period. The loop is stable if and only if all its eigenvalues lie
inside the unit circle.

**Position.** If a spring connects device and user to ground, position is already a function of the states: velocity is
v = C x with zero static gain, thus :math:`p = C A^{-1} x`. Otherwise p is an additional state, :math:`\dot p = v`; for
a free mass so is the constant velocity.

**Many users, many gains.** The gains act through one column of the matrix, which
:mod:`bayes_impedance.design.loop.hessenberg` uses.

References
----------
.. [1] E. I. Jury, "Theory and Application of the z-Transform Method" (1964), chapter 2.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from bayes_impedance.design.circuits.state_space import Realisation
from bayes_impedance.design.loop.device import Device
from bayes_impedance.design.loop.hessenberg import all_inside, reduced
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError

MARGIN = 1e-9
"""A pole up to this far outside the unit circle counts as on it. By choice: it allows for rounding errors of
eigenvalues."""

_BLOCK = 20
"""Users whose matrices are computed at once. By choice: few enough for progress reports and load balancing."""

_SCAN = 81
"""Stiffnesses scanned for the first unstable one, before bisection. By choice: about ten per decade."""

_BISECTIONS = 40
"""Bisections of the interval that was found: its width falls below 1e-12 in ln K."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SampledLoop(Brief):
    """Discrete-time model of a device held by each of U users.

    Attributes
    ----------
    transition : ndarray, shape (U, n, n)
        Transition matrix of the mechanical states over one period.
    now, late : ndarray, shape (U, n)
        Effect of the forces :math:`f_{k-d}` and :math:`f_{k-d-1}` on the states, per newton.
    position : ndarray, shape (U, n)
        Row vector whose product with the states is the position in m.
    whole : int
        Number d of whole periods in the delay.
    period_s : float
    """

    transition: np.ndarray
    now: np.ndarray
    late: np.ndarray
    position: np.ndarray
    whole: int
    period_s: float

    def __getitem__(self, rows: np.ndarray) -> SampledLoop:
        return replace(
            self,
            transition=self.transition[rows],
            now=self.now[rows],
            late=self.late[rows],
            position=self.position[rows],
        )

    def __len__(self) -> int:
        return int(self.now.shape[0])

    @property
    def size(self) -> int:
        """Number q of poles."""
        return int(self.now.shape[1] + 1 + self.whole + int(np.any(self.late)))

    def matrices(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """Transition matrices of the closed loop over one period: gains of shape (U, G) to (U, G, q, q)."""
        users, gains = stiffness.shape
        n, late = self.now.shape[1], bool(np.any(self.late))
        size = self.size
        held = size - n - 1
        m = np.zeros((users, gains, size, size))
        m[:, :, :n, :n] = self.transition[:, None]
        m[:, :, n, :n] = self.position[:, None]
        force = np.zeros((users, gains, size))
        rate = damping / self.period_s
        force[:, :, :n] = -(stiffness + rate)[..., None] * self.position[:, None]
        force[:, :, n] = rate
        if self.whole:
            m[:, :, :n, n + self.whole] += self.now[:, None]
        else:
            m[:, :, :n] += self.now[:, None, :, None] * force[:, :, None]
        if late:
            m[:, :, :n, n + held] += self.late[:, None]
        if held:
            m[:, :, n + 1] = force
            for i in range(1, held):
                m[:, :, n + 1 + i, n + i] = 1.0
        return m

    def inside(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """Whether all poles are inside the unit circle: gains of shape (U, G) to bool (U, G).

        Equivalent to :meth:`radius` below the limit, but several times faster for many gains.
        """
        n, size = self.now.shape[1], self.size
        free = self.matrices(np.zeros((len(self), 1)), np.zeros((len(self), 1)))[:, 0]
        result = np.empty(stiffness.shape, dtype=np.int8)
        rate = damping / self.period_s
        for user in range(len(self)):
            # Units in which force, position and the mechanical states have similar sizes preserve accuracy.
            scale = np.ones(size)
            scale[n] = 1 / np.linalg.norm(self.position[user])
            scale[n + 1 :] = max(np.linalg.norm(self.now[user]), np.linalg.norm(self.late[user]))
            column = np.zeros(size)
            column[n + 1 : n + 2] = 1.0  # a delayed force is a state
            if not self.whole:
                column[:n] = self.now[user]
            form, turned = reduced(scale[:, None] * free[user] / scale, scale * column)
            spring, previous = np.zeros(size), np.zeros(size)
            spring[:n], previous[n] = self.position[user], 1 / scale[n]
            rows = -np.outer(stiffness[user] + rate[user], spring @ turned) + np.outer(rate[user], previous @ turned)
            all_inside(form, rows, 1 + MARGIN, result[user])
        if np.any(result < 0):
            undecided = result < 0
            result[undecided] = (self.radius(stiffness, damping) < 1 + MARGIN)[undecided]
        return np.asarray(result, dtype=bool)

    def radius(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """Largest modulus of the poles: gains of shape (U, G) to (U, G). Stable below 1."""
        return np.asarray(np.abs(self.poles(stiffness, damping)).max(axis=-1))

    def poles(self, stiffness: np.ndarray, damping: np.ndarray) -> np.ndarray:
        """Poles in the z-plane: gains of shape (U, G) to complex (U, G, q)."""
        return np.asarray(np.linalg.eigvals(self.matrices(stiffness, damping)))


def sampled_loop(device: Device, users: Realisation) -> SampledLoop:
    """The loop of a device and each of the users.

    Parameters
    ----------
    device : Device
    users : Realisation
        Impedance of the users at the finger.

    Raises
    ------
    InputError
        If the system is too stiff: the motion over a sampling period cannot be computed.
    """
    mobility = device.with_load(users).reciprocal()
    a, b, position = _with_position(mobility)
    n, period = a.shape[-1], device.period_s
    whole = int(np.floor(device.delay_s / period * (1 + 1e-12)))
    rest = max(device.delay_s - whole * period, 0.0)
    rest = 0.0 if rest < 1e-9 * period else rest
    both = np.zeros((a.shape[0], n + 1, n + 1))
    both[:, :n, :n], both[:, :n, n] = a, b
    first = expm(both * (period - rest))
    if rest:
        second = expm(both * rest)
        transition = first[:, :n, :n] @ second[:, :n, :n]
        late = np.einsum("unm,um->un", first[:, :n, :n], second[:, :n, n])
    else:
        transition, late = first[:, :n, :n], np.zeros_like(b)
    if not np.all(np.isfinite(transition)):
        raise InputError(
            "the motion of device and user over one period cannot be computed: check the device's values and units"
        )
    return SampledLoop(
        transition=transition, now=first[:, :n, n], late=late, position=position, whole=whole, period_s=period
    )


def _with_position(mobility: Realisation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, B and the row vector of the position, for a mobility whose port has mass."""
    a, b, c = mobility.a, mobility.b, mobility.c
    if mobility.low < 0:  # a free mass: its constant velocity is also a state
        root = np.sqrt(mobility.k)[:, None]
        a = np.pad(a, ((0, 0), (1, 0), (1, 0)))
        b, c = np.concatenate([root, b], axis=1), np.concatenate([root, c], axis=1)
    if mobility.low > 0:
        return a, b, np.linalg.solve(np.swapaxes(a, 1, 2), c[..., None])[..., 0]
    a = np.pad(a, ((0, 0), (0, 1), (0, 1)))
    a[:, -1, :-1] = c
    b = np.pad(b, ((0, 0), (0, 1)))
    position = np.zeros_like(b)
    position[:, -1] = 1.0
    return a, b, position


def stable(
    loop: SampledLoop,
    stiffness: np.ndarray,
    damping: np.ndarray,
    *,
    workers: int = 2,
    progress: Callable[[str, int, int], None] | None = None,
) -> np.ndarray:
    """Whether every user's loop is stable at every gain.

    Parameters
    ----------
    loop : SampledLoop
    stiffness, damping : ndarray, shape (G,)
        The same gains for all users, in N/m and N s/m.
    workers : int
        Number of threads; the result does not depend on it.
    progress : callable, optional

    Returns
    -------
    ndarray of bool, shape (U, G)
    """
    blocks = [np.arange(i, min(i + _BLOCK, len(loop))) for i in range(0, len(loop), _BLOCK)]
    shape = (len(loop), stiffness.size)
    gains = np.broadcast_to(stiffness, shape), np.broadcast_to(damping, shape)

    def one(rows: np.ndarray) -> np.ndarray:
        return loop[rows].inside(gains[0][rows], gains[1][rows])

    found = []
    with ThreadPoolExecutor(workers) as pool:  # compiled functions run without the interpreter's lock
        for done, block in enumerate(pool.map(one, blocks), 1):
            found.append(block)
            if progress is not None:
                progress("stability", done, len(blocks))
    return np.concatenate(found)


def largest_stiffness(
    loop: SampledLoop, damping: float, highest: float, *, lowest: float = 1.0, halvings: int = _BISECTIONS
) -> tuple[np.ndarray, np.ndarray]:
    """Stiffness at which stability ends when the stiffness of the wall is raised from low values.

    Parameters
    ----------
    loop : SampledLoop
    damping : float
        Virtual damping in N s/m.
    highest, lowest : float
        Range of stiffnesses in N/m that is searched, in logarithmic steps and then by bisection.
    halvings : int
        Number of bisections of the step that contains the limit.

    Returns
    -------
    stiffness : ndarray, shape (U,)
        The lowest limit in N/m; zero for a user with whom even `lowest` is unstable, `highest` if there is no limit.
    frequency_hz : ndarray, shape (U,)
        Frequency of the oscillation at the limit; NaN if there is none.
    """
    scan = np.geomspace(lowest, highest, _SCAN)
    users = len(loop)

    good = loop.inside(np.broadcast_to(scan, (users, scan.size)), np.full((users, scan.size), damping))
    ends = np.where(good.all(axis=1), scan.size, np.argmin(good, axis=1))
    low = np.log(scan[np.clip(ends - 1, 0, None)])
    high = np.log(scan[np.clip(ends, None, scan.size - 1)])
    for _ in range(halvings):
        middle = (low + high) / 2
        fine = loop.radius(np.exp(middle)[:, None], np.full((users, 1), damping))[:, 0] < 1 + MARGIN
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    found = np.where(ends == 0, 0.0, np.where(ends == scan.size, highest, np.exp(low)))
    poles = loop.poles(np.exp(high)[:, None], np.full((users, 1), damping))[:, 0]
    worst = np.take_along_axis(poles, np.argmax(np.abs(poles), axis=1)[:, None], axis=1)[:, 0]
    frequency = np.abs(np.angle(worst)) / (2 * np.pi * loop.period_s)
    return found, np.where(ends == scan.size, np.nan, frequency)
