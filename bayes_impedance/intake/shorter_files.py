"""Remarks on files that hold less than the others of one import, and may have been cut.

A spectrum with the first frequencies of most others is refused (:mod:`bayes_impedance.recordings.shorter_grid`). Of two
spectra nobody knows which was meant, and signals are often stopped by hand and give an estimate however long they are:
these are said, and read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.recordings.shorter_grid import MOST, ends_early

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
    return [*_of_two(spectra), *_of_signals(spectra)]


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
