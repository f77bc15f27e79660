r"""What a network may hold besides masses, springs and dampers.

**A power law** ``p1^a1`` is an element of its own (springpot, constant-phase element),

.. math:: z = p \left(\frac{s}{\omega_0}\right)^{a-1},

with p its impedance's size at the reference frequency. With an exponent a between 0 and 1 it lies between spring and
damper, with ``p1^b1`` and b between 1 and 2 between damper and mass (a coil's semi-inductance). It is passive, as
:math:`|\arg z| = |a-1|\,\pi/2 \le \pi/2`.

**A wrapper** ``delay[d1](...)`` changes the impedance z of the network inside the parentheses:

=================================  ==================================================  ========================
written                            T(z)                                                passive if z is
=================================  ==================================================  ========================
``delay[d](z)``                    z exp(-s d)                                         no
``highpass[f](z)``                 z s/(s + 2 pi f); if f < 0 the inverse, with abs f  no
``lowpass[t](z)``                  z/(1 + s t); if t < 0 the inverse, with abs t       no
``gain[g](z)``                     g z                                                 yes
``hysteretic[e](z)``               z (1 + j e)                                         yes, of springs
``offset[m](z)``                   z + s m; with k: z + k/s; with r: z + r             yes, if above zero
``line_free[m](z)``                sqrt(y z) coth sqrt(y/z), y = s m                   yes
``line_fixed[m](z)``               sqrt(y z) tanh sqrt(y/z)                            yes
``line_matched[m](z)``             sqrt(y z)                                           yes
``reflex[k, d, f](z)``             z + k exp(-s d)/(s (1 + s/(2 pi f)))                no
``reflex[r, d, f](z)``             z + r exp(-s d)/(1 + s/(2 pi f))^2                  no
``squeeze_film[r, t](z)``          z + 3 r (w - sqrt(w) tanh sqrt(w))/w^2, w = s t     yes
=================================  ==================================================  ========================

**A line** is a layer in which y acts along the way and 1/z between the way and the ground: a mass m spread over
tissue whose impedance between its two sides is z (shear waves), or a resistance r with capacitors n, a line of
diffusion. Then ``line_free[r](n)`` is Warburg's open, ``line_fixed[r](n)`` his short, ``line_matched[r](n)`` his
infinite impedance. For slow motion ``line_free`` is z + y/3, as its far side does not move (v = 0, no current), and
``line_fixed`` is y, as no force acts on its far side (F = 0, no voltage). Without an end a line is the product of the
roots of y and z in the right half-plane, which is passive if they are.

Each formula stands here once in numpy, for any complex s: the definition that tests hold the compiled kernel
against (:mod:`bayes_impedance.network.transform`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayes_impedance.network.parameters import LOG, SIGNED

Formula = Callable[[np.ndarray, np.ndarray, Sequence[np.ndarray], Sequence[str]], np.ndarray]
"""T from s, z, the parameters' values in their units, and their letters."""

_POWER_OF_S = {"m": 1, "r": 0, "k": -1}


@dataclass(frozen=True, kw_only=True)
class Construct:
    """A wrapper.

    Attributes
    ----------
    word : str
    operation : str
        The compiled function, by its name in :mod:`bayes_impedance.network.operations`.
    letters : tuple of str
        For each parameter, the letters that it may have.
    signed : bool
        Whether the first parameter has a meaning below zero.
    passive : bool
        Whether the result is passive if what is wrapped is.
    formula : Formula
    text : str
        The formula as it is printed.
    story : str
        One sentence of explanation.
    source : str
        Where the formula is from.
    """

    word: str
    operation: str
    letters: tuple[str, ...]
    signed: bool = False
    passive: bool = False
    formula: Formula
    text: str
    story: str
    source: str

    def __reduce__(self) -> tuple[Callable[[str], Construct], tuple[str]]:
        """By its word: worker processes have the same table, and its functions cannot be sent to them."""
        return construct_of, (self.word,)

    def link(self, position: int, shared: bool) -> str:
        """Scale on which a parameter is estimated."""
        return SIGNED if self.signed and shared and position == 0 else LOG

    def constants(self, letters: Sequence[str], link: str, scale: float, factor: float) -> tuple[float, float, float]:
        """Constants of the operation, as :mod:`bayes_impedance.network.operations` defines them.

        Parameters
        ----------
        letters : sequence of str
            Of the parameters.
        link : str
            Of the first parameter.
        scale : float
            Of a signed parameter: its value in its unit at u = 1.
        factor : float
            What its value is multiplied by in the formula.
        """
        c0, c2 = (scale * factor, 0.0) if link == SIGNED else (1.0, 1.0)
        power = float(_POWER_OF_S.get(letters[0], 0))
        return c0, (power - 1.0 if self.operation.startswith("line") else power), c2


