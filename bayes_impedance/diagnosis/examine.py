r"""Adequacy of every population fit: whether the network describes the recordings, before its numbers are used.

This is the first part of a diagnosis and shares its tests: the screening of all registered effects in the residuals,
the location of structure, the tests of the population's distribution. Effects are not selected or named; if a test is
significant, the sentence says so and refers to ``diagnose``.

**Affected elements.** Significant effects of the screening are added to the network and the population is refitted for
a few rounds. If none of them describes the recordings better then, the scores, which are linear in the effect and take
the noise as known, were mistaken, and only the location of structure counts. (Of populations with nothing missing and
one recording of 51 points each, 5 of 14 were marked by scores alone.) An element whose centre moves by more than the
half width of its own 90 % interval depends on whether that effect is present, and is marked. If structure is
significant and no effect explains it down to the noise, or people are not of one normal population, all elements are
marked.

**Outliers.** Under one normal population a person's posterior mean deviates from the population's with covariance
:math:`T - C_i`, with T the covariance between people and :math:`C_i` that of the person's posterior: little in
directions that the person's recordings do not determine. With :math:`\lambda` and w the eigenvalues and eigenvectors of
:math:`T^{-1/2}(T - C_i)T^{-1/2}`, of the k directions that are determined by more than half,

.. math:: d_i^2 = \sum_k \frac{\left(w_k^T\,T^{-1/2}(\hat\theta_i - \mu)\right)^2}{\lambda_k}, \qquad
          \frac{N}{(N-1)^2}\,d_i^2 \sim \operatorname{Beta}\left(\tfrac{k}{2}, \tfrac{N - k - 1}{2}\right),

so that an outlier is not masked by its own contribution to the covariance (Gnanadesikan and Kettenring,
Biometrics 28, 81-124, 1972).

The error of a calibration at each frequency is no misfit: its most probable value is removed from the recordings first
(:mod:`bayes_impedance.diagnosis.fit.map_calibration`), unless it is improbable.
"""

from __future__ import annotations

from concurrent.futures import Executor
from contextlib import nullcontext

import numpy as np
from scipy.stats import beta

from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register of effects)
from bayes_impedance.diagnosis.catalogue.effect import Effect, registered
from bayes_impedance.diagnosis.fit.calibration_error import IMPROBABLE
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.map_calibration import most_probable_error, removed
from bayes_impedance.diagnosis.fit.model import build, scales_of
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup
from bayes_impedance.diagnosis.heterogeneity.tests import find_structures
from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.residuals.absolute_fit import badly_described, copies, far_off
from bayes_impedance.diagnosis.residuals.locate import locate
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN
from bayes_impedance.diagnosis.selection.level_starts import from_level
from bayes_impedance.diagnosis.selection.richer_law import simple_and_richer
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import ALPHA, best_shapes
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import Trial, poolings_for, trial_of, try_candidate
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.population.map_error import without_map_noise
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.adequacy import Adequacy
from bayes_impedance.results.curve_errors import relative_rms
from bayes_impedance.results.misfit import MISFIT_SCALE, MISFIT_SHARE
from bayes_impedance.runtime.executors import executor_of

_OUTLIER_ALPHA = 0.002
"""Corrected level of the test of each person: it is one of five tests, and good populations may be marked in 2 % of
cases."""

_DETERMINED = 0.5
"""Smallest fraction of the variance between people that a person's recordings resolve in a tested direction. By
choice."""

_MOST_EXAMINED = 200
"""Largest number of people, evenly spread over all, whose residuals are tested. By choice: enough to detect what
affects a population, and the time of the screening stays bounded."""

_TRIED = 3
"""Number of significant effects whose consequences for the elements are computed, each at its best place. By choice."""

_ROUNDS = 12
"""Rounds of the refits with them. By choice: they start at the fit of the network, and a shift by an interval shows
early."""


def examine(
    fit: PopulationFit, *, workers: int = 2, executor: Executor | None = None, effects: tuple[Effect, ...] | None = None
) -> Adequacy:
    """Look for misfits of a population fit.

    Parameters
    ----------
    fit : PopulationFit
    workers : int
        Threads; the result does not depend on their number.
    executor : Executor, optional
        Runs the work that is done person by person; threads of this process if not given.
    effects : tuple of Effect, optional
        All that are registered if not given.
    """
    from threadpoolctl import threadpool_limits

    candidates, _ = simple_and_richer(registered() if effects is None else effects)
    own = executor_of(workers) if executor is None else nullcontext(executor)
    with threadpool_limits(1), own as running:
        return _examine(fit, candidates, running)


