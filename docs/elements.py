"""Write elements.md, the page of everything that a network may hold, from the package's own tables.

``python docs/elements.py``; a test holds the page equal to what this prints.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayes_impedance.network.constructs import CONSTRUCTS, Construct
from bayes_impedance.network.electrical import CIRCUIT_ELEMENTS
from bayes_impedance.network.elements import KINDS
from bayes_impedance.network.extensions import POWER_LAW_SOURCES
from bayes_impedance.network.parameters import EXPONENTS, QUANTITIES
from bayes_impedance.units import unit_of

PAGE = Path(__file__).with_name("elements.md")

_FORMULAS = {"m": "s m", "n": "1/(s n)", "r": "r"}

_INTRODUCTION = """\
# What a network may hold

A network is built from elements with `|` (one velocity: impedances add) and `-` (one force: mobilities add), as in
`(n3|r3)-(m2|r1|n1)`. Here are all elements, and the wrappers that change the impedance of what is in their parentheses.
z = F/v is the impedance, s = jω. By the analogy of force with voltage the same formulas are those of circuits. Sources
are given in full at the end.

The first letter of a name says what it is; behind it may be any letters, digits and `_`. A parameter without a mark
is each person's own; `m9*` is the same for everybody; `m9=0.0115` is held at that value, in the unit below.

