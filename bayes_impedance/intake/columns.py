"""Which column is what: given, by a recipe, or guessed from its name where that is clear.

Names are compared without their unit (``freq/Hz``, ``Z' (Ω)``, ``phase_deg``), case, spaces and underscores. A minus
in front (``-Z''``, ``-Im(Z)/Ohm``, ``-Phase``) means that the column holds the negative.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bayes_impedance.errors import InputError
from bayes_impedance.intake.contents import Array, Contents, Variable
from bayes_impedance.intake.quantities import SYNONYMS, hertz_factor
from bayes_impedance.intake.text_tables import is_unit
from bayes_impedance.runtime.user_table import hint, shown

ROLES = (
    "subject",
    "repetition",
    "frequency",
    "complex",
    "real",
    "imaginary",
    "magnitude",
    "phase",
    "coherence",
    "noise_sd",
)
_ROLE_SPELLINGS = {"imag": "imaginary", "im": "imaginary", "re": "real", "f": "frequency", "mag": "magnitude"}

# The quantity's letter: impedance first, then a frequency response of any form, then none.
_FORMS = r"impedance|accelerance|mobility|receptance|inertance|compliance|dynamicstiffness|apparentmass"
_LETTERS = (r"z", rf"(?:h|frf|tf|g|response|transfer|{_FORMS})", r"")
_RE, _IM = r"(?:re|real|realpart|realteil)", r"(?:im|imag|imaginary|imagpart|imaginarypart|imaginärteil)"
_ABS = r"(?:mag|magnitude|abs|amplitude|amp|ampl|modulus|mod|betrag)"
_ARG = r"(?:phase|phz|phi|φ|arg|angle|theta|winkel|phasenwinkel|phaseangle)"


def _around(word: str) -> tuple[str, ...]:
    """A word before, behind or around the quantity's letter, or alone; the best reading first."""
    both = tuple(f"{word}\\(?{letter}\\)?|{letter}{word}" for letter in _LETTERS[:2])
    return (*both, word)


_GUESSES: dict[str, tuple[str, ...]] = {
    "subject": (r"subject|person|participant|subj|subjectid|participantid|proband|vp|sample|specimen",),
    "repetition": (r"repetition|rep|run|trial|replicate|take|wiederholung",),
    "frequency": (r"frequency|freq|f|frequenz|fréquence|frequencia|freqdomain|frequencyhz|hz", r"omega|ω|w"),
    "complex": (r"z|impedance", r"h|frf|response|accelerance|mobility|receptance|inertance|compliance"),
    "real": (r"z'|zprime", *_around(_RE)),
    "imaginary": (r"z''|z\"|zprimeprime", *_around(_IM)),
    "magnitude": (r"\|z\|", r"\|h\|", *_around(_ABS), rf"z|{_FORMS}"),
    "phase": _around(_ARG),
    "coherence": (r"coherence|coh|gamma2|γ2|γ²|kohärenz",),
    "noise_sd": (r"noisesd|noise|sd|sigma|std",),
}
_MOST_TOLD = 6
"""Columns without a role that are named. By choice: more do not fit a sentence."""
_RADIAN_NAMES = re.compile(r"omega|ω|w")


@dataclass(frozen=True, eq=False, kw_only=True)
class Column:
    """A variable in its role.

    Attributes
    ----------
    role : str
    variable : Variable
    unit : str
        Given, else of the file, else of the name; empty if unknown.
    negated : bool
    """

    role: str
    variable: Variable
    unit: str = ""
    negated: bool = False

    @property
    def told(self) -> str:
        """The column in a sentence."""
        unit = f" in {self.unit}" if self.unit else ""
        return f"{self.role} from {shown(self.variable.name)}{unit}{' (its negative)' if self.negated else ''}"


