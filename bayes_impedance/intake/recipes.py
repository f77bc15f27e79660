"""Recipes: which columns a program's files have, shipped in ``recipes.toml`` or in a file of the user's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from bayes_impedance.errors import InputError
from bayes_impedance.intake.columns import ROLES
from bayes_impedance.intake.contents import Contents
from bayes_impedance.runtime.input_files import read_toml
from bayes_impedance.runtime.user_table import UserTable, hint, shown, text_in


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """Columns of one kind of file.

    Attributes
    ----------
    name : str
    columns : dict of str to str
        Assignments by role, as with ``--columns``.
    unit : str
        Unit of the values; empty if the file says it.
    form : str
        Form of the values; empty if the unit says it.
    """

    name: str
    columns: dict[str, str]
    unit: str = ""
    form: str = ""

    def applies(self, contents: Contents) -> bool:
        """Whether a file has all of the columns, spelt as the program spells them."""
        names = {name.casefold() for name in contents.names}
        return all(self._plain(text) in names for text in self.columns.values())

    @staticmethod
    def _plain(text: str) -> str:
        return text.partition("[")[0].casefold()


@cache
def shipped() -> dict[str, Recipe]:
    """The recipes of the package by name."""
    return _recipes(read_toml(Path(__file__).with_name("recipes.toml"), "recipes"), "recipes.toml")


def recipe_named(text: str) -> Recipe:
    """A shipped recipe by its name, or that of a TOML file with one table.

    Raises
    ------
    InputError
        If there is none.
    """
    if text in shipped():
        return shipped()[text]
    if not text.endswith(".toml"):
        raise InputError(f"--recipe {shown(text)} is neither a recipe nor a TOML file; {hint(text, shipped())}")
    found = _recipes(read_toml(Path(text), "a recipe"), text)
    if len(found) != 1:
        raise InputError(f"{text}: there are {len(found)} tables, but one recipe is needed; write one, e.g. [mine]")
    return next(iter(found.values()))


def recipe_for(contents: Contents) -> Recipe | None:
    """The shipped recipe whose columns a file has."""
    return next((recipe for recipe in shipped().values() if recipe.applies(contents)), None)


def _recipes(content: dict[str, Any], file: str) -> dict[str, Recipe]:
    found = {}
    for name, entry in content.items():
        table = UserTable(entry, f"{file}, [{name}]", ("about", "columns", "unit", "form"))
        given = table.get("columns", {})
        UserTable(given, f"{file}, [{name}] columns", ROLES)  # refuses unknown roles
        found[name] = Recipe(
            name=name,
            columns={role: text_in(given[role], f"{file}, [{name}] {role}") for role in given},
            unit=table.text("unit", ""),
            form=table.text("form", ""),
        )
    return found
