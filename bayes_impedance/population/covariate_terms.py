r"""Names of categories and of interactions among covariates, written out as the covariates that they stand for.

A column of text ``sex`` is kept as one covariate of 0 and 1 for each value but one, ``sex=m``
(:mod:`bayes_impedance.recordings.categories`); its name alone stands for all of them. ``age_y:sex`` is an
**interaction**: how far the effect of age differs between the categories. Its covariate is the product of the two
standardised ones, so that it is nearly uncorrelated with them, and their own slopes are those of somebody in the middle
of the other. An interaction has no meaning without the covariates themselves, which are therefore taken too.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.user_table import hint, shown

BETWEEN = ":"
"""Stands between the two covariates of an interaction."""


def goes_with_others(name: str) -> bool:
    """Whether a covariate depends on others: one category of several, or an interaction."""
    return BETWEEN in name or "=" in name


def correlations_of(recordings: Recordings, names: tuple[str, ...]) -> np.ndarray | None:
    """Correlations over people (Q, Q) of covariates among which are categories or interactions; None without such."""
    if not any(goes_with_others(name) for name in names):
        return None
    values = standardised_covariates(recordings, names)
    return np.asarray(values.T @ values / len(values))


def with_terms(recordings: Recordings, names: Sequence[str]) -> tuple[Recordings, tuple[str, ...]]:
    """Recordings with the covariates that names stand for, and the names of these.

    Parameters
    ----------
    recordings : Recordings
    names : sequence of str
        Covariates, columns of text, and interactions of two of them.

    Returns
    -------
    recordings : Recordings
        The same, if no interaction is named.
    names : tuple of str
        Of single covariates; what is none is left as it is.

    Raises
    ------
    InputError
        If a part of an interaction is unknown or missing for somebody, or its parts are one.
    """
    known = list(dict.fromkeys(name for subject in recordings.subjects for name in subject.covariates))
    found: list[str] = []
    products: dict[str, np.ndarray] = {}
    for name in names:
        parts = name.split(BETWEEN)
        if name in known or len(parts) == 1:
            found += _single(name, known)
            continue
        if len(parts) != 2:
            raise InputError(f"covariate {shown(name)}: an interaction is of two covariates, as age_y:sex; name two")
        first, second = (_of_interaction(part, name, known) for part in parts)
        if set(first) & set(second):
            raise InputError(f"covariate {shown(name)}: an interaction is of two different covariates; name another")
        found += [own for own in (*first, *second) if own not in found and own not in names]
        for one in first:
            for other in second:
                columns = standardised_covariates(recordings, (one, other))
                products[f"{one}{BETWEEN}{other}"] = columns[:, 0] * columns[:, 1]
                found.append(f"{one}{BETWEEN}{other}")
    if products:
        subjects = [
            _with(subject, {name: float(values[i]) for name, values in products.items()})
            for i, subject in enumerate(recordings.subjects)
        ]
        recordings = replace(recordings, subjects=tuple(subjects))
    return recordings, tuple(found)


def _single(name: str, known: Sequence[str]) -> list[str]:
    """The covariates of a column of text, or the name itself."""
    categories = [own for own in known if own.startswith(f"{name}=")]
    return categories if categories and name not in known else [name]


def _of_interaction(part: str, name: str, known: Sequence[str]) -> list[str]:
    found = _single(part, known)
    if found[0] not in known:
        meant = hint(part, known) if known else "there are none"
        raise InputError(
            f"covariate {shown(name)}: {shown(part)} is not in the dataset ({meant}); add it to subjects.csv, or leave "
            "the interaction out"
        )
    return found


def _with(subject: Subject, added: dict[str, float]) -> Subject:
    """A copy with more covariates; of a subject whose data are in a file, without reading them."""
    other = copy(subject)
    other.__dict__["covariates"] = {**subject.covariates, **added}
    return other
