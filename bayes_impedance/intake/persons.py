"""A table of the persons' covariates, in any of the formats of tables, for a dataset's ``subjects.csv``."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bayes_impedance.errors import InputError
from bayes_impedance.intake.columns import columns_of
from bayes_impedance.intake.formats.registry import read_file
from bayes_impedance.intake.text_tables import TableFormat
from bayes_impedance.recordings.csv_table import parse_covariates
from bayes_impedance.runtime.user_table import shown
from bayes_impedance.units import counted


def covariates_of_subjects(file: Path, names: Sequence[str], how: TableFormat) -> tuple[bytes, list[str]]:
    """Content of ``subjects.csv`` for the subjects of a dataset, and what was guessed or left out.

    Parameters
    ----------
    file : Path
        A table with a column of subjects and any others.
    names : sequence of str
        Subjects of the dataset, in its order.
    how : TableFormat

    Raises
    ------
    InputError
        If there is no column of subjects, a subject is there twice, or none of the dataset's is there.
    """
    (contents, *_) = read_file(file, replace(how, of_words=True))
    found, _ = columns_of(contents, {})  # its remark says that other columns are not used, and here they are
    if "subject" not in found:
        raise InputError(
            f"{file}: no column is clearly the subject (found: {', '.join(contents.names[:12])}); name one subject"
        )
    column = found["subject"].variable
    who = contents.texts(column)
    twice = next((i for i, name in enumerate(who) if name in who[:i]), None)
    if twice is not None:
        raise InputError(f"{contents.where(twice)}: subject {shown(who[twice])} is there twice; keep one row for each")
    others = [variable for variable in contents.variables if variable is not column]
    cells = {variable.name: contents.texts(variable) for variable in others}
    rows = {name: [values[i] for values in cells.values()] for i, name in enumerate(who)}
    unknown = [name for name in names if name not in rows]
    if len(unknown) == len(names):
        raise InputError(
            f"{file}: none of the subjects of the recordings is in it, e.g. {shown(names[0])}; use the same names"
        )
    told = (
        [f"{file}: nothing is known of {', '.join(unknown[:5])}" + (", ..." if unknown[5:] else "")] if unknown else []
    )
    surplus = [name for name in who if name not in names]
    if surplus:
        told.append(f"{file}: there are no recordings of {len(surplus)} of its {counted(len(who), 'subject')}")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["subject", *cells])
    if contents.decimal == ",":
        rows = {name: [cell.replace(",", ".") for cell in row] for name, row in rows.items()}
    writer.writerows([[name, *rows.get(name, [""] * len(cells))] for name in names])
    content = text.getvalue().encode()
    parse_covariates(content, str(file))  # refuses what a dataset could not have
    guess = f"{file}: guessed from the names: {found['subject'].told}, and the other columns are covariates"
    return content, [guess, *contents.notes, *told]
