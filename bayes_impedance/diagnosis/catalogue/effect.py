r"""An effect: one piece of physics that the network or the description of the rig may lack.

Every effect acts at one place of the network, on the impedance z of that place. Most effects are an
:mod:`operation <bayes_impedance.network.operations>`; any other can be given as a **branch** of further elements that
is put beside the place (impedances add) or in series with it (mobilities add). To first order in its coefficient x the
impedance of the place changes by x d(s), the effect's *direction*:

.. math:: \text{operation: } d = \partial T/\partial x, \quad \text{beside: } d = z_B, \quad
          \text{in series: } d = -z^2/z_B,

and the impedance at the port by :math:`x\,d\,\partial z_\text{port}/\partial z`. (A branch of several elements is
scaled as a whole.) Parameters on which the direction depends nonlinearly are **shapes**. They are scanned over a grid;
the p-value is corrected for the number of candidates.

A new effect is registered in a few lines::

    register(Effect(
        id="body.nail", name="nail", side="body", pooling="varying", branch="m-(n|r)", connection="beside",
        places=("port",), formula="z + 1/(1/(s m) + 1/(r + 1/(s n)))",
        story="The nail moves with its bed at low frequencies and lags behind at high ones.",
        look_for="a bump at the resonance", separates="a recording with the nail clamped", source="ours"))
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient, Scales
from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import KINDS, kind_of
from bayes_impedance.network.extensions import RADIAN_PER_SECOND, PowerLaw
from bayes_impedance.network.notation import Element, Network, Parallel, Place, Series, parse
from bayes_impedance.network.operation_traits import PLACES, Setting, Traits
from bayes_impedance.network.operations import N_PARAMETERS, NAMES, TRAITS
from bayes_impedance.network.own_motion import saturating_share
from bayes_impedance.network.parameters import LOGIT, Parameter
from bayes_impedance.network.transform import transform_many
from bayes_impedance.population.natural_scales import LOSS_FACTOR, with_references
from bayes_impedance.runtime.user_table import choice_in, shown, text_in

SIDES, POOLINGS, CONNECTIONS = ("rig", "body"), ("shared", "varying", "some"), ("beside", "series")
_BRANCH_FREQUENCIES = 5
"""Frequencies per decade at which the elements of a branch meet: steps of a factor of 1.6. By choice: more would scan
narrower steps, and correct the p-value for more candidates."""

_DAMPER_LEVELS = (0.1, 0.5)
"""Impedance of a resonant branch's dampers relative to that of its mass at the resonance. By choice: one level of weak
and one of strong damping; each further level adds as many candidates again."""

_EXPONENTS = (0.2, 0.5, 0.8)
"""Exponents of a branch's power laws above their lower bound, at which it is scanned. By choice: three are at most 0.2
from any other."""

_PLACES_OF = {"m": "masses", "n": "springs", "r": "dampers"}
"""Kind of place that an element is."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Effect(Brief):
    """An entry of the catalogue.

    Attributes
    ----------
    id, name : str
        Stable identifier for programs, and the name shown to readers.
    side : str
        ``rig`` or ``body``.
    pooling : str
        ``shared`` (the same for all people), ``varying`` (differs between people) or ``some`` (only some have it).
    places : tuple of str
        Kinds of place where it may act, from :data:`PLACES`.
    formula, story, look_for, separates, source : str
        Formula; a description in two sentences; the signature to look for; the measurement that separates it from its
        usual aliases; the reference.
    operation : str
        Name of the operation; empty for a branch.
    coefficients : tuple of Coefficient
        For an operation: the linear coefficient first, then its other parameters.
    branch, connection : str
        Notation of a one-port put ``beside`` the place or in ``series`` with it: any network of the language, in which
        a power law without a reference frequency has the middle of the recordings' band.
    signed : bool
        Whether the coefficient may be negative.
    needs_repetitions : bool
        Whether only people who were recorded again can show it (:mod:`bayes_impedance.diagnosis.catalogue.offered`).
    refines : tuple of str
        Ids of simpler effects of which this is a richer law: it is tried in the place of one of them that leaves
        structure (:mod:`bayes_impedance.diagnosis.selection.richer_law`), and not otherwise. Empty for an effect that
        is always tried, as is one of which no simpler one is among the candidates.
    """

    id: str
    name: str
    side: str
    pooling: str
    places: tuple[str, ...]
    formula: str
    story: str
    look_for: str
    separates: str
    source: str
    operation: str = ""
    coefficients: tuple[Coefficient, ...] = ()
    branch: str = ""
    connection: str = "beside"
    signed: bool = False
    needs_repetitions: bool = False
    refines: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        what = f"effect '{text_in(self.id, 'the id of an effect')}'"
        if not self.id:
            raise InputError("an effect has no id; give it one, such as body.nail")
        for name in ("name", "formula", "story", "look_for", "separates", "source", "operation", "branch"):
            text_in(getattr(self, name), f"{what}: {name}")
        choice_in(self.side, f"{what}: side", SIDES)
        choice_in(self.pooling, f"{what}: pooling", POOLINGS)
        choice_in(self.connection, f"{what}: connection", CONNECTIONS)
        for name in ("signed", "needs_repetitions"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(f"{what}: {name} is {shown(getattr(self, name))}, but must be True or False")
        if not isinstance(self.places, tuple) or not self.places:
            raise InputError(f'{what}: places is {shown(self.places)}, but must be a tuple such as ("port",)')
        for place in self.places:
            choice_in(place, f"{what}: a place", PLACES)
        if not isinstance(self.refines, tuple):
            raise InputError(
                f'{what}: refines is {shown(self.refines)}, but must be a tuple of ids such as ("body.relaxation",)'
            )
        for simpler in self.refines:
            text_in(simpler, f"{what}: refines")
        if not self.branch and not self.operation:
            raise InputError(f"{what}: give an operation or a branch")
        if not isinstance(self.coefficients, tuple) or not all(isinstance(c, Coefficient) for c in self.coefficients):
            raise InputError(f"{what}: coefficients must be a tuple of Coefficient, not {shown(self.coefficients)}")
        if self.operation:
            choice_in(self.operation, f"{what}: operation", NAMES)
            self._check_coefficients(what)
        elif self.coefficients:
            raise InputError(f"{what}: the coefficients of a branch are its elements; leave 'coefficients' out")
        if self.branch:
            self._check_branch(what)

    def _check_branch(self, what: str) -> None:
        """What is the same for everybody is said by the pooling; something must be left to estimate."""
        branch = parse(self.branch)
        same = [p.name for p in branch.parameters if p.shared]
        if same:
            raise InputError(
                f"{what}: its branch marks {same[0]}* as the same for everybody; leave the mark out, because the "
                "effect's pooling says that ('shared')"
            )
        if not branch.elements:
            raise InputError(f"{what}: its branch holds all its parameters; leave one without a value to be estimated")

    def _check_coefficients(self, what: str) -> None:
        """Check number, units and links of the coefficients against what the operation takes."""
        traits = self.traits
        if tuple(c.link for c in self.coefficients) != traits.links:
            wanted = ", ".join(f"{p} ({k})" for p, k in zip(traits.parameters, traits.links, strict=True))
            raise InputError(f"{what}: the coefficients of '{self.operation}' are {wanted}, in this order")
        names = [c.name for c in self.coefficients]
        if len(set(names)) < len(names):
            raise InputError(f"{what}: two coefficients have the same name; give each its own")
        for coefficient, parameter, units in zip(self.coefficients, traits.parameters, traits.units, strict=True):
            choice_in(coefficient.unit, f"{what}: unit of coefficient '{coefficient.name}' ({parameter})", units)
        for coefficient in self.coefficients[1:]:
            if traits.scanned is None and coefficient.grid == ():
                raise InputError(
                    f"{what}: coefficient '{coefficient.name}' has no grid, so that the effect would never be tried; "
                    "give a tuple of values, or the number of values per decade"
                )
        if not set(self.places) <= set(traits.places):
            raise InputError(f"{what}: '{self.operation}' acts on {', '.join(traits.places)} only")

    @property
    def traits(self) -> Traits:
        """Properties of its operation; only for an effect that is not a branch."""
        return TRAITS[self.operation]

    @property
    def is_outermost(self) -> bool:
        """Whether it acts on the port after all other effects: an effect of the rig acts on the whole body."""
        return self.side == "rig"

    @property
    def is_of_the_channel(self) -> bool:
        """Whether it changes the signal of all that the rig measures, its own masses, springs and dampers included."""
        return self.side == "rig" and bool(self.operation) and self.traits.connection == "replaces"

    @property
    def is_innermost(self) -> bool:
        """Whether it changes the element at its place before all other effects there."""
        return bool(self.operation) and self.traits.of_the_element

    @property
    def follows_motion(self) -> bool:
        """Whether it depends on how its place moves under the force at the port."""
        return bool(self.operation) and self.traits.follows_motion

    def setting(self, scales: Scales, compliance: float = float("nan")) -> Setting:
        """Units and typical sizes of an operation's parameters, with the compliance of the element at the place."""
        return Setting(
            units=tuple(c.unit for c in self.coefficients),
            scales=tuple(c.scale(scales) for c in self.coefficients),
            low=scales.low,
            middle=scales.middle,
            high=scales.high,
            compliance=compliance,
        )

    def network(self, scales: Scales) -> Network:
        """Its branch, with a reference frequency in the band for every power law."""
        return with_references(parse(self.branch), scales.middle / (2 * np.pi))

    @property
    def form(self) -> str:
        """What distinguishes entries with one id: operation and unit, or how the branch is connected."""
        return f"{self.operation} {self.coefficients[0].unit}" if self.operation else f"{self.connection} {self.branch}"

    def sites(self, network: Network) -> tuple[Place, ...]:
        """Places of a network at which the effect may act, no two of them electrically equivalent.

        Beside a part of a parallel group is equivalent to beside the group, and in series with a part of a chain to in
        series with the whole chain. Of equivalent places only the first admissible one is returned.
        """
        wanted = set(self.places)
        found: dict[tuple[int, ...], Place] = {}
        for place in network.places():
            node = network.at(place)
            letter = kind_of(node.name).letter if isinstance(node, Element) else ""
            kinds = {"port"} if not place.path else {"elements", _PLACES_OF[letter]} if letter else {"groups"}
            if kinds & wanted:
                found.setdefault(self._outermost(network, place.path), place)
        return tuple(found.values())

    def _outermost(self, network: Network, path: tuple[int, ...]) -> tuple[int, ...]:
        """Path of the outermost place where the effect is equivalent."""
        connection = self.traits.connection if self.operation else self.connection
        group = {"beside": Parallel, "series": Series}.get(connection)
        while path and group is not None and isinstance(network.at(Place(path[:-1], "")), group):
            path = path[:-1]
        return path


_CATALOGUE: dict[tuple[str, str], Effect] = {}


def register(effect: Effect) -> Effect:
    """Add an effect to the catalogue, or replace the one with the same id and form.

    Raises
    ------
    InputError
        If the argument is not an `Effect`. (The fields of an effect are checked when it is made.)
    """
    if not isinstance(effect, Effect):
        raise InputError(f"the argument of register is {shown(effect)}, but must be an Effect")
    _CATALOGUE[effect.id, effect.form] = effect
    return effect


def unregister(effect: Effect) -> None:
    """Remove an effect from the catalogue."""
    _CATALOGUE.pop((effect.id, effect.form), None)


def registered() -> tuple[Effect, ...]:
    """All effects, in the order in which they were registered."""
    return tuple(_CATALOGUE.values())


def shape_grid(effect: Effect, scales: Scales) -> Iterator[dict[str, float]]:
    """Grid of shapes at which an effect is scanned.

    Yields
    ------
    dict
        For an operation: names of the shapes, with values in its unit. For a branch: values of its elements, all with
        impedance of magnitude one at a common frequency (dampers with a fraction of it in a resonant branch).
    """
    if not effect.operation:
        yield from _branch_grid(effect, scales)
    elif effect.traits.scanned is not None:
        yield from effect.traits.scanned(scales.low, scales.high)
    else:
        shapes = effect.coefficients[1:]
        for values in product(*(c.values(scales) for c in shapes)):
            yield {c.name: v for c, v in zip(shapes, values, strict=True)}


def _branch_grid(effect: Effect, scales: Scales) -> Iterator[dict[str, float]]:
    network = effect.network(scales)
    parameters = [p for p in network.parameters if not p.held]
    laws = {node.size.name: node for _, node in network.walk() if isinstance(node, PowerLaw)}
    letters = {p.letter for p in parameters}
    levels = _DAMPER_LEVELS if {"m", "n", "r"} <= letters else (1.0,)
    exponents = [p.name for p in parameters if p.link == LOGIT]
    # With one size, and no time beside it, another frequency is another size only.
    several = len(parameters) - len(exponents) - ("e" in letters) > 1
    n = max(4, round(_BRANCH_FREQUENCIES * np.log10(scales.high / scales.low))) if several else 1
    for omega in np.geomspace(scales.low, scales.high, n):
        for level, *shares in product(levels, *(_EXPONENTS for _ in exponents)):
            given = dict(zip(exponents, shares, strict=True))
            given = {p.name: p.quantity.low + given[p.name] for p in parameters if p.name in given}
            yield {
                p.name: given[p.name] if p.name in given else _typical(p, float(omega), level, given, laws)
                for p in parameters
            }


def _typical(
    parameter: Parameter, omega: float, level: float, exponents: dict[str, float], laws: dict[str, PowerLaw]
) -> float:
    """Value of a branch's parameter that shows at omega: an element's impedance is one there, a damper's the level."""
    letter = parameter.letter
    if letter in KINDS:
        return kind_of(parameter.name).value_at(level if letter == "r" else 1.0, omega / (2 * np.pi))
    if letter == "p":
        law = laws[parameter.name]
        exponent = exponents[law.exponent.name] if law.exponent.value is None else law.exponent.value
        return float((omega / (2 * np.pi * (law.reference_hz or RADIAN_PER_SECOND))) ** (1 - exponent))
    return {"d": 1 / omega, "t": 1 / omega, "f": omega / (2 * np.pi), "k": omega, "e": LOSS_FACTOR, "g": 1.0}[letter]


def direction(
    effect: Effect,
    shape: dict[str, float],
    scales: Scales,
    omega: np.ndarray,
    z: np.ndarray,
    motion: np.ndarray | None = None,
) -> np.ndarray:
    """First-order change of a place's impedance per unit of the coefficient.

    Parameters
    ----------
    effect : Effect
    shape : dict
        From :func:`shape_grid`.
    scales : Scales
    omega : ndarray, shape (F,)
        In rad/s.
    z : ndarray, complex, shape (M, F)
        Impedance of the place.
    motion : ndarray, shape (M, F), optional
        How far it moves per unit of force, for effects that follow that.

    Returns
    -------
    ndarray, complex, shape (M, F)
        For an operation per unit of x, in its own unit.
    """
    if not effect.operation:
        branch = effect.network(scales).impedance(1j * omega, shape)
        return np.broadcast_to(branch, z.shape) if effect.connection == "beside" else np.asarray(-(z**2) / branch)
    traits = effect.traits
    if traits.follows_motion:
        assert motion is not None  # whoever scans the catalogue knows it
        return np.asarray(z * saturating_share(motion, shape[effect.coefficients[1].name]))
    if traits.direction is not None:
        return np.broadcast_to(traits.direction(shape, omega), z.shape)
    u = np.zeros((z.shape[0], N_PARAMETERS))
    constants = np.array([1.0, *operation_constants(effect, scales)])
    if traits.secant is not None:
        u[:, 0] = traits.secant(shape, omega, z)
        return np.asarray((transform_many(traits.code, u, constants, omega, z)[0] - z) / u[:, :1])
    for k, coefficient in enumerate(effect.coefficients[1:], 1):
        u[:, k] = coefficient.unbounded(shape[coefficient.name], scales)
    return np.asarray(transform_many(traits.code, u, constants, omega, np.ascontiguousarray(z))[2])


def operation_constants(effect: Effect, scales: Scales) -> tuple[float, float]:
    """The constants c1 and c2 of an effect's operation."""
    constants = effect.traits.constants if effect.operation else None
    return (0.0, 0.0) if constants is None else constants(effect.setting(scales))


@dataclass(frozen=True)
class Candidate:
    """An effect at a place with one choice of its shapes.

    Attributes
    ----------
    effect : Effect
    place : str
    shape : dict of str to float
    """

    effect: Effect
    place: str
    shape: dict[str, float]