def _examine(fit: PopulationFit, effects: tuple[Effect, ...], executor: Executor) -> Adequacy:
    recordings, n = fit.recordings, len(fit.recordings.subjects)
    wrong = far_off(_error(fit), fit.noise_scale, recordings.unit)
    far = [f"{why}, then the network with 'bayes-impedance diagnose'" for why in wrong]
    gross = [*copies(recordings), *far]
    if gross:
        return Adequacy(gross=tuple(gross))
    refitter, base, names_of = _refitted(fit, executor)
    residuals = tuple(person_residuals(base, names_of, executor))
    location = locate(residuals, fit.seed)
    step = Step(before=base, residuals=residuals, screening=screen(base, residuals, effects, fit.seed, executor))
    misfit, bent, names = list[str](), dict[str, float](), list[str]()
    if step.log_p < np.log(ALPHA):
        bent, names = _consequences(fit, refitter, base, step)
    if location.p_value < STRUCTURE_ALPHA and not names:
        bent = _all(fit)
    if names or location.p_value < STRUCTURE_ALPHA:
        by_scores = float(np.exp(step.log_p)) if names else 1.0
        misfit.append(_missing(fit, min(location.p_value, by_scores), bent))
    shape = badly_described(recordings.names, fit.noise_scale)
    if n > 1:
        structures, _ = find_structures(base, recordings.select(names_of), False, fit.seed)
        shape += [_two_groups(s) for s in structures if isinstance(s, Subgroup)]
        shape += _outliers(fit)
    if shape:
        bent = _all(fit) | bent
    misfit += shape
    return Adequacy(misfit=tuple(misfit), bent=bent, log_p=step.log_p, p_value=location.p_value, effects=tuple(names))


def _all(fit: PopulationFit) -> dict[str, float]:
    """All reported elements, marked with an unknown change."""
    return {name: np.inf for name, seen in zip(fit.kernel.elements, fit.identified, strict=True) if seen}


def varying_of(fit: PopulationFit) -> np.ndarray:
    """Which parameters differ between people, bool, shape (P,): all of the only person's."""
    return np.array([fit.one_person or not p.shared for p in fit.kernel.parameters])


def _without_calibration_error(fit: PopulationFit) -> Recordings | None:
    """Recordings without the most probable error of a calibration at each frequency; None if none is removed."""
    if fit.recordings.calibration_map is None or any(one.noise_sd is None for one in fit.recordings.subjects):
        return None
    plain, elements = without_map_noise(fit.recordings), fit.person_means
    loads = [
        fit.kernel.impedance(theta + own, one.frequency_hz)
        for one, theta, own in zip(plain.subjects, elements, fit.deviations, strict=True)
    ]
    found = most_probable_error(plain, loads, len(fit.kernel.elements))
    return removed(plain, found) if found.probability > IMPROBABLE else None


def _refitted(fit: PopulationFit, executor: Executor) -> tuple[Refitter, Refit, tuple[str, ...]]:
    """Converged refit of the examined people, started at the posterior's centre, with its refitter and their names."""
    n = len(fit.recordings.subjects)
    some = np.unique(np.linspace(0, n - 1, min(n, _MOST_EXAMINED)).round().astype(int)).tolist()
    data, clean = [], _without_calibration_error(fit)
    for i in some:
        s = fit.recordings.subjects[i] if clean is None else clean.subjects[i]
        noise = fit.noise[i] / fit.noise_scale[i] if s.noise_sd is None else s.noise_sd
        noise = noise if fit.noise_weights is None else noise / np.sqrt(fit.noise_weights[i])
        own = fit.deviations[i][:, varying_of(fit)]
        data.append(Likelihood.make(s.frequency_hz, s.z, noise, own))
    refitter = Refitter(data, executor, fit.one_person)
    # What is the same for everybody is held at its central value: the people are examined.
    shared = ~varying_of(fit)
    centre = {p.name: float(p.value(np.median(fit.parameters.mu[:, k]))) for k, p in enumerate(fit.kernel.parameters)}
    held = {p.name: centre[p.name] for p, same in zip(fit.kernel.parameters, shared, strict=True) if same}
    model = build(fit.kernel.network.holding(held), (), scales_of(fit.recordings), ())
    persons = fit.person_means[:, ~shared]
    u = np.concatenate([persons[i] + fit.deviations[i][:, ~shared] for i in some])
    p = persons.shape[1]
    if fit.one_person:
        population = Population(fit.prior.centre, np.eye(p) * fit.prior.centre_sd**2, np.full(p, 0.1))
    else:
        rho = fit.parameters.between_repetitions.mean(axis=0)[~shared]
        covariance = fit.parameters.covariance.mean(axis=0)[np.ix_(~shared, ~shared)]
        population = Population(fit.parameters.mu.mean(axis=0)[~shared], covariance, rho)
    base = refitter.settle(refitter.fit(model, u, population, 60), fit.seed, rounds=1)
    return refitter, base, tuple(fit.recordings.names[i] for i in some)


