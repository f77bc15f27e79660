r"""Vector fitting: poles and residues of one measured impedance, without a network.

Fits the stable rational function with real coefficients

.. math:: z(s) = \sum_k \frac{c_k}{s - p_k} + \Bigl[\frac{c_0}{s}\Bigr] + [d] + [e\,s]

closest to a curve :math:`z_f = z(j\omega_f)`; terms in brackets are optional. Only the poles enter nonlinearly.

**Relocation** [1]_. Multiply z by an unknown :math:`\sigma(s)` whose poles are the present poles :math:`q_k` and whose
zeros are the poles of z. These cancel in the product, so that both are sums over the *known* :math:`q_k`, and

.. math:: \sum_k\frac{c_k}{s-q_k} + \Bigl[\frac{c_0}{s}\Bigr] + [d] + [e\,s]
          = z_f\,\Bigl(\sum_k\frac{\tilde c_k}{s-q_k} + \tilde d\Bigr), \qquad s = j\omega_f,

is linear in all unknowns. The zeros of :math:`\sigma`, the eigenvalues of :math:`A - b\,\tilde c^T/\tilde d` with
:math:`(A, b, \tilde c, \tilde d)` its state space, are the next poles; those in the right half plane are reflected.
A pole at exactly 0 (a spring to ground) stays fixed: :math:`\sigma` has no pole there, so the column 1/s is only on the
left. With a term e s in z the left side has a constant d even if z has none, from s times the fractions.

Fixing :math:`\tilde d = 1` would exclude the zero solution but bias the poles of noisy data, because it favours a small
:math:`\sigma`. The relaxed constraint [2]_ leaves :math:`\tilde d` free and fixes an average,
:math:`\sum_f \operatorname{Re}\sigma(j\omega_f) = F`, by one more row; only if the resulting :math:`\tilde d` is too
small to divide by, the step is repeated with 1. The weighted real and imaginary rows are compressed by QR as in [3]_.

**Basis.** A conjugate pair, or two real poles, are the roots of :math:`q(s) = s^2 + a s + b`; both are stable if and
only if a, b > 0. 1/q and s/q span the same functions as their partial fractions and, unlike these, stay independent
where real poles coincide. With an odd number of real poles one is kept as 1/(s + g).

**Refinement.** Relocation minimises the error of the *product*. The weighted error of z itself is minimised afterwards
over log a, log b and log g, which keeps every pole stable. Numerators are eliminated: with :math:`\Phi` the weighted
columns and :math:`P = 1 - \Phi\Phi^+`, the residual of the weighted data y is :math:`r = P\,y`, with derivative [4]_

.. math:: \partial r = -P\,\partial\Phi\,\Phi^+ y - (P\,\partial\Phi\,\Phi^+)^T y .

The second term lies in the span of :math:`\Phi`, to which r is orthogonal: leaving it out keeps the gradient exact.

References
----------
.. [1] B. Gustavsen, A. Semlyen, "Rational approximation of frequency domain responses by vector fitting", IEEE
   Transactions on Power Delivery 14(3), 1999.
.. [2] B. Gustavsen, "Improving the pole relocating properties of vector fitting", IEEE Trans. Power Deliv. 21(3), 2006.
.. [3] D. Deschrijver, M. Mrozowski, T. Dhaene, D. De Zutter, "Macromodeling of multiport systems using a fast
   implementation of the vector fitting method", IEEE Microwave and Wireless Components Letters 18(6), 2008.
.. [4] G. H. Golub, V. Pereyra, SIAM Journal on Numerical Analysis 10(2), 1973; L. Kaufman, BIT 15, 1975, leaves it out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from threadpoolctl import threadpool_limits

from bayes_impedance.classical.pole_residue import PoleResidue
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError

_SETTLED = 1e-6
"""Relative change of every pole at which relocation has converged. By choice: refinement finds further digits."""
_SMALLEST_CONSTANT = 1e-8
"""Smallest relaxed d-tilde that is divided by. By choice: about the square root of machine precision."""
_LARGEST_LOG = 27.0
"""Bound on log a, b and g in scaled frequency. By choice: a factor of 5e11, so that diverging poles stay finite."""
_RANK = 1e-13
"""Relative size below which columns count as dependent, and an error as rounding. By choice: near machine precision."""
_DAMPING = 0.01
"""Damping ratio of initial conjugate pairs, as recommended in [1]_."""
_REFINED = 3
"""Number of different relocated models that are refined. By choice: more cost time."""


@dataclass(frozen=True, eq=False, repr=False)
class VectorFit(Brief):
    """A rational function fitted to one curve.

    Attributes
    ----------
    model : PoleResidue
        The impedance in the data's unit; poles in rad/s, by ascending size, a fixed one being exactly 0.
    relative_rms : float
        Root mean square over frequency of ``|model - z| / |z|``.
    weighted_rms : float
        The same of ``|model - z| / noise_sd``; about the square root of two if the model fits to within the noise.
    iterations : int
        Relocations from the initial poles whose result was kept.
    converged : bool
        Whether the relocation converged. On noisy data superfluous poles may keep moving without affecting the error.
    """

    model: PoleResidue
    relative_rms: float
    weighted_rms: float
    iterations: int
    converged: bool


def vector_fit(
    frequency_hz: npt.ArrayLike,
    z: npt.ArrayLike,
    n_poles: int,
    *,
    noise_sd: npt.ArrayLike | None = None,
    pole_at_zero: bool = False,
    constant: bool = True,
    linear: bool = False,
    start: npt.ArrayLike | None = None,
    refine: bool = True,
    max_iterations: int = 50,
) -> VectorFit:
    """Fit poles and residues to one impedance curve.

    On noisy data the result depends on the initial poles: unless given, several fixed sets are tried and the model of
    least weighted error is returned (nothing is random). Superfluous pairs may become resonances between two points:
    :func:`~bayes_impedance.classical.order.select_order` finds how many poles the data support.

    Parameters
    ----------
    frequency_hz : array_like, shape (F,)
        Frequencies in Hz, ascending.
    z : array_like, complex, shape (F,)
        Impedance with exp(+jwt), not 0 anywhere.
    n_poles : int
        Number of poles, including the one at 0 if `pole_at_zero`: five are then four free ones and 0.
    noise_sd : array_like, shape (F,) or (), optional
        Standard deviation of each of real and imaginary part, in the unit of z; weights are its inverse. Else 1/abs(z).
    pole_at_zero : bool
        Whether one pole is fixed at s = 0 exactly.
    constant, linear : bool
        Whether there is a constant d (a damper at high frequency) and a term e s (a mass).
    start : array_like, complex, shape (number of free poles,), optional
        Initial free poles in rad/s, real or with their conjugates; unstable ones are reflected.
    refine : bool
        Whether the weighted error is minimised after the relocation; the error is never larger than without.
    max_iterations : int
        Bound on relocations from each starting set.

    Returns
    -------
    VectorFit

    Raises
    ------
    InputError
        If shapes, values or frequencies are invalid, initial poles do not match, or data are fewer than unknowns.
    """
    frequency, values = np.asarray(frequency_hz, dtype=float), np.asarray(z, dtype=complex)
    sd = np.abs(values) if noise_sd is None else np.asarray(noise_sd, dtype=float)
    _check_curve(frequency, values, sd)
    _check_order(n_poles, frequency.size, pole_at_zero, constant, linear)
    if max_iterations < 1:
        raise InputError(f"max_iterations is {max_iterations}: allow at least one relocation")
    n_free = int(n_poles) - int(pole_at_zero)
    # Frequencies around one and weighted data of mean square one make every tolerance relative, whatever the units.
    scale = 2 * np.pi * float(np.sqrt(frequency[0] * frequency[-1]))
    s, size = 2j * np.pi * frequency / scale, float(np.sqrt(np.mean(np.abs(values / sd) ** 2)))
    terms = ((1 / s, pole_at_zero), (s**0, constant), (s, linear), (s**0, linear and not constant))
    others = np.array([column for column, used in terms if used]).reshape(-1, s.size).T
    n_others = sum(used for _, used in terms[:3])
    problem = _Problem(s, values, 1 / (sd * size) + np.zeros(s.size), others[:, :n_others], others)
    starts = _starting_sets(n_free, abs(s[-1])) if start is None else [_checked_start(start, n_free) / scale]
    with threadpool_limits(1, "blas"):  # matrices are too small to gain from threads
        distinct = problem.candidates([_denominators(poles) for poles in starts], max_iterations, refine)
        # Compared by their partial fractions, which, unlike the quadratics, lose digits where poles nearly coincide.
        models = [problem.partial_fractions(candidate, scale, pole_at_zero, constant) for candidate in distinct]
    deviations = [np.abs(model(2j * np.pi * frequency) - values) for model in models]
    i = int(np.argmin([np.mean((deviation / sd) ** 2) for deviation in deviations]))
    relative, weighted = (float(np.sqrt(np.mean((deviations[i] / by) ** 2))) for by in (np.abs(values), sd))
    return VectorFit(models[i], relative, weighted, distinct[i].iterations, distinct[i].settled)


def number_of_unknowns(n_poles: int, *, pole_at_zero: bool = False, constant: bool = True, linear: bool = False) -> int:
    """Number of real parameters of a model: two per free pole, one for a pole at 0 and for each further term."""
    return 2 * n_poles - int(pole_at_zero) + int(constant) + int(linear)


@dataclass(frozen=True)
class _Relocated:
    """The best step of the relocation from one set of initial poles."""

    log_denominators: np.ndarray
    error: float
    iterations: int
    settled: bool


@dataclass(frozen=True, eq=False)
class _Problem:
    """The curve to be fitted, in scaled frequency. The free poles are given by log a, log b of all pairs, and log g."""

    s: np.ndarray  # complex, shape (F,)
    z: np.ndarray  # complex, shape (F,)
    weight: np.ndarray  # shape (F,)
    others: np.ndarray  # columns of 1/s, 1 and s in the model: complex, shape (F, up to 3)
    of_product: np.ndarray  # the same of sigma z: complex, shape (F, up to 3)

    def basis(self, log_denominators: np.ndarray) -> np.ndarray:
        """1/q and s/q of every pair, 1/(s + g) of an odd pole: complex, shape (F, free poles)."""
        (a, b, g), s = _factors(log_denominators), self.s[:, None]
        q = s**2 + a * s + b
        return np.hstack([1 / q, s / q, 1 / (s + g)])

    def columns(self, log_denominators: np.ndarray) -> np.ndarray:
        """Design matrix of the numerators: weighted, real, shape (2 F, numerators)."""
        return _real(self.weight[:, None] * np.hstack([self.basis(log_denominators), self.others]))

    def candidates(self, starts: list[np.ndarray], max_iterations: int, refine: bool) -> list[_Relocated]:
        """Distinct models after relocation from all initial denominators, and refined versions of the best of them."""
        found: list[_Relocated] = []
        for log_denominators in starts:
            found.append(self.relocated(log_denominators, max_iterations))
            if found[-1].error < _RANK:
                break  # noise-free data: every other start could only give the same poles
        found.sort(key=lambda model: model.error)
        distinct = [m for i, m in enumerate(found) if i == 0 or m.error > found[i - 1].error * (1 + 1e-4)]
        return distinct + [self.refined(m) for m in distinct[:_REFINED] if refine and m.log_denominators.size]

    def relocated(self, log_denominators: np.ndarray, max_iterations: int) -> _Relocated:
        """Relocate until the poles converge, and return the best step."""
        errors, steps = [self.solved(log_denominators)[1]], [log_denominators]
        poles, settled = _poles(log_denominators), log_denominators.size == 0
        while len(steps) <= max_iterations and not settled:
            steps.append(self.next_denominators(steps[-1]))
            errors.append(self.solved(steps[-1])[1])
            before, poles = poles, _poles(steps[-1])
            moved = np.abs(poles[_order(poles)] - before[_order(before)])
            settled = bool(np.all(moved <= _SETTLED * np.sort(np.abs(before))))
        best = int(np.argmin(errors))
        return _Relocated(steps[best], errors[best], len(steps) - 1, settled)

    def next_denominators(self, log_denominators: np.ndarray) -> np.ndarray:
        """One relocation: the zeros of sigma, reflected into the left half plane."""
        basis, n = self.basis(log_denominators), log_denominators.size
        sigma = np.column_stack([basis, self.s**0])
        columns = _real(self.weight[:, None] * np.hstack([basis, self.of_product, -self.z[:, None] * sigma]))
        # The average of sigma, weighted as in [2]_: as one equation of typical size.
        average, target = np.zeros(columns.shape[1]), np.zeros(columns.shape[0] + 1)
        average[-n - 1 :], target[-1] = sigma.real.sum(axis=0) / np.sqrt(self.s.size), np.sqrt(self.s.size)
        solution = _least_squares(np.vstack([columns, average]), target)
        if abs(solution[-1]) < _SMALLEST_CONSTANT:
            solution = np.append(_least_squares(columns[:, :-1], -columns[:, -1]), 1.0)
        c_tilde, d_tilde = solution[-n - 1 : -1], solution[-1]
        return _denominators(np.linalg.eigvals(_state_matrix(log_denominators, c_tilde / d_tilde)))

    def solved(self, log_denominators: np.ndarray) -> tuple[np.ndarray, float]:
        """Best numerators for given denominators, and the root mean square over frequency of the weighted error."""
        columns, data = self.columns(log_denominators), _real(self.weight * self.z)
        numerators = _least_squares(columns, data)
        return numerators, float(np.linalg.norm(data - columns @ numerators) / np.sqrt(self.s.size))

    def refined(self, model: _Relocated) -> _Relocated:
        """Minimise the weighted error over the denominators."""
        residual = partial(self.without_span, vectors=_real(self.weight * self.z))
        found = least_squares(residual, model.log_denominators, self.derivative, method="lm", ftol=1e-10, xtol=1e-10).x
        return replace(model, log_denominators=found, error=self.solved(found)[1])

    def derivative(self, log_denominators: np.ndarray) -> np.ndarray:
        """Jacobian of the weighted residual with the best numerators, see above: real, shape (2 F, free poles)."""
        c_1, c_2, c_g = _split(self.solved(log_denominators)[0][: log_denominators.size])
        (a, b, g), s = _factors(log_denominators), self.s[:, None]
        pair = -(c_1 + c_2 * s) / (s**2 + a * s + b) ** 2
        moved = _real(self.weight[:, None] * np.hstack([a * s * pair, b * pair, -g * c_g / (s + g) ** 2]))
        inside = np.abs(log_denominators) < _LARGEST_LOG
        return np.asarray(-self.without_span(log_denominators, moved) * inside)

    def without_span(self, log_denominators: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Component of the vectors, shape (2 F, ...), orthogonal to the columns of the numerators."""
        span = np.linalg.qr(self.columns(log_denominators))[0]
        return np.asarray(vectors - span @ (span.T @ vectors))

    def partial_fractions(self, best: _Relocated, scale: float, pole_at_zero: bool, constant: bool) -> PoleResidue:
        """The model in rad/s."""
        poles, numerators = _poles(best.log_denominators), self.solved(best.log_denominators)[0]
        n, m = poles.size, poles.size // 2
        (c_1, c_2, c_g), others = _split(numerators[:n]), numerators[n:].tolist()
        first, second = poles[:m], poles[m : 2 * m]
        of_first = (c_1 + c_2 * first) / (first - second)
        of_second = np.where(first.imag != 0, of_first.conj(), (c_1 + c_2 * second) / (second - first))
        residues = np.concatenate([of_first, of_second, c_g])
        if pole_at_zero:
            poles, residues = np.append(poles, 0.0), np.append(residues, others.pop(0))
        d = others.pop(0) if constant else 0.0
        order = _order(poles)
        return PoleResidue(poles[order] * scale, residues[order] * scale, d, others[0] / scale if others else 0.0)