def _filtered(low: bool) -> Formula:
    def of(s: np.ndarray, z: np.ndarray, x: Sequence[np.ndarray], _: Sequence[str]) -> np.ndarray:
        positive = np.real(x[0]) >= 0
        size = np.where(positive, 1, -1) * (x[0] if low else 2 * np.pi * x[0])  # abs, but analytic in x on either side
        factor = 1 / (1 + s * size) if low else s / (s + size)
        return np.asarray(np.where(positive, z * factor, z / factor))

    return of


def _line(end: Callable[[np.ndarray], np.ndarray]) -> Formula:
    def of(s: np.ndarray, z: np.ndarray, x: Sequence[np.ndarray], letters: Sequence[str]) -> np.ndarray:
        root = np.sqrt(x[0] * s ** _POWER_OF_S[letters[0]] / z + 0j)  # of either sign: root * end(root) is even
        return np.asarray(z * root * end(root))

    return of


def _matched_line(s: np.ndarray, z: np.ndarray, x: Sequence[np.ndarray], letters: Sequence[str]) -> np.ndarray:
    # Of sqrt(y z) the root that is passive: y/z may be negative, where the sign of its root is a matter of rounding.
    return np.asarray(np.sqrt(x[0] * s ** _POWER_OF_S[letters[0]] + 0j) * np.sqrt(z + 0j))


def _reflex(s: np.ndarray, z: np.ndarray, x: Sequence[np.ndarray], letters: Sequence[str]) -> np.ndarray:
    lag = 1 + s / (2 * np.pi * x[2])
    return np.asarray(z + x[0] * np.exp(-s * x[1]) / (lag * (s if letters[0] == "k" else lag)))


def _squeeze_film(s: np.ndarray, z: np.ndarray, x: Sequence[np.ndarray], _: Sequence[str]) -> np.ndarray:
    w = s * x[1]
    root = np.sqrt(w + 0j)
    # The fraction 3/(w + 3 + w/(5 + w/(7 + ...))) is the same, and does not cancel where w is small.
    below = np.full_like(root, 2 * _FRACTION + 3)
    for odd in range(2 * _FRACTION + 1, 1, -2):
        below = odd + w / below
    with np.errstate(all="ignore"):
        film = np.where(np.abs(w) < 1, 3 / (w + below), 3 * (w - root * np.tanh(root)) / w**2)
    return np.asarray(z + x[0] * film)


_LINES = "Cremer, Heckl and Ungar 1973; Warburg 1899; Barsoukov and Macdonald 2005"
"""Of lines with mass, of diffusion at an electrode, and of both ends of a line of diffusion."""

_FRACTION = 12
"""Terms of the continued fraction of a squeeze film: the next one is below 1e-20 of it for abs(w) < 1."""


