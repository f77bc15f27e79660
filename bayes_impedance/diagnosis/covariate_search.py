r"""Which elements follow which covariate: every pair tested, with a correction for having looked at all of them.

The network is fitted once without covariates, as a diagnosis fits it. With each person's quadratic likelihood of the
log elements, slopes are estimated and tested by the regression of
:mod:`bayes_impedance.diagnosis.heterogeneity.regression`: Kenward and Roger's t test, each covariate beside those
already found, p values corrected over all elements times all covariates (Holm). For a covariate with a significant
slope, the gain in log density of held-out people says how well it predicts
(:mod:`bayes_impedance.diagnosis.heterogeneity.gain`). The same tests, at a stricter level, are part of a diagnosis.

A slope that was selected because it is the largest of many is too large on average: its interval holds for a slope that
was chosen beforehand. Fit the population with the covariates that were found, ``fit --covariate``.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.heterogeneity.gain import gain_of_covariate
from bayes_impedance.diagnosis.heterogeneity.regression import find_covariates
from bayes_impedance.diagnosis.heterogeneity.tests import covariates_of, person_likelihoods
from bayes_impedance.diagnosis.heterogeneity.trends import Trend, regressors_of
from bayes_impedance.display import MOST_ROWS, heading, joined, lines, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network
from bayes_impedance.population.covariates import not_used
from bayes_impedance.recordings.dataset import require_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.executors import executor_of
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.user_table import hint, shown, whole_number_in

if TYPE_CHECKING:
    import pandas as pd

LEVEL = 0.05
"""Corrected p value below which a slope is significant: the chance that any of the pairs is found if none follows. The
usual level of a search that is itself the question; in a diagnosis, where it is one of many, the level is 0.003."""

SCHEMA = 1
"""Version of the layout of ``covariates.json``."""


@dataclass(frozen=True, kw_only=True)
class CovariateSearch:
    """Slopes of all elements on all covariates.

    Attributes
    ----------
    network : str
    subjects : int
    trends : tuple of Trend
        The most significant first.
    tried : int
        Number of slopes over which p values are corrected.
    gains : dict of str to (float, float)
        Of each covariate with a significant slope: gain in log density of held-out people, and its standard error.
    remarks : tuple of str
        What was left out, and why.
    """

    network: str
    subjects: int
    trends: tuple[Trend, ...]
    tried: int
    gains: dict[str, tuple[float, float]]
    remarks: tuple[str, ...]

    @property
    def found(self) -> tuple[Trend, ...]:
        """Significant slopes."""
        return tuple(t for t in self.trends if t.p_corrected < LEVEL)

    def __repr__(self) -> str:
        return f"<CovariateSearch of {self.network}: {len(self.found)} of {self.tried} slopes significant>"

    def _repr_html_(self) -> str:
        rows = self.rows()[:MOST_ROWS]
        body = table(list(rows[0]), [list(row.values()) for row in rows]) if rows else ""
        return joined(heading(repr(self).strip("<>")), body, lines(self.remarks))

    def rows(self) -> list[dict[str, Any]]:
        """One row for each slope; the most significant first."""
        return [
            {
                "element": t.element,
                "covariate": t.covariate,
                "transform": t.transform,
                "slope": t.estimate,
                "q05": t.q05,
                "q95": t.q95,
                "p_value": t.p_value,
                "p_corrected": t.p_corrected,
                "significant": t.p_corrected < LEVEL,
                "persons": t.persons,
            }
            for t in self.trends
        ]

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each slope, the most significant first.

        Returns
        -------
        DataFrame
            Columns element, covariate, transform (``log``: the slope is an exponent; ``linear``: change of the log
            element per unit of the covariate), slope with its 90 % interval, p value, the same corrected for all
            pairs, significant, persons.
        """
        import pandas as pd

        return pd.DataFrame(self.rows())

    def summary(self) -> dict[str, Any]:
        """Contents of ``covariates.json``."""
        return {
            "schema": SCHEMA,
            "network": self.network,
            "subjects": self.subjects,
            "tried": self.tried,
            "level": LEVEL,
            "slopes": self.rows(),
            "gains": {name: {"elpd_gain": gain, "elpd_gain_se": se} for name, (gain, se) in self.gains.items()},
            "remarks": list(self.remarks),
        }


def search_covariates(
    recordings: Recordings,
    network: Network | str | None = None,
    *,
    covariates: Sequence[str] = (),
    seed: int = 1,
    workers: int = 2,
    progress: Progress = lambda *_: None,
    executor: Executor | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> CovariateSearch:
    """Test every element of the network against every covariate.

    Parameters
    ----------
    recordings : Recordings
        Of people with covariates; one that is unknown for somebody leaves that person out of its tests.
    network : Network or str, optional
        That of the dataset if not given.
    covariates : sequence of str
        Those that are tested; all if none are named.
    seed : int
        Of the starts of the fit, and of the division of people for gains.
    workers : int
        Threads; the result does not depend on their number.
    progress : callable, optional
        Called with stage, done, total.
    executor : Executor, optional
        Runs the work that is done person by person; threads of this process if not given.
    checkpoint : path, optional
        Folder in which the fit of the network is saved as it progresses.

    Raises
    ------
    InputError
        If there is no network, or there are no covariates, or a named one is unknown.
    """
    from threadpoolctl import threadpool_limits

    require_recordings(recordings)
    whole_number_in(seed, "seed", 0)
    whole_number_in(workers, "workers", 1)
    known = covariates_of(recordings)
    if not known:
        reason = not_used(recordings)
        raise InputError(f"the recordings have no covariates: {reason or 'add them to subjects.csv'}")
    for name in covariates:
        if name not in known:
            raise InputError(f"covariate {shown(name)} is not in the dataset ({hint(name, known)}); name another")
    values = {name: known[name] for name in known if not covariates or name in covariates}
    own = executor_of(workers) if executor is None else nullcontext(executor)
    with threadpool_limits(1), own as executor:
        kept = None if checkpoint is None else Path(checkpoint)
        fitted = fit_network(recordings, network, seed, executor, progress, kept)
    people = person_likelihoods(fitted.fit)
    tested = find_covariates(people, values, alpha=LEVEL)
    gains = {}
    for name in dict.fromkeys(t.covariate for t in tested.trends if t.p_corrected < LEVEL):
        elements = [t.element for t in tested.trends if t.covariate == name and t.p_corrected < LEVEL]
        gains[name] = gain_of_covariate(people, regressors_of({name: values[name]}, [])[name][0], elements, seed)
    return CovariateSearch(
        network=str(fitted.fit.model.network),
        subjects=len(recordings.subjects),
        trends=tested.trends,
        tried=tested.tried,
        gains=gains,
        remarks=tuple(text for text in (*fitted.remarks, tested.reason, *tested.remarks) if text),
    )
