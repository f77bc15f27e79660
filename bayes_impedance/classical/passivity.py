r"""Passivity of a rational impedance: a test on the whole imaginary axis, and the nearest passive model.

The driving-point impedance of a finger that cannot deliver energy is positive real, and every positive real rational
function is the impedance of some passive network [1]_. For real coefficients this means: no pole to the right of the
imaginary axis; poles on it, 0 and infinity included, simple and with a real positive residue; and
:math:`\operatorname{Re} z(j\omega) \ge 0` at *every* frequency, of which a recording covers only a band.

**Test.** Sampling could miss a narrow or distant band. :mod:`bayes_impedance.classical.real_part` gives all
frequencies at which :math:`\operatorname{Re} z` can change its sign; between two of them one sample suffices. The depth
of a dip is measured by :math:`\operatorname{Re} z / |z| = \cos\arg z`, which is dimensionless.

**Repair.** With the poles kept, z is linear in the residues, d and e, and so is its real part at one frequency. The
nearest positive real model is therefore a least squares problem with linear inequalities, as in [2]_,

.. math:: \min_\theta \sum_i w_i^2\,|z_i - \Phi(j\omega_i)\,\theta|^2 \quad\text{with}\quad
          \operatorname{Re}\Phi(j\nu)\,(\theta - m\,\theta^+) \ge 0 \text{ for all } \nu,

and with non-negative e and residues on the axis. The problem is solved with few :math:`\nu`, the whole axis is tested,
the worst frequency of every violation is added, and this is repeated. Each solution is exact: in the coordinates in
which the objective is a squared length it is a least distance problem, solved by non-negative least squares [3]_. The
small margin m ends the iteration: without it every round would leave a smaller dip. In :math:`\theta^+` all residues
and d are replaced by their absolute values. Each of its terms has a positive real part, e.g.

.. math:: \operatorname{Re}\Bigl(\frac{1}{j\omega - p} + \frac{1}{j\omega - \bar p}\Bigr)
          = \frac{-2 \operatorname{Re} p\;(|p|^2 + \omega^2)}{|j\omega - p|^2\,|j\omega - \bar p|^2} > 0,

so that a solution always exists, and needs no term that the model does not have.

References
----------
.. [1] O. Brune, "Synthesis of a finite two-terminal network whose driving-point impedance is a prescribed function of
   frequency", Journal of Mathematics and Physics 10 (1931) 191-236.
.. [2] B. Gustavsen, A. Semlyen, "Enforcing passivity for admittance matrices approximated by rational functions", IEEE
   Trans. Power Systems 16 (2001) 97-104.
.. [3] C. L. Lawson, R. J. Hanson, "Solving Least Squares Problems" (1974), chapter 23.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from bayes_impedance.classical.pole_residue import PoleResidue
from bayes_impedance.classical.real_part import AxisPole, RealPart, on_axis, real_part
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.rational import TransferFunction
from bayes_impedance.units import hertz

_TOLERANCE = 1e-9
"""Depth of a dip, relative to abs(z), that counts as a violation. By choice: above the error of polynomial roots."""
_ROUNDS = 100
"""Most rounds of adding constraint frequencies. By choice: violations that remain after them raise an error."""
_RIDGE = 1e-5
"""Ridge weight relative to a column's length. By choice: small beside the data, and fixes undetermined directions."""


@dataclass(frozen=True)
class Violation:
    """A band of frequencies in which Re z is negative.

    Attributes
    ----------
    low_hz, high_hz : float
        Its edges; 0 and inf are possible.
    worst_hz : float
        Where Re z / abs(z) is smallest; 0 and inf are possible.
    real_part : float
        Re z there, in the impedance's unit.
    relative : float
        Re z / abs(z) there, -1 to 0.
    """

    low_hz: float
    high_hz: float
    worst_hz: float
    real_part: float
    relative: float


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Passivity(Brief):
    """Whether an impedance is positive real, and which conditions it violates.

    Attributes
    ----------
    positive_real : bool
    violations : tuple of Violation
        In ascending frequency.
    unstable_poles : ndarray, complex, shape (U,)
        Poles in the right half plane in rad/s, conjugates listed, too.
    wrong_residues : tuple of AxisPole
        Poles on the axis, 0 and infinity included, that are multiple or have a residue that is not real and positive.
    reasons : tuple of str
        One sentence for each violated condition; empty for a positive real function.
    margin : float
        The smallest Re z / abs(z) on the axis, its ends included: 0 if z is lossless at some frequency, as a spring to
        ground is at 0 Hz.
    """

    positive_real: bool
    violations: tuple[Violation, ...]
    unstable_poles: np.ndarray
    wrong_residues: tuple[AxisPole, ...]
    reasons: tuple[str, ...]
    margin: float