def parse_assignments(texts: Iterable[str]) -> dict[str, str]:
    """``ROLE=NAME`` texts of ``--columns`` as a table.

    Raises
    ------
    InputError
        If a text has another form, or a role is unknown or given twice.
    """
    found: dict[str, str] = {}
    for text in texts:
        role, equals, name = text.partition("=")
        role = _ROLE_SPELLINGS.get(role.strip().lower(), role.strip().lower())
        if not equals or not name.strip():
            raise InputError(f"--columns {shown(text)} is not of the form ROLE=NAME, e.g. frequency=f[kHz]; correct it")
        if role not in ROLES:
            raise InputError(f"--columns {shown(text)}: there is no role {shown(role)}; {hint(role, ROLES)}")
        if role in found:
            raise InputError(f"--columns gives {role} twice; leave one out")
        found[role] = name.strip()
    return found


def assigned(contents: Contents, role: str, text: str, option: str = "--columns") -> Column:
    """The column that an assignment names: ``NAME``, ``-NAME``, ``NAME[UNIT]``.

    Raises
    ------
    InputError
        If there is no such column.
    """
    unit, name = "", text.strip()
    known = {n.casefold() for n in contents.names}
    if name.casefold() not in known:
        match = re.fullmatch(r"(.+?)\s*\[([^\[\]]*)\]", name)
        if match:
            name, unit = match[1], match[2].strip()
    negated = name.startswith("-")
    if negated and name.casefold() not in known:
        name = name[1:].strip()
    variable = contents.variable(name, option)
    own = _read_name(variable)
    return Column(role=role, variable=variable, unit=unit or own[2], negated=negated or own[0])


def columns_of(contents: Contents, given: dict[str, str]) -> tuple[dict[str, Column], tuple[str, ...]]:
    """Columns by role, and what was guessed, as sentences.

    Parameters
    ----------
    contents : Contents
    given : dict of str to str
        Assignments, of options or a recipe; only roles that are not among them are guessed.

    Raises
    ------
    InputError
        If a name is not there, or two columns fit a role equally well.
    """
    found = {role: assigned(contents, role, text) for role, text in given.items()}
    pairs = ({"complex"}, {"real", "imaginary"}, {"magnitude", "phase"})
    closed = set().union(*pairs) if any(pair <= set(given) for pair in pairs) else set()
    taken = {id(column.variable) for column in found.values()}
    guessed: dict[str, Column] = {}
    for role in ROLES:
        if role in found or role in closed:
            continue
        candidates = [v for v in contents.variables if id(v) not in taken and _fits_kind(v, role)]
        column = _best(contents, role, candidates)
        if column is not None:
            guessed[role] = column
    _keep_one_pair(found, guessed)
    notes: tuple[str, ...] = ()
    if guessed:
        said = ", ".join(column.told for column in guessed.values())
        used = {id(column.variable) for column in (*found.values(), *guessed.values())}
        unused = [shown(v.name) for v in contents.variables if id(v) not in used]
        more = f" (and {len(unused) - _MOST_TOLD} more)" if len(unused) > _MOST_TOLD else ""
        left = f"; not used: {', '.join(unused[:_MOST_TOLD])}{more}" if unused else ""
        notes = (f"{contents.file}: guessed from the names: {said}{left}; --columns says otherwise",)
    return found | guessed, notes


def form_in_names(columns: Iterable[Column]) -> str | None:
    """The form that the names of the value columns say: a word, or the letter Z; None if none or two do."""
    said = set()
    forms = {form: form for form in ("accelerance", "mobility", "receptance", "impedance")} | SYNONYMS
    for column in columns:
        stem = " ".join(re.sub(r"[_-]", " ", column.variable.name.lower()).split())
        words = {form for word, form in forms.items() if word in stem}
        said |= words or ({"impedance"} if re.search(r"(?<![a-z])z|zreal|zimag|zmod|zphz", stem) else set())
    return said.pop() if len(said) == 1 else None


def _keep_one_pair(found: dict[str, Column], guessed: dict[str, Column]) -> None:
    """Of guessed values keep complex numbers, else real and imaginary part, else magnitude and phase."""
    both = found | guessed
    drop: tuple[str, ...] = ()
    if "complex" in both:
        drop = ("real", "imaginary", "magnitude", "phase")
    elif "real" in both and "imaginary" in both:
        drop = ("magnitude", "phase")
    elif "magnitude" in both and "phase" in both:
        drop = ("real", "imaginary")
    for role in drop:
        guessed.pop(role, None)


