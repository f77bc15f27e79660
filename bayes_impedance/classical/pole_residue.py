r"""Rational impedances as partial fractions.

.. math:: z(s) = \sum_k \frac{c_k}{s - p_k} + d + e\,s

With real d and e, and with poles and residues that are real or come in conjugate pairs, the polynomials of
:math:`z = N/D` have real coefficients by construction. A pole at exactly 0 is a spring to ground: eq. 4 has one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bayes_impedance.display import Brief
from bayes_impedance.network.rational import TransferFunction

_PAIRING = 1e-9
"""Relative difference up to which two poles or residues count as conjugates. By choice: above rounding errors, and
below the digits that are given in practice."""


@dataclass(frozen=True, eq=False, repr=False)
class PoleResidue(Brief):
    """A real rational function of s with simple poles.

    Attributes
    ----------
    poles : ndarray, complex, shape (P,)
        In rad/s; conjugates are listed, too.
    residues : ndarray, complex, shape (P,)
        In the impedance's unit times rad/s.
    constant : float
        The value d, in the impedance's unit.
    linear : float
        The coefficient e of s: a mass.

    Raises
    ------
    ValueError
        If the shapes differ, a number is not finite, or a complex pole lacks its conjugate or their residues are not
        conjugate.
    """

    poles: np.ndarray
    residues: np.ndarray
    constant: float = 0.0
    linear: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "poles", np.asarray(self.poles, dtype=complex))
        object.__setattr__(self, "residues", np.asarray(self.residues, dtype=complex))
        if self.poles.ndim != 1 or self.poles.shape != self.residues.shape:
            raise ValueError(
                f"poles have shape {self.poles.shape} and residues {self.residues.shape}: give one residue for each "
                "pole"
            )
        if not np.all(np.isfinite([*self.poles, *self.residues, self.constant, self.linear])):
            raise ValueError("a pole, residue or coefficient is not finite: all must be")
        pairs = list(zip(self.poles, self.residues, strict=True))
        largest = max((abs(residue) for residue in self.residues), default=0.0)
        for pole, residue in pairs:
            if not any(
                abs(pole.conjugate() - p) <= _PAIRING * abs(pole)
                and abs(residue.conjugate() - c) <= _PAIRING * max(abs(residue), 1e-6 * largest)
                for p, c in pairs
            ):
                raise ValueError(f"pole {pole:.6g} with residue {residue:.6g} has no conjugate partner: list both")

    def __call__(self, s: npt.ArrayLike) -> np.ndarray:
        """Value at complex frequency s (rad/s), same shape as `s`."""
        s = np.asarray(s, dtype=complex)
        fractions = self.residues / (s[..., None] - self.poles)
        return np.asarray(fractions.sum(axis=-1) + self.constant + self.linear * s)

    def transfer_function(self) -> TransferFunction:
        """The same function as a ratio of polynomials, real coefficients, 1 as the denominator's highest."""
        denominator = np.poly(self.poles).real if self.poles.size else np.ones(1)
        numerator = np.polymul(denominator, [self.linear, self.constant] if self.linear else [self.constant])
        for k, residue in enumerate(self.residues):
            rest = residue * np.poly(np.delete(self.poles, k))
            numerator = np.polyadd(numerator, rest.real)  # the imaginary parts of conjugates cancel
        return TransferFunction.from_coefficients(np.trim_zeros(numerator, "f").tolist(), denominator.tolist())


def partial_fractions(transfer: TransferFunction) -> PoleResidue:
    """Expand a ratio of real polynomials with simple poles.

    Parameters
    ----------
    transfer : TransferFunction
        The degree of the numerator is at most one above the denominator's. A denominator that ends in exactly 0 has a
        pole at exactly 0.

    Raises
    ------
    ValueError
        If coefficients are complex, the degrees do not allow it, or a pole is multiple.
    """
    numerator = np.atleast_1d(np.trim_zeros(np.asarray(transfer.numerator), "f"))
    denominator = np.atleast_1d(np.trim_zeros(np.asarray(transfer.denominator), "f"))
    if np.iscomplexobj(numerator) or np.iscomplexobj(denominator):
        raise ValueError(
            "the coefficients are complex, but those of a driving-point impedance are real: drop the imaginary parts"
        )
    numerator, denominator = numerator.astype(float), denominator.astype(float)
    if numerator.size > denominator.size + 1:
        raise ValueError(
            f"degree {numerator.size - 1} over {denominator.size - 1}: an impedance has at most one pole at infinity"
        )
    scale = _frequency_scale(denominator)
    numerator, denominator = _scaled(numerator, scale), _scaled(denominator, scale)
    # The polynomial part from the leading coefficients; the residues need no remainder, since D is 0 at its roots.
    excess = numerator.size - denominator.size
    linear = numerator[0] / denominator[0] if excess == 1 else 0.0
    constant = 0.0
    if excess >= 0:
        below = denominator[1] if denominator.size > 1 else 0.0
        constant = (numerator[excess] - linear * below) / denominator[0]
    poles = _conjugate(np.roots(denominator))
    slope = np.polyval(np.polyder(denominator), poles) if poles.size else np.zeros(0)
    for i, pole in enumerate(poles):
        if np.any(np.abs(np.delete(poles, i) - pole) <= 1e-7 * max(abs(pole), 1e-12)):
            raise ValueError(
                f"pole {pole * scale:.6g} rad/s is multiple, so that there are no simple partial fractions: separate "
                "the poles slightly"
            )
    residues = _conjugate(np.polyval(numerator, poles) / slope) if poles.size else np.zeros(0)
    return PoleResidue(poles * scale, residues * scale, float(constant), float(linear / scale))


def _frequency_scale(denominator: np.ndarray) -> float:
    """Geometric mean of the sizes of the poles other than 0: around it powers of s neither over- nor underflow."""
    kept = np.trim_zeros(denominator, "b")
    return float(abs(kept[-1] / kept[0]) ** (1 / (kept.size - 1))) if kept.size > 1 else 1.0


def _scaled(coefficients: np.ndarray, scale: float) -> np.ndarray:
    """Coefficients of the same polynomial in s/scale."""
    return np.asarray(coefficients * scale ** np.arange(coefficients.size - 1, -1, -1))


def _conjugate(values: np.ndarray) -> np.ndarray:
    """Make adjacent conjugate pairs, in LAPACK's order of roots, exactly conjugate."""
    values = np.asarray(values, dtype=complex).copy()
    i = 0
    while i < values.size:
        if values[i].imag != 0 and i + 1 < values.size:
            values[i + 1] = values[i].conjugate()
            i += 2
        else:
            values[i] = values[i].real
            i += 1
    return values
