r"""What an effect is: one thing that a network or a rig may have left out.

Every effect acts at one place, on the impedance z of what stands there. Most are an
:mod:`operation <bayes_impedance.network.operations>`; any other can be given as a **branch** of further elements that
is put beside the place (impedances add) or in series with it (mobilities add). To first order in its coefficient x the
impedance of the place changes by x d(s), the effect's *direction*:

.. math:: \text{operation: } d = \partial T/\partial x, \quad \text{beside: } d = z_B, \quad
          \text{in series: } d = -z^2/z_B,

and the impedance at the port by :math:`x\,d\,\partial z_\text{port}/\partial z`. (A branch of several elements is
scaled as a whole.) What the direction depends on nonlinearly are **shapes**, which are scanned over a grid; the price
of looking at many is paid in the p-value.

A new effect is registered in a few lines::

    register(Effect(
        id="body.nail", name="nail", side="body", pooling="varying", branch="m-(n|r)", connection="beside",
        places=("port",), formula="z + 1/(1/(s m) + 1/(r + 1/(s n)))",
        story="The nail rides on its bed. It moves along at low and stays behind at high frequencies.",
        look_for="a bump at the resonance", separates="a recording with the nail clamped", source="ours"))
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from bayes_impedance.errors import InputError
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import Element, Network, Parallel, Place, Series, parse
from bayes_impedance.network.operations import N_PARAMETERS, NAMES, PLACES, TRAITS, Setting, Traits
from bayes_impedance.network.transform import transform_many

SIDES, POOLINGS, CONNECTIONS = ("rig", "body"), ("shared", "varying", "some"), ("beside", "series")
_BRANCH_FREQUENCIES = 5
_DAMPER_LEVELS = (0.1, 0.5)


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Typical sizes in a dataset: they make coefficients dimensionless.

    Attributes
    ----------
    low, middle, high : float
        Angular frequencies of the band in rad/s; the middle one is the geometric mean.
    z_low, z_middle, z_high : float
        Magnitude of the population's curve there.
    unit : str
        Of the impedance.
    """

    low: float
    middle: float
    high: float
    z_low: float
    z_middle: float
    z_high: float
    unit: str


@dataclass(frozen=True)
class Coefficient:
    """One parameter of an operation.

    Attributes
    ----------
    name : str
        As in ``verdict.json``.
    unit : str
        ``s``, ``Hz`` (the operation takes rad/s) or nothing; ``m``, ``n``, ``r``, ``k``, ``c`` stand for the unit of a
        mass, a compliance, a damper, a stiffness and a power law in the dataset's unit.
    link : str
        ``linear`` (x = scale u), ``log`` (positive: exp u) or ``logit`` (between 0 and 1).
    grid : tuple of float, or float
        Values of a shape that are scanned, or how many per decade of the band.
    prior_sd : float
        Of a shape's u, around the place in the grid where the score is highest.
    """

    name: str
    unit: str
    link: str = "linear"
    grid: tuple[float, ...] | float = ()
    prior_sd: float = 1.0

    def value(self, u: npt.ArrayLike, scales: Scales) -> np.ndarray:
        """Value in the unit of the operation from the unbounded parameter."""
        u = np.asarray(u, dtype=float)
        match self.link:
            case "log":
                return np.asarray(np.exp(u))
            case "logit":
                return np.asarray(1 / (1 + np.exp(-u)))
        return self.scale(scales) * u

    def unbounded(self, value: float, scales: Scales) -> float:
        """Inverse of :meth:`value`."""
        match self.link:
            case "log":
                return float(np.log(value))
            case "logit":
                return float(np.log(value / (1 - value)))
        return value / self.scale(scales)

    def scale(self, scales: Scales) -> float:
        """Value of a linear coefficient that changes the impedance by about as much as there is, where it acts most."""
        s = scales
        return {
            "m": s.z_high / s.high,
            "r": s.z_middle,
            "c": s.z_middle,
            "k": s.z_low * s.low,
            "n": 1 / (s.z_high * s.high),
            "s": 1 / s.high,
            "Hz": s.low,
        }.get(self.unit, 1.0)

    def values(self, scales: Scales) -> tuple[float, ...]:
        """The shape's values that are scanned, in the unit of the operation."""
        if isinstance(self.grid, tuple):
            return tuple(2 * np.pi * g for g in self.grid) if self.unit == "Hz" else self.grid
        n = max(4, round(self.grid * np.log10(scales.high / scales.low)) + 1)
        omega = np.geomspace(scales.low, scales.high, n)
        return tuple((1 / omega if self.unit == "s" else omega).tolist())