def check_passivity(model: PoleResidue | TransferFunction, *, unit: str = "") -> Passivity:
    """Whether a driving-point impedance F/v is positive real, at all frequencies from 0 to infinity.

    Parameters
    ----------
    model : PoleResidue or TransferFunction
        In a TransferFunction poles off the axis may be multiple. Poles on or right of the axis are not cancelled
        against zeros: two equal lossless branches leave such a pair, which is reported as a multiple pole.
    unit : str
        The impedance's unit, for the text of `reasons` only.

    Returns
    -------
    Passivity
        With complex coefficients the function is not positive real; other conditions are tested on their real parts.

    Raises
    ------
    InputError
        If coefficients are not finite or the denominator is 0.
    """
    axis = real_part(model)
    omega = axis.samples()
    violations = tuple(_violations(axis, omega))
    margin = min([axis.lowest(omega, True, True)[1], *(v.relative for v in violations)])
    reasons = [*axis.remarks]
    reasons += [
        f"the pole at {pole:.4g} rad/s is in the right half-plane: the model is unstable"
        for pole in axis.unstable
        if pole.imag >= 0
    ]
    reasons += [_residue_sentence(wrong) for wrong in axis.wrong]
    reasons += [_violation_sentence(violation, unit) for violation in violations]
    return Passivity(
        positive_real=not reasons,
        violations=violations,
        unstable_poles=axis.unstable,
        wrong_residues=axis.wrong,
        reasons=tuple(reasons),
        margin=margin,
    )


def _violation_sentence(violation: Violation, unit: str) -> str:
    low, high, worst = (hertz(f) for f in (violation.low_hz, violation.high_hz, violation.worst_hz))
    value = f"{violation.real_part:.3g} {unit}".strip()
    return (
        f"Re z is negative from {low} to {high}, at worst {value} at {worst} ({100 * violation.relative:.2g} % of |z|)"
    )


def _residue_sentence(wrong: AxisPole) -> str:
    place = hertz(abs(wrong.pole) / (2 * np.pi))
    if np.isnan(wrong.residue):
        return f"the pole at {place} on the imaginary axis is multiple"
    residue = wrong.residue.real if wrong.residue.imag == 0 else wrong.residue
    name = "coefficient of s" if np.isinf(wrong.pole) else "residue"
    return f"the pole at {place} on the imaginary axis has the {name} {residue:.4g}, which is not positive"


def _violations(axis: RealPart, omega: np.ndarray) -> list[Violation]:
    """Bands with negative Re z whose worst relative value is beyond the tolerance."""
    omega = np.concatenate([[0.0], omega, [np.inf]])
    negative = axis.relative(omega) < 0
    steps = np.diff(np.concatenate([[0], negative.astype(int), [0]]))
    found = []
    for first, end in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1), strict=True):
        low = axis.crossing(omega[first - 1], omega[first]) if first else 0.0
        high = axis.crossing(omega[end], omega[end - 1]) if end < omega.size else np.inf
        inside = omega[first:end]
        points = np.unique(np.concatenate([[low], inside, [high]]))
        points = points[(points > 0) & np.isfinite(points)]
        points = np.unique(np.concatenate([points, np.geomspace(points[0], points[-1], 33)]))
        worst, relative = axis.lowest(points, inside[0] == 0, np.isinf(inside[-1]))
        if relative < -_TOLERANCE:
            end_value = axis.ends[0][1] if worst == 0 else axis.ends[1][1]
            real = float(axis.real(worst)) if 0 < worst < np.inf else end_value
            low, high, worst = (float(value / (2 * np.pi)) for value in (low, high, worst))
            found.append(Violation(low, high, worst, real, relative))
    return found


