"""A network with effects added to it: its parameters, where they act, and their names."""

from __future__ import annotations

import operator
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import count

import numpy as np

from bayes_impedance.diagnosis.catalogue.coefficient import Scales
from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect, operation_constants
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, Parallel, Place, Wrapped, parse
from bayes_impedance.network.operations import Operation
from bayes_impedance.population.natural_scales import NaturalScales
from bayes_impedance.recordings.files import Recordings

COEFFICIENT_SD = 30.0
"""Prior standard deviation of a linear coefficient around zero, in units of its scale: nearly flat, because an effect
inside a network may be much larger than its part at the port. By choice."""

TYPICAL_DISPERSION = 0.35
"""Relative dispersion of a coefficient between people before it is estimated: a typical difference. By choice."""

DISPERSION_IN_SOME = float(np.sqrt((1 + TYPICAL_DISPERSION**2) / 0.4 - 1))
"""The same (1.34) of a coefficient that is zero in six people of ten and typical in the others. With the typical one,
members would be held near the mean of all: a layer in 17 of 47 people was fitted with a quarter of its size, and their
elements took the rest. The share is by choice: with 0.2 and 0.8 it is 2.1 and 0.6."""

SHAPE_DISPERSION = 0.2
"""The same for shapes (exponents, time constants), which differ less than coefficients do. By choice."""

TEMPORARY_LABEL = "inner_place_"
"""Beginning of the labels by which places are found again after branches were inserted."""


@dataclass(frozen=True, kw_only=True)
class Addition:
    """An effect at a place of the network.

    Attributes
    ----------
    effect : Effect
    place : str
        Name in the network as given.
    pooling : str
        ``shared``: one coefficient for all people; ``varying``: the coefficient differs between people, its shapes do
        not; ``free``: the shapes differ too.
    dispersion : float
        Of a varying coefficient between people, relative to its mean.
    other_dispersions : tuple of float
        Of the operation's other parameters that differ between people; where none is given :data:`SHAPE_DISPERSION` for
        a shape, and that of the first for a coefficient.
    correlation : float
        Between coefficient and first shape over people, where both differ.
    """

    effect: Effect
    place: str
    pooling: str
    dispersion: float = TYPICAL_DISPERSION
    other_dispersions: tuple[float, ...] = ()
    correlation: float = 0.0

    @classmethod
    def of(cls, candidate: Candidate, pooling: str) -> Addition:
        """A candidate as an addition, with the dispersion that its kind has before it is estimated."""
        addition = cls(effect=candidate.effect, place=candidate.place, pooling=pooling)
        return replace(addition, dispersion=DISPERSION_IN_SOME) if addition.absent_in_some else addition

    @property
    def absent_in_some(self) -> bool:
        """Whether it is claimed of some people only, in whom its coefficient is not zero."""
        return self.only_in_some and bool(self.effect.operation)

    @property
    def only_in_some(self) -> bool:
        """Whether it is claimed of some people only: a rig does not differ between people, but sessions and rigs do."""
        return self.effect.pooling == "some" or (self.effect.side == "rig" and self.pooling != "shared")

    @property
    def key(self) -> tuple[str, str, str]:
        """Identity of the addition: effect and place, whatever the pooling."""
        return self.effect.id, self.effect.form, self.place


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter besides the network's own elements.

    Attributes
    ----------
    name : str
        In the kernel.
    addition : int
        Which addition it belongs to.
    shared : bool
    centre, prior_sd : float
        Of the shared value, or of the population's mean.
    start : float
        Start value of a fit.
    is_coefficient : bool
        Whether it is on a linear scale, where zero means no effect; otherwise it is a shape or an element, on a
        logarithmic scale.
    dispersion : float
        Between people if it varies, relative to the mean for a coefficient.
    """

    name: str
    addition: int
    shared: bool
    centre: float
    prior_sd: float
    start: float
    is_coefficient: bool
    dispersion: float


@dataclass(frozen=True)
class Model:
    """The network and its additions.

    Attributes
    ----------
    network : Network
        As given.
    additions : tuple of Addition
    scales : Scales
    kernel : Kernel
        Elements of the network first, in their order.
    parameters : tuple of Parameter
        Those of the additions, in the kernel's order after the network's elements.
    """

    network: Network
    additions: tuple[Addition, ...]
    scales: Scales
    kernel: Kernel
    parameters: tuple[Parameter, ...]

    @cached_property
    def n_elements(self) -> int:
        """Number of the network's own elements."""
        return len(self.network.elements)

    @cached_property
    def shared(self) -> np.ndarray:
        """Which of the kernel's parameters are shared by all people, bool, shape (P,)."""
        return np.array([False] * self.n_elements + [p.shared for p in self.parameters])

    def columns(self, addition: int) -> list[int]:
        """Positions of an addition's parameters."""
        return [self.n_elements + i for i, p in enumerate(self.parameters) if p.addition == addition]

    @property
    def notation(self) -> str:
        """The network with those additions that are branches."""
        return self._grown()[0]

    @property
    def branches(self) -> tuple[str, ...]:
        """Branch that each addition puts into :attr:`notation`, with its names there; empty for an operation."""
        return self._grown()[1]

    def _grown(self) -> tuple[str, tuple[str, ...]]:
        """Notation of the network with its branches, and of each branch."""
        network, branches = _with_labels(self.network), dict[int, str]()
        names = {place.name: _inner_name(network, place) for place in self.network.places()}
        order = sorted(range(len(self.additions)), key=lambda i: self.additions[i].effect.is_outermost)
        for i in order:  # the rig is outermost
            addition = self.additions[i]
            if addition.effect.branch:
                target = Place((), "port") if addition.effect.is_outermost else _find(network, names[addition.place])
                branch, _ = _renamed(addition.effect.network(self.scales), network)
                beside = addition.effect.connection == "beside"
                network = network.beside(target, branch) if beside else network.in_series(target, branch)
                branches[i] = str(branch)
        return str(_without_labels(network)), tuple(branches.get(i, "") for i in range(len(self.additions)))


