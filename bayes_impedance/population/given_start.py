"""Where everybody's fit begins besides the searches of its own: parameters that are known from elsewhere.

A parameter that single recordings hardly show, and all people together show well, such as a weak resonance of a
fixture, is found by a search of one person's recordings only by chance. Who has a fit to all people in hand, as a
diagnosis has, gives it as a start: the population that begins there is compared with those that begin where the
searches ended, and the most probable goes on.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.whole import Whole

Start = Mapping[str, float | np.ndarray]
"""Values of all parameters of the fitted network in their units, by name: one for all people, or one for each, (N,)."""


def unbounded_start(start: Start, kernel: Kernel, n_persons: int) -> np.ndarray:
    """Unbounded parameters of everybody on the scales of a fit, (N, P).

    Raises
    ------
    InputError
        If a parameter has no value or an impossible one, or the network does not have it.
    """
    names = kernel.elements
    if set(start) != set(names):
        missing, other = sorted(set(names) - set(start)), sorted(set(start) - set(names))
        what = f"has no value of {', '.join(missing)}" if missing else f"names {', '.join(other)}"
        raise InputError(f"the start {what}: give one value for each of {', '.join(names)}")
    whole = Whole(Pooling(kernel))
    parameters = {p.name: p for p in whole.kernel.parameters}
    u = np.empty((n_persons, len(names)))
    for k, name in enumerate(names):
        value = np.asarray(start[name], dtype=float)
        if value.shape not in ((), (n_persons,)):
            raise InputError(f"the start has {value.size} values of {name}: give one, or one for each of {n_persons}")
        u[:, k] = parameters[name].u(value) / whole.unit[k]
    if not np.all(np.isfinite(u)):
        bad = [name for k, name in enumerate(names) if not np.all(np.isfinite(u[:, k]))]
        raise InputError(f"the start of {', '.join(bad)} is not finite: give finite values that the elements can have")
    return u
