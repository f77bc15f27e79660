r"""System identification: a rational function of given orders fitted to complex impedances, as a toolbox would.

The paper used MATLAB's ``tfest`` with the orders of eq. 4. The algorithm has three steps, as in such a tool:

1. **A linear start.** :math:`N(s) - z\,D(s)` is linear in the coefficients, but least squares on it weighs every
   frequency by :math:`|D|^2` (Levy 1959). Dividing by the :math:`|D|` of the step before and repeating removes
   that weight (Sanathanan and Koerner 1963).
2. **Instrumental variables.** With noise in z the regressors :math:`z\,s^k` are noisy themselves, and least squares is
   biased. Replacing z in them by the model's own curve, on one side of the normal equations only, removes most of the
   bias (Young 1976): :math:`\sum \hat\varphi^* (N - zD)/|D|^2 = 0`.
3. **Nonlinear least squares** on :math:`N/D - z` itself. With noise it has local minima in which a pole in the
   right half plane nearly cancels a zero. It therefore starts from the curves of both linear steps, from the same with
   such poles reflected, and from poles spread over the band; the best end point with stable poles only is kept,
   because a passive impedance has no unstable poles.

Frequencies are scaled to their geometric mean and columns to unit length, so that powers of s stay near one. Several
curves are first reduced: :math:`\sum_i w_i |m - z_i|^2` differs from :math:`\sum_i w_i\,|m - \bar z|^2` with the
weighted mean :math:`\bar z` only by a term that does not depend on the model. The relative weights use the
median magnitude: weights from each curve's own magnitude would bias the mean towards small impedances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.rational import TransferFunction

WEIGHTINGS = ("none", "relative")
"""Least squares of the absolute or of the relative error."""

_LINEAR_ROUNDS = 30
"""Linearised steps from each start. By choice: the best of them is kept, so that more only cost time."""


@dataclass(frozen=True, repr=False)
class Identification(Brief):
    """A rational function fitted to recordings.

    Attributes
    ----------
    transfer : TransferFunction
        Real coefficients; the denominator's highest is 1, and its lowest exactly 0 if the pole at 0 was kept.
    relative_rms : float
        Root mean square over frequency of the relative complex error against the weighted mean curve.
    converged : bool
        Whether the nonlinear search ended at a minimum.
    """

    transfer: TransferFunction
    relative_rms: float
    converged: bool


def identify(
    frequency_hz: np.ndarray,
    z: np.ndarray,
    n_zeros: int = 5,
    n_poles: int = 5,
    *,
    pole_at_zero: bool = True,
    weighting: str = "relative",
    noise_sd: np.ndarray | None = None,
) -> Identification:
    """Fit a rational function of given orders; the defaults are those of eq. 4.

    Parameters
    ----------
    frequency_hz : ndarray, shape (F,)
    z : ndarray, complex, shape (F,) or (N, F)
        One curve or several, NaN where data are missing.
    n_zeros, n_poles : int
        Degrees of numerator and denominator; the pole at 0 counts.
    pole_at_zero : bool
        Keep a pole at exactly 0, as eq. 4 has one.
    weighting : str
        ``relative`` (1/abs(z)) or ``none``, which is ``tfest``'s default and lets the largest impedances decide.
    noise_sd : ndarray, shape of `z`, optional
        Standard deviation of the noise; replaces `weighting`.

    Returns
    -------
    Identification

    Raises
    ------
    InputError
        If the orders cannot be those of an impedance, or there are too few frequencies for them.
    """
    curve, weight = _reduced(frequency_hz, z, weighting, noise_sd)
    if n_poles < int(pole_at_zero) or n_zeros < 0 or n_zeros > n_poles + 1:
        raise InputError(
            f"there are {n_zeros} zeros and {n_poles} poles: give at least as many poles as are fixed at 0, "
            "and at most one zero more than poles"
        )
    n_unknown = n_zeros + 1 + n_poles - int(pole_at_zero)
    if 2 * curve.size < n_unknown:
        raise InputError(
            f"{curve.size} frequencies are too few for {n_unknown} coefficients: record more or lower the orders"
        )
    problem = _Problem(frequency_hz, curve, weight, n_zeros, n_poles, pole_at_zero)
    linear = problem.linear_starts()
    starts = [*linear, *(problem.with_poles(_reflected(problem.poles(u))) for u in linear), *problem.spread_starts()]
    ends = [problem.refine(start) for start in starts]
    stable = [end for end in ends if np.all(problem.poles(end[0]).real <= 0)]
    best = min(stable or ends, key=lambda end: end[1])
    transfer = problem.transfer(best[0])
    model = transfer(2j * np.pi * np.asarray(frequency_hz))
    error = float(np.sqrt(np.mean(np.abs(model / curve - 1) ** 2)))
    return Identification(transfer, error, best[2])


def _reduced(
    frequency_hz: np.ndarray, z: np.ndarray, weighting: str, noise_sd: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean curve and the square root of its weight, (F,) each."""
    curves = np.atleast_2d(z)
    if curves.shape[-1] != np.size(frequency_hz):
        raise InputError(f"z has {curves.shape[-1]} frequencies, but there are {np.size(frequency_hz)}: give one grid")
    if weighting not in WEIGHTINGS:
        raise InputError(f"weighting is '{weighting}': choose {' or '.join(WEIGHTINGS)}")
    present = np.isfinite(curves)
    if not np.all(present.any(axis=0)):
        raise InputError("there is a frequency without any data: leave it out")
    curves = np.where(present, curves, 1.0)
    if noise_sd is not None:
        w = np.broadcast_to(noise_sd, curves.shape) ** -2.0
    else:
        size = np.nanmedian(np.where(present, np.abs(curves), np.nan), axis=0) if weighting == "relative" else 1.0
        w = np.broadcast_to(size, curves.shape) ** -2.0
    w = np.where(present, w, 0.0)
    total = w.sum(axis=0)
    return np.asarray((w * curves).sum(axis=0) / total), np.sqrt(total / np.max(total))