This page is written by `docs/elements.py` from the tables that the package computes with.
"""

_SIGNS = """\
On its scale a parameter is unbounded: that is what is normal over people, and what is sampled. What differs between
people is positive. `d`, `t`, `f` of a filter and the coefficient of `offset` may have either sign where they are the
same for everybody or held, as belongs to an error of the rig: a delay below zero means that the other channel is late.
"""

_PASSIVE = """\
**Passive** is what cannot give more energy than it was given, whatever the values: Re z ≥ 0 at every frequency, and for
growing motions, Re s > 0. (A loss factor is defined for steady vibrations only.) Of a wrapper it is said provided that
what it wraps is. `known_passive` of `bayes_impedance.network.passivity` says it for a whole network.
"""

_LINES = """\
In a line, y = s m or y = r acts along the way: the mass, or the resistance, is spread over tissue (or capacitors) whose
impedance from one side to the other is z. Roots are those in the right half-plane.
"""

_CIRCUITS = """\
A network may be written as circuits are in impedance.py, `R0-p(R1,CPE1)-Wo1`: there `-` is series and `p(a,b)` is
parallel, which is `|` and `a-b` here. `electrical` of `bayes_impedance.network.electrical` prints a network so, and
`values_from_circuit` and `values_to_circuit` convert values. A constant-phase element's size is that at 1 rad/s.
Passivity and source are those of what is written here.
"""

REFERENCES = {
    "Barsoukov and Macdonald 2005": "E. Barsoukov and J. R. Macdonald (eds.), Impedance Spectroscopy: Theory, "
    "Experiment, and Applications, 2nd ed., Wiley-Interscience, 2005",
    "Bishop 1955": "R. E. D. Bishop, The treatment of damping forces in vibration theory, Journal of the Royal "
    "Aeronautical Society 59, 738-742, 1955",
    "Blech 1983": "J. J. Blech, On isothermal squeeze films, Journal of Lubrication Technology 105, 615-620, 1983",
    "Cole and Cole 1941": "K. S. Cole and R. H. Cole, Dispersion and absorption in dielectrics I. Alternating current "
    "characteristics, Journal of Chemical Physics 9, 341-351, 1941",
    "Cremer, Heckl and Ungar 1973": "L. Cremer, M. Heckl and E. E. Ungar, Structure-Borne Sound, Springer, 1973",
    "Ewins 2000": "D. J. Ewins, Modal Testing: Theory, Practice and Application, 2nd ed., Research Studies Press, 2000 "
    "(mass cancellation)",
    "Griffin, Richardson and Yamanami 1966": "W. S. Griffin, H. H. Richardson and S. Yamanami, A study of fluid "
    "squeeze-film damping, Journal of Basic Engineering 88, 451-456, 1966",
    "Hixson 2002": "E. L. Hixson, Mechanical impedance, chapter 10 of C. M. Harris and A. G. Piersol (eds.), Harris' "
    "Shock and Vibration Handbook, 5th ed., McGraw-Hill, 2002",
    "Horowitz and Hill 2015": "P. Horowitz and W. Hill, The Art of Electronics, 3rd ed., Cambridge University Press, "
    "2015 (chapter 1: RC filters)",
    "ISO 7626-1:2011": "ISO 7626-1:2011, Mechanical vibration and shock. Experimental determination of mechanical "
    "mobility. Part 1: Basic terms and definitions, and transducer specifications (calibration)",
    "Koeller 1984": "R. C. Koeller, Applications of fractional calculus to the theory of viscoelasticity, Journal of "
    "Applied Mechanics 51, 299-307, 1984",
    "Mirbagheri, Barbeau and Kearney 2000": "M. M. Mirbagheri, H. Barbeau and R. E. Kearney, Intrinsic and reflex "
    "contributions to human ankle stiffness: variation with activation level and position, Experimental Brain Research "
    "135, 423-436, 2000",
    "Neumark 1962": "S. Neumark, Concept of complex stiffness applied to problems of oscillations with viscous and "
    "hysteretic damping, Aeronautical Research Council Reports and Memoranda 3269, 1962",
    "Olson 1943": "H. F. Olson, Dynamical Analogies, Van Nostrand, 1943",
    "Oppenheim and Willsky 1997": "A. V. Oppenheim and A. S. Willsky with S. H. Nawab, Signals and Systems, 2nd ed., "
    "Prentice Hall, 1997 (time shift of the Laplace transform)",
    "Scott Blair 1947": "G. W. Scott Blair, The role of psychophysics in rheology, Journal of Colloid Science 2, "
    "21-32, 1947",
    "Vanderkooy 1989": "J. Vanderkooy, A model of loudspeaker driver impedance incorporating eddy currents in the pole "
    "structure, Journal of the Audio Engineering Society 37, 119-128, 1989",
    "Warburg 1899": "E. Warburg, Ueber das Verhalten sogenannter unpolarisirbarer Elektroden gegen Wechselstrom, "
    "Annalen der Physik und Chemie 303, 493-499, 1899",
}
"""What the column of sources names, by these names."""


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown; a bar within a cell is escaped."""
    lines = [[cell.replace("|", r"\|") for cell in row] for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def quantities() -> str:
    """Every letter."""
    rows = []
    for letter, quantity in QUANTITIES.items():
        units = [unit_of(quantity.unit, unit) or "1" for unit in ("N s/m", "ohm")]
        scale = f"logit, of its distance from {quantity.low:g}" if letter in EXPONENTS else "logarithmic"
        signed = [c.word for c in CONSTRUCTS.values() if c.signed and letter in c.letters[0]]
        if signed and letter not in KINDS:
            scale += "; itself where shared or held"
        rows.append([f"`{letter}`", quantity.name, units[0], units[1], scale, quantity.story])
    return table(["letter", "is a", "unit", "in circuits", "scale", ""], rows)


def units(letters: Sequence[str]) -> str:
    """Units of parameters with these first letters, of a mechanical one-port."""
    return ", ".join(f"`{letter}`: {unit_of(QUANTITIES[letter].unit, 'N s/m') or '1'}" for letter in letters)


def law_source(letters: str) -> str:
    """Where a power law with these parameters is from; that with a held exponent of a half is Warburg's too."""
    source = POWER_LAW_SOURCES["b" if "b" in letters else "a"]
    return source if len(letters) > 1 else f"{source}; Warburg 1899"


def leaves() -> str:
    """Masses, compliances, dampers, power laws."""
    circuits = {e.names[0][0]: word for word, e in CIRCUIT_ELEMENTS.items() if len(e.names) == 1 and word != "W"}
    rows = [
        [
            f"`{letter}1`",
            kind.name,
            f"`{_FORMULAS[letter]}`",
            units(letter),
            "yes",
            f"`{circuits[letter]}1`",
            kind.source,
        ]
        for letter, kind in KINDS.items()
    ]
    slow, fast = "between spring (a = 0) and damper (a = 1)", "between damper (b = 1) and mass (b = 2)"
    laws = [
        ("p1^a1", f"power law {slow}", "p s^(a-1)", "pa", "`CPE1`"),
        ("p1^b1", f"power law {fast}", "p s^(b-1)", "pb", "`La1`"),
        ("p1^0.5", "the same with a held exponent", "p/sqrt(s)", "p", "`W1`"),
        ("p1^a1@100", "the same with its size at 100 Hz", "p (s/(2 pi 100))^(a-1)", "pa", "none"),
    ]
    rows += [
        [f"`{law}`", what, f"`{z}`", units(letters), "yes", circuit, law_source(letters)]
        for law, what, z, letters, circuit in laws
    ]
    return table(["written", "is a", "z", "units", "passive", "in circuits", "source"], rows)


def passive(construct: Construct) -> str:
    """Whether, and on what condition."""
    if not construct.passive:
        return "no"
    conditions = {"hysteretic": "around springs, dampers and `p^a`", "offset": "if above zero"}
    return ("yes, " + conditions[construct.word]) if construct.word in conditions else "yes"


def wrappers() -> str:
    """Every construct."""
    circuits = {"line_free": "`Wo1`: `line_free[r1](n1)`", "line_fixed": "`Ws1`: `line_fixed[r1](n1)`"}
    rows = []
    for word, construct in CONSTRUCTS.items():
        written = " or ".join(
            f"`{word}[{', '.join([first + '1', *(letters[0] + '1' for letters in construct.letters[1:])])}](...)`"
            for first in construct.letters[0]
        )
        sign = "either" if construct.signed else "above zero"
        letters = [letter for choice in construct.letters for letter in choice]
        rows.append(
            [
                written,
                f"`{construct.text}`",
                construct.story,
                units(letters),
                sign,
                passive(construct),
                circuits.get(word, "none"),
                construct.source,
            ]
        )
    head = ["written", "z becomes", "", "units", "sign where shared or held", "passive", "in circuits", "source"]
    return table(head, rows)


def circuits() -> str:
    """Every element of circuits."""
    rows = [
        [f"`{e.word}1`", f"`{e.formula}`", f"`{e.network('1')}`", f"`{e.conversion}`"]
        for e in CIRCUIT_ELEMENTS.values()
    ]
    return table(["circuits", "z", "here", "conversion"], rows)


def references() -> str:
    """Every source in full."""
    return table(["source", "in full"], [[name, full] for name, full in REFERENCES.items()])


def page() -> str:
    """The whole page."""
    parts = [
        _INTRODUCTION,
        "## Parameters\n",
        quantities(),
        _SIGNS,
        "## Elements\n",
        leaves(),
        _PASSIVE,
        "## Wrappers\n",
        wrappers(),
        _LINES,
        "## The spelling of circuits\n",
        _CIRCUITS,
        circuits(),
        "## Sources\n",
        references(),
    ]
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