def scales_of(recordings: Recordings) -> Scales:
    """Typical sizes of a dataset."""
    low = float(np.median([s.frequency_hz[0] for s in recordings.subjects]))
    high = float(np.median([s.frequency_hz[-1] for s in recordings.subjects]))
    middle = float(np.sqrt(low * high))

    def magnitude(frequency: float) -> float:
        near = [abs(s.mean[np.argmin(np.abs(np.log(s.frequency_hz / frequency)))]) for s in recordings.subjects]
        return float(np.median(near))

    return Scales(
        low=2 * np.pi * low,
        middle=2 * np.pi * middle,
        high=2 * np.pi * high,
        z_low=magnitude(low),
        z_middle=magnitude(middle),
        z_high=magnitude(high),
        unit=recordings.unit,
    )


def build(network: Network, additions: Sequence[Addition], scales: Scales, starts: Sequence[dict[str, float]]) -> Model:
    """Put additions into a network.

    Parameters
    ----------
    network : Network
    additions : sequence of Addition
    scales : Scales
    starts : sequence of dict
        For each addition the shapes at which it was found; the centres of their priors are there, or at the nearest
        values of their grids. For a branch, start values of its elements.

    Returns
    -------
    Model
    """
    inner = _with_labels(network)
    names = {place.name: _inner_name(inner, place) for place in network.places()}
    grown, parameters, found = inner, list[Parameter](), list[tuple[Addition, tuple[str, ...], int]]()
    # What changes an element itself is innermost at its place; the rig is outermost, and its signals pass there last.
    order = sorted(range(len(additions)), key=lambda i: _from_inside(additions[i].effect))
    branch_parameters: list[Parameter] = []
    for i in order:
        addition, shape = additions[i], starts[i]
        effect = addition.effect
        if effect.operation:
            own = []
            for k, coefficient in enumerate(effect.coefficients):
                centre_only = k > 0 and coefficient.link != "linear"  # a shape
                start = coefficient.unbounded(shape[coefficient.name], scales) if centre_only else 0.0
                # A fit may have driven a shape out of its grid, where it begins again, but is not likelier for that.
                centre = coefficient.within_grid(start, scales) if centre_only else 0.0
                sd = coefficient.prior_sd if centre_only else COEFFICIENT_SD
                name = f"{effect.id}.{coefficient.name}.{i}"
                varies = addition.pooling == "free" or (addition.pooling == "varying" and not centre_only)
                spreads = (addition.dispersion, *addition.other_dispersions)
                typical = SHAPE_DISPERSION if centre_only else addition.dispersion
                own.append(
                    Parameter(
                        name=name,
                        addition=i,
                        shared=not varies,
                        centre=centre,
                        prior_sd=sd,
                        start=start,
                        is_coefficient=not centre_only,
                        dispersion=spreads[k] if k < len(spreads) else typical,
                    )
                )
            parameters += own
            found.append((addition, tuple(p.name for p in own), i))
        else:
            written = effect.network(scales)
            branch, names_there = _renamed(written, grown)
            target = Place((), "port") if effect.is_outermost else _find(grown, names[addition.place])
            grown = grown.beside(target, branch) if effect.connection == "beside" else grown.in_series(target, branch)
            natural = NaturalScales(float(np.log(scales.z_middle)), float(np.log(scales.middle / (2 * np.pi))))
            for p in written.parameters:
                if p.held:
                    continue
                centre, sd = natural.centre(p)
                branch_parameters.append(
                    Parameter(
                        name=names_there[p.name],
                        addition=i,
                        shared=addition.pooling == "shared",
                        centre=centre,
                        prior_sd=sd,
                        start=float(p.u(shape[p.name])) if p.name in shape else centre,
                        is_coefficient=False,
                        dispersion=addition.dispersion,
                    )
                )
    operations = []
    for addition, own_names, _ in found:
        effect = addition.effect
        path = () if effect.is_outermost else _find(grown, names[addition.place]).path
        constants = (effect.coefficients[0].scale(scales), *operation_constants(effect, scales))
        operations.append(Operation(effect.operation, path, own_names, constants))
    kernel = Kernel(grown, operations)
    by_name = {p.name: p for p in (*branch_parameters, *parameters)}
    # Elements of branches stand among those of the grown network: the network's own elements are put first again.
    if branch_parameters:
        rank = {e: k for k, e in enumerate(kernel.elements)}
        first = list(network.elements)
        if [rank[e] for e in first] != list(range(len(first))):
            kernel = _Reordered(grown, operations, first)
    extra = [by_name[e] for e in kernel.elements[len(network.elements) :]]
    return Model(network, tuple(additions), scales, kernel, tuple(extra))


