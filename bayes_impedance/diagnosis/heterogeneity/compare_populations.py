r"""Elementwise comparison of a claimed population with the recorded one: centres and dispersions, with p-values.

With the information :math:`K_i - T^{-1}` of each person's recordings about the elements, the population's
centre has the precision :math:`\sum_i (T + V_i)^{-1}`, :math:`V_i = (K_i - T^{-1})^{-1}`, and a dispersion, with
:math:`\kappa_i = \tau^2/(\tau^2 + v_i)` the fraction of it that a person's recordings resolve, the variance

.. math:: \operatorname{var}(\ln \tau) = \Bigl(2\sum_i \kappa_i^2\Bigr)^{-1} .

Differences of logarithms between two independent populations are compared with the root of the summed variances, and
p-values are corrected for the number of comparisons (Holm).
"""

from __future__ import annotations

import numpy as np
from scipy.stats import norm

from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods
from bayes_impedance.diagnosis.heterogeneity.tests import person_likelihoods
from bayes_impedance.diagnosis.multiple_testing import holm
from bayes_impedance.diagnosis.verdict_types import ParameterDifference
from bayes_impedance.network.elements import kind_of
from bayes_impedance.units import NORMAL_Q95

_LARGEST_SD = 3.0
"""Largest standard error of a difference of logarithms that is reported: with a factor of 20 (one standard error)
the recordings do not determine the element."""

_UNSEEN_VARIANCE = 1e6
"""Variance of the centre of an undetermined element, in place of infinity."""


def compare_populations(claimed: Refit, recorded: Refit, unit: str) -> tuple[ParameterDifference, ...]:
    """Differences between a simulated and a recorded population of one network, smallest p-value first.

    Parameters
    ----------
    claimed, recorded : Refit
        Of the same network.
    unit : str
        Of the impedance.
    """
    names = recorded.model.network.elements
    rows: list[tuple[str, str, str, float, float, float, float]] = []
    ours, theirs = _summary(recorded), _summary(claimed)
    for p, name in enumerate(names):
        kind = kind_of(name)
        for what, scale_unit, transform in (
            ("central", kind.unit(unit), np.exp),
            ("dispersion_between_persons", "", np.exp),
        ):
            (a, sd_a), (b, sd_b) = ours[what], theirs[what]
            sd = float(np.hypot(sd_a[p], sd_b[p]))
            if not np.isfinite(sd) or sd > _LARGEST_SD:
                continue
            rows.append(
                (name, scale_unit, what, float(transform(b[p])), float(transform(a[p])), float(a[p] - b[p]), sd)
            )
    if not rows:
        return ()
    raw = np.array([2 * norm.sf(abs(row[5]) / row[6]) for row in rows])
    corrected = holm(raw)
    found = [
        ParameterDifference(
            element=name,
            unit=own_unit,
            what=what,
            simulation=simulated,
            recordings=measured,
            ratio=float(np.exp(d)),
            q05=float(np.exp(d - NORMAL_Q95 * sd)),
            q95=float(np.exp(d + NORMAL_Q95 * sd)),
            p_value=float(p),
        )
        for (name, own_unit, what, simulated, measured, d, sd), p in zip(rows, corrected, strict=True)
    ]
    return tuple(sorted(found, key=lambda row: (row.p_value, row.element)))


def _summary(fit: Refit) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Logarithms of centres and dispersions with their standard errors, each (P,)."""
    e = fit.model.n_elements
    covariance = fit.population.covariance[:e, :e]
    likelihoods: PersonLikelihoods = person_likelihoods(fit)
    inverse = np.linalg.inv(covariance)
    posterior = np.linalg.inv(likelihoods.information + inverse)
    # sum of (T + V_i)^-1 without ever inverting a singular information
    precision = np.sum(inverse - inverse @ posterior @ inverse, axis=0)
    centre_sd = np.sqrt(np.minimum(np.diag(np.linalg.pinv(precision)), _UNSEEN_VARIANCE))
    variance = np.diag(covariance)
    resolved = 1 - np.einsum("npp->np", posterior) / variance
    dispersion_sd = 1 / np.sqrt(np.maximum(2 * np.sum(np.clip(resolved, 0, 1) ** 2, axis=0), 1e-6))
    return {
        "central": (fit.population.mu[:e], centre_sd),
        "dispersion_between_persons": (0.5 * np.log(variance), dispersion_sd),
    }
