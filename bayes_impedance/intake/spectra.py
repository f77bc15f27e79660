"""Spectra that others have estimated: columns of a file to impedances.

A frequency response comes as complex numbers, real and imaginary part, or magnitude (also in dB) and phase, in any of
the six forms of :mod:`.quantities`. Which form it is follows from the unit, the names of the columns, a recipe or an
option, in the order: option, unit of the file, names. Nothing is assumed silently: a ratio of unknown form is refused.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.intake.columns import Column, columns_of, form_in_names, in_brackets
from bayes_impedance.intake.contents import Contents
from bayes_impedance.intake.names import Who
from bayes_impedance.intake.quantities import (
    FORMS,
    Response,
    hertz_factor,
    is_response_unit,
    radian_factor,
    response_of,
    si_response,
)
from bayes_impedance.intake.recipes import Recipe, recipe_for
from bayes_impedance.intake.spectrum import FREQUENCY_UNIT, QUANTITY, ComplexArray, FloatArray, Spectrum
from bayes_impedance.intake.text_tables import is_unit
from bayes_impedance.intake.unit_notation import same_unit
from bayes_impedance.recordings.repetitions import MINIMUM_POINTS
from bayes_impedance.runtime.user_table import shown

_LISTED = 12
"""Most columns that a message lists, arrays of complex numbers first. By choice: a line or two."""


@dataclass(frozen=True, kw_only=True)
class SpectraSettings:
    """What is said about the files.

    Attributes
    ----------
    columns : dict of str to str
        Assignments by role.
    recipe : Recipe or None
    form, unit, frequency_unit : str or None
        Of the values and the frequencies; None if the files say it.
    conjugated : bool
        The files use exp(-jwt).
    negated : bool
        Force or motion is counted the other way.
    averages : int or None
        Number of averages behind the files' noise, or behind their coherence, from which the noise follows.
    """

    columns: dict[str, str] = field(default_factory=dict)
    recipe: Recipe | None = None
    form: str | None = None
    unit: str | None = None
    frequency_unit: str | None = None
    conjugated: bool = False
    negated: bool = False
    averages: int | None = None


def spectra_of(contents: Contents, who: Who, settings: SpectraSettings) -> tuple[list[Spectrum], list[str]]:
    """Recordings of a file of spectra, and what was guessed or changed.

    Parameters
    ----------
    contents : Contents
    who : Who
        From the file's name; a column of subjects or repetitions is preferred.
    settings : SpectraSettings

    Raises
    ------
    InputError
        If a column or the form is missing or not clear, or a value cannot be used.
    """
    recipe, notes = settings.recipe, list(contents.notes)
    if recipe is None and not settings.columns:
        recipe = recipe_for(contents)
        notes += [f"{contents.file}: read by the recipe {recipe.name}"] if recipe is not None else []
    given = settings.columns or (recipe.columns if recipe is not None else {})
    columns, guessed = columns_of(contents, given)
    notes += guessed if recipe is None else ()
    frequency = _frequency(contents, columns, settings, notes)
    for column in columns.values():
        if column.variable.values.size != frequency.size:
            raise InputError(
                f"{contents.file}: {column.told} has {column.variable.values.size} values, but the frequency has "
                f"{frequency.size}; name columns of equal length with --columns"
            )
    measured, values = _measured(contents, columns)
    response, told, by_letter = _response(contents, values, settings, recipe)
    notes += told
    no_unit = settings.frequency_unit is None and not columns["frequency"].unit
    assumed = frozenset(({FREQUENCY_UNIT} if no_unit else set()) | ({QUANTITY} if by_letter else set()))
    if settings.conjugated:
        measured = measured.conj()
    if settings.negated:
        measured = -measured
    z = response.impedance(frequency, measured)
    noise = _noise(contents, columns, response, z, measured)
    coherence = contents.numbers(columns["coherence"].variable) if "coherence" in columns else None
    if coherence is not None and noise is None:
        noise = _noise_of_coherence(z, coherence, settings.averages)
        if noise is None:
            notes.append(
                f"{contents.file}: the coherence is kept, but without the number of averages behind it (--averages) no "
                "noise follows from it"
            )
    found = []
    for subject, repetition, index in _groups(contents, columns, who):
        parts = [None if array is None else array[index] for array in (noise, coherence)]
        for one in _ordered(contents, frequency[index], z[index], parts[0], parts[1], index, notes):
            again = f" {one[4]}" if one[4] and repetition else str(one[4] or "")
            found.append(
                Spectrum(
                    subject=subject,
                    repetition=repetition + again,
                    frequency_hz=one[0],
                    z=one[1],
                    unit=response.unit,
                    source=contents.file,
                    noise_sd=one[2],
                    degrees_of_freedom=_degrees(settings, one[2]),
                    coherence=one[3],
                    facts={**who.facts, **contents.facts},
                    downwards=bool(np.all(np.diff(frequency[index]) < 0)),
                    assumed=assumed,
                )
            )
    return found, notes


def _degrees(settings: SpectraSettings, noise: FloatArray | None) -> float | None:
    """Degrees of freedom of averages behind a noise: 2 (n - 1), n complex averages less the response."""
    return None if noise is None or settings.averages is None else 2.0 * (settings.averages - 1)


def _frequency(
    contents: Contents, columns: dict[str, Column], settings: SpectraSettings, notes: list[str]
) -> FloatArray:
    column = columns.get("frequency")
    if column is None:
        raise InputError(
            f"{contents.file}: no column is clearly the frequency (found: {', '.join(contents.names[:12])}); say which "
            "with --columns frequency=NAME, or, if these are signals over time, name force and motion by "
            "--force NAME[UNIT] and --motion NAME[UNIT]"
        )
    unit = settings.frequency_unit or column.unit or "Hz"
    factor = hertz_factor(unit)
    if column.unit and settings.frequency_unit is not None and hertz_factor(column.unit) != factor:
        notes.append(f"{contents.file}: {column.told}, but --frequency-unit says {unit}, which was used")
    if factor is None:
        raise InputError(
            f'{contents.file}: {shown(unit)} is no unit of frequency; give one with --frequency-unit, e.g. "kHz" or '
            '"rad/s"'
        )
    frequency: FloatArray = contents.numbers(column.variable) * factor
    negative = np.flatnonzero(frequency < 0)
    if negative.size:
        raise InputError(
            f"{contents.where(int(negative[0]))}: the frequency is {frequency[negative[0]]:g} Hz, below zero; delete "
            "the negative half of a two-sided spectrum, or name another column with --columns"
        )
    return frequency


def _measured(contents: Contents, columns: dict[str, Column]) -> tuple[ComplexArray, list[Column]]:
    """The measured ratio in its own unit (linear, not dB), and the columns that hold it."""
    if "complex" in columns:
        column = columns["complex"]
        numbers = contents.complex_numbers(column.variable)
        return (-numbers if column.negated else numbers), [column]
    if "real" in columns and "imaginary" in columns:
        pair = [columns["real"], columns["imaginary"]]
        real, imaginary = (contents.numbers(column.variable) * (-1.0 if column.negated else 1.0) for column in pair)
        return real + 1j * imaginary, pair
    if "magnitude" in columns and "phase" in columns:
        return _polar(contents, columns["magnitude"], columns["phase"]), [columns["magnitude"]]
    have = [role for role in ("real", "imaginary", "magnitude", "phase") if role in columns]
    names = [v.name for v in sorted(contents.variables, key=lambda v: not np.iscomplexobj(v.values))]
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    raise InputError(
        f"{contents.file}: the values are not clear (columns: {', '.join(names[:_LISTED])}{more}"
        f"{'; found only ' + ' and '.join(have) if have else ''}){_of_unknown_units(contents)}; say which are real and "
        "imaginary, magnitude and phase, or complex, with --columns real=NAME imaginary=NAME, or complex=NAME"
    )


def _of_unknown_units(contents: Contents) -> str:
    """Part of a sentence: what stands in brackets behind names and is no unit, as a misspelt one."""
    unknown = [unit for unit in map(in_brackets, contents.names) if unit and not is_unit(unit)]
    return f", and {' and '.join(map(shown, dict.fromkeys(unknown)))} behind a name is no known unit" if unknown else ""


def _polar(contents: Contents, magnitude: Column, phase: Column) -> ComplexArray:
    size = contents.numbers(magnitude.variable)
    if magnitude.unit == "dB":
        size = 10 ** (size / 20)
    elif (size < 0).any():
        row = int(np.flatnonzero(size < 0)[0])
        raise InputError(
            f"{contents.where(row)}: the magnitude is {size[row]:g}, below zero; if the column is in dB, say so with "
            f"--columns magnitude={magnitude.variable.name}[dB]"
        )
    angle = contents.numbers(phase.variable)
    unit = phase.unit
    if not unit:
        # A turn and a half of phase in radians is 9.4: more than that are degrees.
        unit = "deg" if np.nanmax(np.abs(angle), initial=0.0) > 3 * np.pi else "rad"
        if unit == "rad":
            raise InputError(
                f"{contents.file}: the unit of the phase {shown(phase.variable.name)} is not clear; say it with "
                f"--columns phase={phase.variable.name}[rad], or [deg]"
            )
    factor = radian_factor(unit)
    if factor is None:
        raise InputError(f"{contents.file}: {shown(unit)} is no unit of phase; write [deg] or [rad] behind its name")
    angle = angle * factor * (-1.0 if phase.negated else 1.0)
    return np.asarray(size * np.exp(1j * angle))


def _response(
    contents: Contents, values: list[Column], settings: SpectraSettings, recipe: Recipe | None
) -> tuple[Response, list[str], bool]:
    """Form and unit of the values, a note of what was guessed, and whether nothing but a letter Z says the form."""
    form = settings.form or (recipe.form if recipe is not None and recipe.form else None)
    with_units = [c for c in values if c.unit and c.unit != "dB" and is_response_unit(c.unit)]
    own = with_units[0].unit if with_units else None
    unit = settings.unit or own or (recipe.unit if recipe is not None and recipe.unit else None)
    if unit is not None:
        others = [c for c in with_units if not same_unit(c.unit, unit)]
        said = " and ".join(c.told for c in others)
        if others and settings.unit is None:
            raise InputError(
                f"{contents.file}: {with_units[0].told}, but {said}: both parts must have one unit; correct the names, "
                "or give the unit of both with --unit"
            )
        notes = [f"{contents.file}: {said}, but --unit says {unit}, which was used"] if others else []
        return response_of(unit, contents.file, form), notes, False
    named = form or form_in_names(values)
    if named is None:
        raise InputError(
            f"{contents.file}: no unit says what {' and '.join(shown(c.variable.name) for c in values)} "
            f"{'are' if values[1:] else 'is'}; give "
            f'--unit, e.g. "m/s^2/N", or --form, one of {", ".join(FORMS)}'
        )
    response = si_response(named)
    unknown = {"impedance": "N s/m", "dynamic stiffness": "N/m", "apparent mass": "kg", "receptance": "m/N"}
    unknown |= {"mobility": "m/(N s)", "accelerance": "m/s^2/N"}
    note = f"{contents.file}: no unit is given; the values are taken to be {named} in {unknown[named]}"
    word = any(named in column.variable.name.lower() for column in values)
    return response, [note], form is None and named == "impedance" and not word


def _noise(
    contents: Contents,
    columns: dict[str, Column],
    response: Response,
    z: ComplexArray,
    measured: ComplexArray,
) -> FloatArray | None:
    if "noise_sd" not in columns:
        return None
    sd = contents.numbers(columns["noise_sd"].variable)
    wrong = np.flatnonzero(sd <= 0)
    if wrong.size:
        raise InputError(
            f"{contents.where(int(wrong[0]))}: noise_sd is {sd[wrong[0]]:g}, but must be above zero; correct it"
        )
    return response.noise(z, measured, sd)


def _noise_of_coherence(z: ComplexArray, coherence: FloatArray, averages: int | None) -> FloatArray | None:
    """Standard deviation of each part: |z| sqrt((1 - c) / (2 c (n - 1))), as in :mod:`.averaged_spectra`.

    Bendat & Piersol (Random Data, section 9.2.3) have n in place of n - 1, with the true coherence; the measured one of
    n averages is larger on average by (1 - c) / n.
    """
    if averages is None:
        return None
    inside = np.clip(coherence, np.finfo(float).eps, 1 - np.finfo(float).eps)
    return np.asarray(np.abs(z) * np.sqrt((1 - inside) / (2 * (averages - 1) * inside)))


def _groups(contents: Contents, columns: dict[str, Column], who: Who) -> Iterator[tuple[str, str, np.ndarray]]:
    """Subject, repetition and rows of each recording of the file."""
    size = (
        contents.variables[0].values.size if "frequency" not in columns else columns["frequency"].variable.values.size
    )
    subject = contents.texts(columns["subject"].variable) if "subject" in columns else [who.subject] * size
    repetition = (
        contents.texts(columns["repetition"].variable)
        if "repetition" in columns
        else [who.repetition or contents.part] * size
    )
    for i, (one, other) in enumerate(zip(subject, repetition, strict=True)):
        if not one or ("repetition" in columns and not other):
            raise InputError(
                f"{contents.where(i)}: {'repetition' if one else 'subject'} is empty; give it, or delete the row"
            )
    pairs = list(zip(subject, repetition, strict=True))
    places: dict[tuple[str, str], list[int]] = {}
    for i, pair in enumerate(pairs):
        places.setdefault(pair, []).append(i)
    for (one, other), index in places.items():
        yield one, other, np.array(index)


Rows = tuple[FloatArray, ComplexArray, FloatArray | None, FloatArray | None, int]


def _ordered(
    contents: Contents,
    frequency: FloatArray,
    z: ComplexArray,
    noise: FloatArray | None,
    coherence: FloatArray | None,
    index: np.ndarray,
    notes: list[str],
) -> list[Rows]:
    """Usable rows by ascending frequency; runs over all frequencies again are repetitions, numbered from 1 (else 0)."""
    where = contents.where(int(index[0]))
    zero = int(np.sum(frequency == 0))
    if zero:
        notes.append(f"{where}: {zero} value{'s' if zero > 1 else ''} at 0 Hz left out: no impedance is measured there")
    usable = np.isfinite(frequency) & (frequency > 0)
    good = usable & np.isfinite(z) & (z != 0)
    if noise is not None:
        good &= np.isfinite(noise)
    lost = int(usable.sum() - good.sum())
    if lost:
        notes.append(f"{where}: {lost} of {frequency.size} rows have no finite value and were left out")
    keep = np.flatnonzero(good)
    order = keep[np.argsort(frequency[keep], kind="stable")]
    if np.any(np.diff(keep[np.argsort(frequency[keep], kind="stable")]) < 0):
        notes.append(f"{where}: sorted by ascending frequency")
    grid, first, count = np.unique(frequency[order], return_index=True, return_counts=True)
    if grid.size < MINIMUM_POINTS:
        raise InputError(
            f"{where}: there are {grid.size} usable frequencies, but at least {MINIMUM_POINTS} are needed; complete "
            "the file, or leave it out"
        )

    def at(rows: np.ndarray, number: int) -> Rows:
        chosen = [None if array is None else array[rows] for array in (noise, coherence)]
        return frequency[rows], z[rows], chosen[0], chosen[1], number

    if count.max() == 1:
        return [at(order, 0)]
    if np.all(count == count[0]):
        notes.append(f"{where}: every frequency is there {count[0]} times; each time is a repetition")
        return [at(order[first + k], k + 1) for k in range(int(count[0]))]
    notes.append(f"{where}: {int(np.sum(count > 1))} frequencies are there more than once and were averaged")
    mean = np.asarray(np.add.reduceat(z[order], first) / count, dtype=np.complex128)
    sd = None if noise is None else np.sqrt(np.add.reduceat(noise[order] ** 2, first)) / count
    averaged = None if coherence is None else np.add.reduceat(coherence[order], first) / count
    return [(grid, mean, sd, averaged, 0)]
