"""The work of ``check``, and what every command asks of recordings before it uses them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayes_impedance.errors import InputError

if TYPE_CHECKING:
    from bayes_impedance.population.given_prior import GivenPrior
    from bayes_impedance.quality.findings import Finding
    from bayes_impedance.recordings.files import Recordings

_MOST = 0.5
"""Share of the subjects above which a fault is one of all. By choice."""


def check_dataset(
    dataset: Path, network: str | None = None
) -> tuple[dict[str, Any], tuple[str, ...], tuple[Finding, ...]]:
    """Contents of a dataset, changes made when it was read, and its anomalies.

    Raises
    ------
    InputError
        If it cannot be read, recordings are copies of one another, or its network or the given one describes it as
        another quantity than impedance.
    """
    from bayes_impedance.quality.checks import check_recordings, describe
    from bayes_impedance.quality.findings import of_all
    from bayes_impedance.recordings.files import read_recordings

    recordings = distinct(read_recordings(dataset).in_memory(), dataset)
    doubt = require_quantity(recordings, network)
    doubts = () if doubt is None else (of_all("other_quantity", doubt),)
    return describe(recordings), recordings.warnings, (*doubts, *check_recordings(recordings))


def distinct(recordings: Recordings, dataset: Path) -> Recordings:
    """The recordings of a dataset, refused if they are copies of one another.

    Raises
    ------
    InputError
        If there are copies; it names the dataset and the subjects.
    """
    from bayes_impedance.quality.copies import require_distinct

    require_distinct(replace(recordings, title=str(dataset)))
    return recordings


def require_quantity(recordings: Recordings, network: str | None) -> str | None:
    """Refuse another quantity than impedance; not decided without a network, or with one that cannot be read.

    Returns
    -------
    str or None
        A doubt, in a sentence.

    Raises
    ------
    InputError
        If the network describes the recordings as another quantity, and not as impedance.
    """
    from bayes_impedance.network.notation import parse

    if network is None:
        try:
            parse(recordings.network or "")
        except InputError:  # it is a finding of `check`, and a fit refuses it
            return None
    from bayes_impedance.population.other_quantity import require_impedance  # takes seconds to import

    return require_impedance(recordings, network)


def require_said_quantity(recordings: Recordings, assumed: Collection[str]) -> None:
    """Refuse what nothing says to be an impedance but a letter, and what would be passive as another quantity.

    Such curves may also be impedances behind a filter of one channel
    (:mod:`bayes_impedance.population.other_quantity`), so that the user is asked. Of 300 random structures each (those
    of :mod:`bayes_impedance.recordings.driving_point`) none is asked about, 1 % if late, 9 % behind a filter of first
    order (masses nearly always), and of accelerance and dynamic stiffness 46 %.

    The recordings' own network is no answer: where it decides, :func:`require_quantity` has refused them, and a passive
    one describes such impedances behind a filter only. Of one with a delay or filter inside nothing is asked.

    Parameters
    ----------
    recordings : Recordings
    assumed : collection of str
        Subjects of whom neither a unit, nor a word, nor an option says the quantity.

    Raises
    ------
    InputError
        If most subjects are such.
    """
    forms = None if _turns_the_phase(recordings.network) else _passive_as(recordings, assumed)
    if forms is None:
        return
    options = " or ".join(f"--form '{form}'" for form in forms)
    raise InputError(
        f"{recordings.title}: nothing but the letter Z of a name says that these are impedances, and Re z is negative, "
        f"which that of a passive load is not; as {' or '.join(forms)} they would be passive: give {options}, or, if "
        "they are impedances behind a filter of one channel, --form impedance"
    )


def doubt_of_quantity(recordings: Recordings, of_signals: bool) -> str | None:
    """A remark on what is said to be impedance, and would be passive as another quantity.

    It may be that, or impedance behind a filter of one channel: nothing but the user, or a network, can tell.

    Parameters
    ----------
    recordings : Recordings
    of_signals : bool
        Whether they were estimated from signals, whose units say the quantity.
    """
    if recordings.quantity is not None or _turns_the_phase(recordings.network):
        return None
    forms = _passive_as(recordings, recordings.names)
    if forms is None:
        return None
    option = "correct channel and unit of --force and --motion" if of_signals else "give it with --form"
    return (
        f"Re z is negative, and as {' or '.join(forms)} these recordings would be those of a passive load: if the unit "
        f"or name of the values is wrong, {option}; if they are impedances behind a filter of one channel, nothing is "
        "to be done, and 'bayes-impedance diagnose' finds that"
    )


def _passive_as(recordings: Recordings, names: Collection[str]) -> tuple[str, str] | None:
    """The quantities as which most subjects would be passive, if Re z of these is clearly negative; else None."""
    from bayes_impedance.quality.negative_real_part import other_quantity

    found = [other_quantity(one) for one in recordings.subjects if one.name in names]
    sizes = [own.size for own in found if own is not None]
    if len(sizes) <= _MOST * len(recordings):
        return None
    return ("apparent mass", "receptance") if sum(sizes) > 0 else ("accelerance", "dynamic stiffness")


def _turns_the_phase(network: str | None) -> bool:
    """Whether a network has something inside that makes Re z negative; not if it cannot be read."""
    from bayes_impedance.network.notation import parse
    from bayes_impedance.network.passivity import known_passive

    try:
        return not known_passive(parse(network or ""))
    except InputError:
        return False


def require_prior(recordings: Recordings, network: str | None, prior: GivenPrior | None) -> None:
    """Refuse a given prior that does not belong to the network.

    Raises
    ------
    InputError
        If it names another element, or says what is impossible.
    """
    if prior is None:
        return
    from bayes_impedance.population.natural_scales import default_prior
    from bayes_impedance.population.requirements import checked_model

    kernel = checked_model(recordings, network).kernel
    prior.applied(default_prior(kernel, recordings), kernel, recordings.unit)