CONSTRUCTS: dict[str, Construct] = {
    c.word: c
    for c in (
        Construct(
            word="delay",
            operation="delay",
            letters=("d",),
            signed=True,
            formula=lambda s, z, x, _: z * np.exp(-s * x[0]),
            text="z exp(-s d)",
            story="One channel is delayed with respect to the other.",
            source="Oppenheim and Willsky 1997",
        ),
        Construct(
            word="highpass",
            operation="highpass",
            letters=("f",),
            signed=True,
            formula=_filtered(low=False),
            text="z s/(s + 2 pi f)",
            story="The force channel loses low frequencies that the motion channel keeps; f < 0: the reverse.",
            source="Horowitz and Hill 2015",
        ),
        Construct(
            word="lowpass",
            operation="lowpass",
            letters=("t",),
            signed=True,
            formula=_filtered(low=True),
            text="z/(1 + s t)",
            story="The force channel loses high frequencies that the motion channel keeps; t < 0: the reverse.",
            source="Horowitz and Hill 2015",
        ),
        Construct(
            word="gain",
            operation="gain",
            letters=("g",),
            passive=True,
            formula=lambda _s, z, x, _: z * x[0],
            text="g z",
            story="A wrong sensitivity (calibration factor). The elements can absorb it, so hold it at a known value.",
            source="ISO 7626-1:2011",
        ),
        Construct(
            word="hysteretic",
            operation="hysteresis",
            letters=("e",),
            passive=True,
            formula=lambda _s, z, x, _: z * (1 + 1j * x[0]),
            text="z (1 + j e)",
            story="A spring that loses the same share of its energy in each cycle, at every frequency.",
            source="Neumark 1962; Bishop 1955",
        ),
        Construct(
            word="offset",
            operation="add",
            letters=("mrk",),
            signed=True,
            passive=True,
            formula=lambda s, z, x, letters: z + x[0] * s ** _POWER_OF_S[letters[0]],
            text="z + s m, z + r or z + k/s",
            story="A mass, damper or stiffness that was subtracted incompletely, or, if negative, in excess.",
            source="Ewins 2000",
        ),
        Construct(
            word="line_free",
            operation="line",
            letters=("mr",),
            passive=True,
            formula=_line(lambda root: 1 / np.tanh(root)),
            text="sqrt(y z) coth sqrt(y/z)",
            story="A layer with distributed mass (or resistance); its far side does not move (in circuits: an open "
            "end). A layer whose far side is mechanically free is `line_fixed`.",
            source=_LINES,
        ),
        Construct(
            word="line_fixed",
            operation="line_fixed",
            letters=("mr",),
            passive=True,
            formula=_line(np.tanh),
            text="sqrt(y z) tanh sqrt(y/z)",
            story="The same layer; no force acts on its far side, which moves freely (in circuits: a short circuit). A "
            "layer whose far side is held is `line_free`.",
            source=_LINES,
        ),
        Construct(
            word="line_matched",
            operation="line_matched",
            letters=("mr",),
            passive=True,
            formula=_matched_line,
            text="sqrt(y z)",
            story="The same layer of infinite thickness: no reflection from the far side.",
            source=_LINES,
        ),
        Construct(
            word="reflex",
            operation="reflex",
            letters=("kr", "d", "f"),
            formula=_reflex,
            text="z + k exp(-s d)/(s (1 + s/(2 pi f))) or z + r exp(-s d)/(1 + s/(2 pi f))^2",
            story="A muscle that responds with a delay, to a stretch (a stiffness behind a low-pass filter) or to its "
            "velocity (behind one of second order).",
            source="Mirbagheri, Barbeau and Kearney 2000",
        ),
        Construct(
            word="squeeze_film",
            operation="squeeze_film",
            letters=("r", "t"),
            passive=True,
            formula=_squeeze_film,
            text="z + 3 r (w - sqrt(w) tanh sqrt(w))/w^2, w = s t",
            story="A film of a compressible fluid between two plates: a damper when slow, a spring when fast.",
            source="Griffin, Richardson and Yamanami 1966; Blech 1983",
        ),
    )
}
"""Every wrapper by its word."""


def construct_of(word: str) -> Construct:
    """The wrapper with this word."""
    return CONSTRUCTS[word]