@dataclass(frozen=True)
class Effect:
    """An entry of the catalogue.

    Attributes
    ----------
    id, name : str
        Stable name for programs, and what a person calls it.
    side : str
        ``rig`` or ``body``.
    pooling : str
        ``shared`` (the same for everybody), ``varying`` or ``some`` (only some people have it).
    places : tuple of str
        Where it may sit: of :data:`PLACES`.
    formula, story, look_for, separates, source : str
        Formula; two sentences for a person; the signature to look for; the measurement that tells it from its usual
        aliases; where it comes from.
    operation : str
        Name of the operation; empty for a branch.
    coefficients : tuple of Coefficient
        Of an operation: the coefficient first, then what else it has.
    branch, connection : str
        Notation of a one-port put ``beside`` the place or in ``series`` with it.
    signed : bool
        Whether the coefficient may be negative.
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

    def __post_init__(self) -> None:
        if self.side not in SIDES or self.pooling not in POOLINGS or self.connection not in CONNECTIONS:
            raise InputError(
                f"effect '{self.id}': side is one of {SIDES}, pooling of {POOLINGS}, connection of {CONNECTIONS}"
            )
        if not set(self.places) <= set(PLACES):
            raise InputError(f"effect '{self.id}': places are {PLACES}, not {self.places}")
        if not self.branch and not self.operation:
            raise InputError(f"effect '{self.id}': give an operation or a branch")
        if self.operation and (self.operation not in NAMES or not self.coefficients):
            raise InputError(f"effect '{self.id}': operation is one of {', '.join(NAMES)}, with its coefficients")
        if self.operation:
            links = tuple(c.link for c in self.coefficients)
            if links != self.traits.links:
                wanted = ", ".join(f"{p} ({k})" for p, k in zip(self.traits.parameters, self.traits.links, strict=True))
                raise InputError(
                    f"effect '{self.id}': the coefficients of '{self.operation}' are {wanted}, in this order"
                )
            if not set(self.places) <= set(self.traits.places):
                raise InputError(f"effect '{self.id}': '{self.operation}' acts on {', '.join(self.traits.places)} only")
        if self.branch:
            parse(self.branch)

    @property
    def traits(self) -> Traits:
        """What is known of its operation; an effect that is a branch has none."""
        return TRAITS[self.operation]

    @property
    def is_outermost(self) -> bool:
        """Whether it acts on the port after everything else: what the rig does, it does to the whole body."""
        return self.side == "rig"

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

    @property
    def form(self) -> str:
        """What distinguishes entries with one id: the operation, or how the branch is connected."""
        return self.operation or f"{self.connection} {self.branch}"

    def sites(self, network: Network) -> tuple[Place, ...]:
        """Places of a network at which the effect may sit, each electrically different from the others.

        Beside a part of a parallel group is beside the group, and in series with a part of a chain in series with all
        of it: of such places the first that is wanted stands for all.
        """
        wanted = set(self.places)
        found: dict[tuple[int, ...], Place] = {}
        for place in network.places():
            node = network.at(place)
            letter = kind_of(node.name).letter if isinstance(node, Element) else ""
            kinds = {"port"} if not place.path else {"elements", "springs", "dampers"} if letter else {"groups"}
            if letter:
                kinds -= {"springs"} if letter != "n" else {"dampers"}
                kinds -= {"dampers"} if letter != "r" else {"springs"}
            if kinds & wanted:
                found.setdefault(self._outermost(network, place.path), place)
        return tuple(found.values())

    def _outermost(self, network: Network, path: tuple[int, ...]) -> tuple[int, ...]:
        """The outermost place where the effect would do the same."""
        connection = self.traits.connection if self.operation else self.connection
        group = {"beside": Parallel, "series": Series}.get(connection)
        while path and group is not None and isinstance(network.at(Place(path[:-1], "")), group):
            path = path[:-1]
        return path


_CATALOGUE: dict[tuple[str, str], Effect] = {}


def register(effect: Effect) -> Effect:
    """Add an effect to the catalogue, or replace the one with the same id and form."""
    _CATALOGUE[effect.id, effect.form] = effect
    return effect


def unregister(effect: Effect) -> None:
    """Take an effect out of the catalogue."""
    _CATALOGUE.pop((effect.id, effect.form), None)


def registered() -> tuple[Effect, ...]:
    """All effects, in the order in which they were registered."""
    return tuple(_CATALOGUE.values())


def shape_grid(effect: Effect, scales: Scales) -> Iterator[dict[str, float]]:
    """Shapes of an effect that are scanned.

    Yields
    ------
    dict
        Names of the shapes with values in the operation's unit; of a branch, values of its elements, whose
        impedances meet at one frequency with magnitude one (dampers at a part of it, if there is a resonance).
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
    elements = parse(effect.branch).elements
    letters = {e[0] for e in elements}
    resonates = {"m", "n"} <= letters
    levels = _DAMPER_LEVELS if resonates and "r" in letters else (1.0,)
    n = max(4, round(_BRANCH_FREQUENCIES * np.log10(scales.high / scales.low))) if len(elements) > 1 else 1
    for omega in np.geomspace(scales.low, scales.high, n):
        for level in levels:
            yield {e: kind_of(e).value_at(level if e[0] == "r" else 1.0, float(omega) / (2 * np.pi)) for e in elements}


def direction(effect: Effect, shape: dict[str, float], scales: Scales, omega: np.ndarray, z: np.ndarray) -> np.ndarray:
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

    Returns
    -------
    ndarray, complex, shape (M, F)
        For an operation per unit of x, in its own unit.
    """
    if not effect.operation:
        branch = parse(effect.branch).impedance(1j * omega, shape)
        return np.broadcast_to(branch, z.shape) if effect.connection == "beside" else np.asarray(-(z**2) / branch)
    traits = effect.traits
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
