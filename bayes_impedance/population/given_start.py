"""Where everybody's fit begins besides the searches of its own: parameters that are known from elsewhere.

A parameter that single recordings hardly show, and all people together show well, such as a weak resonance of a
fixture, is found by a search of one person's recordings only by chance. Who has a fit to all people in hand, as a
diagnosis has, gives it as a start: the population that begins there is compared with those that begin where the
searches ended, and the most probable goes on.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.whole import Whole

Start = Mapping[str, float | np.ndarray]
"""Values of all parameters of the fitted network in their units, by name: one for all people, or one for each, (N,)."""


def unbounded_start(
    start: Start, kernel: Kernel, n_persons: int, prior: Prior, rig: Collection[str] = ()
) -> np.ndarray:
    """Unbounded parameters of everybody on the scales of a fit, (N, P).

    Parameters
    ----------
    start : mapping of str to float or ndarray
    kernel : Kernel
    n_persons : int
    prior : Prior
    rig : collection of str
        Parameters that the prior knows, of which no start needs to be given.

    Raises
    ------
    InputError
        If a parameter has no value or an impossible one, or the network does not have it.
    """
    names = kernel.elements
    missing, other = sorted(set(names) - set(start) - set(rig)), sorted(set(start) - set(names))
    if missing or other:
        what = f"has no value of {', '.join(missing)}" if missing else f"names {', '.join(other)}"
        raise InputError(f"the start {what}: give one value for each of {', '.join(names)}")
    whole = Whole(Pooling(kernel))
    parameters = {p.name: p for p in whole.kernel.parameters}
    u = np.empty((n_persons, len(names)))
    for k, name in enumerate(names):
        if name not in start:
            u[:, k] = prior.centre[k]
            continue
        value = np.asarray(start[name], dtype=float)
        if value.shape not in ((), (n_persons,)):
            raise InputError(f"the start has {value.size} values of {name}: give one, or one for each of {n_persons}")
        u[:, k] = parameters[name].u(value) / whole.unit[k]
    if not np.all(np.isfinite(u)):
        bad = [name for k, name in enumerate(names) if not np.all(np.isfinite(u[:, k]))]
        raise InputError(f"the start of {', '.join(bad)} is not finite: give finite values that the elements can have")
    return u