def _from_inside(effect: Effect) -> tuple[bool, bool, bool]:
    return effect.is_outermost, effect.is_of_the_channel, not effect.is_innermost


class _Reordered(Kernel):
    """A kernel whose first parameters are the elements of the network as given, whatever the places of branches."""

    def __init__(self, network: Network, operations: Sequence[Operation], first: Sequence[str]) -> None:
        super().__init__(network, operations)
        order = [*first, *(e for e in self.elements if e not in first)]
        program = self.program
        held = np.arange(len(order), len(order) + program.held.size)  # they come after all, and stay there
        position = np.concatenate([[order.index(e) for e in self.elements], held]).astype(np.int64)
        parameter = np.where(program.node_parameter >= 0, position[program.node_parameter], -1)
        self.program = program._replace(term_element=position[program.term_element], node_parameter=parameter)
        self.elements = tuple(order)


_LEAST_SD = 1e-7
"""Least standard deviation of an addition's parameter between people: a coefficient of zero has one. By choice: far
less than can be told, and the covariance can be inverted beside variances near one."""


def with_dispersions(model: Model, covariance: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """The covariance with the rows and columns of additions set from their dispersions, means and correlations."""
    result = covariance.copy()
    varying = [p for p in model.parameters if not p.shared]
    for k, p in enumerate(varying, model.n_elements):
        result[k] = result[:, k] = 0.0
        result[k, k] = max(p.dispersion * (abs(mu[k]) if p.is_coefficient else 1.0), _LEAST_SD) ** 2
    for i, addition in enumerate(model.additions):
        own = [k for k, p in enumerate(varying, model.n_elements) if p.addition == i]
        if addition.correlation and len(own) > 1:
            k, j = own[:2]
            result[k, j] = result[j, k] = addition.correlation * np.sign(mu[k]) * np.sqrt(result[k, k] * result[j, j])
    return result


def inner_places(model: Model) -> dict[str, tuple[int, ...]]:
    """Path in the kernel's network of every place of the network as given; the port is the outermost."""
    inner, grown = _with_labels(model.network), model.kernel.network
    paths = {p.name: _find(grown, _inner_name(inner, p)).path for p in model.network.places()}
    return {**paths, "port": ()}


def _with_labels(network: Network) -> Network:
    """The network with a label on every group, by which places are found again after branches were inserted."""
    for k, place in enumerate(network.places()):
        node = network.at(place)
        if not isinstance(node, Element) and node.label is None:
            network = network.replaced(place, node.labelled(f"{TEMPORARY_LABEL}{k}"))
    return network


def _inner_name(inner: Network, place: Place) -> str:
    node = inner.at(place)
    return node.label or node._notation()


def _find(network: Network, name: str) -> Place:
    """Place of the group with a label, or of an element."""
    for path, node in network.walk():
        if name in (node.label, node._notation()):
            return Place(path, name)
    raise KeyError(name)


def _without_labels(network: Network) -> Network:
    """The network without the temporary labels."""
    kept = None if network.label is None or network.label.startswith(TEMPORARY_LABEL) else network.label
    if not network.parts:
        return network.labelled(kept)
    if isinstance(network, Wrapped):
        return replace(network, part=_without_labels(network.part)).labelled(kept)
    parts = [_without_labels(part) for part in network.parts]
    join = operator.or_ if isinstance(network, Parallel) else operator.sub
    joined: Network = reduce(join, parts)
    return joined if kept is None else joined.labelled(kept)


def _renamed(branch: Network, network: Network) -> tuple[Network, dict[str, str]]:
    """The branch with its parameters renamed to names that are free in a network, and the new names by the old."""
    taken, names = {*network.elements, *(p.name for p in branch.parameters)}, dict[str, str]()
    for old in branch.elements:
        number = next(k for k in count(1) if f"{old[0]}{k}" not in taken)
        names[old] = f"{old[0]}{number}"
        taken.add(names[old])
    word = re.compile("|".join(rf"\b{old}\b" for old in names))
    return parse(word.sub(lambda found: names[found[0]], str(branch))), names