class _Problem:
    """The scaled least squares problem: unknowns are the numerator's and then the denominator's free coefficients."""

    def __init__(
        self,
        frequency_hz: np.ndarray,
        curve: np.ndarray,
        weight: np.ndarray,
        n_zeros: int,
        n_poles: int,
        pole_at_zero: bool,
    ) -> None:
        omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
        self.scale = float(np.exp(np.mean(np.log(omega))))
        s = 1j * omega / self.scale
        self.s, self.curve, self.weight = s, curve, weight
        self.zero_powers = s[:, None] ** np.arange(n_zeros, -1, -1)
        # The highest coefficient of the denominator is 1.
        self.lead = s**n_poles
        self.pole_powers = s[:, None] ** np.arange(n_poles - 1, int(pole_at_zero) - 1, -1)
        self.n_zeros, self.n_poles, self.pole_at_zero = n_zeros, n_poles, pole_at_zero

    def denominator(self, unknown: np.ndarray) -> np.ndarray:
        return np.asarray(self.lead + self.pole_powers @ unknown[self.n_zeros + 1 :])

    def model(self, unknown: np.ndarray) -> np.ndarray:
        return np.asarray(self.zero_powers @ unknown[: self.n_zeros + 1] / self.denominator(unknown))

    def cost(self, unknown: np.ndarray) -> float:
        return float(np.sum(np.abs(self.weight * (self.model(unknown) - self.curve)) ** 2))

    def linear_starts(self) -> list[np.ndarray]:
        """Best iterate of the linearised least squares, and best iterate with instrumental variables."""
        found: list[np.ndarray] = []
        unknown: np.ndarray | None = None
        for instruments in (False, True):
            best: tuple[float, np.ndarray] | None = None
            unknown = found[0] if found else None
            for _ in range(_LINEAR_ROUNDS):
                unknown = self._linear_step(unknown, instruments)
                cost = self.cost(unknown)
                if np.isfinite(cost) and (best is None or cost < best[0]):
                    best = (cost, unknown)
            if best is not None:
                found.append(best[1])
        return found

    def spread_starts(self) -> list[np.ndarray]:
        """Poles spread evenly over the band in the logarithm: real ones, and weakly damped pairs."""
        low, high = np.abs(self.s[0]), np.abs(self.s[-1])
        n_free = self.n_poles - int(self.pole_at_zero)
        real = -np.geomspace(low, high, n_free).astype(complex)
        size = np.geomspace(low, high, n_free // 2)
        pairs = np.concatenate(
            [size * (-0.3 + 0.95j), size * (-0.3 - 0.95j), real[n_free // 2 : n_free // 2 + n_free % 2]]
        )
        return [self.with_poles(real), self.with_poles(pairs)]

    def poles(self, unknown: np.ndarray) -> np.ndarray:
        """Free poles, in units of the frequency scale."""
        return np.roots(np.concatenate([[1.0], unknown[self.n_zeros + 1 :]]))

    def with_poles(self, poles: np.ndarray) -> np.ndarray:
        """The coefficients of given free poles with the best numerator."""
        bottom = np.atleast_1d(np.poly(poles)).real[1:]
        w = self.weight / np.abs(self.denominator(np.concatenate([np.zeros(self.n_zeros + 1), bottom])))
        matrix = self.zero_powers * w[:, None]
        length = np.linalg.norm(matrix, axis=0)
        target = _real(self.curve * (self.lead + self.pole_powers @ bottom) * w)
        top = np.linalg.lstsq(_real(matrix / length), target, rcond=None)[0] / length
        return np.concatenate([top, bottom])

    def _linear_step(self, unknown: np.ndarray | None, instruments: bool) -> np.ndarray:
        divisor = self.lead if unknown is None else self.denominator(unknown)
        w = self.weight / np.abs(divisor)
        matrix = np.hstack([self.zero_powers, -self.curve[:, None] * self.pole_powers]) * w[:, None]
        target = self.curve * self.lead * w
        length = np.linalg.norm(matrix, axis=0)
        a, b = _real(matrix / length), _real(target)
        if not instruments or unknown is None:
            return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0] / length)
        instrument = np.hstack([self.zero_powers, -self.model(unknown)[:, None] * self.pole_powers]) * w[:, None]
        t = _real(instrument / length).T
        return np.asarray(np.linalg.lstsq(t @ a, t @ b, rcond=None)[0] / length)

    def refine(self, start: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """Nonlinear least squares: the coefficients, half the weighted sum of squares, whether it converged."""
        from scipy.optimize import least_squares

        def residual(unknown: np.ndarray) -> np.ndarray:
            return _real(self.weight * (self.model(unknown) - self.curve))

        def jacobian(unknown: np.ndarray) -> np.ndarray:
            denominator = self.denominator(unknown)
            inner = np.hstack([self.zero_powers, -self.model(unknown)[:, None] * self.pole_powers])
            return _real(inner * (self.weight / denominator)[:, None])

        done = least_squares(residual, start, jacobian, method="lm", x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        return done.x, float(done.cost), bool(done.status > 0)

    def transfer(self, unknown: np.ndarray) -> TransferFunction:
        """The transfer function in s, from the coefficients in s/scale."""
        numerator = unknown[: self.n_zeros + 1]
        denominator = np.concatenate([[1.0], unknown[self.n_zeros + 1 :], [0.0] * self.pole_at_zero])
        n_poles = denominator.size - 1
        # Dividing both polynomials by scale^n_poles keeps the denominator's highest coefficient at 1.
        top = numerator * self.scale ** (n_poles - np.arange(self.n_zeros, -1.0, -1.0))
        bottom = denominator * self.scale ** np.arange(0.0, n_poles + 1.0)
        return TransferFunction.from_coefficients(top.tolist(), bottom.tolist())


def _reflected(poles: np.ndarray) -> np.ndarray:
    """Poles with those in the right half plane reflected into the left."""
    return np.asarray(-np.abs(poles.real) + 1j * poles.imag)


def _real(values: np.ndarray) -> np.ndarray:
    """Real parts above imaginary parts."""
    return np.concatenate([values.real, values.imag])
