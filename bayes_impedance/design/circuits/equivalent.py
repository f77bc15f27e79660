r"""Users as networks of masses, compliances and dampers, which every circuit, state space and loop is made of.

Such a network has a transfer function that is a ratio of polynomials. What else a network may hold is replaced:

==================  ==================================================================================================
``gain``            exact: all elements of its part are scaled
``offset``          exact: an element beside its part
power law           a ladder (:mod:`bayes_impedance.design.circuits.fractional`)
``line_*``          a ladder of copies of its part
``hysteretic``      the power of s with the same phase, :math:`z (1 + j e) \approx z \sqrt{1 + e^2} (s/\omega_0)^a` with
                    :math:`\tan(a \pi/2) = e` and :math:`\omega_0` in the middle of the band: springs become power laws.
                    Their size is right at :math:`\omega_0` only: no causal material has the same stiffness *and* the
                    same loss at all frequencies, and the error that is stated says how much that matters in the band
==================  ==================================================================================================

A delay, a reflex, and filters that differ between people are not made of passive elements; they are refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.design.circuits import expressions
from bayes_impedance.design.circuits.expressions import Expression, of, parameter_name
from bayes_impedance.design.circuits.fractional import (
    Found,
    Names,
    Terms,
    film_rest,
    film_terms,
    line_ladder,
    line_terms,
    power_ladder,
    together,
)
from bayes_impedance.design.circuits.state_space import Realisation, realise
from bayes_impedance.design.users import Users
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.extensions import RADIAN_PER_SECOND
from bayes_impedance.network.notation import Element, Network, Parallel, PowerLaw, Series, Wrapped
from bayes_impedance.network.parameters import Symbol
from bayes_impedance.units import ELECTRICAL_UNIT

ACCURACY = 1e-3
"""Relative error in the band that ladders in files aim at. By choice: a tenth of what recordings are accurate to."""
LOOP_ACCURACY = 1e-2
"""The same in stability analyses. By choice: a pole costs time in the third power, and limits of populations are known
to some per cent."""

_CHECKED = 61
"""Frequencies at which the error is computed. By choice: twenty per decade of the usual three."""
_MOST, _MOST_IN_LOOP = 400, 100
"""Most elements of an equivalent network, and of one in a loop. By choice: one user's circuit still fits on a page of
text; a stability analysis of a thousand users, with some fifty poles each, takes minutes."""
_WORST = 0.1
_WORDS = {
    False: ("masses, compliances and dampers", "user", "body"),
    True: ("inductances, capacitances and resistances", "virtual subject", "cell"),
}
"""What ladders are made of, whose they are and what they represent, by whether the impedance is electrical."""
"""Largest error of ladders that are meant to be accurate. It is missed by lines whose material has hardly a loss and no
end: no finite network swallows waves without losing any."""


class NotRealisableError(InputError):
    """The network is not made of passive elements, and no network of passive elements is near to it."""


@dataclass(frozen=True, repr=False)
class Equivalent(Brief):
    """Users of a network of masses, compliances and dampers.

    Attributes
    ----------
    users : Users
    error : float
        Largest relative error of any user's impedance in the band; zero if the network is the same or exact.
    replaced : tuple of str
        What is approximated, in the notation of networks.
    texts : mapping of str to str
        Each element as an expression of the parameters of the original network.
    """

    users: Users
    error: float
    replaced: tuple[str, ...]
    texts: dict[str, str]

    @property
    def note(self) -> str:
        """What is approximated and how well, as a sentence; empty if nothing is."""
        if not self.replaced:
            return ""
        low, high = self.users.band_hz or (0.0, 0.0)
        kinds, user, represented = _WORDS[self.users.unit == ELECTRICAL_UNIT]
        return (
            f"{', '.join(self.replaced)} {'is' if len(self.replaced) == 1 else 'are'} approximated by ladders of "
            f"{kinds}, within {_percent(self.error)} of every {user}'s impedance from {low:g} to "
            f"{high:g} Hz; outside this band they do not represent the {represented}"
        )


def equivalent(users: Users, accuracy: float = ACCURACY) -> Equivalent:
    """Replace what is not a mass, compliance or damper, for all users alike.

    Parameters
    ----------
    users : Users
        With the band in which ladders must be accurate, if there are any.
    accuracy : float
        Relative error in the band that each ladder aims at; that of the whole is computed.

    Raises
    ------
    NotRealisableError
        If the network holds what is no network of passive elements.
    """
    if users.network.plain:
        return Equivalent(users, 0.0, (), {name: name for name in users.elements})
    builder = _Builder(users, accuracy)
    network, found = builder.build(users.network, _WHOLE)
    if len(network.elements) > _MOST:
        if accuracy < LOOP_ACCURACY:
            return equivalent(users, LOOP_ACCURACY)
        raise NotRealisableError(
            f"{users.network} has no finite state space, and ladders that approximate it need "
            f"{len(network.elements)} elements, more than {_MOST}"
        )
    order = network.elements
    u = np.stack([np.broadcast_to(np.log(found[name].value), len(users)) for name in order], axis=-1)
    plain = Users(network, users.unit, users.names, u, users.band_hz)
    error = 0.0
    if builder.replaced:
        frequency = np.geomspace(*builder.band, _CHECKED)
        error = float(np.max(np.abs(plain.impedance(frequency) / users.impedance(frequency) - 1)))
        if error > _WORST and not builder.lossy:
            raise NotRealisableError(
                f"{', '.join(builder.replaced)} has no finite state space, and the best ladder deviates by "
                f"{_percent(error)} from some user's impedance"
            )
    return Equivalent(plain, error, tuple(builder.replaced), {name: found[name].text for name in order})


def in_loop(users: Users) -> Equivalent:
    """The same with fewer elements, for a stability analysis.

    Raises
    ------
    NotRealisableError
        If it takes too many elements.
    """
    made = equivalent(users, LOOP_ACCURACY)
    if made.replaced and len(made.users.elements) > _MOST_IN_LOOP:
        raise NotRealisableError(
            f"ladders that approximate {users.network} need {len(made.users.elements)} elements, more than the "
            f"{_MOST_IN_LOOP} that a stability analysis allows"
        )
    return made


def realised(users: Users) -> Realisation:
    """Impedance of users in a loop in state space, exact or within the ladders' accuracy."""
    plain = in_loop(users).users
    return realise(plain.network, plain.values)


