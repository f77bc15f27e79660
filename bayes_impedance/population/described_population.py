"""Virtual populations from files: the summary of a fit, or the truth of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bayes_impedance.errors import InputError
from bayes_impedance.population.simulate import VirtualPopulation, require_usable_population
from bayes_impedance.runtime.user_table import UserTable, number_in, shown, text_in

_ELEMENT_KEYS = ("central", "dispersion_between_persons", "dispersion_between_repetitions", "contact_force_exponent")
_TRUTH_KEYS = ("seed", "network", "elements", "correlation", "noise", "distribution")
_DISTRIBUTION_KEYS = (
    *("name", "degrees_of_freedom", "second_group_share", "distance", "difference"),
    *("dispersion_between_persons_is", "prior"),
)


def population_from(described: Mapping[str, Any], where: str) -> VirtualPopulation:
    """The population that a fit's summary or a simulation's truth describes.

    Parameters
    ----------
    described : mapping
        Contents of ``summary.json`` or ``truth.json``.
    where : str
        Name of the file, for messages.

    Raises
    ------
    InputError
        If it does not describe a population, or leaves elements undetermined.
    """
    # A fit's summary has many other keys; a file written by hand in the form of truth.json has only these.
    table = UserTable(described, where, _TRUTH_KEYS, tolerant=isinstance(described, Mapping) and "schema" in described)
    elements = table["elements"]
    if not isinstance(elements, Mapping) or not elements:
        raise InputError(
            f"{where}: does not describe a population (elements is {shown(elements)}, but must be a table)"
        )
    rows = {
        str(name): UserTable(row, f"{where}: element {shown(str(name))}", _ELEMENT_KEYS, tolerant="schema" in described)
        for name, row in elements.items()
        if not (isinstance(row, Mapping) and row.get("combined_in"))  # replaced in the network by another element
    }
    if described.get("subjects") == 1:
        raise InputError(
            f"{where}: is the fit of one subject, which does not say how subjects differ; name a fit of more, or a "
            "truth.json with dispersions"
        )
    central = {name: _middle(row, "central") for name, row in rows.items()}
    unknown = [name for name, value in central.items() if value is None]
    if unknown:
        raise InputError(f"{where}: element '{unknown[0]}' has no value; fit recordings that determine it")
    noise = UserTable(table.get("noise", {}), f"{where}: noise", ("relative_sd", "corner_hz"))
    population = VirtualPopulation(
        network=table.text("network"),
        central={name: value for name, value in central.items() if value is not None},
        between_persons={name: _middle(row, "dispersion_between_persons") or 0.0 for name, row in rows.items()},
        between_repetitions={name: _middle(row, "dispersion_between_repetitions") or 0.0 for name, row in rows.items()},
        correlation=_correlations(table["correlation"], where),
        noise=noise.number("relative_sd", 0.01),
        noise_corner_hz=noise.number("corner_hz", 8.0),
        **_distribution(table, where),
    )
    try:
        require_usable_population(population)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return population


def _correlations(content: object, where: str) -> dict[tuple[str, str], float]:
    if not isinstance(content, list):
        raise InputError(f'{where}: correlation is {shown(content)}, but must be a list such as [["n1", "r1", -0.4]]')
    found = {}
    for i, row in enumerate(content, 1):
        if not isinstance(row, list) or len(row) < 3:
            raise InputError(f"{where}: entry {i} of correlation must hold two elements and a number")
        a, b = (text_in(name, f"{where}: an element in entry {i} of correlation") for name in row[:2])
        found[a, b] = number_in(row[2], f"{where}: correlation of {shown(a)} and {shown(b)}", at_least=-1, at_most=1)
    return found


def _distribution(described: UserTable, where: str) -> dict[str, Any]:
    """What is said of the distribution of people, as arguments of a virtual population."""
    if "distribution" not in described:
        return {}
    table = UserTable(described["distribution"], f"{where}: distribution", _DISTRIBUTION_KEYS)
    if "second_group_share" not in table:
        value = _middle(table, "degrees_of_freedom")
        return {} if value is None else {"degrees_of_freedom": value}
    share, difference = _middle(table, "second_group_share"), table["difference"]
    if share is None or not isinstance(difference, Mapping):
        raise InputError(f"{where}: distribution does not say how two groups differ; name a fit that is reliable")
    own = UserTable(difference, f"{where}: distribution: difference", tuple(map(str, difference)))
    return {
        "second_group_share": share,
        "group_difference": {str(name): _middle(own, str(name)) or 0.0 for name in difference},
    }


def _middle(row: UserTable, key: str) -> float | None:
    """A number, or the median of an interval; None where it is not known."""
    value = row[key]
    if isinstance(value, Mapping):
        value = UserTable(value, f"{row.where(key)}: {key}", ("median", "q05", "q95"), tolerant=True)["median"]
    return None if value is None else number_in(value, f"{row.where(key)}: {key}")
