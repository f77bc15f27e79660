r"""Real part of a rational impedance on the imaginary axis: its value, its rounding error, and its sign changes.

**Poles and residues.** Lossless terms (a pole at 0, :math:`e\,s`, pairs on the axis) have no real part there and are
removed. Since poles are real or conjugate, the others give, with :math:`x = s^2 = -\omega^2`,

.. math:: \operatorname{Re} z(j\omega) = d + \sum_k \frac{g_k}{x - q_k}, \qquad q_k = p_k^2, \quad g_k = c_k p_k,

which changes sign only at its real negative roots x. (So does :math:`\operatorname{Im} z / \omega` with e and
:math:`c_k` in place of d and :math:`g_k`: there the phase is 0 or 180 degrees.) The roots are eigenvalues of the pencil

.. math:: \begin{pmatrix} \operatorname{diag} q & \mathbf 1 \\ g^\top & d \end{pmatrix}
          - x \begin{pmatrix} I & 0 \\ 0 & 0 \end{pmatrix},

the Hamiltonian pencil of the passivity tests of Boyd, Balakrishnan and Kabamba [1]_ and Grivet-Talocia [2]_, reduced
to half its size by the symmetry of :math:`z(s) + z(-s)` as in [3]_; it needs no inverse of d, which may be 0. As q
covers twice the decades of the poles, in a single eigenvalue problem the rounding error of the large roots would exceed
the small roots. Shifted to :math:`\sigma` and inverted, the pencil becomes the ordinary matrix

.. math:: T(\sigma) = D^{-1} + \frac{D^{-1}\mathbf 1\, g^\top D^{-1}}{d - g^\top D^{-1}\mathbf 1},
          \qquad D = \operatorname{diag}(q) - \sigma I,

whose eigenvalues :math:`1/(x - \sigma)` are accurate for x near :math:`\sigma`. One shift per decade of frequency finds
all roots.

**Ratios of polynomials** need no expansion, and poles off the axis may be multiple: :math:`\operatorname{Re} N/D` has
the sign of the even part of :math:`N(s)\,D(-s)`, which is a polynomial in x.

References
----------
.. [1] S. Boyd, V. Balakrishnan, P. Kabamba, "A bisection method for computing the H-infinity norm of a transfer matrix
   and related problems", Mathematics of Control, Signals and Systems 2 (1989) 207-219.
.. [2] S. Grivet-Talocia, "Passivity enforcement via perturbation of Hamiltonian matrices", IEEE Trans. Circuits and
   Systems I 51 (2004) 1755-1769.
.. [3] A. Semlyen, B. Gustavsen, "A half-size singularity test matrix for fast and reliable passivity assessment of
   rational models", IEEE Trans. Power Delivery 24 (2009) 345-351.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq, minimize_scalar

from bayes_impedance.classical.pole_residue import PoleResidue
from bayes_impedance.errors import InputError
from bayes_impedance.network.rational import TransferFunction

_RESOLUTION = 1e-12
"""Re z below this fraction of its terms' size counts as rounding. By choice: some thousand machine epsilons."""
_ON_AXIS = 1e-7
"""Damping ratio below which a pole counts as lossless. By choice: well above rounding errors of simple roots."""
_RESIDUE_PHASE = 1e-6
"""Phase in radians up to which a residue counts as real. By choice: larger than for a pole, which is more accurate."""
_MULTIPLE = 1e-6
"""Relative distance below which poles count as one multiple pole: rounding moves a double root by about its square
root, 1e-8. By choice: well above that."""
_DECADES_BEYOND = 9
"""Decades of frequency below the slowest and above the fastest pole that are searched for roots. By choice: more shifts
cost time, and each decade needs one."""
_DIPS = 3
"""Number of lowest local minima of the samples that are refined. By choice: the lowest sample alone may lead to a
minimum that is not the global one."""
_TIE = 1e-12
"""Difference of Re z / abs(z) up to which an end of the axis is preferred to a frequency. By choice: rounding error, as
for :data:`_RESOLUTION`."""