def why_not(network: Network) -> str:
    """What of a network is not made of passive elements, as a clause; empty if it is."""
    words = [_head(node) for _, node in network.walk() if isinstance(node, Wrapped) and node.construct.word in _REFUSED]
    return f"{', '.join(words)} {'has' if len(words) == 1 else 'have'} no finite state space" if words else ""


_REFUSED = ("delay", "reflex", "highpass", "lowpass")
"""Wrappers that no passive network replaces."""


@dataclass(frozen=True)
class _Scale:
    """What a part's impedance is multiplied by: a factor, and a power of s (rad/s) if there is one."""

    factor: Expression
    power: Expression | None


_WHOLE = _Scale(of(1.0), None)
"""As it is."""


class _Builder:
    def __init__(self, users: Users, accuracy: float) -> None:
        self.accuracy, self.names, self.values = accuracy, Names(set(users.elements)), users.values
        self.replaced: list[str] = []
        self.lossy = any(isinstance(n, Wrapped) and n.construct.word == "hysteretic" for _, n in users.network.walk())
        self._band = users.band_hz

    @property
    def band(self) -> tuple[float, float]:
        if self._band is None:
            raise InputError("power laws and lines are replaced by ladders in a band: give the users one, band_hz")
        return self._band

    def build(self, node: Network, scale: _Scale) -> Found:
        """A copy of a part with its impedance multiplied; what is not multiplied keeps its name."""
        if isinstance(node, Element):
            return self._element(node, scale)
        if isinstance(node, PowerLaw):
            return self._power_law(node, scale)
        if isinstance(node, Wrapped):
            return self._wrapped(node, scale)
        return together(
            Parallel if isinstance(node, Parallel) else Series, *(self.build(part, scale) for part in node.parts)
        )

    def _value(self, symbol: Symbol) -> Expression:
        if symbol.value is not None:
            return of(symbol.value)
        return Expression(self.values[symbol.name], parameter_name(symbol.name))

    def _element(self, node: Element, scale: _Scale) -> Found:
        value = self._value(node.symbol)
        if scale == _WHOLE:
            return Element(node.name), {node.name: value}
        return self._new(node.name[0], value, scale)

    def _power_law(self, node: PowerLaw, scale: _Scale) -> Found:
        self._note(node._notation())
        omega = 2 * np.pi * (node.reference_hz or RADIAN_PER_SECOND)
        power = self._value(node.exponent) - 1
        strength = scale.factor * self._value(node.size) * expressions.exp(power * float(-np.log(omega)))
        return self._power(strength, power if scale.power is None else power + scale.power)

    def _power(self, strength: Expression, power: Expression) -> Found:
        """The ladder of strength s^power."""
        if np.all(power.value < 0):
            return power_ladder(strength, 0 - power, self.names, self.band, self.accuracy)
        if np.all(power.value > 0):
            return power_ladder(strength, power, self.names, self.band, self.accuracy, rising=True)
        raise NotRealisableError("the power laws of some users rise and those of others fall with frequency")

    def _wrapped(self, node: Wrapped, scale: _Scale) -> Found:
        word, first = node.construct.word, self._value(node.symbols[0])
        letter = node.symbols[0].name[0]
        if word in _REFUSED:
            raise NotRealisableError(why_not(node))
        if word == "gain":
            return self.build(node.part, _Scale(scale.factor * first, scale.power))
        if word == "offset":
            beside = self._new("n" if letter == "k" else letter, 1 / first if letter == "k" else first, scale)
            return together(Parallel, self.build(node.part, scale), beside)
        self._note(_head(node))
        if word == "squeeze_film":
            time = self._value(node.symbols[1])
            pair = [self._squeezed(first * c, time * t, scale) for c, t in self._film_terms(time)]
            rest = self._new("r", first * film_rest(len(pair)), scale)
            return together(Parallel, self.build(node.part, scale), *pair, rest)
        if word == "hysteretic":
            power = expressions.arctan(first) * (2 / np.pi)
            middle = float(np.log(2 * np.pi) + np.mean(np.log(self.band)))
            factor = scale.factor * expressions.sqrt(1 + first * first) * expressions.exp(power * -middle)
            return self.build(node.part, _Scale(factor, power if scale.power is None else scale.power + power))
        terms = self._terms(node, letter, first)
        return line_ladder(
            terms,
            lambda c: self._new(letter, first, _Scale(scale.factor * c, scale.power)),
            lambda c: self.build(node.part, _Scale(scale.factor * c, scale.power)),
        )

    def _film_terms(self, time: Expression) -> list[tuple[float, float]]:
        return film_terms(2 * np.pi * self.band[1] * float(np.max(time.value)), self.accuracy)

    def _squeezed(self, damping: Expression, time: Expression, scale: _Scale) -> Found:
        """A damper in series with a spring."""
        return together(Series, self._new("r", damping, scale), self._new("n", time / damping, scale))

    def _new(self, letter: str, value: Expression, scale: _Scale) -> Found:
        """A new element, with its impedance multiplied."""
        if scale.power is None:
            return self.names.element(letter, value / scale.factor if letter == "n" else value * scale.factor)
        if letter == "m":
            raise NotRealisableError(
                "a loss factor applied to a mass is not passive, so that there is no finite state space"
            )
        if letter == "n":
            return self._power(scale.factor / value, scale.power - 1)
        return self._power(scale.factor * value, scale.power)

    def _terms(self, node: Wrapped, letter: str, along: Expression) -> Terms:
        s = 2j * np.pi * np.geomspace(*self.band, _CHECKED)
        z = node.part.impedance(s, {name: value[:, None] for name, value in self.values.items()})
        y = np.atleast_1d(along.value)[:, None] * (s if letter == "m" else 1.0)
        return line_terms(node.construct.word, np.atleast_2d(y / z), self.accuracy)

    def _note(self, text: str) -> None:
        if text not in self.replaced:
            self.replaced.append(text)


def _head(node: Wrapped) -> str:
    return f"{node.construct.word}[{', '.join(map(str, node.symbols))}](...)"


def _percent(error: float) -> str:
    return f"{100 * error:.2g} %"
