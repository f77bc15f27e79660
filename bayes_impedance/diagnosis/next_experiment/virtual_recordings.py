"""Virtual recordings of the same people in other experiments: wider band, heavier contactor, changed elements."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.operations import Operation

_POINTS_PER_DECADE = 20.0
"""Points per decade of a wider band where the present recording has a single frequency and so no spacing. By choice."""

_KNOWN = "known mass"
"""Name of the known mass among the kernel's parameters."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A virtual recording.

    Attributes
    ----------
    person : int
        Number of the person.
    row : int
        Row of the present recording in the fits' u.
    copies : int
        Number of recordings it represents.
    frequency_hz, relative_sd : ndarray, shape (F,)
        Noise over magnitude, of the mean of the copies.
    change : ndarray, shape (E,)
        Difference of the log elements from those of the present recording.
    mass : float
        Known mass that moves with the contactor.
    """

    person: int
    row: int
    copies: int
    frequency_hz: np.ndarray
    relative_sd: np.ndarray
    change: np.ndarray
    mass: float = 0.0

    def wider(self, down: float, up: float) -> Recording:
        """The recording over a wider band, with the same points per decade, and noise beyond it as at its edges."""
        f = self.frequency_hz
        decades = np.log10(f[-1] / f[0])
        density = (f.size - 1) / decades if decades > 0 else _POINTS_PER_DECADE

        def count(factor: float) -> int:
            return 1 + int(np.ceil(density * np.log10(factor) - 1e-9))

        below = np.geomspace(f[0] / down, f[0], count(down))[:-1]
        above = np.geomspace(f[-1], f[-1] * up, count(up))[1:]
        noise = np.pad(self.relative_sd, (below.size, above.size), mode="edge")
        return replace(self, frequency_hz=np.r_[below, f, above], relative_sd=noise)


def present_recordings(fit: Refit) -> list[Recording]:
    """One present recording of each person, with the noise of the mean of all recordings of that person."""
    result, row = [], 0
    for i, (d, scale) in enumerate(zip(fit.data, fit.weight, strict=True)):
        frequency = d.omega / (2 * np.pi)
        # The recordings of one person are alike, so their weights add up.
        sd = 1 / np.sqrt(scale * d.weight.sum(axis=0))
        magnitude = np.abs(fit.model.kernel.impedance(fit.u[row], frequency))
        change = np.zeros(fit.model.n_elements)
        result.append(
            Recording(
                person=i,
                row=row,
                copies=d.z.shape[0],
                frequency_hz=frequency,
                relative_sd=sd / magnitude,
                change=change,
            )
        )
        row += d.z.shape[0]
    return result


class Port:
    """Predictions of a model for recordings with a known mass on the contactor, parameters in the model's order."""

    def __init__(self, model: Model, mass: float) -> None:
        kernel = model.kernel
        if mass > 0:
            side = {p.name: model.additions[p.addition].effect.side for p in model.parameters}
            rig = {name for name, where in side.items() if where == "rig"}
            operations = list(kernel.operations)
            # Effects of the rig act on the mass as well: the mass is nearer to the finger.
            at = [k for k, operation in enumerate(operations) if rig & set(operation.parameters)]
            known = Operation("add", _finger(model, rig), (_KNOWN,), (mass, 1.0, 0.0))
            operations.insert(min(at, default=len(operations)), known)
            kernel = Kernel(kernel.network, operations)
        self._kernel = kernel
        self._names = list(kernel.elements)
        self._source = [model.kernel.elements.index(e) for e in self._names if e != _KNOWN]
        self._target = [k for k, e in enumerate(self._names) if e != _KNOWN]

    def impedance(self, u: np.ndarray, frequency_hz: np.ndarray) -> np.ndarray:
        """Impedance of one recording, shape (F,)."""
        return np.asarray(self._kernel.impedance(self._all(u), frequency_hz))

    def derivative(self, u: np.ndarray, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Impedance (F,) and its derivative (P, F)."""
        z, dz = self._kernel.derivative(self._all(u), frequency_hz)
        ordered = np.empty((u.size, z.size), dtype=complex)
        ordered[self._source] = dz[self._target]
        return z, ordered

    def _all(self, u: np.ndarray) -> np.ndarray:
        values = np.ones(len(self._names))  # the known mass is its own unit
        values[self._target] = u[self._source]
        return values


def _finger(model: Model, rig: set[str]) -> tuple[int, ...]:
    """Path of a model's network without the branches of the rig, which are outermost."""
    path: tuple[int, ...] = ()
    node = model.kernel.network
    while rig & set(node.elements):
        i = next(i for i, part in enumerate(node.parts) if model.network.elements[0] in part.elements)
        path, node = (*path, i), node.parts[i]
    return path
