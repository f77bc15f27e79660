r"""Local impedance at every place of a network, and its adjoint sensitivity: the derivative of the port's impedance.

Impedances are combined from the leaves up to the port. The derivative
:math:`a_p = \partial z_\text{port}/\partial z_p` is propagated from the port down to the leaves:

.. math:: \text{parallel: } a_\text{part} = a, \qquad \text{series: } a_\text{part} = a\,(z/z_\text{part})^2, \qquad
          \text{operation: } a_\text{inside} = a\,T'(z).

The motion that an element follows (:mod:`bayes_impedance.network.own_motion`) is held in these derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.model import Model, inner_places
from bayes_impedance.network.notation import Element, Network, Parallel, PowerLaw, Wrapped
from bayes_impedance.network.operations import N_PARAMETERS, TRAITS, Operation
from bayes_impedance.network.own_motion import motion_per_force, saturating_share
from bayes_impedance.network.program import changed_by
from bayes_impedance.network.transform import transform_many

INSIDE, BEFORE_CHANNELS = "port, inside the rig", "port, before the channels"


def spot_of(candidate: Candidate) -> str:
    """Where an effect acts, among those at the port: a body's effects are inside of the rig.

    Of the rig's own, masses, springs and dampers are measured through its channels.
    """
    if candidate.place != "port" or candidate.effect.is_of_the_channel:
        return candidate.place
    return BEFORE_CHANNELS if candidate.effect.is_outermost else INSIDE


@dataclass(frozen=True)
class Local:
    """Impedance and sensitivity at one place, in many recordings.

    Attributes
    ----------
    z : ndarray, complex, shape (M, F)
        Impedance at the place.
    adjoint : ndarray, complex, shape (M, F)
        Derivative of the port's impedance with respect to it.
    """

    z: np.ndarray
    adjoint: np.ndarray


def local_impedances(model: Model, u: np.ndarray, omega: np.ndarray) -> dict[str, Local]:
    """Impedance and sensitivity at every place of the network as given, with the additions in the model.

    Parameters
    ----------
    model : Model
    u : ndarray, shape (M, P)
        Parameters in the kernel's order.
    omega : ndarray, shape (F,)

    Returns
    -------
    dict of str to Local
        By the names of the places. ``port`` is the port after all effects; :data:`INSIDE` is the port after the body's
        effects and before the rig's operations, and :data:`BEFORE_CHANNELS` after those of its mechanics, where its
        delays and filters begin.
    """
    kernel = model.kernel
    values = {name: u[:, i, None] for i, name in enumerate(kernel.elements)}
    at_port: dict[str, Local] = {}
    before: dict[tuple[int, ...], list[np.ndarray]] = {}
    wrapping: dict[tuple[int, ...], np.ndarray] = {}
    after: dict[tuple[int, ...], np.ndarray] = {}

    def up(node: Network, path: tuple[int, ...]) -> np.ndarray:
        if isinstance(node, Element | PowerLaw):
            known = {p.name: p.value(values[p.name]) for p in node.own_parameters if not p.held}
            z = np.broadcast_to(node.impedance(1j * omega, known), (len(u), omega.size))
        elif isinstance(node, Wrapped):
            wrapper = {p.name: values[p.name][:, 0] for p in node.own_parameters if not p.held}
            z, wrapping[path] = changed_by(node, wrapper, omega, up(node.part, (*path, 0)))
        else:
            parts = [up(part, (*path, i)) for i, part in enumerate(node.parts)]
            z = np.sum(parts, axis=0) if isinstance(node, Parallel) else 1 / np.sum([1 / p for p in parts], axis=0)
        slopes, stages = [], [np.asarray(z)]
        for operation in kernel.operations:
            if operation.path == path:
                changed, slope = _changed(model, operation, u, omega, np.asarray(z))
                slopes.append(slope)
                z = changed
                stages.append(z)
        before[path], after[path] = slopes, np.asarray(z)
        if not path:
            rig = [a.effect for a in model.additions if a.effect.operation and a.effect.is_outermost]
            channels = sum(effect.is_of_the_channel for effect in rig)
            for name, later in ((INSIDE, len(rig)), (BEFORE_CHANNELS, channels)):
                first = len(slopes) - later
                at_port[name] = Local(stages[first], reduce(np.multiply, slopes[first:], np.ones_like(stages[0])))
        return after[path]

    up(kernel.network, ())
    adjoints: dict[tuple[int, ...], np.ndarray] = {}

    def down(node: Network, path: tuple[int, ...], adjoint: np.ndarray) -> None:
        adjoints[path] = adjoint
        inside = adjoint
        for slope in reversed(before[path]):
            inside = inside * slope
        if isinstance(node, Wrapped):
            down(node.part, (*path, 0), inside * wrapping[path])
            return
        bare = after[path]
        if before[path]:
            parts = [after[(*path, i)] for i in range(len(node.parts))]
            if parts:
                total = (
                    np.sum(parts, axis=0) if isinstance(node, Parallel) else 1 / np.sum([1 / p for p in parts], axis=0)
                )
                bare = np.asarray(total)
        for i, part in enumerate(node.parts):
            child = after[(*path, i)]
            down(part, (*path, i), inside if isinstance(node, Parallel) else inside * (bare / child) ** 2)

    down(kernel.network, (), np.ones_like(after[()]))
    found: Mapping[str, tuple[int, ...]] = inner_places(model)
    places = {name: Local(after[path], adjoints[path]) for name, path in found.items()}
    return {**places, **at_port}


def motion_at(model: Model, u: np.ndarray, omega: np.ndarray, path: tuple[int, ...]) -> np.ndarray:
    """How far a place of the kernel's network moves per unit of force at the port, its operations left aside (M, F)."""
    kernel = model.kernel
    values = {name: u[:, i, None] for i, name in enumerate(kernel.elements)}
    known = {p.name: p.value(values[p.name]) for p in kernel.network.parameters if not p.held}
    return motion_per_force(kernel.network, path, 1j * omega, known)


def _changed(
    model: Model, operation: Operation, u: np.ndarray, omega: np.ndarray, z: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What an operation makes of the impedance z (M, F) of its place, and the derivative of that with respect to z."""
    own = np.zeros((len(z), N_PARAMETERS))
    for k, name in enumerate(operation.parameters):
        own[:, k] = u[:, model.kernel.elements.index(name)]
    if TRAITS[operation.name].follows_motion:
        share = saturating_share(motion_at(model, u, omega, operation.path), np.exp(own[:, 1, None]))
        factor = np.exp(operation.constants[0] * own[:, :1] * share)
        return z * factor, factor.astype(complex)
    constants = np.array((*operation.constants, 0.0, 0.0))[:N_PARAMETERS]
    t = transform_many(operation.code, own, constants, omega, np.ascontiguousarray(z))
    return t[0], t[1]
