"""Remarks on files that hold less than the others of one import, and may have been cut.

A spectrum with the first frequencies of most others is refused (:mod:`bayes_impedance.recordings.shorter_grid`). Of two
spectra nobody knows which was meant, and signals are often stopped by hand and give an estimate however long they are:
these are said, and read. So are the last subjects of one table who have fewer repetitions than all before: a table may
end between two recordings.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.recordings.shorter_grid import LEAST_OTHERS, MOST, ends_early
from bayes_impedance.runtime.user_table import shown
from bayes_impedance.units import counted

SHORTER = 0.99
"""Length of a signal over the usual one below which it is said. By choice: recorders that a timer stops differ by some
blocks of samples, and a hundredth of the samples changes the noise by half a per cent."""
_REMEDY = "if the file was cut, export or copy it again"


def remarks_on_short_files(spectra: Sequence[Spectrum]) -> list[str]:
    """What is said of files that end before the others do.

    Parameters
    ----------
    spectra : sequence of Spectrum
        All of one import.
    """
    return [*_of_two(spectra), *_of_signals(spectra), *_of_last(spectra)]


def places_of(spectra: Sequence[Spectrum]) -> list[str]:
    """The file of each recording, with subject and repetition where it has several.

    Parameters
    ----------
    spectra : sequence of Spectrum
        All of one import.
    """
    counts = Counter(one.source for one in spectra)
    which = [f", repetition {shown(one.repetition)}" if one.repetition else "" for one in spectra]
    return [
        one.source if counts[one.source] == 1 else f"{one.source}: subject {shown(one.subject)}{more}"
        for one, more in zip(spectra, which, strict=True)
    ]


def _of_two(spectra: Sequence[Spectrum]) -> list[str]:
    """The shorter of two spectra, if it has the first frequencies of the longer one; not of one file's two people."""
    if len(spectra) != 2 or any(one.samples is not None for one in spectra) or spectra[0].source == spectra[1].source:
        return []
    short, whole = sorted(spectra, key=lambda one: one.frequency_hz.size)
    ends = ends_early(short.frequency_hz, whole.frequency_hz, short.downwards)
    if ends is None:
        return []
    return [
        f"{short.source}: the frequencies end at {ends[0]:g} Hz after {short.frequency_hz.size}, where those of "
        f"{whole.source} are the same and go on, {whole.frequency_hz.size} to {ends[1]:g} Hz; {_REMEDY}"
    ]


def _of_signals(spectra: Sequence[Spectrum]) -> list[str]:
    """Signals that are shorter than those of most files, or than the only other ones."""
    lengths = [(one.source, one.samples) for one in spectra if one.samples is not None]
    if len(lengths) < 2:
        return []
    usual, count = Counter(samples for _, samples in lengths).most_common(1)[0]
    if len(lengths) == 2:
        usual, count = max(samples for _, samples in lengths), 1
    elif count <= MOST * len(lengths):
        return []
    others = "the other file has" if len(lengths) == 2 else f"{count} others have"
    return [
        f"{source}: the signals have {samples} samples, where {others} {usual}; {_REMEDY}"
        for source, samples in lengths
        if samples < SHORTER * usual
    ]


def _of_last(spectra: Sequence[Spectrum]) -> list[str]:
    """The last subjects of a single table, if all before have the same number of repetitions, and they have fewer."""
    if len({one.source for one in spectra}) != 1:
        return []
    counts = Counter(one.subject for one in spectra)
    names, numbers = list(counts), list(counts.values())
    usual = numbers.count(numbers[0])
    last = numbers[usual:]
    if not last or usual < LEAST_OTHERS or usual <= MOST * len(numbers) or numbers[:usual] != [numbers[0]] * usual:
        return []
    if max(last) >= numbers[0]:
        return []
    who = f"subject {shown(names[usual])}" if len(last) == 1 else f"the last {len(last)} subjects"
    has = "has" if len(last) == 1 else "have"
    few = f"{min(last)}" if min(last) == max(last) else f"{min(last)} to {max(last)}"
    said = f"{who} of the table {has} {few} of the {counted(numbers[0], 'repetition')} that all others have"
    return [f"{spectra[0].source}: {said}; {_REMEDY}"]