def _fits_kind(variable: Variable, role: str) -> bool:
    """Whether values of this kind can have the role."""
    if role in ("subject", "repetition"):
        return True
    is_complex = variable.values.dtype.kind == "c" or (variable.is_text and _looks_complex(variable.values[:1]))
    return is_complex == (role == "complex")


def _looks_complex(cells: Array) -> bool:
    return any(re.search(r"\d\s*\*?[ij]\)?$|^\(?[ij]", str(cell).strip()) is not None for cell in cells)


def _best(contents: Contents, role: str, candidates: Sequence[Variable]) -> Column | None:
    for pattern in _GUESSES[role]:
        fitting = []
        for variable in candidates:
            negated, stem, unit = _read_name(variable)
            # F [N] is no frequency.
            fits = role != "frequency" or not unit or hertz_factor(unit) is not None
            if fits and any(re.fullmatch(pattern, one) for one in (stem, _in_structure(variable))):
                if role == "frequency" and not unit and _RADIAN_NAMES.fullmatch(stem):
                    unit = "rad/s"
                fitting.append(Column(role=role, variable=variable, unit=unit, negated=negated))
        if len(fitting) > 1:
            names = " and ".join(shown(column.variable.name) for column in fitting[:3])
            raise InputError(f"{contents.file}: {names} may each be the {role}; say which with --columns {role}=NAME")
        if fitting:
            return fitting[0]
    return None


def _read_name(variable: Variable) -> tuple[bool, str, str]:
    """Whether the name begins with a minus, its stem in small letters, and the unit (the file's own first)."""
    name = variable.name.strip()
    negated = name.startswith(("-", "−", "\u2013"))
    name = name[1:].strip() if negated else name
    unit = ""
    for pattern in (
        r"(.+?)\s*[\(\[]([^()\[\]]+)[\)\]]",
        r"(.+?)\s*\[([^\[\]]+)\]",  # with parentheses inside, as "[(m/s^2)/N]"
        r"([^/]+)/\s*(.+)",
        r"(.+?),\s*(.+)",
        r"(.+)_([A-Za-z°]+)",
    ):
        match = re.fullmatch(pattern, name)
        # "Re(Z)" has no unit, nor has "a/F" alone: what follows must be one.
        if match and is_unit(_known_case(match[2])):
            # "Re(Z) / (N s/m)" is the name, a stroke and the unit (ISO 80000-1).
            name, unit = match[1].removesuffix("/").rstrip(), _known_case(match[2])
            break
    else:
        # ZView writes Z'(a) and Z''(b).
        name = re.sub(r"\([ab]\)$", "", name)
    stem = re.sub(r"[\s_.]", "", name.lower()).replace("’", "'").replace("″", "''").replace("´", "'")
    return negated, stem, variable.unit or unit


def _in_structure(variable: Variable) -> str:
    """The stem of a field's own name in a structure, as ``freq`` of ``data.freq``; an empty text of other names."""
    match = re.fullmatch(r"[A-Za-z_]\w+\.(?:\w+\.)*(\w+)", variable.name)
    return match[1].lower().replace("_", "") if match else ""


def in_brackets(name: str) -> str:
    """What stands in brackets at the end of a column's name; an empty text if there are none."""
    match = re.fullmatch(r".+?\s*\[([^\[\]]+)\]", name.strip())
    return _known_case(match[1].strip()) if match else ""


def _known_case(unit: str) -> str:
    """Units in small letters, as in names such as ``freq_khz``."""
    known = {"hz": "Hz", "khz": "kHz", "mhz": "MHz", "db": "dB", "ohm": "ohm", "Deg": "deg", "DEG": "deg"}
    return known.get(unit, unit)


def looks_like_frequency(variable: Variable) -> bool:
    """Whether a column is guessed to be the frequency, by its name and unit."""
    _, stem, unit = _read_name(variable)
    return (not unit or hertz_factor(unit) is not None) and any(
        re.fullmatch(pattern, one) for pattern in _GUESSES["frequency"] for one in (stem, _in_structure(variable))
    )