def enforce_passivity(
    model: PoleResidue,
    frequency_hz: npt.ArrayLike,
    z: npt.ArrayLike | None = None,
    *,
    noise_sd: npt.ArrayLike | None = None,
    margin: float = 1e-6,
) -> PoleResidue:
    """The nearest positive real model with the same poles.

    Poles in the right half plane are reflected first. Residues, constant and linear term are free, but a constant or a
    linear term that is exactly 0 stays 0: there is a positive real model without it.

    Parameters
    ----------
    model : PoleResidue
    frequency_hz : array-like, shape (F,)
        Frequencies in Hz over which the distance is measured; the result is positive real at all frequencies.
    z : array-like, complex, shape (F,), optional
        Values to approximate; by default those of the model itself.
    noise_sd : array-like, shape (F,), optional
        Standard deviation of `z`; by default abs(z), which minimises relative errors.
    margin : float
        Least value of Re z at the constrained frequencies, relative to the real part that the model would have with
        positive residues; that real part is scaled down to the size of `z` if it is larger.

    Returns
    -------
    PoleResidue
        The same object if the model is already positive real, whatever `z` is.

    Raises
    ------
    InputError
        If shapes differ, frequencies or weights are not positive, or `margin` is not above 0.
    RuntimeError
        If violations remain after the last round.
    """
    if margin <= 0:
        raise InputError(f"margin is {margin:g}: choose a small number above 0, for instance 1e-6")
    if check_passivity(model).positive_real:
        return model
    s, target, weight = _target(model, frequency_hz, z, noise_sd)
    mirrored = np.where((model.poles.real > 0) & ~on_axis(model.poles), -model.poles.conj(), model.poles)
    family = _Family.of(model, mirrored)
    own = family.parameters(model.residues, model.constant, model.linear)
    positive = family.parameters(np.abs(model.residues), abs(model.constant), abs(model.linear))
    columns = family.columns(s)
    share = np.median(np.abs(target) / np.maximum(np.abs(columns @ positive), np.abs(target)))
    nu = np.zeros(0)
    for _ in range(_ROUNDS):
        real, signs = family.real_parts(nu), family.signs()
        least = np.concatenate([margin * share * real @ positive, np.zeros(len(signs))])
        theta, binding = _constrained(weight[:, None] * columns, weight * target, own, np.vstack([real, signs]), least)
        repaired = family.member(theta)
        verdict = check_passivity(repaired)
        if verdict.positive_real:
            return repaired
        # Inactive constraints do not affect this solution; kept, they would make the next set nearly dependent.
        added = [family.deepest(violation, theta, positive) for violation in verdict.violations]
        nu = np.concatenate([nu[binding[1 : nu.size + 1]], *added])
    raise RuntimeError(f"no positive real model after {_ROUNDS} rounds: {'; '.join(verdict.reasons)}; raise the margin")


