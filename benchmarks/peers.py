r"""The fingertip's network evaluated by peers: numpy written by hand, impedance.py, JAX.

All of them compute what one likelihood needs: the impedance at every frequency and

.. math:: \chi^2 = \sum_k |z_k - Z_k(\theta)|^2 / \sigma_k^2,

numpy and JAX also its gradient by the log elements. In the force-voltage analogy a mass is an inductance, a compliance
a capacitance and a damper a resistance. Forces that add are voltages that add, so parallel elements of the mechanical
network are in series in the circuit.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np

NETWORK = "skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))"
ELEMENTS = ("n3", "r3", "m2", "r1", "n1", "m1", "n2", "r2")
CIRCUIT = "p(C3-R3,L2-R1-C1-p(L1,C2-R2))"
CIRCUIT_ORDER = ("n3", "r3", "m2", "r1", "n1", "m1", "n2", "r2")
"""Order in which impedance.py numbers the parameters of :data:`CIRCUIT`."""


def numpy_parts(theta: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, ...]:
    """Skin, limb's spring and damper, limb, tissue and the whole: each (S, F), from log elements (S, 8)."""
    n3, r3, m2, r1, n1, m1, n2, r2 = np.exp(theta).T[:, :, None]
    s = 1j * omega
    skin = r3 + 1 / (s * n3)
    shank = r2 + 1 / (s * n2)
    limb = 1 / (1 / (s * m1) + 1 / shank)
    tissue = s * m2 + r1 + 1 / (s * n1) + limb
    return skin, shank, limb, tissue, 1 / (1 / skin + 1 / tissue)


def numpy_chi_square(theta: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Shape (S,)."""
    rest = numpy_parts(theta, omega)[-1] - z
    return np.asarray((rest.real**2 + rest.imag**2) @ weight)


def numpy_gradient(
    theta: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Chi-square (S,) and its gradient (S, 8), by the chain rule written out."""
    n3, r3, m2, r1, n1, m1, n2, r2 = np.exp(theta).T[:, :, None]
    s = 1j * omega
    skin, shank, limb, tissue, whole = numpy_parts(theta, omega)
    by_skin, by_tissue = (whole / skin) ** 2, (whole / tissue) ** 2
    by_shank, by_mass = by_tissue * (limb / shank) ** 2, by_tissue * (limb / (s * m1)) ** 2
    derivative = (
        -by_skin / (s * n3),
        by_skin * r3,
        by_tissue * s * m2,
        by_tissue * r1,
        -by_tissue / (s * n1),
        by_mass * s * m1,
        -by_shank / (s * n2),
        by_shank * r2,
    )
    rest = whole - z
    weighted = 2 * weight * rest.conj()
    gradient = np.stack([np.sum((weighted * d).real, axis=1) for d in derivative], axis=1)
    return np.asarray((rest.real**2 + rest.imag**2) @ weight), gradient


def impedance_py(theta: np.ndarray, omega: np.ndarray, z: np.ndarray, weight: np.ndarray) -> Callable[[], float]:
    """One chi-square by impedance.py, through its `CustomCircuit.predict`."""
    from impedance.models.circuits import CustomCircuit

    parameters = circuit_parameters(theta)
    circuit = CustomCircuit(CIRCUIT, initial_guess=parameters)
    frequency = omega / (2 * np.pi)

    def chi_square() -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that the parameters are initial ones
            rest = circuit.predict(frequency, use_initial=True) - z
        return float((rest.real**2 + rest.imag**2) @ weight)

    return chi_square


def circuit_parameters(theta: np.ndarray) -> list[float]:
    """Log elements in our order as the circuit's parameters."""
    values = dict(zip(ELEMENTS, np.exp(theta), strict=True))
    return [float(values[name]) for name in CIRCUIT_ORDER]


def jax_functions(omega: np.ndarray, z: np.ndarray, weight: np.ndarray) -> tuple[Any, Any] | None:
    """Compiled functions of log elements (S, 8): chi-square, and with its gradient; None without JAX."""
    try:
        import jax
    except ImportError:
        return None
    jax.config.update("jax_enable_x64", True)
    jnp = jax.numpy

    def one(theta: Any) -> Any:
        n3, r3, m2, r1, n1, m1, n2, r2 = jnp.exp(theta)
        s = 1j * omega
        shank = r2 + 1 / (s * n2)
        limb = 1 / (1 / (s * m1) + 1 / shank)
        tissue = s * m2 + r1 + 1 / (s * n1) + limb
        rest = 1 / (1 / (r3 + 1 / (s * n3)) + 1 / tissue) - z
        return jnp.sum(weight * (rest.real**2 + rest.imag**2))

    return jax.jit(jax.vmap(one)), jax.jit(jax.vmap(jax.value_and_grad(one)))
