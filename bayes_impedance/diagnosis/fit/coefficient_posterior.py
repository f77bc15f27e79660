r"""Posterior of the additions' parameters from the quadratic expansion: draws, dispersions, rig or body.

With each person's coefficients integrated out (:mod:`bayes_impedance.diagnosis.fit.normal_equations`) shared
parameters and means are normal, and only the few dispersions :math:`\tau` are left, which are drawn from a grid, one
after the other. Their prior is half-normal with the size of the coefficient itself: people may differ by 100 %, or not
at all.

**Rig or body.** A coefficient of the rig has no dispersion. If the posterior of :math:`\tau/|\mu|` bounds the
dispersion from above, the effect is attributed to the rig; if it excludes equality between people, to the body;
otherwise it is undecided (:func:`verdict_on_side`).

**In some people.** Who lacks an effect (:mod:`bayes_impedance.diagnosis.fit.spike_slab`) says nothing of its size: the
posterior of an effect that only some have is from those who have it. One normal distribution of all would rather be one
around zero.

Positive coefficients of the body are reported as median and dispersion of a log-normal distribution with the same mean
and variance: :math:`s^2 = \ln(1 + \tau^2/\mu^2)`, median :math:`\mu e^{-s^2/2}`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import marginal, quadratic
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import Membership, members
from bayes_impedance.units import INTERVAL, unit_of

DRAWS = 2000
"""Draws of the posterior: the 5 % quantile then has an error of a twentieth of a standard deviation."""

_GRID = np.r_[0.0, np.geomspace(0.01, 3.0, 60)]
"""Relative dispersions 10 % apart, and zero. By choice."""

SAME = 0.1
"""Relative dispersion below which people count as equal. By choice."""


@dataclass(frozen=True, kw_only=True)
class CoefficientPosterior:
    """Posterior of the additions' parameters, A of them, in the kernel's order.

    Attributes
    ----------
    central : ndarray, shape (S, A)
        Draws of the shared values and of the population means.
    relative_dispersion : ndarray, shape (S, A)
        Draws of tau/abs(mu) of varying coefficients; zero for shared ones.
    covariance : ndarray, shape (A, A)
        Of the central values, with the dispersions at their posterior means.
    settled : bool
        Whether the draws have converged.
    elements : ndarray, shape (P, S) or None
        Log elements of the network in the median person; None where they are not drawn with the additions.
    who : mapping of int to Membership
        Who has what only some have, by addition; empty where that was not looked for.
    """

    central: np.ndarray
    relative_dispersion: np.ndarray
    covariance: np.ndarray
    settled: bool = True
    elements: np.ndarray | None = None
    who: Mapping[int, Membership] = field(default_factory=dict)

    @property
    def is_sampled(self) -> bool:
        """Whether it is the population's posterior, and no approximation."""
        return self.elements is not None