def _target(
    model: PoleResidue, frequency_hz: npt.ArrayLike, z: npt.ArrayLike | None, noise_sd: npt.ArrayLike | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Complex frequency, values to approximate, and weights, each of shape (F,)."""
    frequency = np.asarray(frequency_hz, dtype=float)
    if frequency.ndim != 1 or frequency.size == 0 or not np.all((frequency > 0) & np.isfinite(frequency)):
        raise InputError("frequency_hz must be a list of finite numbers above 0: leave out the others")
    s = 2j * np.pi * frequency
    target = model(s) if z is None else np.asarray(z, dtype=complex)
    sd = np.abs(target) if noise_sd is None else np.asarray(noise_sd, dtype=float)
    if target.shape != frequency.shape or sd.shape != frequency.shape:
        raise InputError(f"z {target.shape} and noise_sd {sd.shape} need the shape of frequency_hz, {frequency.shape}")
    if not np.all(np.isfinite(target)) or not np.all((sd > 0) & np.isfinite(sd)):
        raise InputError(
            "z must be finite, and noise_sd (or without it abs(z)) above 0: leave out the other frequencies"
        )
    return s, target, 1 / sd


@dataclass(frozen=True, eq=False)
class _Family:
    """All real models with the poles of one, R + 2 real parameters: residues, constant and linear term.

    `basis`, complex, shape (P, R), maps the first R parameters to residues; `free`, bool, shape (R + 2,), marks the
    parameters that are not held at 0.
    """

    poles: np.ndarray
    basis: np.ndarray
    free: np.ndarray

    @classmethod
    def of(cls, model: PoleResidue, poles: np.ndarray) -> _Family:
        """The family of a model with its poles moved."""
        columns = []
        lower = list(np.flatnonzero(poles.imag < 0))
        for k in np.flatnonzero(poles.imag >= 0):
            pair = [k]
            if poles[k].imag > 0:
                pair.append(lower[int(np.argmin(np.abs(poles[lower] - poles[k].conj())))])
                lower.remove(pair[1])
            columns.append(np.isin(np.arange(poles.size), pair).astype(complex))
            if len(pair) == 2 and not on_axis(poles[k]):
                columns.append(np.zeros(poles.size, dtype=complex))
                columns[-1][pair] = 1j, -1j
        basis = np.array(columns).reshape(-1, poles.size).T
        free = np.concatenate([np.ones(basis.shape[1], dtype=bool), [model.constant != 0, model.linear != 0]])
        return cls(poles, basis, free)

    def parameters(self, residues: np.ndarray, constant: float, linear: float) -> np.ndarray:
        """Parameters of a model; the imaginary part of a residue on the axis is dropped."""
        own = (self.basis.conj().T @ residues).real / np.sum(np.abs(self.basis) ** 2, axis=0)
        return np.asarray(np.concatenate([own, [constant, linear]])[self.free])

    def member(self, theta: np.ndarray) -> PoleResidue:
        """The model with these parameters."""
        every = np.zeros(self.free.size)
        every[self.free] = theta
        never_negative = np.append(self._lossless(), [False, True])
        every[never_negative] = np.maximum(every[never_negative], 0.0)  # negative by rounding only
        return PoleResidue(self.poles, self.basis @ every[:-2], float(every[-2]), float(every[-1]))

    def columns(self, s: np.ndarray) -> np.ndarray:
        """Contribution of each parameter to z (design matrix), complex, shape (F, free)."""
        every = [(1 / (s[:, None] - self.poles)) @ self.basis, np.ones((s.size, 1)), s[:, None]]
        return np.hstack(every)[:, self.free]

    def real_parts(self, nu: np.ndarray) -> np.ndarray:
        """Contribution of each parameter to Re z, shape (2 + V, free): at 0, nu in rad/s, and infinity."""
        # Without a constant Re z falls as 1/omega**2; the row for infinity is then the coefficient of 1/omega**2.
        s = 1j * np.concatenate([[0.0], nu])[:, None]
        lossy = ~on_axis(self.poles)
        poles, basis = self.poles[lossy], self.basis[lossy]
        finite = (-poles / ((poles - s) * (poles + s)) @ basis).real
        rows = np.hstack([finite, np.ones((len(s), 1)), np.zeros((len(s), 1))])
        has_constant = self.free[-2]
        infinity = np.concatenate([0 * finite[0] if has_constant else -(poles @ basis).real, [1.0, 0.0]])
        return np.vstack([rows, infinity])[:, self.free]

    def deepest(self, violation: Violation, theta: np.ndarray, positive: np.ndarray) -> np.ndarray:
        """Frequencies in rad/s at which Re z / abs(z), and Re z relative to that of `positive`, are smallest in a band.

        The first may be a zero of Im z at the very edge of a band, where a constraint would move little but the edge.
        """
        low, high, worst = 2 * np.pi * np.array([violation.low_hz, violation.high_hz, violation.worst_hz])
        sizes = np.abs(self.poles[~on_axis(self.poles)])
        first = low if low > 0 else min(high, sizes.min()) / 1e3
        last = high if np.isfinite(high) else max(low, sizes.max()) * 1e3
        grid = np.geomspace(first, last, 65)
        rows = self.real_parts(grid)[1:-1]
        depth = rows @ theta
        found = np.array([worst, grid[np.argmin(depth / (rows @ positive + 1e-9 * np.abs(depth).max()))]])
        return np.asarray(found[(found > 0) & np.isfinite(found)])

    def signs(self) -> np.ndarray:
        """Constraint rows that select the parameters >= 0: residues on the axis and the linear term."""
        chosen = np.append(self._lossless(), [False, True]) & self.free
        return np.asarray(np.eye(self.free.size)[chosen][:, self.free])

    def _lossless(self) -> np.ndarray:
        """Which of the first R parameters are residues on the axis."""
        return np.asarray(np.abs(self.basis[on_axis(self.poles)]).sum(axis=0) > 0)


def _constrained(
    columns: np.ndarray, target: np.ndarray, own: np.ndarray, rows: np.ndarray, least: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters with the smallest abs(columns theta - target)^2 and rows theta >= least, by Lawson and Hanson's LDP.

    Columns and target are complex; directions that they do not determine stay near `own`. The second result is the
    mask of active rows.
    """
    length = np.sqrt(np.sum(np.abs(columns) ** 2, axis=0))
    scaled = columns / length
    matrix = np.vstack([scaled.real, scaled.imag, _RIDGE * np.eye(length.size)])
    q, r = np.linalg.qr(matrix)
    free = q.T @ np.concatenate([target.real, target.imag, _RIDGE * own * length])
    # r theta = free + step: the squared length of the step is the increase of the objective due to the constraints.
    rows = rows / length
    walls = solve_triangular(r, rows.T, trans="T").T
    present = np.linalg.norm(walls, axis=1) > 0
    rows, least, walls = rows[present], least[present], walls[present]
    size = np.linalg.norm(walls, axis=1)
    step, binding = np.zeros(length.size), np.zeros(present.size, dtype=bool)
    missing = (least - rows @ solve_triangular(r, free)) / size
    if np.any(missing > 0):
        wanted = np.append(np.zeros(length.size), 1.0)
        scale = missing.max()
        matrix = np.vstack([(walls / size[:, None]).T, missing / scale])
        weights, _ = nnls(matrix, wanted)
        residual = matrix @ weights - wanted
        step = -residual[:-1] / residual[-1] * scale
        touched = weights > 0
        binding[present] = touched
        for _ in range(2):  # iterative refinement of the active constraints: r may be close to singular
            gap = least[touched] - rows[touched] @ solve_triangular(r, free + step)
            step = step + np.linalg.lstsq(walls[touched] / size[touched, None], gap / size[touched], rcond=1e-6)[0]
    return solve_triangular(r, free + step) / length, binding
