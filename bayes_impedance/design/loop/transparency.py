r"""Transparency: the impedance transmitted to a user compared with the desired impedance of the virtual wall.

The desired impedance is :math:`z_w = K/s + B`. A user with the impedance :math:`z_u` and the active force :math:`F_0`
(eq. 3 of the paper, with a force source) feels the transmitted impedance :math:`z_t`, so that the velocity is

.. math:: v = \frac{F_0}{z_u + z_t} \quad\text{instead of}\quad \frac{F_0}{z_u + z_w} .

Sampling is treated exactly. With the motor off the user's force moves the actuator by the phasor :math:`x_o`. Samples
of a sinusoid have its phasor, so in the loop the samples are :math:`x_o / (1 + C(z) G(z))` with
:math:`z = e^{j\omega T}`, the controller :math:`C = K + B (1 - z^{-1})/T` and the exact pulse transfer function G of
:mod:`bayes_impedance.design.loop.sampled_loop`. The component of the held force at the same frequency is

.. math:: f = -C\, \frac{x_o}{1 + C G}\; \frac{1 - e^{-sT}}{sT}\, e^{-s\tau} .

G contains the user, because images above the sampling frequency are reflected by device and user: :math:`z_t` depends
on the user.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.design.loop.device import Device
from bayes_impedance.design.loop.sampled_loop import MARGIN, SampledLoop
from bayes_impedance.design.loop.stability import loop_of
from bayes_impedance.design.loop.two_port import of_device
from bayes_impedance.design.percentiles import PERCENTILES
from bayes_impedance.design.users import Users
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.units import INTERVAL

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True, repr=False)
class Transparency(Brief):
    """Transmitted against desired impedance.

    Attributes
    ----------
    frequency_hz : ndarray, shape (F,)
        Below half the sampling frequency.
    stiffness, damping : float
        Gains in N/m and N s/m.
    desired : ndarray, complex, shape (F,)
    transmitted : ndarray, complex, shape (M, F)
        For the M users with whom the loop is stable.
    velocity_error : ndarray, shape (M, F)
        Modulus of the relative error of the velocity, for the same users.
    share : float
        Share of stable users.
    """

    frequency_hz: np.ndarray
    stiffness: float
    damping: float
    desired: np.ndarray
    transmitted: np.ndarray
    velocity_error: np.ndarray
    share: float

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each frequency: desired magnitude, and median and 90 % interval over stable users of the rest."""
        import pandas as pd

        columns = {"frequency_hz": self.frequency_hz, "desired": np.abs(self.desired)}
        for name, of_users in (("transmitted", np.abs(self.transmitted)), ("velocity_error", self.velocity_error)):
            none = np.full((len(INTERVAL), self.frequency_hz.size), np.nan)
            ends = np.quantile(of_users, INTERVAL, axis=0) if len(of_users) else none
            columns |= {f"{name}{end}": row for end, row in zip(("_q05", "", "_q95"), ends, strict=True)}
        frame = pd.DataFrame(columns)
        magnitudes = [name for name in columns if name.startswith(("desired", "transmitted"))]
        frame.attrs["units"] = {"frequency_hz": "Hz"} | dict.fromkeys(magnitudes, "N s/m")
        return frame

    def band(self, probabilities: tuple[float, ...] = PERCENTILES) -> tuple[np.ndarray, np.ndarray]:
        """Percentiles over users of abs(transmitted/desired) and of the velocity error, each (len, F)."""
        ratio = np.abs(self.transmitted / self.desired)
        errors = np.quantile(self.velocity_error, probabilities, axis=0)
        return np.asarray(np.quantile(ratio, probabilities, axis=0)), np.asarray(errors)


def transparency(
    users: Users, device: Device, stiffness: float, damping: float, frequency_hz: np.ndarray
) -> Transparency:
    """Transmitted impedance over users.

    Parameters
    ----------
    users : Users
    device : Device
    stiffness, damping : float
        Gains in N/m and N s/m, not both zero.
    frequency_hz : ndarray, shape (F,)
        Frequencies at or above half the sampling frequency are left out: they are aliased to lower ones.

    Raises
    ------
    InputError
        If the loop is stable with no user at these gains, or both gains are zero.
    """
    if not stiffness + damping > 0:
        raise InputError("transparency is not defined for a wall without stiffness and damping: give gains above zero")
    frequency_hz = frequency_hz[frequency_hz < 0.5 / device.period_s]
    loop = loop_of(device, users)
    gains = (np.full((len(users), 1), g) for g in (stiffness, damping))
    good = loop.radius(*gains)[:, 0] < 1 + MARGIN
    if not good.any():
        raise InputError(f"no user is stable at K = {stiffness:g} N/m and B = {damping:g} N s/m: lower the gains")
    rows = np.flatnonzero(good)
    s = 2j * np.pi * frequency_hz
    user = users[rows].impedance(frequency_hz)
    a = of_device(device, s).chain
    # With F_t = z_u v_t - F_0 behind the device: F_a = a11 F_t + a12 v_t and v_a = a21 F_t + a22 v_t.
    total = a[:, 0, 0] * user + a[:, 0, 1]
    reach = a[:, 1, 0] * user + a[:, 1, 1]
    tip_open = a[:, 0, 0] / total  # v_t per F_0, motor off
    position_open = (reach * tip_open - a[:, 1, 0]) / s
    controller, pulse = loop_gain(loop[rows], stiffness, damping, frequency_hz)
    hold = -np.expm1(-s * device.period_s) / (s * device.period_s) * np.exp(-s * device.delay_s)
    force = -controller * position_open / (1 + controller * pulse) * hold
    velocity = tip_open + force / total
    desired = stiffness / s + damping
    return Transparency(
        frequency_hz=frequency_hz,
        stiffness=stiffness,
        damping=damping,
        desired=desired,
        transmitted=np.asarray(1 / velocity - user),
        velocity_error=np.asarray(np.abs(velocity * (user + desired) - 1)),
        share=float(good.mean()),
    )


def loop_gain(
    loop: SampledLoop, stiffness: float, damping: float, frequency_hz: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Controller C, shape (F,), and pulse transfer functions G, shape (U, F), at z = exp(j w T)."""
    z = np.exp(2j * np.pi * frequency_hz * loop.period_s)
    controller = stiffness + damping * (1 - 1 / z) / loop.period_s
    n = loop.now.shape[1]
    pulse = np.empty((len(loop), z.size), dtype=complex)
    for f, point in enumerate(z):
        force = loop.now * point**-loop.whole + loop.late * point ** -(loop.whole + 1)
        states = np.linalg.solve(point * np.eye(n) - loop.transition, force[..., None])[..., 0]
        pulse[:, f] = np.sum(loop.position * states, axis=1)
    return controller, pulse