@dataclass(frozen=True)
class AxisPole:
    """A pole on the imaginary axis; of a conjugate pair, the one with positive frequency.

    Attributes
    ----------
    pole : complex
        In rad/s; inf is the pole at infinity.
    residue : complex
        In the impedance's unit times rad/s, at infinity the coefficient of s; NaN for a multiple pole.
    """

    pole: complex
    residue: complex


class RealPart(ABC):
    """Re z on the imaginary axis, and the poles that decide passivity; frequencies are in rad/s.

    `ends` holds Re z / abs(z) and Re z at 0 and at infinity; both are 0 where z is imaginary or unbounded.
    """

    unstable: np.ndarray
    wrong: tuple[AxisPole, ...]
    remarks: tuple[str, ...] = ()
    ends: tuple[tuple[float, float], tuple[float, float]]

    @abstractmethod
    def real(self, omega: npt.ArrayLike) -> np.ndarray:
        """Re z without lossless terms."""

    @abstractmethod
    def resolution(self, omega: npt.ArrayLike) -> np.ndarray:
        """Bound on the rounding error of Re z."""

    @abstractmethod
    def magnitude(self, omega: npt.ArrayLike) -> np.ndarray:
        """Abs z."""

    @abstractmethod
    def landmarks(self) -> np.ndarray:
        """Frequencies above 0 between which Re z keeps its sign, and those of poles, shape (L,)."""

    def relative(self, omega: npt.ArrayLike) -> np.ndarray:
        """Re z / abs(z), 0 below the resolution; at 0 and infinity the limit."""
        omega = np.asarray(omega, dtype=float)
        inner = np.where((omega > 0) & np.isfinite(omega), omega, 1.0)
        real, size = self.real(inner), self.magnitude(inner)
        clear = (np.abs(real) > self.resolution(inner)) & (size > 0)
        ratio = np.clip(np.divide(real, size, out=np.zeros(inner.shape), where=clear), -1.0, 1.0)
        return np.where(omega == 0, self.ends[0][0], np.where(np.isinf(omega), self.ends[1][0], ratio))

    def samples(self) -> np.ndarray:
        """Landmarks, a grid around them, and the geometric means between neighbours; ascending, shape (W,)."""
        landmarks = self.landmarks()
        low, high = (landmarks.min(), landmarks.max()) if landmarks.size else (1.0, 1.0)
        marks = np.unique(np.concatenate([landmarks, np.geomspace(low / 1e3, high * 1e3, 200)]))
        return np.unique(np.concatenate([marks, np.sqrt(marks[1:] * marks[:-1])]))

    def crossing(self, outside: float, inside: float) -> float:
        """Where Re z changes sign between two frequencies; `outside` if there is no clear sign change."""
        if not 0 < inside < np.inf or not 0 < outside < np.inf:
            return float(outside)
        ends = np.log([outside, inside])
        if np.prod(np.sign(self.real(np.exp(ends)))) >= 0:
            return float(outside)
        return float(np.exp(brentq(lambda x: float(self.real(np.exp(x))), *ends)))

    def lowest(self, omega: np.ndarray, with_zero: bool, with_infinity: bool) -> tuple[float, float]:
        """Frequency and value of the smallest Re z / abs(z) near ascending frequencies, optionally also at the ends."""
        relative = self.relative(omega)
        padded = np.concatenate([[np.inf], relative, [np.inf]])
        dips = np.flatnonzero((relative <= padded[:-2]) & (relative <= padded[2:]))
        found = []
        for best in dips[np.argsort(relative[dips])][:_DIPS]:
            found.append((float(omega[best]), float(relative[best])))
            low, high = omega[max(best - 1, 0)], omega[min(best + 1, omega.size - 1)]
            if low < high:
                # The variable is the fraction of the interval: the minimiser resolves no less than 1e-8 of it.
                local = minimize_scalar(
                    lambda x, low=low, high=high: float(self.relative(low * (high / low) ** x)),
                    bounds=(0, 1),
                    method="bounded",
                    options={"xatol": 1e-6},
                )
                found.append((float(low * (high / low) ** local.x), float(local.fun)))
        ends = ((with_zero, 0.0, self.ends[0][0]), (with_infinity, np.inf, self.ends[1][0]))
        found += [(place, value) for wanted, place, value in ends if wanted]
        # An end is preferred to frequencies at which the value is lower by rounding only.
        return min(found, key=lambda pair: pair[1] - (_TIE if pair[0] in (0.0, np.inf) else 0.0))