def _real(columns: np.ndarray) -> np.ndarray:
    """Real parts above imaginary parts."""
    return np.concatenate([columns.real, columns.imag])


def _least_squares(columns: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Least squares on scaled columns, reduced by a QR decomposition; the minimum-norm solution if rank-deficient."""
    norms = np.linalg.norm(columns, axis=0)
    reduced: np.ndarray = np.asarray(np.linalg.qr(np.column_stack([columns / norms, target]), mode="r"))
    return np.asarray(np.linalg.lstsq(reduced[:, :-1], reduced[:, -1], rcond=_RANK)[0] / norms)


def _split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of 1/q (or a) and of s/q (or b) of all pairs, shape (n // 2,) each, and of an odd pole, shape (n % 2,)."""
    m = values.size // 2
    return values[:m], values[m : 2 * m], values[2 * m :]


def _factors(log_denominators: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients a and b of all pairs, and g of an odd pole."""
    return _split(np.exp(np.clip(log_denominators, -_LARGEST_LOG, _LARGEST_LOG)))


def _poles(log_denominators: np.ndarray) -> np.ndarray:
    """Roots: the first of all pairs, the second of all pairs, the odd one; complex, shape (n,)."""
    a, b, g = _factors(log_denominators)
    discriminant = a**2 / 4 - b
    # Two equal poles would have no partial fractions. A separation this small does not change the curve.
    discriminant = np.where(np.abs(discriminant) < 1e-12 * b, -1e-12 * b, discriminant)
    first = -a / 2 - np.sqrt(discriminant.astype(complex))
    second = np.where(discriminant < 0, first.conj(), b / first)  # no cancellation if one is far smaller
    return np.concatenate([first, second, -g]) + 0.0  # no imaginary part -0


def _order(poles: np.ndarray) -> np.ndarray:
    """Indices that sort poles by magnitude, conjugates next to each other."""
    return np.asarray(np.lexsort((poles.imag, np.abs(poles))))


def _denominators(poles: np.ndarray) -> np.ndarray:
    """Logarithms of a and b of all pairs and of g of an odd pole; poles are reflected into the left half plane."""
    upper, sizes = poles[poles.imag > 0], np.sort(np.abs(poles[poles.imag == 0]))
    odd = sizes[:0]
    if sizes.size % 2:
        # Only the two poles of one pair can become conjugates, so the closest real poles should form pairs.
        gaps = np.diff(np.log(np.maximum(sizes, 1e-300)))
        left_out = 2 * int(np.argmin([gaps[:i:2].sum() + gaps[i + 1 :: 2].sum() for i in range(0, sizes.size, 2)]))
        sizes, odd = np.delete(sizes, left_out), sizes[left_out : left_out + 1]
    a = np.concatenate([2 * np.abs(upper.real), sizes[::2] + sizes[1::2]])
    b = np.concatenate([np.abs(upper) ** 2, sizes[::2] * sizes[1::2]])
    return np.asarray(np.log(np.clip(np.concatenate([a, b, odd]), np.exp(-_LARGEST_LOG), np.exp(_LARGEST_LOG))))


def _state_matrix(log_denominators: np.ndarray, c: np.ndarray) -> np.ndarray:
    """A - b c^T in companion form, for numerators c of the basis: its eigenvalues are the zeros of c basis + 1."""
    a, b, g = _factors(log_denominators)
    m, n = a.size, c.size
    matrix = np.zeros((n, n))
    matrix[:m, m : 2 * m] = np.eye(m)
    matrix[m : 2 * m, : 2 * m] = np.hstack([-np.diag(b), -np.diag(a)])
    matrix[2 * m :, 2 * m :] = -g
    matrix[m:] -= c  # the input drives the second state of a pair, and the odd pole's only one
    return matrix


def _starting_sets(n_free: int, edge: float) -> list[np.ndarray]:
    """Log-spaced weakly damped pairs, real poles and mixtures, over the band 1/edge..edge and over ten times that."""
    sets = []
    for half_width in (np.log(edge), np.log(edge) + np.log(10.0) / 2):
        for n_pairs in sorted({n_free // 2, (n_free + 2) // 4, 0}, reverse=True):
            numbers = (n_free - 2 * n_pairs, n_pairs)
            real, pairs = (np.exp(half_width * (2 * np.arange(n) + 1 - n) / max(n, 1)) for n in numbers)
            upper = pairs * (-_DAMPING + 1j)
            sets.append(_denominators(np.concatenate([-real, upper, upper.conj()])))
    return sets


def _check_curve(frequency: np.ndarray, z: np.ndarray, sd: np.ndarray) -> None:
    """Check shapes, order and finiteness of the data."""
    if frequency.ndim != 1 or z.shape != frequency.shape:
        raise InputError(f"frequency_hz has shape {frequency.shape} and z {z.shape}: both must be (F,), one curve")
    if sd.shape not in ((), frequency.shape):
        raise InputError(f"noise_sd has shape {sd.shape}: give one value, or one per frequency, {frequency.shape}")
    if not (np.all(np.isfinite(frequency)) and np.all(np.isfinite(z))):
        raise InputError("frequency_hz or z has values that are not finite: leave these points out")
    if frequency.size == 0 or frequency[0] <= 0 or np.any(np.diff(frequency) <= 0):
        raise InputError("frequency_hz does not ascend from above zero: sort the points, leave out 0 Hz and doubles")
    if np.any(z == 0):
        raise InputError(f"z is 0 at {frequency[np.argmax(z == 0)]:g} Hz and has no relative error: leave it out")
    if not np.all(np.isfinite(sd) & (sd > 0)):
        raise InputError("noise_sd has values that are not finite and above 0: leave points of unknown noise out")


def _check_order(n_poles: int, points: int, pole_at_zero: bool, constant: bool, linear: bool) -> None:
    """Refuse a model without terms, or with more unknowns than the data determine."""
    if n_poles != int(n_poles) or n_poles < int(pole_at_zero):
        raise InputError(f"n_poles is {n_poles}: give a whole number, at least {int(pole_at_zero)} for this model")
    unknowns = number_of_unknowns(n_poles, pole_at_zero=pole_at_zero, constant=constant, linear=linear)
    if unknowns == 0:
        raise InputError("the model has no pole, no constant and no linear term: ask for at least one of them")
    least = (unknowns + 1) // 2
    if points < least:
        raise InputError(f"{points} frequencies are too few for {n_poles} poles: give {least} or ask for fewer poles")


def _checked_start(start: npt.ArrayLike, n_free: int) -> np.ndarray:
    """Initial poles after checking that they are finite, not 0 and closed under conjugation."""
    poles = np.asarray(start, dtype=complex)
    usable = poles.shape == (n_free,) and np.all(np.isfinite(poles)) and np.all(poles != 0)
    if not usable or not np.array_equal(np.sort_complex(poles), np.sort_complex(poles.conj())):
        raise InputError(f"start must hold {n_free} free poles: make them finite, not 0, and list conjugates, too")
    return poles
