r"""Operations of the catalogue as networks of elements; operations that elements cannot realise are refused.

An :class:`bayes_impedance.network.operations.Operation` changes the impedance z of a place. Some are realised exactly
by a few further elements ("beside" means connected in parallel):

==================  ==================================================================================================
add                 a mass, damper or spring beside the place (a negative one if the coefficient is negative)
relaxation          x/(1 + s t): a damper x in series with a compliance t/x, beside
resonator           a mass x in series with (compliance 1/(x p²) beside damper 2 d p x), beside
bypass              a damper beside a spring, beside
series_compliance   a compliance x, in series
series_layer        a compliance x beside a damper t/x, in series
==================  ==================================================================================================

Two are approximated to a stated accuracy by the ladders of :mod:`bayes_impedance.design.circuits.fractional`: power
laws (``beside_power``, and ``power`` of a spring), and a layer of mass (``line``).

Filters of a measurement channel (``highpass``, ``lowpass``) cannot be realised by elements;
:mod:`bayes_impedance.design.circuits.spice` writes them as sources. A delay, a reflex, rate-independent loss and drift
are not rational functions of s and are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.design.circuits.expressions import of
from bayes_impedance.design.circuits.fractional import Found, Names, Terms, line_ladder, power_ladder, together
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, Parallel, Place, Series
from bayes_impedance.network.operations import LOGARITHMIC, TRAITS, Operation
from bayes_impedance.network.program import parameter_names

FILTERS = tuple(name for name, traits in TRAITS.items() if traits.built_as == "filter")
"""Operations of a measurement channel: written as sources in a SPICE deck, not as elements."""

LADDERS = tuple(name for name, traits in TRAITS.items() if traits.built_as == "ladder")
"""Operations that elements approximate."""

_LINE_TERMS = 24
"""Terms of a line's series that are realised one by one. By choice: the rest of the sum is lumped into one mass, and
the remaining error at the port is reported with the circuit."""

_CHECKED = 301
"""Frequencies at which that error is computed. By choice: 100 per decade over the usual three decades."""


@dataclass(frozen=True, repr=False)
class Built(Brief):
    """A network of elements that replaces a network with operations.

    Attributes
    ----------
    network : Network
    values : dict of str to float
        Values of its elements in their units.
    filters : tuple of Operation
        Operations that elements cannot realise, with paths in the new network.
    error : float
        Largest relative error of the port's impedance in the band; zero if nothing is approximated.
    """

    network: Network
    values: dict[str, float]
    filters: tuple[Operation, ...]
    error: float


def built(
    network: Network,
    operations: Sequence[Operation],
    parameters: Mapping[str, float],
    band_hz: tuple[float, float] = (5.0, 5000.0),
    accuracy: float = 1e-4,
) -> Built:
    """Replace the operations by elements.

    Parameters
    ----------
    network : Network
    operations : sequence of Operation
        As for the kernel.
    parameters : mapping of str to float
        Natural logarithm of each element, and each parameter of the operations, as for the kernel.
    band_hz : (float, float)
        Where ladders must be accurate.
    accuracy : float
        Largest relative error of a power law's ladder in the band; the resulting error at the port is in the result.

    Raises
    ------
    InputError
        If an operation cannot be built, or a parameter is missing.
    """
    missing = [name for name in parameter_names(network, operations) if name not in parameters]
    if missing:
        raise InputError(f"parameter '{missing[0]}' has no value: give one for each element and operation")
    values = {e: float(np.exp(parameters[e])) for e in network.elements}
    whole, exact, filters = network, True, []
    # Later places first, and inner parts before the groups around them, so that the remaining paths stay valid.
    for path in sorted({operation.path for operation in operations}, reverse=True):
        here = [operation for operation in operations if operation.path == path]
        if any(o.name in FILTERS for o in here):
            if path or any(
                o.name not in FILTERS for o in here[min(i for i, o in enumerate(here) if o.name in FILTERS) :]
            ):
                raise InputError("filters can be written only at the port, outside all other operations there")
            filters = [o for o in here if o.name in FILTERS]
            here = [o for o in here if o.name not in FILTERS]
        for operation in here:
            network, values = _applied(network, values, operation, parameters, band_hz, accuracy)
            exact = exact and operation.name not in LADDERS
    values = {e: values[e] for e in network.elements}
    error = 0.0
    if not exact:
        kernel = Kernel(whole, [o for o in operations if o.name not in FILTERS])
        frequency = np.geomspace(*band_hz, _CHECKED)
        wanted = kernel.impedance([parameters[name] for name in kernel.elements], frequency)
        error = float(np.max(np.abs(network.impedance(2j * np.pi * frequency, values) / wanted - 1)))
    return Built(network, values, tuple(filters), error)


def coefficient(operation: Operation, parameters: Mapping[str, float]) -> float:
    """The coefficient x of an operation."""
    u = parameters[operation.parameters[0]]
    positive = len(operation.constants) > 2 and operation.constants[2] == LOGARITHMIC
    return float(np.exp(u)) if positive else operation.constants[0] * u


def _applied(
    network: Network,
    values: dict[str, float],
    operation: Operation,
    parameters: Mapping[str, float],
    band_hz: tuple[float, float],
    accuracy: float,
) -> tuple[Network, dict[str, float]]:
    if TRAITS[operation.name].built_as not in ("elements", "ladder"):
        raise InputError(
            f"the operation '{operation.name}' cannot be realised, nor approximated, by a passive network of elements"
        )
    place = Place(operation.path, "")
    x = coefficient(operation, parameters)
    more = [parameters[name] for name in operation.parameters[1:]]
    names = _Names(set(network.elements))
    there = network.at(place)
    match operation.name:
        case "add":
            kind = {1.0: "m", 0.0: "r", -1.0: "n"}[operation.constants[1]]
            new, own = names.numbered(kind, 1 / x if kind == "n" else x)
            return network.beside(place, new), values | own
        case "relaxation":
            damper, spring = names.numbered("r", x), names.numbered("n", float(np.exp(more[0])) / x)
            return network.beside(place, damper[0] - spring[0]), values | damper[1] | spring[1]
        case "resonator":
            p, d = np.exp(more)
            mass = names.numbered("m", x)
            spring, damper = names.numbered("n", float(1 / (x * p * p))), names.numbered("r", float(2 * d * p * x))
            return network.beside(place, mass[0] - (spring[0] | damper[0])), values | mass[1] | spring[1] | damper[1]
        case "bypass":
            damper, spring = names.numbered("r", x), names.numbered("n", 1 / (operation.constants[1] * more[0]))
            return network.beside(place, damper[0] | spring[0]), values | damper[1] | spring[1]
        case "series_compliance":
            new, own = names.numbered("n", x)
            return network.in_series(place, new), values | own
        case "series_layer":
            spring, damper = names.numbered("n", x), names.numbered("r", float(np.exp(more[0])) / x)
            return network.in_series(place, spring[0] | damper[0]), values | spring[1] | damper[1]
        case "line":
            branch, own = _layer(there, values, x, names)
            return network.beside(place, branch), values | own
        case "beside_power":
            beta = 1 - 1 / (1 + np.exp(-more[0]))
            branch, own = _power_law(x * operation.constants[1] ** beta, float(beta), names, band_hz, accuracy)
            return network.beside(place, branch), values | own
    if not (isinstance(there, Element) and there.name[0] == "n"):
        raise InputError("a power law can replace an element only at the place of a spring")
    strength = float(operation.constants[1] ** -x / values[there.name])  # z (s/c1)^x with z = 1/(s n)
    branch, own = _power_law(strength, 1 - x, names, band_hz, accuracy)
    return network.replaced(place, branch), values | own


def power_law(
    strength: float, beta: float, band_hz: tuple[float, float], accuracy: float = 1e-4
) -> tuple[Network, dict[str, float]]:
    """Passive ladder for z = strength s^(-beta).

    Parameters
    ----------
    strength : float
        In the impedance's unit times (rad/s)^beta.
    beta : float
        Between 0 (a damper) and 1 (a spring).
    band_hz : (float, float)
    accuracy : float
        Largest relative error in the band.

    Raises
    ------
    InputError
        If no passive ladder has this power law.
    """
    return _power_law(strength, beta, _Names(), band_hz, accuracy)


def _power_law(
    strength: float, beta: float, names: _Names, band_hz: tuple[float, float], accuracy: float
) -> tuple[Network, dict[str, float]]:
    network, found = power_ladder(of(strength), of(beta), names, band_hz, accuracy)
    return network, {name: float(x.value) for name, x in found.items()}


class _Names(Names):
    """Creates elements with unused names and plain values."""

    def numbered(self, letter: str, value: float) -> tuple[Element, dict[str, float]]:
        """A new element and its value."""
        element, _ = self.element(letter, of(value))
        assert isinstance(element, Element)  # of a letter
        return element, {element.name: float(value)}


def _layer(there: Network, values: Mapping[str, float], mass: float, names: _Names) -> tuple[Network, dict[str, float]]:
    """The network in parallel to z in a layer of the given mass."""
    if not mass > 0:
        raise InputError("a layer of negative mass cannot be built as a network")
    kappa = np.pi * np.arange(1, _LINE_TERMS + 1)
    terms = Terms(kappa, np.full(kappa.size, 2.0), 1.0, float(1 / 3 - np.sum(2 / kappa**2)))
    network, found = line_ladder(
        terms,
        lambda c: names.element("m", of(c * mass)),
        lambda c: _copy(there, values, c, names),
        whole=False,
    )
    return network, {name: float(x.value) for name, x in found.items()}


def _copy(network: Network, values: Mapping[str, float], factor: float, names: _Names) -> Found:
    """Copy of a network with new names and its impedance multiplied by a factor."""
    if isinstance(network, Element):
        value = values[network.name]
        return names.element(network.name[0], of(value / factor if network.name[0] == "n" else value * factor))
    pairs = [_copy(part, values, factor, names) for part in network.parts]
    return together(Parallel if isinstance(network, Parallel) else Series, *pairs)
