"""Models with one addition more or less, refitted from the estimates of the previous model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.spike_slab import members
from bayes_impedance.network.notation import parse

_SCALED = {"m": 1, "r": 1, "p": 1, "k": 1, "n": -1}
"""Power of a factor on a branch's impedance in each parameter; exponents, times and losses do not change it."""


def extended(model: Model, candidate: Candidate, pooling: str, size: float) -> Model:
    """The model with one more addition."""
    effect = candidate.effect
    addition = Addition.of(candidate, pooling)
    shape = candidate.shape
    if not effect.operation:  # scaled as a whole: masses and dampers in proportion, compliances inversely
        factor = max(size, 1e-12) if effect.connection == "beside" else 1 / max(size, 1e-12)
        shape = {e: v * factor ** _SCALED.get(e[0], 0) for e, v in shape.items()}
    return build(model.network, [*model.additions, addition], model.scales, [*starts_of(model), shape])


def starts_of(model: Model) -> list[dict[str, float]]:
    """Start values of every addition, as :func:`~bayes_impedance.diagnosis.fit.model.build` takes them."""
    return [dict(zip(names_of(a.effect), shape_values(model, i), strict=True)) for i, a in enumerate(model.additions)]


def names_of(effect: Effect) -> list[str]:
    """Names of an effect's parameters: of its operation, or the elements of its branch."""
    return [c.name for c in effect.coefficients] if effect.operation else list(parse(effect.branch).elements)


def shape_values(model: Model, addition: int) -> list[float]:
    """Centres of an addition's shapes in the operation's unit, or the start values of its elements."""
    effect = model.additions[addition].effect
    own = [p for p in model.parameters if p.addition == addition]
    if not effect.operation:
        by_name = {p.name: p for p in model.kernel.network.parameters}
        return [float(by_name[p.name].value(np.array(p.start))) for p in own]
    return [float(c.value(p.centre, model.scales)) for c, p in zip(effect.coefficients, own, strict=True)]


def carried(old: Model, new: Model, u: np.ndarray) -> np.ndarray:
    """Parameters (M, P') of a larger model: those (M, P) of the smaller one, and new ones at their start values."""
    position = {name: i for i, name in enumerate(old.kernel.elements)}
    begin = {name: p.start for name, p in zip(new.kernel.elements[new.n_elements :], new.parameters, strict=True)}
    columns = [u[:, position[e]] if e in position else np.full(len(u), begin[e]) for e in new.kernel.elements]
    return np.column_stack(columns)


def extended_start(fit: Refit, model: Model) -> tuple[np.ndarray, Population]:
    """Start of a larger model's refit: the smaller model's estimates, and new parameters at their start values."""
    old, new = fit.model, model
    u = carried(old, new, fit.u)
    varying_old = [n for n, s in zip(old.kernel.elements, old.shared, strict=True) if not s]
    varying_new = [n for n, s in zip(new.kernel.elements, new.shared, strict=True) if not s]
    n = len(varying_new)
    mu, covariance, rho = np.empty(n), np.zeros((n, n)), np.full(n, 1e-3)
    for i, name in enumerate(varying_new):
        if name in varying_old:
            k = varying_old.index(name)
            mu[i], rho[i] = fit.population.mu[k], fit.population.rho[k]
            for j, other in enumerate(varying_new):
                if other in varying_old:
                    covariance[i, j] = fit.population.covariance[k, varying_old.index(other)]
        else:
            mu[i] = u[:, new.kernel.elements.index(name)].mean()
            covariance[i, i] = 1.0  # set from the mean when the fit begins
    return u, Population(mu, covariance, rho)


def is_physical(fit: Refit) -> bool:
    """Whether every coefficient has an admissible sign, and is absent in some people if the effect claims that."""
    return not unphysical(fit)


def unphysical(fit: Refit) -> list[int]:
    """Additions of which a coefficient has another sign than it may, or that everybody has though some should not."""
    return [i for i in range(len(fit.model.additions)) if not _may_be(fit, i)]


