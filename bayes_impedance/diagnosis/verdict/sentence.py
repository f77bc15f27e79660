"""The verdict as a headline: at most two findings, in at most two sentences."""

from __future__ import annotations

import re
from collections.abc import Sequence

from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.verdict.electrical_words import UNIT
from bayes_impedance.diagnosis.verdict_types import Physics, Verdict
from bayes_impedance.units import number_with_unit as number

_WITHOUT_ARTICLE = frozenset(
    {"corners", "damping", "feedback", "hum", "loss", "resistance", "stiffness", "tissue", "waves"}
)
"""Head nouns of names in the catalogue that take no article: uncountable nouns and plurals."""


_FINDINGS = 2
"""Most effects, and most rivals, that a headline names: what one reading takes in. The others are counted."""
_CLEAR = 3.0
"""Standard errors from which a gain is called clear. By choice, as wherever gains are compared."""


def sentence(verdict: Verdict, people: int) -> str:
    """The verdict summarised in one or two sentences.

    Parameters
    ----------
    verdict : Verdict
        Its `sentence` is not used.
    people : int
        Number of people measured.
    """
    if not verdict.reliable and verdict.shortcomings:
        return f"Nothing can be concluded: {_clause_of(verdict.shortcomings[0])}"
    if not verdict.mismatch and not verdict.reliable:
        return "No verdict is possible: the fit of the network did not converge."
    if not verdict.mismatch and verdict.shortcomings:
        return (
            "No effect was found that is missing for all subjects, but the network does not describe every subject: "
            f"{_clause_of(verdict.shortcomings[0])}"
        )
    if only_structure(verdict):
        located = [(band.low_hz, band.high_hz) for band in verdict.located.bands]
        where = f", mostly {_span(located)}" if located else ""
        return (
            f"No effect was found that is missing, but the residuals of {_people(people)} are not noise alone{where}: "
            "a subject may be in another optimum of the network, or the noise is not what was estimated."
        )
    if not verdict.mismatch:
        return (
            f"Nothing is missing: the network describes the recordings of {_people(people)} to within their noise; "
            "an effect above the listed detection limits would have been found with a probability of 90 %."
        )
    bands = verdict.where.bands_hz
    band = f", seen mostly {_span(bands)}" if bands else ""
    clauses = [_clause(entry, verdict.unit) for entry in verdict.physics[:_FINDINGS]]
    more = len(verdict.physics) - len(clauses)
    text = f"The network leaves out {listed([*clauses, *([f'{more} more'] if more else [])])}{band}"
    better = verdict.improvement
    gain, error = (None, None) if better is None else (better.elpd_gain, better.elpd_gain_se)
    if gain is not None and gain > 0:
        added = "it" if len(verdict.physics) == 1 else "them"
        text += f"; with {added}, held-out recordings are predicted {gain_in_words(gain, error)} (gain {gain:.0f} nats)"
    undecided = [entry for entry in verdict.physics if any(not alias.separated for alias in entry.aliases)]
    if undecided:
        rivals = [alias for entry in undecided for alias in entry.aliases if not alias.separated]
        names = list(dict.fromkeys(f"{_with_article(alias.name)} at {place_in_words(alias.place)}" for alias in rivals))
        one = "it" if len(verdict.physics) == 1 else listed([entry.name for entry in undecided], "or")
        text += f". These recordings cannot distinguish {one} from {listed(names[:_FINDINGS], 'or')}"
    if verdict.shortcomings:
        text += f"{'; even' if undecided else '. Even'} so, {_clause_of(verdict.shortcomings[0])[:-1]}"
    return text + "."


def only_structure(verdict: Verdict) -> bool:
    """Whether nothing is said to be missing, although the residuals have structure."""
    return not verdict.mismatch and verdict.located.p_value < STRUCTURE_ALPHA


def gain_in_words(gain: float, error: float | None) -> str:
    """How a gain in log predictive density compares with its standard error."""
    if error is None or not error > 0:
        return "better" if gain > 0 else "no better"
    if gain <= 0:
        return "no better"
    return "clearly better" if gain >= _CLEAR * error else "better, though not surely"


def _clause_of(sentence: str) -> str:
    """A sentence as the final clause of another."""
    return sentence[0].lower() + sentence[1:].rstrip(".") + "."


def _clause(entry: Physics, unit: str) -> str:
    if entry.connection == "instead":
        return f"that the network lacks elements: {entry.network} describes the recordings"
    if entry.kind == "unknown" and not entry.formula:
        return "something that no effect of the catalogue and no small network predicts"
    if entry.kind == "unknown":
        return f"an unknown effect at {place_in_words(entry.place)}, represented by {entry.formula}"
    size = ""
    for name, row in list(entry.parameters.items())[:1]:
        size = f" ({name.replace('_', ' ')} {number(row.median, row.unit)}, 90 % interval "
        size += f"{number(row.q05, row.unit)} to {number(row.q95, row.unit)})"
    side = {"rig": ", an effect of the rig", "body": f", an effect of the {body_of(unit)}"}.get(entry.side or "", "")
    others = {alias.id.split(".")[0] for alias in entry.aliases if not alias.separated}
    if not entry.side_decided or others - {entry.side}:
        side = ""  # dispersion is undecided, or an inseparable rival belongs to the other side
    if entry.covariate or entry.kind == "correlation":
        return f"that {entry.name}{size}"
    word = "in" if entry.kind == "subgroup" else "at"
    at = "" if entry.place == "port" and entry.side == "rig" else f" {word} {place_in_words(entry.place)}"
    return f"{_with_article(entry.name)}{at}{size}{side}"


def body_of(unit: str) -> str:
    """Word for what is measured, beside the rig: a cell has no body."""
    return "cell" if unit == UNIT else "body"


def _with_article(name: str) -> str:
    """A name of the catalogue with its indefinite article, if it takes one."""
    head = re.split(r" (?:at|between|in|moving|of|on|that|to|with) ", name)[0].split()[-1:]
    if not head or head[0] in _WITHOUT_ARTICLE or name.startswith(("a ", "an ")):
        return name
    return f"{'an' if name[0].lower() in 'aeio' else 'a'} {name}"


def place_in_words(name: str) -> str:
    """A place of the network in a sentence."""
    return "the port" if name == "port" else f"'{name}'"


def _span(bands: Sequence[Sequence[float]]) -> str:
    spans = [f"{number(low, 'Hz')} to {number(high, 'Hz')}" for low, high in bands[:2]]
    return "from " + " and from ".join(spans)


def listed(parts: Sequence[str], word: str = "and") -> str:
    """Parts of a sentence with commas between them, and a word before the last."""
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + f" {word} " + parts[-1]


def _people(n: int) -> str:
    return "one subject" if n == 1 else f"{n} subjects"