def real_part(model: PoleResidue | TransferFunction) -> RealPart:
    """Re z on the imaginary axis.

    Raises
    ------
    InputError
        If coefficients are not finite or the denominator is 0.
    """
    return _OfFractions(model) if isinstance(model, PoleResidue) else _OfRatio(model)


def on_axis(poles: np.ndarray) -> np.ndarray:
    """Mask of the lossless poles, bool, same shape."""
    return np.asarray(np.abs(poles.real) <= _ON_AXIS * np.abs(poles))


def _is_positive(residue: complex, rounding: float = 0.0) -> bool:
    return residue.real > 0 and abs(residue.imag) <= _RESIDUE_PHASE * abs(residue) + rounding


class _OfFractions(RealPart):
    """Re z of a function given by poles and residues."""

    def __init__(self, model: PoleResidue) -> None:
        self.model = model
        present = model.residues != 0  # a zero residue means no pole
        poles, residues = model.poles[present], model.residues[present]
        # A slightly damped pole with another residue has a finite contribution to Re z, which is tested.
        positive = np.array([_is_positive(residue) for residue in residues], dtype=bool)
        lossless = on_axis(poles) & (positive | (np.abs(poles.real) <= _RESOLUTION * np.abs(poles)) | (poles.real > 0))
        self.poles, self.residues = poles[~lossless], residues[~lossless]
        self.unstable = self.poles[self.poles.real > 0]
        pairs = zip(poles[lossless].tolist(), residues[lossless].tolist(), strict=True)
        lossless_poles = [AxisPole(pole, residue) for pole, residue in pairs]
        if model.linear:
            lossless_poles.append(AxisPole(complex(np.inf), complex(model.linear)))
        self.wrong = tuple(a for a in lossless_poles if a.pole.imag >= 0 and not _is_positive(a.residue))
        zero, infinity = 0.0 if np.any(poles == 0) else self.real(0.0), 0.0 if model.linear else model.constant
        zero = zero if abs(zero) > self.resolution(0.0) else 0.0
        self.ends = ((float(np.sign(zero)), float(zero)), (float(np.sign(infinity)), float(infinity)))

    def _terms(self, omega: npt.ArrayLike) -> np.ndarray:
        """Terms of the sum, shape (..., P); as products, since a difference of squares cancels near a resonance."""
        s = 1j * np.asarray(omega)[..., None]
        return np.asarray(-self.residues * self.poles / ((self.poles - s) * (self.poles + s)))

    def real(self, omega: npt.ArrayLike) -> np.ndarray:
        return np.asarray(self._terms(omega).real.sum(axis=-1) + self.model.constant)

    def resolution(self, omega: npt.ArrayLike) -> np.ndarray:
        return np.asarray(_RESOLUTION * (np.abs(self._terms(omega)).sum(axis=-1) + abs(self.model.constant)))

    def magnitude(self, omega: npt.ArrayLike) -> np.ndarray:
        with np.errstate(divide="ignore", invalid="ignore"):  # on a lossless pole
            return np.asarray(np.nan_to_num(np.abs(self.model(1j * np.asarray(omega))), nan=np.inf, posinf=np.inf))

    def landmarks(self) -> np.ndarray:
        if not self.poles.size:
            return np.zeros(0)
        sizes = np.abs(self.poles)
        ends = np.log10(sizes.min()) - _DECADES_BEYOND, np.log10(sizes.max()) + _DECADES_BEYOND
        constant, linear = self.model.constant, self.model.linear
        real = _sign_changes(self.poles**2, self.residues * self.poles, constant, *ends)
        imaginary = _sign_changes(self.model.poles**2, self.model.residues, linear, *ends)
        marks = np.concatenate([real, imaginary, _around(self.poles)])
        return marks[marks > 0]