def _consequences(
    fit: PopulationFit, refitter: Refitter, base: Refit, step: Step
) -> tuple[dict[str, float], list[str]]:
    """Elements that significant effects change, with the change of their logarithm, and the effects, best first.

    Both are empty if no refit with one of these effects describes the recordings better.
    """
    screening, bent, gains = step.screening, dict[str, float](), dict[str, float]()
    order = [*best_shapes(screening), *best_shapes(screening, by_spread=True)]
    p_size = screening.log_p(np.nan_to_num(screening.z))
    tried, trials, explained = set[str](), list[Trial](), False
    known = {name for name, seen in zip(fit.kernel.elements, fit.identified, strict=True) if seen}
    half = 0.5 * np.subtract(*np.quantile(fit.parameters.mu[:, varying_of(fit)], (0.95, 0.05), axis=0))
    for k in order:
        candidate = screening.candidates[k]
        significant = min(float(p_size[k]), float(screening.log_p_spread[k])) < np.log(ALPHA)
        if not significant or candidate.effect.id in tried or len(tried) == _TRIED:
            continue
        tried.add(candidate.effect.id)
        pooling = poolings_for(candidate.effect, len(refitter.data))
        trials.append(try_candidate(refitter, base, candidate, float(screening.size[k]), pooling, _ROUNDS)[-1])
    if screening.log_p_levels < np.log(ALPHA):
        level = screening.levels[0]
        grown = from_level(refitter, base, level, _ROUNDS)
        trials.append(trial_of(level.candidate, "varying", grown, base))
    for trial in trials:
        if not (trial.physical and trial.gain > LEAST_GAIN):
            continue
        gains[trial.effect.id] = max(trial.gain, gains.get(trial.effect.id, 0.0))
        explained = explained or float(np.mean(trial.fit.weight**-0.5 > MISFIT_SCALE)) <= MISFIT_SHARE
        e = base.model.n_elements
        change = trial.fit.persons[:, :e].mean(axis=0) - base.persons[:, :e].mean(axis=0)
        for name, moved, width in zip(base.model.network.elements, change, half, strict=True):
            if not abs(moved) <= width and name in known:
                bent[name] = max(abs(float(moved)), bent.get(name, 0.0))
    if gains and not explained:
        bent = _all(fit) | bent
    return bent, sorted(gains, key=lambda name: -gains[name])


def _missing(fit: PopulationFit, p: float, bent: dict[str, float]) -> str:
    factor = float(np.median(fit.noise_scale))
    text = (
        f"The network leaves out something that the recordings show ({_p_value(p)}; "
        f"residuals are {factor:.2g} times the estimated noise): run 'bayes-impedance diagnose' to see what."
    )
    if len(bent) == int(fit.identified.sum()):
        return f"{text} The values of all elements would change by more than their intervals if it were modelled."
    if bent:
        return f"{text} If it were modelled, {', '.join(bent)} would change by more than the interval."
    return f"{text} No element would change by more than its interval if it were modelled."


def _p_value(p: float) -> str:
    """A p-value for a sentence; one that is below the smallest number is not zero."""
    return f"p = {p:.1g}" if p > 0 else "p below 1e-300"


def _error(fit: PopulationFit) -> np.ndarray:
    """Relative error of each person's fitted network against the mean recording, shape (N,).

    The error among the predictions is another number: of each repetition with its own deviation, so that noise counts
    in full; and they are made only when this examination has released the executor.
    """
    own = zip(fit.recordings.subjects, fit.person_means, strict=True)
    return np.array([relative_rms(fit.kernel.impedance(theta, s.frequency_hz), s.mean) for s, theta in own])


def _two_groups(group: Subgroup) -> str:
    return (
        f"The subjects seem to form two groups ({100 * group.share:.0f} % differ from the others by "
        f"{group.separation:.1f} standard deviations): one central value and one dispersion describe neither of them."
    )


def _outliers(fit: PopulationFit) -> list[str]:
    seen = np.flatnonzero(fit.identified & varying_of(fit))
    n = len(fit.recordings.subjects)
    if n < seen.size + 3 or not seen.size:
        return []
    draws = fit.person_draws.reshape(-1, n, fit.person_draws.shape[-1])
    between = fit.parameters.covariance.mean(axis=0)[np.ix_(seen, seen)]
    values, vectors = np.linalg.eigh(between)
    root = (vectors / np.sqrt(values)) @ vectors.T
    centre = fit.parameters.mu.mean(axis=0)[seen]
    p = np.ones(n)
    for i in range(n):
        scaled = (draws[:, i, seen] - centre) @ root
        share, direction = np.linalg.eigh(np.eye(seen.size) - np.cov(scaled.T).reshape(2 * (seen.size,)))
        known = share > _DETERMINED
        k = int(known.sum())
        if k:
            square = float(np.sum((scaled.mean(axis=0) @ direction[:, known]) ** 2 / share[known]))
            p[i] = n * beta.sf(min(square * n / (n - 1) ** 2, 1.0), k / 2, (n - k - 1) / 2)
    far = np.flatnonzero(p < _OUTLIER_ALPHA)
    if not far.size:
        return []
    names = ", ".join(fit.recordings.names[i] for i in far[np.argsort(p[far])][:5])
    who, it, s = ("Subjects", "them", "") if far.size > 1 else ("Subject", "it", "s")
    return [
        f"{who} {names} lie{s} far outside the population of the others ({_p_value(float(p.min()))}) and bias"
        f"{'es' if s else ''} its central values and dispersions; check the recording{'' if s else 's'}, or leave "
        f"{it} out."
    ]
