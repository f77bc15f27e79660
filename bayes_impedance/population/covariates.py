r"""Covariates of a fit: standardised, and refused if they are collinear.

Slopes B of :math:`\theta_i = \mu + B x_i` are determined by the columns of the standardised design matrix X (N, Q). Its
condition number, largest over smallest singular value, is the ratio of the largest to the smallest standard error of a
normalised combination of slopes. Where it is large, the data determine only a combination of the slopes, and the
estimates of single slopes would come from the prior.
"""

from __future__ import annotations

import re

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.user_table import hint, shown
from bayes_impedance.units import counted

LARGEST_CONDITION = 30.0
"""Of the standardised design matrix: from 30 on a dependency is strong and damages estimates, by Belsley, Kuh and
Welsch, Regression Diagnostics, Wiley 1980, section 3.2. Two covariates reach it with a correlation of 0.998."""

SHARE_OF_DEPENDENCY = 0.1
"""A covariate is named as part of a dependency if its weight is at least this fraction of the largest weight. By
choice: columns are standardised, so that a smaller weight means less than a tenth of a standard deviation per one."""


def not_used(recordings: Recordings, column: str = "") -> str:
    """Why a column of ``subjects.csv``, or any, is no covariate, as reading it has said; empty if nothing is known."""
    pattern = re.compile(rf": {re.escape(column) or '.+'} is .*, and is not used")
    return next((warning for warning in recordings.warnings if pattern.search(warning)), "")


def standardised_covariates(recordings: Recordings, names: tuple[str, ...]) -> np.ndarray:
    """Covariates with mean 0 and standard deviation 1.

    Parameters
    ----------
    recordings : Recordings
        N people.
    names : tuple of str
        Q covariates.

    Returns
    -------
    ndarray, shape (N, Q)

    Raises
    ------
    InputError
        If a covariate is unknown, named twice, missing for a person, the same for all persons, so large that the
        differences between persons are lost in rounding, or if covariates depend on each other.
    """
    subjects = recordings.subjects
    known = list(dict.fromkeys(name for subject in subjects for name in subject.covariates))
    columns = []
    for i, name in enumerate(names):
        what = f"covariate {shown(name)}"
        if name in names[:i]:
            raise InputError(f"{what} is named twice: name it once")
        if name not in known:
            if reason := not_used(recordings, name):
                raise InputError(f"{what} cannot be used: {reason}")
            meant = hint(name, known) if known else "there are none"
            raise InputError(f"{what} is not in the dataset ({meant}): add it to subjects.csv or leave it out")
        values = np.array([s.covariates.get(name, np.nan) for s in subjects], dtype=float)
        if not np.all(np.isfinite(values)):
            who = subjects[int(np.argmin(np.isfinite(values)))].name
            raise InputError(f"{what} is missing for subject {who}: add it to subjects.csv or leave it out")
        columns.append(_standardised(values, what, recordings.names))
    if names and len(subjects) < len(names) + 2:
        raise InputError(
            f"{counted(len(names), 'covariate')} {'is' if len(names) == 1 else 'are'} too many for "
            f"{counted(len(subjects), 'subject')}: fewer than {len(names) + 2} leave nothing to estimate the remaining "
            "dispersion from; leave some covariates out"
        )
    design = np.array(columns).T if columns else np.zeros((len(subjects), 0))
    _require_independent(design, names)
    return design


def _standardised(values: np.ndarray, what: str, people: tuple[str, ...]) -> np.ndarray:
    """One column, standardised. It is first divided by its largest number: squares of very large numbers overflow."""
    largest = int(np.argmax(np.abs(values)))
    size = np.abs(values[largest])
    # Differences below this fraction of the largest number are rounding errors.
    resolution = len(values) * np.finfo(float).eps
    if size == 0 or np.ptp(values / size) <= resolution:
        raise InputError(f"{what} is the same for all subjects: leave it out")
    others = values[values != values[largest]]
    usual = np.abs(others).max()
    if usual > 0 and np.ptp(others / usual) > resolution and np.ptp(others / size) <= resolution:
        raise InputError(
            f"{what} is {values[largest]:g} for subject {people[largest]}, so large that the values of the "
            "others cannot be distinguished: correct it in subjects.csv"
        )
    centred = values / size - np.mean(values / size)
    return np.asarray(centred / centred.std())


def _require_independent(design: np.ndarray, names: tuple[str, ...]) -> None:
    """Refuse columns that are nearly linearly dependent (collinear)."""
    if design.shape[1] < 2:
        return
    _, singular, rows = np.linalg.svd(design, full_matrices=design.shape[0] < design.shape[1])
    missing = design.shape[1] > singular.size
    if not missing and singular[-1] * LARGEST_CONDITION > singular[0]:
        return
    weights = np.abs(rows[-1])
    involved = [shown(n) for n, w in zip(names, weights, strict=True) if w >= SHARE_OF_DEPENDENCY * weights.max()]
    raise InputError(
        f"covariates {', '.join(involved)} are linearly dependent for these {design.shape[0]} subjects (one follows "
        "from the others), so that their slopes cannot be separated: leave one out"
    )
