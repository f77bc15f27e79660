r"""Tissue from first principles: waves in a layer, diffusing fluid, spectra of relaxation, contact, creep.

Impedances are z = F/v in N s/m, s = jw in rad/s, compliances in m/N. Two-ports are chain matrices

.. math:: \begin{pmatrix} F_1\\ v_1\end{pmatrix} =
          \begin{pmatrix} A & B\\ C & D\end{pmatrix} \begin{pmatrix} F_2\\ v_2\end{pmatrix}, \qquad AD - BC = 1,

with port 1 at the contactor and port 2 towards the bone; the load z at port 2 is seen as (A z + B)/(C z + D).

**Shear layer.** A layer of area A, thickness h, density rho and complex shear modulus G(s) obeys
d F/dx = -s rho A v, d v/dx = -s F/(G A). With its total mass M = rho A h and its quasi-static impedance
z_0 = G A/(s h),

.. math:: x = \sqrt{s M / z_0}, \quad Z_c = \sqrt{s M z_0}, \quad
          A = D = \cosh x, \; B = Z_c \sinh x, \; C = \sinh x / Z_c .

On a rigid base (v_2 = 0) it shows A/C = Z_c coth x, for slow motion z_0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class TwoPort:
    """A chain matrix; entries in 1, N s/m, m/(N s), 1, each broadcasting to (..., F)."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray

    def __matmul__(self, other: TwoPort) -> TwoPort:
        """Chain: self stands nearer to the contactor."""
        return TwoPort(
            self.a * other.a + self.b * other.c,
            self.a * other.b + self.b * other.d,
            self.c * other.a + self.d * other.c,
            self.c * other.b + self.d * other.d,
        )

    def seen(self, z: np.ndarray) -> np.ndarray:
        """Impedance at port 1 with z at port 2."""
        return np.asarray((self.a * z + self.b) / (self.c * z + self.d))


def common_velocity(z: np.ndarray) -> TwoPort:
    """Two-port of an impedance that moves with the contactor, such as a mass (z = s m): forces add."""
    one, zero = np.ones_like(z), np.zeros_like(z)
    return TwoPort(one, z, zero, one)


def common_force(mobility: np.ndarray) -> TwoPort:
    """Two-port of a mobility that transmits the force, such as a spring (s n): velocities add."""
    one, zero = np.ones_like(mobility), np.zeros_like(mobility)
    return TwoPort(one, zero, mobility, one)


def shear_layer(s: np.ndarray, mass: np.ndarray | float, quasi_static: np.ndarray) -> TwoPort:
    """The exact two-port of a layer with mass M (kg) and quasi-static impedance z_0 (N s/m)."""
    x = np.sqrt(s * mass / quasi_static)
    characteristic = np.sqrt(s * mass * quasi_static)
    # Both roots have Re >= 0 for a passive layer; if rounding flips the sign of one, sinh and Z_c flip with x.
    characteristic = np.where((characteristic * x / (s * mass)).real < 0, -characteristic, characteristic)
    return TwoPort(np.cosh(x), characteristic * np.sinh(x), np.sinh(x) / characteristic, np.cosh(x))


def layer_on_rigid_base(s: np.ndarray, mass: np.ndarray | float, quasi_static: np.ndarray) -> np.ndarray:
    """Impedance of a shear layer whose far side is held."""
    line = shear_layer(s, mass, quasi_static)
    return np.asarray(line.a / line.c)


def relaxation_spectrum(
    s: np.ndarray, coefficient: np.ndarray | float, exponent: np.ndarray | float, per_decade: int = 2
) -> np.ndarray:
    r"""Power-law tissue as a sum of Maxwell branches with a power-law spectrum of relaxation times.

    From :math:`\int_0^\infty \frac{\tau^{-a}}{1 + s\tau} d\tau\,\frac{\sin\pi a}{\pi} = s^{a-1}`, with branches of
    dampers :math:`c\,\frac{\sin \pi a}{\pi}\tau^{1-a}\,\Delta\ln\tau` and relaxation times spaced evenly in
    logarithm, from 1e-12 s to 1e8 s: beyond both ends of every band by decades. The trapezoidal rule in ln(tau) errs by
    about exp(-pi^2/step), 2e-4 for two branches per decade.

    Parameters
    ----------
    s : ndarray, complex, shape (F,)
    coefficient : ndarray or float
        c in N s^a/m.
    exponent : ndarray or float
        a, between 0 (spring) and 1 (damper).
    per_decade : int
        Branches.

    Returns
    -------
    ndarray, complex
        Approximately c s^(a-1).
    """
    step = np.log(10) / per_decade
    total = np.zeros(np.broadcast_shapes(np.shape(coefficient), np.shape(exponent), s.shape), dtype=complex)
    for tau in np.exp(np.arange(np.log(1e-12), np.log(1e8), step)):
        total += tau ** (1 - np.asarray(exponent)) / (1 + s * tau)
    return np.asarray(coefficient * np.sin(np.pi * np.asarray(exponent)) / np.pi * step * total)


def poroelastic(s: np.ndarray, stiffness: np.ndarray | float, time: np.ndarray | float) -> np.ndarray:
    r"""Fluid that has to diffuse out of a layer (Biot): :math:`z = \frac ks\bigl(1 - \frac{\tanh x}{x}\bigr)`.

    x^2 = s tau with the diffusion time tau = h^2/c_v. Fast motion traps the fluid (stiffness k, N/m); slow motion
    lets it out, which leaves a damper k tau/3.
    """
    x = np.sqrt(s * time)
    return np.asarray(stiffness / s * (1 - np.tanh(x) / x))


def fractional_zener(
    s: np.ndarray, compliance: np.ndarray | float, coefficient: np.ndarray | float, exponent: float
) -> np.ndarray:
    """A spring (m/N) in series with a power-law element c s^(a-1): mobilities add."""
    return np.asarray(1 / (s * compliance + s ** (1 - exponent) / coefficient))


def causal_hysteresis(s: np.ndarray, loss: np.ndarray | float, low_rad_s: float) -> np.ndarray:
    r"""Factor of a spring with a causal loss that hardly depends on frequency (Biot 1958).

    A flat spectrum of relaxation times below 1/w_0 gives
    :math:`1 + \frac{2\eta}{\pi}\ln(1 + s/\omega_0)`: loss factor eta and a stiffness that grows with the logarithm of
    frequency, as Kramers and Kronig demand.
    """
    return np.asarray(1 + 2 * loss / np.pi * np.log(1 + s / low_rad_s))


def hertz_exponents() -> dict[str, float]:
    r"""How skin compliance and damping follow the static contact force: F^(-1/3) and F^(1/3).

    The contact radius of a sphere grows as F^(1/3) (Hertz), and the tangential stiffness of the contact and the tissue
    that takes part in its loss grow in proportion to that radius (Mindlin).
    """
    return {"n3": -1 / 3, "r3": 1 / 3}


def logarithmic_creep(time_s: np.ndarray, onset_s: float) -> np.ndarray:
    """ln(1 + t/t0), the creep of tissue under a held load."""
    return np.asarray(np.log1p(time_s / onset_s))