def _around(roots: np.ndarray) -> np.ndarray:
    """Magnitudes of poles or zeros, and frequencies across the width of their resonances."""
    steps = np.array([0.0, 0.5, 1, 2, 4, 8, 32, 128])
    widths = np.abs(roots.real) * np.concatenate([-steps, steps])[:, None]
    return np.concatenate([np.abs(roots), (np.abs(roots.imag) + widths).ravel()])


def _sign_changes(q: np.ndarray, g: np.ndarray, d: float, low: float, high: float) -> np.ndarray:
    """Frequencies in rad/s that include all roots of d + sum g/(x - q), x = -omega**2; `low`, `high` are log10."""
    # Shifts off the negative real axis, where roots and poles of a real function of x are unlikely.
    shifts = -(10.0 ** (2 * np.linspace(low, high, int(high - low) + 2)[:, None])) * (1 + 0.3j)
    difference = q - shifts
    parts = g / difference
    value = d - parts.sum(axis=1)
    value = np.where(value == 0, 1e-16 * np.abs(parts).sum(axis=1), value)  # avoids division by 0 at an exact root
    half = np.sqrt(g) / difference  # a similarity transform that makes T symmetric balances it
    matrices = half[:, :, None] * half[:, None, :] / value[:, None, None]
    diagonal = np.arange(g.size)
    matrices[:, diagonal, diagonal] += 1 / difference
    inverse = np.linalg.eigvals(matrices)
    x = shifts + 1 / np.where(inverse == 0, np.inf, inverse)
    distance = np.abs(x) / np.abs(shifts)
    return np.asarray(np.sqrt(-x[(distance > 1e-3) & (distance < 1e3) & (x.real < 0)].real))


