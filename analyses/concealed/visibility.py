r"""By how much an effect can stand out at most: a strong effect is invisible if the elements can imitate it.

With the curve z' of each recording without its noise, and the network's curve Z that comes nearest to it,

.. math:: \lambda = \sum_{ij} \min_\theta \left|\left(z'_{ij} - Z(\theta)\right)/\sigma_{ij}\right|^2

is the noncentrality of the best chi-square test there is when the elements of each recording are free and the effect's
shape is known; its root is the number of standard errors by which the effect stands out. A search for an unknown effect
that leaves the elements free can do no better, so what lies below about six is not to be expected, however strong it is
on the curve.

Three effects show otherwise. Mains hum has a random phase: its power stands out from that of 2n numbers of noise by
lambda / sqrt(4 n), n harmonic points in all recordings. A drift and a covariate are changes of the elements: they stand
out of the elements' scatter between repetitions, rho, and between persons, tau, with the error v_i of one estimate from
the Fisher information, people weighted by their precision,

.. math:: \text{drift: } b\sqrt{\sum_j (j - \bar\jmath)^2 \sum_i \frac1{\rho^2 + v_i}}, \qquad
          \text{covariate: } b\,s_x \sqrt{\sum_i \frac1{\tau^2 - b^2 s_x^2 + (\rho^2 + v_i)/J}},

of the element that shows it best.
"""

from __future__ import annotations

import numpy as np
from cases import COVARIATE, Case, followers, hums
from people import COVARIATES, ELEMENTS, impedance

_STEP = 1e-5
_MOST_STEPS = 12


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
        What no values of the elements can imitate, over the noise, rms over the recordings of those concerned; for a
        drift or a covariate the whole change, because there it is the elements that change.
    """
    change = _white(case.concealed - case.without, sd, axis=-1)
    n_subjects, n_repetitions, n = sd.shape
    outside = change
    if case.id not in ("body.drift", "body.covariate"):
        outside = _nearest(case, sd)
    total = float(np.sqrt(np.sum(outside**2)))
    if case.id == "rig.mains":
        hum = np.tile(hums(case.frequency_hz), 2)
        total = float(np.sum(outside[..., hum] ** 2) / np.sqrt(2 * hum.sum() * n_subjects * n_repetitions))
    elif case.id in ("body.drift", "body.covariate"):
        tangent = _white(_tangent(case.log_elements, case.frequency_hz), sd[..., None], axis=-2)
        fisher = np.einsum("ijfp,ijfq->ijpq", tangent, tangent)
        error = np.mean(np.diagonal(np.linalg.inv(fisher), axis1=-2, axis2=-1), axis=1)
        total = _of_elements(case, error)
    size = outside[..., :n] ** 2 + outside[..., n:] ** 2
    return total, np.sqrt(np.mean(size[case.members], axis=(0, 1)))


def _nearest(case: Case, sd: np.ndarray) -> np.ndarray:
    """White residuals (N, J, 2 F) of the network's curves that come nearest, by Levenberg-Marquardt steps."""
    log_elements = case.log_elements.copy()
    best = _white(case.concealed - impedance(log_elements, case.frequency_hz), sd, axis=-1)
    damping = np.full(best.shape[:2], 1e-3)
    for _ in range(_MOST_STEPS):
        before = np.sum(best**2, axis=-1)
        tangent = _white(_tangent(log_elements, case.frequency_hz), sd[..., None], axis=-2)
        fisher = np.einsum("ijfp,ijfq->ijpq", tangent, tangent)
        fisher = fisher + (damping[..., None] * np.diagonal(fisher, axis1=-2, axis2=-1))[..., None] * np.eye(
            len(ELEMENTS)
        )
        step = np.linalg.solve(fisher, np.einsum("ijfp,ijf->ijp", tangent, best)[..., None])
        trial = log_elements + np.clip(step[..., 0], -1.0, 1.0)
        residual = _white(case.concealed - impedance(trial, case.frequency_hz), sd, axis=-1)
        better = np.sum(residual**2, axis=-1) < before
        log_elements = np.where(better[..., None], trial, log_elements)
        best = np.where(better[..., None], residual, best)
        damping = np.where(better, damping / 10, damping * 10)
        after = float(np.sum(best**2))
        if better.mean() > 0.5 and before.sum() - after < 1e-3 * after + 0.1:
            break
    return best


def _tangent(log_elements: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
    """Derivative of the curves by the log elements (N, J, P), by central differences: complex, shape (N, J, F, P)."""
    steps = _STEP * np.eye(len(ELEMENTS))
    return np.stack(
        [impedance(log_elements + step, frequency_hz) - impedance(log_elements - step, frequency_hz) for step in steps],
        axis=-1,
    ) / (2 * _STEP)


def _white(values: np.ndarray, sd: np.ndarray, axis: int) -> np.ndarray:
    """Real parts, then imaginary parts along the axis of frequency, over the noise."""
    return np.concatenate([values.real / sd, values.imag / sd], axis=axis)


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
