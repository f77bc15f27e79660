r"""Cross-validated gain of a covariate or a drift: log likelihood of people who were not used to estimate it.

The population is fitted to the people outside of a fold with and without the slopes that were found; the gain of a
person in the fold is the difference of the log likelihoods that the two populations give to the person's recordings,
the elements integrated out (:func:`bayes_impedance.diagnosis.heterogeneity.person_likelihoods.log_marginal`). The
slopes were selected with all people: only the estimation of their size is held out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.folds import person_folds
from bayes_impedance.diagnosis.heterogeneity.person_likelihoods import PersonLikelihoods, log_marginal
from bayes_impedance.diagnosis.heterogeneity.reml import Covariance, FullCovariance, centred_fit, fit_normal_population
from bayes_impedance.diagnosis.heterogeneity.within_persons import (
    DRIFT,
    RepetitionLikelihoods,
    variables_of,
    within_persons_model,
)

HELD_OUT = ("body.covariate", "body.drift", "body.amplitude")
"""Effects whose gain is computed here; for other structures only a likelihood ratio is computed."""


def gain_of_covariate(
    likelihoods: PersonLikelihoods, regressor: np.ndarray, elements: Sequence[str], seed: int
) -> tuple[float, float]:
    """Gain of letting some elements follow a regressor.

    Parameters
    ----------
    likelihoods : PersonLikelihoods
        Of N persons.
    regressor : ndarray, shape (N,)
        The covariate as it enters the model; NaN where it is unknown.
    elements : sequence of str
    seed : int

    Returns
    -------
    gain, se : float
        Sum over people with a known regressor, in natural logarithms, and its standard error.
    """
    known = np.isfinite(regressor)
    people = likelihoods.persons(known)
    centre, null = centred_fit(people)
    n, p = len(people), len(people.elements)
    x = (regressor[known] - regressor[known].mean()) / regressor[known].std()
    columns = [people.elements.index(e) for e in elements]
    without = np.broadcast_to(np.eye(p), (n, p, p))
    slopes = x[:, None, None] * np.eye(p)[:, columns]
    return _gain(
        people.around(centre), np.concatenate([without, slopes], axis=2), without, FullCovariance(null.covariance), seed
    )


def gain_within_persons(
    repetitions: RepetitionLikelihoods, elements: Sequence[str], seed: int, variable: str = DRIFT
) -> tuple[float, float]:
    """Gain of letting some elements follow a variable of the repetitions; as :func:`gain_of_covariate`."""
    values, _, _ = variables_of(repetitions, [])[variable]
    likelihoods, design, structure = within_persons_model(repetitions, [values])
    columns = [repetitions.elements.index(e) for e in elements]
    return _gain(likelihoods, design[:, :, columns], design[:, :, :0], structure, seed)


def _gain(
    likelihoods: PersonLikelihoods, with_it: np.ndarray, without: np.ndarray, start: Covariance, seed: int
) -> tuple[float, float]:
    n = len(likelihoods)
    fold = person_folds(n, seed)
    gains = np.zeros(n)
    for k in np.unique(fold):
        inside, outside = fold == k, fold != k
        for design, sign in ((with_it, 1.0), (without, -1.0)):
            fit = fit_normal_population(likelihoods.persons(outside), design[outside], start)
            means = design[inside] @ fit.coefficients
            gains[inside] += sign * log_marginal(likelihoods.persons(inside), means, fit.covariance)
    return float(gains.sum()), float(np.sqrt(n) * gains.std(ddof=1))