class _OfRatio(RealPart):
    """Re z of a ratio of two polynomials, kept in descending powers of s divided by a typical frequency."""

    def __init__(self, transfer: TransferFunction) -> None:
        both = [np.array([complex(c) for c in p]) for p in (transfer.numerator, transfer.denominator)]
        if not all(np.all(np.isfinite(p)) for p in both) or not np.any(both[1].real):
            raise InputError("the transfer function's coefficients must be finite, and its denominator not 0")
        if any(np.any(p.imag) for p in both):
            self.remarks = (
                "the coefficients are complex, but those of a driving-point impedance are real: drop the imaginary "
                "parts",
            )
        numerator, denominator = (np.trim_zeros(p.real, "f") for p in both)
        while numerator.size and numerator[-1] == 0 == denominator[-1]:
            numerator, denominator = numerator[:-1], denominator[:-1]
        numerator = numerator if numerator.size else np.zeros(1)
        kept = np.trim_zeros(denominator if denominator[:-1].any() else numerator, "b")
        self.scale = float(abs(kept[-1] / kept[0]) ** (1 / (kept.size - 1))) if kept.size > 1 else 1.0
        self.numerator, self.denominator = (
            p * self.scale ** np.arange(p.size - 1, -1, -1) for p in (numerator, denominator)
        )
        mirrored = self.denominator * (-1.0) ** np.arange(self.denominator.size - 1, -1, -1)
        size = np.polymul(np.abs(self.numerator), np.abs(self.denominator))
        product = np.polymul(self.numerator, mirrored)
        product = np.where(np.abs(product) > 1e-14 * size, product, 0.0)
        self.size, self.even, self.odd = (p[::-2][::-1] for p in (size, product, product[:-1]))
        poles = np.roots(self.denominator)
        lossless = on_axis(poles)
        self.unstable = poles[(poles.real > 0) & ~lossless] * self.scale
        self.wrong = tuple(self._wrong(poles, lossless))
        zero = self.numerator[-1] / self.denominator[-1] if self.denominator[-1] else 0.0
        infinity = self.numerator[0] / self.denominator[0] if self.numerator.size == self.denominator.size else 0.0
        self.ends = ((float(np.sign(zero)), float(zero)), (float(np.sign(infinity)), float(infinity)))

    def _wrong(self, poles: np.ndarray, lossless: np.ndarray) -> list[AxisPole]:
        found = []
        for i in np.flatnonzero(lossless & (poles.imag >= 0)):
            equal = np.abs(poles - poles[i]) <= _MULTIPLE * np.abs(poles[i])
            slope = np.polyval(np.polyder(self.denominator), poles[i]) / self.scale
            multiple = equal.sum() > 1
            residue = complex(np.nan if multiple else np.polyval(self.numerator, poles[i]) / slope)
            terms = 0.0 if multiple else float(np.polyval(np.abs(self.numerator), np.abs(poles[i])) / np.abs(slope))
            # The residue of a pole just left of the axis may be complex: its contribution to Re z is tested.
            tolerated = _is_positive(residue, _RESOLUTION * terms) or (poles[i].real < 0 < residue.real)
            wrong = multiple or not tolerated
            if np.flatnonzero(equal)[0] == i and wrong:
                found.append(AxisPole(complex(poles[i] * self.scale), residue))
        excess = self.numerator.size - self.denominator.size
        if excess > 0 and (excess > 1 or self.numerator[0] / self.denominator[0] < 0):
            linear = np.nan if excess > 1 else self.numerator[0] / self.denominator[0] / self.scale
            found.append(AxisPole(complex(np.inf), complex(linear)))
        return found

    def _over_denominator(self, polynomial: np.ndarray, omega: npt.ArrayLike, sign: float) -> np.ndarray:
        """A polynomial in +-omega**2 over abs(D)**2; 0 on a lossless pole."""
        y = np.asarray(omega) / self.scale
        below = np.abs(_without_power(self.denominator, 1j * y)) ** 2
        power = np.maximum(y, 1.0) ** (2 * (polynomial.size - self.denominator.size))
        above = _without_power(polynomial, sign * y**2) * power
        return np.asarray(np.divide(above, below, out=np.zeros(y.shape), where=below > 0))

    def real(self, omega: npt.ArrayLike) -> np.ndarray:
        return self._over_denominator(self.even, omega, -1.0)

    def resolution(self, omega: npt.ArrayLike) -> np.ndarray:
        return np.asarray(_RESOLUTION * self._over_denominator(self.size, omega, 1.0))

    def magnitude(self, omega: npt.ArrayLike) -> np.ndarray:
        y = np.asarray(omega) / self.scale
        below = np.abs(_without_power(self.denominator, 1j * y))
        power = np.maximum(y, 1.0) ** (self.numerator.size - self.denominator.size)
        above = np.abs(_without_power(self.numerator, 1j * y)) * power
        return np.asarray(np.divide(above, below, out=np.full(y.shape, np.inf), where=below > 0))

    def landmarks(self) -> np.ndarray:
        x = np.concatenate([_roots(self.even), _roots(self.odd)])
        roots = np.concatenate([np.roots(self.numerator), np.roots(self.denominator)])
        marks = np.concatenate([np.sqrt(-x[x.real < 0].real), _around(roots)])
        return marks[marks > 0] * self.scale


def _roots(polynomial: np.ndarray) -> np.ndarray:
    """Roots other than 0, and again as reciprocal roots of the reversed polynomial, more accurate for small ones."""
    both = [np.roots(np.trim_zeros(p, "f")) for p in (polynomial, polynomial[::-1])]
    return np.concatenate([both[0][both[0] != 0], 1 / both[1][both[1] != 0]])


def _without_power(polynomial: np.ndarray, x: np.ndarray) -> np.ndarray:
    """A polynomial's value over max(1, abs(x))**degree, which does not overflow."""
    large = np.abs(x) > 1
    small = np.polyval(polynomial, np.where(large, 0.0, x))
    inverse = 1 / np.where(large, x, 1.0)
    phase = (np.where(large, x, 1.0) * np.abs(inverse)) ** (polynomial.size - 1)
    return np.asarray(np.where(large, np.polyval(polynomial[::-1], inverse) * phase, small))