def coefficient_posterior(
    fit: Refit, seed: int, n_draws: int = DRAWS, lacks: Mapping[int, np.ndarray] | None = None
) -> CoefficientPosterior:
    """Draws of the posterior of all additions.

    Parameters
    ----------
    fit : Refit
        Of a model with at least one addition.
    seed : int
    n_draws : int
    lacks : mapping of int to ndarray, optional
        Who lacks an addition, bool (N,), if that is known; otherwise it is read from the fit.
    """
    rng = np.random.default_rng(seed)
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    parameters = fit.model.parameters
    varying = np.array([not p.shared for p in parameters])
    start = fit.u[:, fit.model.n_elements :].mean(axis=0)
    lacks = _read_from(fit) if lacks is None else lacks
    h, d, start = _of_those_who_have_it(fit, h, d, start, lacks)
    # Shapes and elements are on a logarithmic scale, where one is the natural unit of dispersion.
    linear = np.array([p.is_coefficient for p in parameters])
    unit = np.where(linear, np.maximum(np.abs(start), 1e-12), 1.0)

    def solved(tau: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        """Log posterior of tau (up to a constant), and mean and precision of a."""
        m = marginal(fit.model, h, d, tau)
        return m.log_density - 0.5 * float(np.sum((tau[varying] / unit[varying]) ** 2)), m.mean, m.precision

    tau = np.where(varying, 0.3 * unit, 0.0)
    chosen = np.zeros((n_draws, varying.size))
    weights: dict[int, np.ndarray] = {}
    for _ in range(3):  # each dispersion's distribution with the others at their means
        for k in np.flatnonzero(varying).tolist():
            grid = _GRID * unit[k]
            values = []
            for g in grid:
                trial = tau.copy()
                trial[k] = g
                values.append(solved(trial)[0])
            edges = np.r_[grid[0], 0.5 * (grid[1:] + grid[:-1]), grid[-1]]
            width = np.diff(edges)
            weight = np.exp(np.array(values) - np.max(values)) * width
            weights[k] = weight / weight.sum()
            tau[k] = float(weights[k] @ grid)
    for k, weight in weights.items():
        chosen[:, k] = rng.choice(_GRID * unit[k], n_draws, p=weight)
    central = np.empty((n_draws, varying.size))
    rows, index = np.unique(chosen, axis=0, return_inverse=True)
    if len(rows) > 400:  # several dispersions: the central values hardly depend on them
        rows, index = tau[None], np.zeros(n_draws, dtype=int)
    for r, row in enumerate(rows):
        _, mean, precision = solved(row)
        mine = index == r
        factor = np.linalg.cholesky(np.linalg.inv(precision))
        central[mine] = mean + rng.normal(size=(mine.sum(), mean.size)) @ factor.T
    relative = chosen / np.where(linear, np.maximum(np.abs(central), 1e-300), 1.0)
    covariance = np.linalg.inv(solved(tau)[2])
    return CoefficientPosterior(central=central, relative_dispersion=relative, covariance=covariance)


def _read_from(fit: Refit) -> dict[int, np.ndarray]:
    """Who lacks what only some have, bool (N,)."""
    who = {i: members(fit, i) for i, addition in enumerate(fit.model.additions) if addition.absent_in_some}
    return {i: own.probability < 0.5 for i, own in who.items() if own.only_some}


def _of_those_who_have_it(
    fit: Refit, h: np.ndarray, d: np.ndarray, start: np.ndarray, lacking: Mapping[int, np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Slopes (N, A), curvatures (N, A, A) and mean values (A,), of what only some have without those who lack it.

    Who lacks it has a coefficient of zero, and shapes where they are: the slopes are of absolute values.
    """
    h, d, start = h.copy(), d.copy(), start.copy()
    for i, lacks in lacking.items():
        if lacks.all():
            continue
        columns = np.array(fit.model.columns(i))
        start[columns - fit.model.n_elements] = fit.u[~lacks[fit.owner]][:, columns].mean(axis=0)
        for column in (columns - fit.model.n_elements).tolist():
            if not fit.model.parameters[column].is_coefficient:  # without a coefficient it may have any value
                own = fit.u[:, fit.model.n_elements + column][np.searchsorted(fit.owner, np.flatnonzero(lacks))]
                h[lacks] -= d[lacks, :, column] * own[:, None]
            h[lacks, column], d[lacks, column], d[lacks, :, column] = 0.0, 0.0, 0.0
    return h, d, start


@dataclass(frozen=True, kw_only=True)
class Reported:
    """A parameter in the units of the report.

    Attributes
    ----------
    name, unit : str
    median, q05, q95 : float
    dispersion : float or None
        Standard deviation of the natural logarithm between people (of a signed coefficient, relative); 0 if shared.
    dispersion_q05, dispersion_q95 : float or None
    """

    name: str
    unit: str
    median: float
    q05: float
    q95: float
    dispersion: float | None
    dispersion_q05: float | None
    dispersion_q95: float | None

    @property
    def dispersion_interval(self) -> tuple[float, float] | None:
        """90 % interval of the dispersion."""
        if self.dispersion_q05 is None or self.dispersion_q95 is None:
            return None
        return self.dispersion_q05, self.dispersion_q95


def reported(model: Model, addition: int, posterior: CoefficientPosterior, elements: np.ndarray) -> list[Reported]:
    """The parameters of an addition in their units.

    Parameters
    ----------
    model : Model
    addition : int
    posterior : CoefficientPosterior
    elements : ndarray, shape (P,) or (P, S)
        Central log elements of the network, or draws of them.
    """
    item = model.additions[addition]
    effect, scales = item.effect, model.scales
    columns = [c - model.n_elements for c in model.columns(addition)]
    draws = posterior.central[:, columns]
    dispersions = posterior.relative_dispersion[:, columns]
    result = []
    if not effect.operation:
        added = [model.kernel.elements[model.n_elements + column] for column in columns]
        by_name = {p.name: p for p in model.kernel.network.parameters}
        kinds = [by_name[name].quantity.name for name in added]
        for k, (own, kind) in enumerate(zip(added, kinds, strict=True)):
            name = f"{kind} {own}" if kinds.count(kind) > 1 else kind  # no name twice
            parameter = by_name[own]
            result.append(_reported(name, parameter.unit(scales.unit), parameter.value(draws[:, k]), dispersions[:, k]))
        return result
    values: list[np.ndarray] = []
    spreads: list[np.ndarray] = []
    for k, coefficient in enumerate(effect.coefficients):
        value, dispersion = coefficient.value(draws[:, k], scales), dispersions[:, k]
        if coefficient.link == "linear" and not effect.signed and item.pooling != "shared":
            square = np.log1p(dispersion**2)
            value, dispersion = value * np.exp(-0.5 * square), np.sqrt(square)
        values.append(value)
        spreads.append(dispersion)
    names, traits = model.network.elements, effect.traits
    compliance = np.exp(elements[names.index(item.place)]) if item.place in names else float("nan")
    setting = effect.setting(scales, compliance)
    for k, coefficient in enumerate(effect.coefficients):
        value = traits.reported(values, setting) if k == 0 and traits.reported is not None else values[k]
        if coefficient.unit == "Hz":
            value = value / (2 * np.pi)
        result.append(_reported(coefficient.name, unit_of(coefficient.unit, scales.unit), value, spreads[k]))
    # Quantities that a reader would otherwise have to compute.
    derived = [] if traits.derived is None else traits.derived(values, setting)
    return result + [_reported(name, unit_of(u, scales.unit), value, None) for name, u, value in derived]


def _reported(name: str, unit: str, values: np.ndarray, dispersion: np.ndarray | None) -> Reported:
    low, middle, high = (float(q) for q in np.quantile(values, INTERVAL))
    spread = (None, None, None) if dispersion is None else (float(q) for q in np.quantile(dispersion, INTERVAL))
    d_low, d_middle, d_high = spread
    return Reported(
        name=name,
        unit=unit,
        median=middle,
        q05=low,
        q95=high,
        dispersion=d_middle,
        dispersion_q05=d_low,
        dispersion_q95=d_high,
    )


def verdict_on_side(dispersion: np.ndarray) -> str:
    """``rig``, ``body`` or ``undecided`` from draws of a relative dispersion."""
    low, high = np.quantile(dispersion, (0.05, 0.95))
    if low > SAME / 2:
        return "body"
    return "rig" if high < 3 * SAME else "undecided"
