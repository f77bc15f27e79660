"""What the package needs to know about an operation besides its formula: the columns of the table of operations.

The table itself is :data:`bayes_impedance.network.operations.TRAITS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

PLACES = ("port", "groups", "springs", "dampers", "masses", "elements")
"""Kinds of place in a network; ``groups`` are groups of elements inside, without the port."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Units and typical sizes for which the constants of an operation are chosen.

    Attributes
    ----------
    units : tuple of str
        Of the operation's parameters: ``m``, ``n``, ``r``, ``k``, ``c``, ``l`` for the unit of a mass, a compliance, a
        damper, a stiffness, a power law and a semi-inductance; ``s``, ``Hz`` or nothing.
    scales : tuple of float
        Typical sizes of the parameters in the operation's unit.
    low, middle, high : float
        Angular frequencies of the band in rad/s.
    compliance : float or ndarray, shape (S,)
        Compliance of the element at the place; NaN if there is none, or it is not needed.
    """

    units: tuple[str, ...]
    scales: tuple[float, ...]
    low: float
    middle: float
    high: float
    compliance: float | np.ndarray = float("nan")


Derived = tuple[str, str, np.ndarray]
"""Name, unit (as in :class:`Setting`) and draws of a quantity that follows from the parameters."""


def _coefficient_not_negative(u: np.ndarray) -> bool:
    return not u[0] <= 0


def _as_written(values: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    return list(values.values())


@dataclass(frozen=True, kw_only=True)
class Traits:
    """Properties of an operation, except its formula.

    Attributes
    ----------
    code : int
        Number of the operation in the compiled functions; 0 is no operation.
    parameters : tuple of str
        Names of the parameters; the coefficient first. An effect may give them more specific names.
    units : tuple of tuple of str
        Units that each parameter may have, as in :class:`Setting`.
    links : tuple of str
        How each value in the operation's unit follows from the unbounded u: ``linear`` (x = scale u), ``log``
        (exp u) or ``logit`` (1/(1 + exp(-u))).
    connection : str
        ``beside`` if it adds an impedance to the place, ``series`` if it adds a mobility, ``replaces`` if it changes
        the place's impedance in another way.
    places : tuple of str
        Kinds of place at which the operation is meaningful: of :data:`PLACES`.
    one_port : bool
        Whether it describes tissue at one place: a passive one-port beside the place or replacing it.
    sums_to_any : bool
        Whether a sum of such terms can be any passive one-port (Foster, Prony).
    passive : bool
        Whether a passive place remains passive with every coefficient of allowed sign.
    written : str
        The changed place in the language of networks, with ``{z}`` for the place and ``{r}`` for a parameter with the
        letter r (``{own_p}`` if it belongs to what is at the place, and is everybody's own); nothing if no network
        computes the operation.
    written_shared : str
        The same where the coefficient is the same for everybody and may have either sign; nothing if it is written
        alike.
    of_the_element : bool
        Whether it changes the element itself that stands at the place, before anything else there.
    follows_motion : bool
        Whether its T also depends on how the place moves, and so on the whole network: its formula is in
        :mod:`bayes_impedance.network.own_motion`, and not among the others.
    read : function
        The operation's parameters, each of shape (S,), from values of those in `written`, by letter.
    built_as : str
        Realisation in a circuit: ``elements`` (exactly), ``ladder`` (of elements, to a stated accuracy), ``filter`` (of
        a measurement channel, as sources) or nothing if there is no circuit.
    constants : function or None
        The constants c1 and c2 in a :class:`Setting`; None if it has none.
    allows : function
        Whether the linear parameters' means over subjects, shape (L,), have signs allowed for an unsigned effect.
    reported : function or None
        The coefficient as it is reported, shape (S,), from draws of all parameters in the operation's unit; None if
        it is reported unchanged.
    derived : function or None
        Further reported quantities, from draws of all parameters.
    scanned : function or None
        Scanned shapes, from the ends of the band in rad/s; None if they are grids of the parameters.
    direction : function or None
        First-order change of a place's impedance per unit of the coefficient, for a scanned shape and angular
        frequencies, shape (F,); None if it is the operation's own derivative at zero.
    secant : function or None
        Coefficients, shape (M,), at which the direction is the secant from zero, for a scanned shape, angular
        frequencies (F,) and impedances (M, F); None for the tangent at zero.
    """

    code: int
    parameters: tuple[str, ...]
    units: tuple[tuple[str, ...], ...]
    links: tuple[str, ...] = ("linear",)
    connection: str = "replaces"
    places: tuple[str, ...] = PLACES
    one_port: bool = False
    sums_to_any: bool = False
    passive: bool = True
    built_as: str = ""
    written: str = ""
    written_shared: str = ""
    of_the_element: bool = False
    follows_motion: bool = False
    read: Callable[[Mapping[str, np.ndarray]], list[np.ndarray]] = _as_written
    constants: Callable[[Setting], tuple[float, float]] | None = None
    allows: Callable[[np.ndarray], bool] = _coefficient_not_negative
    reported: Callable[[Sequence[np.ndarray], Setting], np.ndarray] | None = None
    derived: Callable[[Sequence[np.ndarray], Setting], list[Derived]] | None = None
    scanned: Callable[[float, float], Iterable[dict[str, float]]] | None = None
    direction: Callable[[Mapping[str, float], np.ndarray], np.ndarray] | None = None
    secant: Callable[[Mapping[str, float], np.ndarray, np.ndarray], np.ndarray] | None = None
