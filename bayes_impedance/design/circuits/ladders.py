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

Two are approximated to a stated accuracy by ladders of positive elements, which are passive by construction.

**Power law** :math:`c\,s^{-\beta}`, :math:`0 < \beta < 1` (``beside_power``, and ``power`` of a spring). From

.. math:: s^{-\beta} = \frac{\sin \pi\beta}{\pi} \int_{-\infty}^{\infty} \frac{e^{(1 - \beta) t}}{s + e^t}\, dt

by the trapezoidal rule with step h: each term :math:`k_i/(s + x_i)` is a compliance :math:`1/k_i` in series with a
damper :math:`k_i/x_i`. On the imaginary axis the integrand is analytic within :math:`\pi/2` of the real line, so the
error of the rule falls as :math:`e^{-\pi^2/h}`; terms far below the band are one spring, those far above one damper,
whose sums are geometric series.

**Layer** (``line``) of mass M, :math:`z \sqrt w \coth \sqrt w` with :math:`w = sM/z`. The expansion :math:`x \coth x
= 1 + 2\sum_k x^2/(x^2 + k^2\pi^2)` is a network: beside z, for each k, a mass :math:`2M/(k^2\pi^2)` in series with a
copy of z with twice the impedance. The rest of the sum is one mass.

Filters of a measurement channel (``highpass``, ``lowpass``) cannot be realised by elements;
:mod:`bayes_impedance.design.circuits.spice` writes them as sources. A delay, a reflex, rate-independent loss and drift
are not rational functions of s and are refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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


@dataclass(frozen=True)
class Built:
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
                raise InputError("filters can be written only at the port, after everything else that happens there")
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
            f"the operation '{operation.name}' is no network of elements: it can be neither realised nor approximated "
            "by a passive one"
        )
    place = Place(operation.path, "")
    x = coefficient(operation, parameters)
    more = [parameters[name] for name in operation.parameters[1:]]
    names = _Names(network)
    there = network.at(place)
    match operation.name:
        case "add":
            kind = {1.0: "m", 0.0: "r", -1.0: "n"}[operation.constants[1]]
            new, own = names.element(kind, 1 / x if kind == "n" else x)
            return network.beside(place, new), values | own
        case "relaxation":
            damper, spring = names.element("r", x), names.element("n", float(np.exp(more[0])) / x)
            return network.beside(place, damper[0] - spring[0]), values | damper[1] | spring[1]
        case "resonator":
            p, d = np.exp(more)
            mass = names.element("m", x)
            spring, damper = names.element("n", float(1 / (x * p * p))), names.element("r", float(2 * d * p * x))
            return network.beside(place, mass[0] - (spring[0] | damper[0])), values | mass[1] | spring[1] | damper[1]
        case "bypass":
            damper, spring = names.element("r", x), names.element("n", 1 / (operation.constants[1] * more[0]))
            return network.beside(place, damper[0] | spring[0]), values | damper[1] | spring[1]
        case "series_compliance":
            new, own = names.element("n", x)
            return network.in_series(place, new), values | own
        case "series_layer":
            spring, damper = names.element("n", x), names.element("r", float(np.exp(more[0])) / x)
            return network.in_series(place, spring[0] | damper[0]), values | spring[1] | damper[1]
        case "line":
            branch, own = _layer(there, values, x, names)
            return network.beside(place, branch), values | own
        case "beside_power":
            beta = 1 - 1 / (1 + np.exp(-more[0]))
            branch, own = _power_law(x * operation.constants[1] ** beta, float(beta), names, band_hz, accuracy)
            return network.beside(place, branch), values | own
    if not (isinstance(there, Element) and there.name[0] == "n"):
        raise InputError("a power law in place of an element is built of springs only, at the place of a spring")
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
    return _power_law(strength, beta, _Names(None), band_hz, accuracy)


class _Names:
    """Creates elements with unused names."""

    def __init__(self, network: Network | None) -> None:
        self.used = set(network.elements) if network is not None else set()

    def element(self, letter: str, value: float) -> tuple[Element, dict[str, float]]:
        """A new element and its value."""
        number = 1 + max((int(n[1:]) for n in self.used if n[0] == letter and n[1:].isdigit()), default=0)
        name = f"{letter}{number}"
        self.used.add(name)
        return Element(name), {name: float(value)}


def _power_law(
    strength: float, beta: float, names: _Names, band_hz: tuple[float, float], accuracy: float
) -> tuple[Network, dict[str, float]]:
    if not (0 < beta < 1 and strength > 0):
        raise InputError(
            f"a power law with exponent {-beta:.4g} is no passive material: its exponent lies between -1 (spring) and "
            "0 (damper)"
        )
    low, high = 2 * np.pi * band_hz[0], 2 * np.pi * band_hz[1]
    # Half the error is allowed for the rule, a quarter for either end, where terms are lumped to first order.
    step = np.pi**2 / np.log(8 / accuracy)
    # To first order the error of the lumped terms is (x/w) relative to a sum that falls as (x/w)^(1-beta), or mirrored
    # above the band.
    below = np.log(8 / accuracy) / (2 - beta)
    above = np.log(8 / accuracy) / (1 + beta)
    first = int(np.floor((np.log(low) - below) / step))
    last = int(np.ceil((np.log(high) + above) / step))
    scale = strength * np.sin(np.pi * beta) / np.pi * step
    x = np.exp(step * np.arange(first, last + 1))
    k = scale * x ** (1 - beta)
    # Geometric sums of the terms outside the band: springs below (1 - beta > 0), dampers k/x above (-beta < 0).
    spring = scale * np.exp((1 - beta) * step * (first - 1)) / -np.expm1(-(1 - beta) * step)
    damper = scale * np.exp(-beta * step * (last + 1)) / -np.expm1(-beta * step)
    parts: list[Network] = []
    values: dict[str, float] = {}
    ends = [names.element("n", 1 / spring), names.element("r", damper)]
    for element, own in ends:
        parts.append(element)
        values |= own
    for x_i, k_i in zip(x, k, strict=True):
        n, r = names.element("n", 1 / k_i), names.element("r", k_i / x_i)
        parts.append(n[0] - r[0])
        values |= n[1] | r[1]
    return Parallel(tuple(parts)), values


def _layer(there: Network, values: Mapping[str, float], mass: float, names: _Names) -> tuple[Network, dict[str, float]]:
    """The network in parallel to z in a layer of the given mass."""
    if not mass > 0:
        raise InputError("a layer of negative mass is no network: it cannot be built")
    parts: list[Network] = []
    found: dict[str, float] = {}
    rest = 1 / 3
    for k in range(1, _LINE_TERMS + 1):
        share = 2 / (k * np.pi) ** 2
        element, own = names.element("m", mass * share)
        copy, copied = _copy(there, values, 2.0, names)
        parts.append(element - copy)
        found |= own | copied
        rest -= share
    element, own = names.element("m", mass * rest)
    return Parallel((*parts, element)), found | own


def _copy(
    network: Network, values: Mapping[str, float], factor: float, names: _Names
) -> tuple[Network, dict[str, float]]:
    """Copy of a network with new names and its impedance multiplied by a factor."""
    if isinstance(network, Element):
        value = values[network.name]
        return names.element(network.name[0], value / factor if network.name[0] == "n" else value * factor)
    pairs = [_copy(part, values, factor, names) for part in network.parts]
    kind = Parallel if isinstance(network, Parallel) else Series
    flat: list[Network] = []
    for part, _ in pairs:
        flat.extend(part.parts if isinstance(part, kind) else (part,))
    return kind(tuple(flat)), {name: value for _, own in pairs for name, value in own.items()}
