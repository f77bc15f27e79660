r"""How well a network predicts people whom it has not seen: leave-one-out over people.

The expected log predictive density of person i given all others is estimated from the posterior draws
:math:`\phi_s` of the population with everybody, by importance sampling with weights
:math:`r_s \propto 1/p(z_i|\phi_s)` whose largest are smoothed by a Pareto fit (Vehtari, Gelman and Gabry 2017),

.. math:: \mathrm{elpd}_i = \ln\sum_s w_{is}\,p(z_i\,|\,\phi_s), \qquad w_{is}\ \text{smoothed and normalised},

with the absolute log densities of ``log_likelihood/recordings`` (:mod:`bayes_impedance.population.person_densities`).
It is the person as a whole that is left out, all repetitions and frequencies: the question is what the population says
of somebody new. The elements of that person are integrated out, and hence are no parameters that could overfit.

**Two networks** are compared person by person. With the differences :math:`d_i` of N people, the difference of the
sums is :math:`\sum d_i`, and its standard error over people, :math:`\sqrt{N\operatorname{var}(d)}`, is that of the
pairs: what makes a person hard to predict for both networks cancels.

**Noise.** Each network's fit has estimated its own noise, from what repetitions differ by outside of the network's
tangent space, or, with one repetition, from the roughness of what it leaves. This noise is part of the model that is
compared. Its shape over frequency was estimated from everybody, and stays as it is when somebody is left out, in refits
too, so that all values are of one kind. (Measured with the shipped 71 people: estimated again without the person, an
ordinary one's elpd is 2.9 lower, 1645.4 in place of 1648.3: the sum is optimistic by so much for each person.)

**Refits.** Where the Pareto tail index k is above 0.7 the smoothed weights cannot be believed. For such a person the
network is fitted to the others alone, and elpd is the logarithm of the mean density under the draws of that fit
(:mod:`bayes_impedance.population.held_out_person`). If there are more than a few of these people, a refit is not
reliable, or one person less is too few for a full covariance, so that the refit would be of another model, the value
from the weights stays, with a mark.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.display import MOST_ROWS, heading, joined, table
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.population.covariate_terms import with_terms
from bayes_impedance.population.diagnostics import PARETO_LIMIT
from bayes_impedance.population.fit import FitSettings, fit_population
from bayes_impedance.population.held_out_person import held_out_log_densities
from bayes_impedance.population.recording_noise import noise_of
from bayes_impedance.population.requirements import too_few_for_correlations
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.arviz_layout import for_file
from bayes_impedance.results.result import DENSITY_ATTRIBUTE, Result
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.units import counted

if TYPE_CHECKING:
    import pandas as pd

FEWEST_PEOPLE = 2
"""Fewest people: with one, no other person is left to predict from. (Standard errors over very few people are shown,
although they are uncertain.)"""


@dataclass(frozen=True)
class LeftOut:
    """Log predictive density of each person given all others.

    Attributes
    ----------
    subjects : tuple of str
    elpd : ndarray, shape (N,)
        Natural logarithm of a density of all complex values, real and imaginary parts in the unit of the recordings.
    pareto_k : ndarray, shape (N,)
        Tail index of the importance weights.
    refitted : ndarray of bool, shape (N,)
        Whether the value is that of a fit without the person.
    p_loo : float
        Effective number of parameters, from the weights alone.
    """

    subjects: tuple[str, ...]
    elpd: np.ndarray
    pareto_k: np.ndarray
    refitted: np.ndarray
    p_loo: float

    def __repr__(self) -> str:
        elpd, error = self.total
        return f"<LeftOut of {counted(len(self.subjects), 'subject')}: elpd {elpd:.1f}, standard error {error:.1f}>"

    def _repr_html_(self) -> str:
        rows = list(zip(self.subjects, self.elpd.tolist(), self.pareto_k.tolist(), self.refitted.tolist(), strict=True))
        shown = table(["subject", "elpd", "Pareto k", "refitted"], rows[:MOST_ROWS])
        return joined(heading(repr(self).strip("<>")), shown)

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each subject, whose name is the index; columns elpd, pareto_k, refitted."""
        import pandas as pd

        columns = {"elpd": self.elpd, "pareto_k": self.pareto_k, "refitted": self.refitted}
        return pd.DataFrame(columns, index=pd.Index(self.subjects, name="subject", dtype=object))

    @property
    def doubtful(self) -> np.ndarray:
        """Whether the weights cannot be believed and there is no refit, shape (N,)."""
        return np.asarray(~(self.pareto_k <= PARETO_LIMIT) & ~self.refitted)

    @property
    def total(self) -> tuple[float, float]:
        """Sum over people and its standard error."""
        return _sum_and_error(self.elpd)

    def less(self, other: LeftOut) -> tuple[float, float]:
        """Sum less another network's, of the same people, and the standard error of the pairs."""
        if self.subjects != other.subjects:
            raise ValueError("not the same people in the same order")
        return _sum_and_error(self.elpd - other.elpd)