def _may_be(fit: Refit, addition: int) -> bool:
    own = fit.model.additions[addition]
    if own.effect.operation and own.only_in_some and not members(fit, addition).only_some:
        return False
    return has_admissible_signs(fit, addition)


def has_admissible_signs(fit: Refit, addition: int, recordings: np.ndarray | None = None) -> bool:
    """Whether the means of an addition's coefficients have signs that its effect may have.

    Over all recordings, or those given, bool (M,).
    """
    effect = fit.model.additions[addition].effect
    if not effect.operation or effect.signed:
        return True
    columns = zip(fit.model.columns(addition), effect.coefficients, strict=True)
    linear = [column for column, coefficient in columns if coefficient.link == "linear"]
    rows = slice(None) if recordings is None else recordings
    return effect.traits.allows(fit.u[rows][:, linear].mean(axis=0))


def has_shapes(effect: Effect) -> bool:
    """Whether an effect has shapes that could differ between people."""
    return any(c.link != "linear" for c in effect.coefficients[1:])


def with_pooling(
    model: Model, addition: int, pooling: str, dispersions: Sequence[float] = (), correlation: float | None = None
) -> Model:
    """The model with another pooling of one addition, and with its dispersions and correlation replaced if given."""
    additions = list(model.additions)
    changed = replace(additions[addition], pooling=pooling)
    if correlation is not None:
        changed = replace(changed, correlation=correlation)
    if dispersions:
        changed = replace(changed, dispersion=dispersions[0], other_dispersions=tuple(dispersions[1:]))
    additions[addition] = changed
    return rebuilt(model, additions, list(range(len(additions))))


def rebuilt(model: Model, additions: Sequence[Addition], kept: Sequence[int]) -> Model:
    """The model with other additions; `kept` is the old index of each, from which its shapes' centres are taken."""
    starts = starts_of(model)
    return build(model.network, additions, model.scales, [starts[k] for k in kept])


def columns_kept(model: Model, kept: Sequence[int]) -> list[int]:
    """Columns of the parameters of a model's network and of some of its additions."""
    return [*range(model.n_elements), *sorted(c for k in kept for c in model.columns(k))]


def shrunk(refitter: Refitter, fit: Refit, model: Model, kept: Sequence[int], rounds: int = 40) -> Refit:
    """Refit of a model with fewer additions (their numbers in the parameters' names may differ), from `fit`."""
    columns = columns_kept(fit.model, kept)
    u = fit.u[:, columns]
    varying_old = np.flatnonzero(~fit.model.shared)
    positions = [int(np.flatnonzero(varying_old == c)[0]) for c in columns if not fit.model.shared[c]]
    population = fit.population
    smaller = replace(
        population,
        mu=population.mu[positions],
        covariance=population.covariance[np.ix_(positions, positions)],
        rho=population.rho[positions],
    )
    return refitter.fit(model, u, smaller, rounds)


def with_last(refitter: Refitter, fit: Refit, addition: int) -> Refit:
    """Refit of the same additions with one of them in the last place, from `fit`."""
    kept = [*(k for k in range(len(fit.model.additions)) if k != addition), addition]
    model = rebuilt(fit.model, [fit.model.additions[k] for k in kept], kept)
    old = [*range(model.n_elements), *(c for k in kept for c in fit.model.columns(k))]
    new = [*range(model.n_elements), *(c for k in range(len(kept)) for c in model.columns(k))]
    columns = np.array(old)[np.argsort(new)]
    varying = np.cumsum(~fit.model.shared) - 1
    positions = varying[columns[~model.shared]]
    population = replace(
        fit.population,
        mu=fit.population.mu[positions],
        covariance=fit.population.covariance[np.ix_(positions, positions)],
        rho=fit.population.rho[positions],
    )
    return refitter.fit(model, fit.u[:, columns], population)


def dispersion_of_shared(fit: Refit, addition: int, seed: int) -> np.ndarray:
    """Posterior draws of the relative dispersion between people of a coefficient that was fitted as shared."""
    model = with_pooling(fit.model, addition, "varying")
    column = model.columns(addition)[0] - model.n_elements
    return coefficient_posterior(replace(fit, model=model), seed).relative_dispersion[:, column]
