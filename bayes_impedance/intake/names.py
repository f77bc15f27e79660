"""Who was recorded: subject, repetition and realisation from a file's name."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import PurePath

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import shown

GROUPS = ("subject", "repetition", "realisation")


@dataclass(frozen=True, kw_only=True)
class Who:
    """Subject, repetition and realisation that a file holds.

    Attributes
    ----------
    subject : str
    repetition : str
        Empty if the name does not say.
    realisation : str
        Empty if the name does not say; files that differ in nothing else are realisations of one excitation.
    facts : dict of str to str
        Other named groups, noted for the repetition.
    """

    subject: str
    repetition: str = ""
    realisation: str = ""
    facts: dict[str, str]


def pattern_of(text: str) -> re.Pattern[str]:
    """The regular expression of ``--subject-from-name``.

    Raises
    ------
    InputError
        If it is none, or has no group named subject.
    """
    example = "write for instance '(?P<subject>[^_]+)_(?P<repetition>\\d+)'"
    try:
        pattern = re.compile(text)
    except re.error as error:
        raise InputError(f"--subject-from-name {shown(text)} is no regular expression ({error}); {example}") from None
    if "subject" not in pattern.groupindex:
        raise InputError(f"--subject-from-name {shown(text)} has no group named subject; {example}")
    return pattern


def who_is(file: str, pattern: re.Pattern[str] | None) -> Who:
    """Subject, repetition and realisation of a file.

    Parameters
    ----------
    file : str
        Path; a pattern is looked for in its name without suffix, then in the whole path. Without a pattern the name
        is the subject.
    pattern : Pattern or None

    Raises
    ------
    InputError
        If the pattern does not match.
    """
    path = PurePath(file)
    stem = path.name.removesuffix(".gz")
    stem = stem.rpartition(".")[0] or stem
    if pattern is None:
        return Who(subject=stem, facts={})
    match = pattern.search(stem) or pattern.search(path.as_posix())
    if match is None:
        raise InputError(f"{file}: the name does not match --subject-from-name {shown(pattern.pattern)}; correct one")
    groups = {name: (value or "").strip() for name, value in match.groupdict().items()}
    if not groups["subject"]:
        raise InputError(f"{file}: --subject-from-name {shown(pattern.pattern)} finds an empty subject; correct it")
    return Who(
        subject=groups["subject"],
        repetition=groups.get("repetition", ""),
        realisation=groups.get("realisation", ""),
        facts={name: value for name, value in groups.items() if name not in GROUPS},
    )
