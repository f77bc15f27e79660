r"""Largest possible evidence of an effect: a strong effect is invisible if the elements can reproduce it.

The curves without noise are compared with the network's nearest curves (``nearest.py``). No search with free elements
can exceed this evidence, so detection of an effect below about six standard errors is not expected, however strongly it
changes the curve.

Three effects are detected in other ways. Mains hum has a random phase: its power stands out from that of 2n numbers of
noise by lambda / sqrt(4 n), n harmonic points in all recordings. A drift and a covariate are changes of the elements:
they stand out of the elements' scatter between repetitions, rho, and between persons, tau, with the error v_i of one
estimate from the Fisher information, people weighted by their precision,

.. math:: \text{drift: } b\sqrt{\sum_j (j - \bar\jmath)^2 \sum_i \frac1{\rho^2 + v_i}}, \qquad
          \text{covariate: } b\,s_x \sqrt{\sum_i \frac1{\tau^2 - b^2 s_x^2 + (\rho^2 + v_i)/J}},

of the element that shows it best.
"""

from __future__ import annotations

import numpy as np
from cases import COVARIATE, Case, followers, hums
from nearest import nearest, size, tangent_basis, white
from people import COVARIATES, ELEMENTS


def visibility(case: Case, sd: np.ndarray) -> tuple[float, np.ndarray]:
    """Greatest possible evidence of a concealed effect.

    Parameters
    ----------
    case : Case
    sd : ndarray, shape (N, J, F)
        Noise of real and of imaginary part.

    Returns
    -------
    total : float
        Standard errors.
    outside : ndarray, shape (F,)
        Part of the change that no elements can reproduce, over the noise, rms over the recordings of people with the
        effect; for a drift or a covariate the whole change, because there the elements themselves change.
    """
    n_subjects, n_repetitions, _ = sd.shape
    if case.id in ("body.drift", "body.covariate"):
        outside = white(case.concealed - case.without, sd)
    else:
        _, outside = nearest(case.log_elements, case.concealed, case.frequency_hz, sd)
    total = float(np.sqrt(np.sum(outside**2)))
    if case.id == "rig.mains":
        hum = np.tile(hums(case.frequency_hz), 2)
        total = float(np.sum(outside[..., hum] ** 2) / np.sqrt(2 * hum.sum() * n_subjects * n_repetitions))
    elif case.id in ("body.drift", "body.covariate"):
        _, variance = tangent_basis(case.log_elements, case.frequency_hz, sd)
        total = _of_elements(case, variance.mean(axis=1))
    return total, size(outside, case.members)


def _of_elements(case: Case, error: np.ndarray) -> float:
    """Standard errors by which a drift or a covariate stands out; `error` (N, P) is the variance of one estimate."""
    n_repetitions = case.log_elements.shape[1]
    names = (case.place,) if case.id == "body.drift" else tuple(followers(case.place))
    best = 0.0
    for i in (ELEMENTS.index(name) for name in names):
        scatter = case.population.between_repetitions[i] ** 2 + error[:, i]
        if case.id == "body.drift":
            lever = np.sum((np.arange(n_repetitions) - (n_repetitions - 1) / 2) ** 2)
            found = case.values["trend"] * np.sqrt(lever * np.sum(1 / scatter))
        else:
            explained = (case.values["slope"] * COVARIATES[COVARIATE][1]) ** 2
            rest = case.population.between_persons[i] ** 2 - explained + scatter / n_repetitions
            found = np.sqrt(explained * np.sum(1 / rest))
        best = max(best, float(found))
    return best
