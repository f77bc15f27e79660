r"""Parameters of what was found that elements can absorb: no recording tells their values, and none is given.

An effect may be certain, and one of its parameters not to be seen. Beside :math:`r_1-(m|n|r_2)` a second path of a
damper and a spring changes the curve by its spring; its damper only makes of the network another one of the same form,

.. math:: \Bigl(\frac1{r_1} + \frac1Z\Bigr)^{-1} + r = \Bigl(\frac1{r_1'} + \frac1{Z'}\Bigr)^{-1}, \qquad
          r_1' = r_1 + r, \qquad Z' = \Bigl(\frac{r_1 + r}{r_1}\Bigr)^2 Z + r + \frac{r^2}{r_1},

whose elements are all positive. Only how people differ says anything of such a parameter, and that is a distribution
that was assumed: a damper of 0.33 N s/m was said to be 1.17 (0.81 to 1.40).

Whether there are such parameters is decided exactly
(:func:`~bayes_impedance.network.redundancy.inseparable`, of the network with what was found). Which combinations of
parameters change no curve are the null vectors v of :math:`J_{kp} = \partial \ln z(s_k)/\partial u_p`; a quantity of
the verdict is not told if it changes along one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bayes_impedance.diagnosis.extended_network import ExtendedNetwork, no_networks
from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior, Reported, reported
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.verdict.sentence import listed, place_in_words
from bayes_impedance.diagnosis.verdict_types import Physics
from bayes_impedance.network.redundancy import inseparable

_BEYOND, _POINTS = 100.0, 400
"""Factor by which the frequencies at which combinations are looked for go beyond the band, and their number. By choice:
that no curve changes is true at all frequencies, and a wide band tells it from what changes little."""

_NOTHING = 1e-9
"""Change of the curves along a combination, in the largest, that is rounding. By choice: above the error of double
precision (1e-15 times the condition of the elements), below what a parameter changes that is felt in a wide band."""

_STEP, _LEAST = 1e-3, 1e-3
"""Step along a combination, in its largest component, and smallest share of it by which a quantity changes. By
choice."""


def without_absorbed(
    physics: Sequence[Physics], final: Refit, first: int, posterior: CoefficientPosterior, extended: ExtendedNetwork
) -> tuple[tuple[Physics, ...], tuple[str, ...]]:
    """The entries without the parameters that elements absorb, and a remark on each.

    Parameters
    ----------
    physics : sequence of Physics
        First the additions from number `first` on, in order.
    final : Refit
        Fit with all that has a name.
    first : int
        Number of additions that were known before.
    posterior : CoefficientPosterior
    extended : ExtendedNetwork
        The network with what was found.
    """
    model, entries = final.model, list(physics)
    if no_networks(model) or not inseparable(extended.network):
        return tuple(entries), ()
    u, remarks = final.u.mean(axis=0), []
    null = without_change(model, u)
    elements = u[: model.n_elements] if posterior.elements is None else posterior.elements
    for i in range(first, len(model.additions)):
        hidden = _changing(model, i, posterior, elements, null)
        entry = entries[i - first]
        lost = [name for name in entry.parameters if name in hidden]
        if lost:
            kept = {name: own for name, own in entry.parameters.items() if name not in hidden}
            entries[i - first] = replace(entry, parameters=kept)
            shown = listed([name.replace("_", " ") for name in lost])
            remarks.append(
                f"Of {entry.id} at {place_in_words(entry.place)} the recordings do not determine "
                f"{shown}: elements of the network can take up any change of it. No value is given."
            )
    return tuple(entries), tuple(remarks)


def without_change(model: Model, u: np.ndarray) -> np.ndarray:
    """Combinations (D, P) of a model's parameters that change no curve at u (P,), each with largest component one."""
    scales = model.scales
    frequency = np.geomspace(scales.low / _BEYOND, scales.high * _BEYOND, _POINTS) / (2 * np.pi)
    z, slope = model.kernel.derivative(u, frequency)
    relative = np.concatenate([(slope / z).real, (slope / z).imag], axis=1)
    size = np.linalg.norm(relative, axis=1)
    size = np.where(size > 0, size, 1.0)
    _, values, vectors = np.linalg.svd((relative / size[:, None]).T, full_matrices=False)
    null = vectors[values <= _NOTHING * values[0]] / size
    return np.asarray(null / np.abs(null).max(axis=1, initial=1e-300, keepdims=True))


def _changing(
    model: Model, addition: int, posterior: CoefficientPosterior, elements: np.ndarray, null: np.ndarray
) -> set[str]:
    """Names of the quantities of an addition that change along any of the combinations (D, P)."""
    n, found = model.n_elements, set[str]()

    def rows(step: np.ndarray) -> list[Reported]:
        at = elements + (step[:n] if elements.ndim == 1 else step[:n, None])
        return reported(model, addition, replace(posterior, central=posterior.central + step[n:]), at)

    before = rows(np.zeros(null.shape[1]))
    for vector in null:
        for row, moved in zip(before, rows(_STEP * vector), strict=True):
            if abs(moved.median - row.median) > _STEP * _LEAST * abs(row.median):
                found.add(row.name)
    return found
