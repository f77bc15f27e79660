r"""Everybody's parameters of the extended network, from the search's fit of the model with what it found.

The search describes a resonator by mass, frequency and damping ratio, the network by a mass, a spring and a damper; the
map :math:`x = g(\theta)` from the network's parameters to the effect's is known
(:attr:`bayes_impedance.network.operation_traits.Traits.read`). Here it is inverted for every person, by Newton's
method. Nearly all maps are products of powers, so that :math:`\ln x` is linear in the logarithms and the first step
arrives.

Of a coefficient that the search lets be zero or negative in some people, and the network does not, such a person begins
at a small part of the typical one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_impedance.diagnosis.extended_network import ExtendedNetwork, no_networks
from bayes_impedance.diagnosis.extended_posterior import Reading
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.fit.rounds import means_of
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.whole import Whole
from bayes_impedance.recordings.files import Recordings

_LEAST = 0.05
"""Least part of the median coefficient with which a person begins. By choice: what is present, but hardly shows."""

_STEPS, _LONGEST, _STEP = 12, 4.0, 1e-5
"""Steps of Newton's method, longest step of a logarithm and step of the derivative. By choice: one step suffices for
products of powers; the longest step keeps exponentials finite."""

_SOLVED = 1e-6
"""Largest remainder of a solution, on logarithmic scales. By choice: much less than any posterior."""


def extended_start(
    fit: Refit, extended: ExtendedNetwork, recordings: Recordings, held: Mapping[str, float]
) -> dict[str, np.ndarray] | None:
    """Values of everybody's parameters in their units, (N,) each.

    Parameters
    ----------
    fit : Refit
        With at least one addition.
    extended : ExtendedNetwork
        Of its model.
    recordings : Recordings
        To which the network is to be fitted.
    held : mapping of str to float
        Parameters that the model holds, and the network does not.

    Returns
    -------
    dict of str to ndarray, or None
        None if the network's parameters do not follow from those of the fit, as where one follows the amplitude, or if
        it cannot be fitted.
    """
    try:
        checked = checked_model(recordings, extended.network)
    except InputError:
        return None
    if checked.combinations:  # elements that are one
        return None
    u = means_of(fit.u, fit.owner, len(fit.data))
    return values_of(fit.model, u, extended, Whole(Pooling(checked.kernel)).kernel, held)


def medians(values: Mapping[str, np.ndarray]) -> dict[str, float]:
    """The median person's values, to six digits: where a fit begins need not be known better."""
    return {name: float(f"{np.median(own):.6g}") for name, own in values.items()}


@np.errstate(all="ignore")  # a step that goes too far is seen by its result
def values_of(
    model: Model, u: np.ndarray, extended: ExtendedNetwork, kernel: Kernel, held: Mapping[str, float]
) -> dict[str, np.ndarray] | None:
    """Values of the extended network's parameters from those of the model, u (N, n + A)."""
    if no_networks(model):
        return None
    n = model.n_elements
    own = dict(zip(model.network.elements, u.T, strict=False))
    symbols = {name for names in extended.symbols for name in names.values()}
    theta = np.zeros((len(u), len(kernel.elements)))
    for k, p in enumerate(kernel.parameters):
        if p.name in own:
            theta[:, k] = own[p.name]
        elif p.name in held:
            theta[:, k] = p.u(held[p.name])
        elif p.name not in symbols:
            return None
    unknown = [k for k, name in enumerate(kernel.elements) if name in symbols]
    longest = np.array([np.inf if kernel.parameters[k].link == SIGNED else _LONGEST for k in unknown])
    moved = [k for k, name in enumerate(own) if name not in kernel.elements]  # a spring that became a power law
    signed = _signed(model, extended, kernel)
    target = _targets(model, u[:, n:], signed)
    if not np.all(np.isfinite(target)):
        return None
    read = Reading(model, extended, kernel)

    def equations(theta: np.ndarray) -> np.ndarray:
        values, sign = read(theta)
        values = np.where(signed, sign * np.exp(values), values)
        return np.hstack([values - target, read.elements(theta)[moved].T - u[:, moved]])

    value = equations(theta)
    if value.shape[1] != len(unknown):
        return None
    for _ in range(_STEPS if unknown else 0):
        slopes = np.empty((*value.shape, len(unknown)))
        for j, k in enumerate(unknown):
            there = theta.copy()
            there[:, k] += _STEP
            slopes[:, :, j] = (equations(there) - value) / _STEP
        try:
            step = np.linalg.solve(slopes, value[..., None])[..., 0]
        except np.linalg.LinAlgError:
            return None
        theta[:, unknown] -= np.clip(step, -longest, longest)
        value = equations(theta)
        if not np.all(np.isfinite(value)):
            return None
    if np.abs(value).max(initial=0.0) > _SOLVED * max(1.0, float(np.abs(target).max(initial=0.0))):
        return None
    return {p.name: p.value(theta[:, k]) for k, p in enumerate(kernel.parameters)}


def _signed(model: Model, extended: ExtendedNetwork, kernel: Kernel) -> np.ndarray:
    """Which of the A parameters are coefficients that may have either sign in the network: bool (A,)."""
    link = {p.name: p.link for p in kernel.parameters}
    either = [any(link.get(name) == SIGNED for name in names.values()) for names in extended.symbols]
    return np.array([p.is_coefficient and either[p.addition] for p in model.parameters], dtype=bool)


def _targets(model: Model, u: np.ndarray, signed: np.ndarray) -> np.ndarray:
    """Everybody's parameters of the additions (N, A), coefficients of one sign as logarithms: NaN of a negative one."""
    target = u.copy()
    for k, p in enumerate(model.parameters):
        if p.is_coefficient and not signed[k] and model.additions[p.addition].effect.operation:
            typical = float(np.median(u[:, k]))
            target[:, k] = np.log(np.maximum(u[:, k], _LEAST * typical)) if typical > 0 else np.nan
    return target
