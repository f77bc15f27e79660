"""The command ``import``: other people's files and raw signals to a dataset."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.commands.checking import doubt_of_quantity, require_quantity, require_said_quantity
from bayes_impedance.commands.import_arguments import require_sources
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.output_folder import output_folder
from bayes_impedance.units import ELECTRICAL_UNIT

if TYPE_CHECKING:
    from bayes_impedance.intake import Imported, ImportSettings
    from bayes_impedance.runtime.progress import Progress

_NOT_RECORDED = ("help", "command", "out", "overwrite", "again")
"""Options that do not belong to how recordings were made."""


def import_dataset(options: argparse.Namespace, progress: Progress) -> Imported:
    """Read the sources and write the dataset; nothing is written if anything cannot be used.

    Parameters
    ----------
    options : Namespace
        Arguments of the command.
    progress : callable

    Raises
    ------
    InputError
        If a source, or what is said about it, cannot be used.
    """
    from bayes_impedance.intake import import_recordings
    from bayes_impedance.intake.importing import BESIDE
    from bayes_impedance.intake.one_person import put_down_again, repeated_by_name, require_persons
    from bayes_impedance.intake.persons import covariates_of_subjects
    from bayes_impedance.intake.spectrum import QUANTITY
    from bayes_impedance.quality.copies import require_distinct
    from bayes_impedance.recordings.files import METADATA_FILE, RECORDINGS_FILES, SUBJECTS_FILE, write_recordings

    require_sources(options.sources)
    settings = settings_of(options)
    imported = import_recordings(options.sources, settings, progress)
    named = replace(imported.recordings, title=str(options.sources[0]))
    doubt = require_quantity(named, None)
    require_said_quantity(named, {one.subject for one in imported.spectra if QUANTITY in one.assumed})
    of_signals = any(one.samples is not None for one in imported.spectra)
    doubt = doubt or doubt_of_quantity(named, of_signals)
    imported = replace(imported, notes=(*imported.notes, *([doubt] if doubt else ())))
    require_distinct(named)
    if settings.who is None and imported.named_by_files:
        require_persons(named.subjects, named.title)
        remark = repeated_by_name(named.subjects)
        if remark is None and named.unit != ELECTRICAL_UNIT:  # cells of one kind are as alike
            remark = put_down_again(named.subjects)
        imported = replace(imported, notes=(*imported.notes, *([remark] if remark else ())))
    beside = imported.beside()
    if options.subjects is not None:
        content, told = covariates_of_subjects(options.subjects, imported.recordings.names, settings.table)
        beside[SUBJECTS_FILE] = content
        imported = replace(imported, notes=(*imported.notes, *told))
    names = (*RECORDINGS_FILES, SUBJECTS_FILE, METADATA_FILE, *BESIDE)
    with output_folder(options.out, names, options.overwrite):
        write_recordings(imported.recordings, options.out, recipe=imported.recipe(arguments_of(options)), beside=beside)
        for name in set(BESIDE) - beside.keys():
            (options.out / name).unlink(missing_ok=True)  # of an earlier import
    return imported


def settings_of(options: argparse.Namespace) -> ImportSettings:
    """Settings of an import from the command's arguments.

    Raises
    ------
    InputError
        If an option cannot be used.
    """
    from bayes_impedance.intake import ImportSettings
    from bayes_impedance.intake.calibrating import CalibrationSettings
    from bayes_impedance.intake.columns import parse_assignments
    from bayes_impedance.intake.known_loads import known_load
    from bayes_impedance.intake.names import pattern_of
    from bayes_impedance.intake.quantities import form_named
    from bayes_impedance.intake.recipes import recipe_named
    from bayes_impedance.intake.signals import SignalSettings
    from bayes_impedance.intake.spectra import SpectraSettings
    from bayes_impedance.intake.text_tables import TableFormat

    if options.recipe is not None and options.columns:
        raise InputError("--recipe and --columns exclude each other, because each says the columns; leave one out")
    if options.band is not None and not options.band[0] < options.band[1]:
        raise InputError(
            f"--band {options.band[0]:g} {options.band[1]:g}: the lower end must be below its upper end; exchange them"
        )
    return ImportSettings(
        spectra=SpectraSettings(
            columns=parse_assignments(options.columns),
            recipe=None if options.recipe is None else recipe_named(options.recipe),
            form=None if options.form is None else form_named(options.form, "--form"),
            unit=options.unit,
            frequency_unit=options.frequency_unit,
            conjugated=options.conjugated,
            negated=options.negated,
            averages=options.averages,
        ),
        signals=SignalSettings(
            force=options.force,
            motion=options.motion,
            reference=options.reference,
            excitation=options.excitation,
            rate_hz=options.sampling_rate,
            estimator=options.estimator,
            window=options.window,
            segment_s=options.segment,
            overlap=options.overlap,
            period_s=options.period,
            drop=options.drop_periods,
            band_hz=None if options.band is None else (options.band[0], options.band[1]),
            negated=options.negated,
        ),
        table=TableFormat(
            separator=options.separator,
            decimal=None if options.decimal is None else {"point": ".", "comma": ","}[options.decimal],
            encoding=options.encoding,
        ),
        record=options.record,
        who=None if options.who is None else pattern_of(options.who),
        calibration=CalibrationSettings(
            unloaded=tuple(options.unloaded),
            known_loads=tuple(known_load(text) for text in options.known_load),
            rig=options.rig,
        ),
        title=options.title,
        source=options.source,
        licence=options.licence,
        network=options.network,
        driving_point=options.driving_point,
        stopped_sweeps=options.stopped_sweeps,
    )


def arguments_of(options: argparse.Namespace) -> list[str]:
    """Sources and options as they would be typed, without those that do not change the recordings."""
    from bayes_impedance.commands.arguments import option_names

    words = [str(source) for source in options.sources]
    for name, text in option_names("import").items():
        value = getattr(options, name, None)
        if name in _NOT_RECORDED or value is None or value is False or value == [] or value == "":
            continue
        if value is True:
            words.append(text)
        elif isinstance(value, list):
            words += [text, *map(str, value)]
        else:
            # One word, because a value may begin with a minus.
            words.append(f"{text}={value}")
    return words


def recorded_digests(dataset: Path) -> dict[str, str]:
    """SHA-256 of every source of a dataset when it was imported, by the file's name."""
    recorded = _recipe(dataset).get("sources")
    entries = [entry for entry in recorded if isinstance(entry, dict)] if isinstance(recorded, list) else []
    return {str(entry.get("file")): str(entry.get("sha256")) for entry in entries}


def recorded_arguments(dataset: Path) -> list[str]:
    """Arguments with which a dataset was imported.

    Raises
    ------
    InputError
        If its dataset.toml has no recipe of an import.
    """
    words = _recipe(dataset).get("arguments")
    if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
        raise InputError(f"{dataset}: has no arguments of an import; give SOURCE and options instead of --again")
    return words


def _recipe(dataset: Path) -> dict[str, Any]:
    from bayes_impedance.runtime.input_files import read_toml

    file = dataset / "dataset.toml" if dataset.is_dir() else dataset
    recipe = read_toml(file, "a dataset.toml that 'import' has written").get("import")
    return recipe if isinstance(recipe, dict) else {}