def require_absolute(result: Result) -> None:
    """Refuse a result whose log densities lack a constant.

    Raises
    ------
    InputError
        If it was written by an earlier version.
    """
    absolute = result.attributes.get(DENSITY_ATTRIBUTE) == "absolute"
    if not absolute or "recordings" not in result.groups["log_likelihood"]:
        raise InputError(
            f"the fit of {result.attributes['network']} is of an earlier version, whose log likelihoods lack a "
            "constant; fit it again"
        )


def leave_one_out(result: Result) -> LeftOut:
    """Leave-one-out over people, from the draws of a finished fit.

    Raises
    ------
    InputError
        If there is only one person, or the result is of a version whose log densities are not absolute.
    """
    from bayes_impedance.mcmc.arviz_file import leave_one_out as smoothed

    require_absolute(result)
    subjects = tuple(str(name) for name in result.coords["subject"])
    if len(subjects) < FEWEST_PEOPLE:
        raise InputError(
            "networks are compared by how well each subject is predicted from the others: give two or more subjects"
        )
    written, _ = for_file(result.groups, result.coords)  # whose efficiency is that which arviz sees in the file
    elpd, k, p_loo = smoothed(written["posterior"], result.groups["log_likelihood"]["recordings"])
    return LeftOut(subjects, elpd, k, np.zeros(elpd.size, dtype=bool), p_loo)


def refit_without(
    recordings: Recordings,
    who: Sequence[int],
    left_out: LeftOut,
    result: Result,
    settings: FitSettings,
    workers: int,
    progress: Progress,
    executor: Executor | None = None,
    checkpoints: Path | None = None,
) -> LeftOut:
    """Replace the values of some people by those of fits without each of them.

    Parameters
    ----------
    recordings : Recordings
        Of everybody in `left_out`, in the same order.
    who : sequence of int
        Places of the people.
    left_out : LeftOut
    result : Result
        Of everybody: its network, noise and seed are taken.
    settings, workers, progress, executor
        As in :func:`~bayes_impedance.population.fit.fit_population`.
    checkpoints : Path, optional
        Folder in which each refit saves its steps.

    Returns
    -------
    LeftOut
        A refit that is not reliable leaves the value as it was, and so does one of too few people for the same model.
    """
    varying = sum(not parameter.shared for parameter in parse(result.attributes["network"]).parameters)
    if settings.covariance == "full" and too_few_for_correlations(len(recordings) - 1, varying):
        return left_out
    elpd, refitted = left_out.elpd.copy(), left_out.refitted.copy()
    recordings, seed = with_noise(recordings, result), int(result.attributes["seed"])
    recordings, _ = with_terms(recordings, settings.covariates)  # of everybody, also of whom is left out
    for i in who:
        others = recordings.select([name for k, name in enumerate(recordings.names) if k != i])
        own = None if checkpoints is None else checkpoints / f"without_{i + 1}"
        fit = fit_population(
            others,
            result.summary["network_as_written"],
            settings=settings,
            seed=seed,
            workers=workers,
            progress=progress,
            checkpoint=own,
            executor=executor,
        )
        if fit.one_person or fit.diagnostics.problems:
            continue
        draws = held_out_log_densities(fit, recordings.subjects[i], np.random.SeedSequence([seed, i]))
        elpd[i], refitted[i] = np.logaddexp.reduce(draws) - np.log(draws.size), True
    return replace(left_out, elpd=elpd, refitted=refitted)


def with_noise(recordings: Recordings, result: Result) -> Recordings:
    """The recordings of a fit, each with the noise that was estimated in it, without the person's own scale.

    Raises
    ------
    InputError
        If a recording has no noise of its own and the result holds no noise model.
    """
    model = result.noise_model
    if model is None and any(s.noise_sd is None for s in recordings.subjects):
        raise InputError("the result holds no model of the noise; fit the recordings again")
    return replace(recordings, subjects=tuple(replace(s, noise_sd=noise_of(s, model)) for s in recordings.subjects))


def _sum_and_error(each: np.ndarray) -> tuple[float, float]:
    return float(np.sum(each)), float(np.sqrt(each.size * np.var(each)))
