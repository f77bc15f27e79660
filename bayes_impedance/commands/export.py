"""The job behind ``bayes-impedance export``: from a finished fit to files for designers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.atomic_files import write_text
from bayes_impedance.runtime.output_folder import output_folder
from bayes_impedance.runtime.user_table import number_in, shown
from bayes_impedance.units import LARGEST_ELEMENT

if TYPE_CHECKING:
    from bayes_impedance.design.circuits.equivalent import Equivalent
    from bayes_impedance.design.loop.device import Device
    from bayes_impedance.design.users import Users
    from bayes_impedance.results.result import Result
    from bayes_impedance.runtime.progress import Progress

FILES = {
    "users": ("users.csv", "users.json", "curves.csv"),
    "transfer": ("transfer.json", "transfer.txt"),
    "spice": ("users.lib", "monte_carlo.lib", "sweep.cir"),
    "people": ("people.csv",),
    "mat": ("users.mat",),
    "modelica": ("Users.mo",),
    "stability": ("stability.json", "stability.csv", "limits.csv", "transparency.csv"),
}
PICTURES = {"users": ("users",), "stability": ("stability", "worst_user", "transparency")}
"""Files and names of pictures of each product."""
PRODUCTS = tuple(FILES)
DESIGN_INPUTS = tuple(product for product in PRODUCTS if product != "people")
"""What is written if nothing is asked for."""
_POINTS = 201
"""Points of the logarithmic grid of exported curves. By choice: 67 per decade of the paper's band."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options of an export.

    Attributes
    ----------
    what : tuple of str
        Names from :data:`PRODUCTS`.
    users : int
        Virtual users to draw.
    seed : int
    spanning : int
        Size of the set that spans the 95 % region.
    repetitions : bool
        Users are single repetitions, not means over many repetitions.
    assume : mapping of str to float
        Values of elements that the recordings do not determine.
    device : Path or None
        TOML file; None for the PHANTOM.
    damping, share : float
        Virtual damping in N s/m, and share of users, for the stability limit.
    grid : int
        Gains on each axis of the stability map.
    pictures : bool
    workers : int
        Threads.
    overwrite : bool
        Replace files of these names that this package did not write.
    unreliable : bool
        Export a fit that must not be used; every file says so.
    """

    what: tuple[str, ...] = DESIGN_INPUTS
    users: int = 1000
    seed: int = 1
    spanning: int = 8
    repetitions: bool = False
    assume: Mapping[str, float] = field(default_factory=dict)
    device: Path | None = None
    damping: float = 0.0
    share: float = 0.99
    grid: int = 40
    pictures: bool = True
    workers: int = 2
    overwrite: bool = False
    unreliable: bool = False


def export_result(
    result: Path, out: Path, options: ExportOptions, progress: Progress
) -> tuple[list[Path], list[str], str | None]:
    """Write design inputs.

    Parameters
    ----------
    result : Path
        Folder of a finished fit, or its ``result.nc``.
    out : Path
        Folder for the files.
    options : ExportOptions
    progress : callable

    Returns
    -------
    files : list of Path
    notes : list of str
        What the users lack of the fit, and what could not be written of them.
    answer : str or None
        The sentence of the stability analysis, if it was requested.

    Raises
    ------
    InputError
        If the fit cannot be used, or an option contradicts it.
    """
    from bayes_impedance.design.loop.device import PHANTOM, read_device
    from bayes_impedance.results.result import RESULT_FILE, load_result

    unknown = sorted(set(options.what) - set(PRODUCTS))
    if unknown:
        raise InputError(f"'{unknown[0]}' cannot be exported: choose {', '.join(PRODUCTS)}")
    if not 0 < options.share < 1:
        raise InputError(f"share is {options.share:g}: give a number between 0 and 1, such as 0.99")
    if not 0 <= options.damping < float("inf"):
        raise InputError(f"damping is {options.damping:g}: give a virtual damping of zero or more, in N s/m")
    device = PHANTOM if options.device is None else read_device(options.device)
    folder = result.parent if result.name == RESULT_FILE else result
    fit = load_result(folder)
    with output_folder(out, _names(options), options.overwrite):
        return _written(fit, folder, out, device, options, progress)


def _names(options: ExportOptions) -> list[str]:
    """Every file that may be written."""
    pictures = [name for product in options.what for name in PICTURES.get(product, ())] if options.pictures else []
    names = [name for product in options.what for name in FILES[product]]
    return names + [f"{name}.{kind}" for name in pictures for kind in ("svg", "png")]


def _written(
    fit: Result, result: Path, out: Path, device: Device, options: ExportOptions, progress: Progress
) -> tuple[list[Path], list[str], str | None]:
    import numpy as np

    from bayes_impedance.design.answer import design_answer
    from bayes_impedance.design.files import (
        warned,
        write_mat,
        write_modelica,
        write_spice,
        write_stability,
        write_tables,
        write_transfer,
        write_users,
    )
    from bayes_impedance.design.representatives import representatives
    from bayes_impedance.design.users import population_of

    if options.what == ("people",):  # which every fit has, also that of one person
        people, said = _people(fit, out), [*fit.problems, *fit.summary["adequacy"]["misfit"]]
        return [warned(people, said) if said else people], [], None
    population = population_of(fit, options.assume, options.unreliable)
    mechanical = [name for name in ("stability", "modelica") if name in options.what]
    if mechanical and population.unit != "N s/m":
        raise InputError(
            f"{result}: the impedance is in {population.unit}, but a device needs one in N s/m; leave "
            f"{' and '.join(mechanical)} out of --what"
        )
    frequency = np.asarray(fit.coords["frequency_hz"], dtype=float)
    band = float(frequency[0]), float(frequency[-1])
    grid = np.geomspace(*band, _POINTS)
    users = population.draw(options.users, options.seed, repetitions=options.repetitions)
    chosen = representatives(population, users, band, options.spanning)

    answer = None
    made, what, notes = _possible(chosen.users + users, options.what)
    notes = [note for note in (population.note, *notes) if note]
    files = [_people(fit, out)] if "people" in what else []
    if "users" in what:
        files += write_users(out, population, users, chosen, grid)
    if "transfer" in what and made is None:
        files += write_tables(out, users, chosen.users, grid, notes[-1])
    elif "transfer" in what:
        files += write_transfer(out, users, chosen.users, made)
    if "spice" in what:
        files += write_spice(out, population, users, chosen.users, band, made)
    if "mat" in what:
        files += write_mat(out, users, chosen.users, grid, made)
    if "modelica" in what:
        files += write_modelica(out, users, chosen.users, made)
    if "stability" in what:
        answer = design_answer(
            population,
            # Importance weights are defined for persons, not for single repetitions.
            users if not options.repetitions else population.draw(options.users, options.seed),
            device,
            damping=options.damping,
            share=options.share,
            grid=options.grid,
            seed=options.seed,
            workers=options.workers,
            progress=progress,
        )
        files += write_stability(out, answer)
    warnings = [*fit.problems, *fit.summary["adequacy"]["misfit"], *notes]
    if warnings:
        files = [warned(file, warnings) for file in files]
    if options.pictures:
        from bayes_impedance.plots import save_figure, style
        from bayes_impedance.plots.design import felt, stability, users_band, worst_user

        with style():
            figures = {"users": users_band(users, chosen, grid)} if "users" in what else {}
            if answer is not None:
                figures |= {"stability": stability(answer), "worst_user": worst_user(answer, population)}
                last = felt(answer)
                figures |= {} if last is None else {"transparency": last}
            files += [save_figure(figure, out, name) for name, figure in figures.items()]
    return files, notes, None if answer is None else answer.sentence


def _people(fit: Result, out: Path) -> Path:
    """The values of everybody who was recorded."""
    return write_text(out / FILES["people"][0], fit.persons_table(intervals=True).to_csv(lineterminator="\n"))


def _possible(everybody: Users, what: Sequence[str]) -> tuple[Equivalent | None, set[str], list[str]]:
    """Users as elements, the products that can be written of them, and what to say about both."""
    from bayes_impedance.design.circuits.equivalent import NotRealisableError, equivalent, in_loop

    made, left, notes = None, set(what), list[str]()
    as_elements = {"transfer", "spice", "mat", "modelica"}
    if left & {*as_elements, "stability"}:
        try:
            made = equivalent(everybody)
            notes.append(made.note if left & as_elements else "")
        except NotRealisableError as error:
            left -= {"spice", "modelica", "stability"}
            notes.append(
                f"{error}: impedances are exported as tables over frequency, but neither SPICE, Modelica nor stability"
            )
    if "stability" in left:
        try:
            loops = in_loop(everybody)
            notes.append(loops.note and f"in the stability analysis {loops.note}")
        except NotRealisableError as error:
            left -= {"stability"}
            notes.append(f"{error}: stability is not analysed")
    if not left:
        raise InputError(notes[-1])
    return made, left, notes


def assumed(texts: Sequence[str]) -> dict[str, float]:
    """Values of elements from ``name=value``.

    Raises
    ------
    InputError
        If a text has another form.
    """
    found: dict[str, float] = {}
    for text in texts:
        name, sign, number = (part.strip() for part in text.partition("="))
        what = f"--assume {shown(text)}"
        try:
            value: object = float(number)
        except ValueError:
            sign = ""
        if not sign or not name:
            raise InputError(f"{what}: give an element and its value, such as n3=6.8e-7")
        if name in found:
            raise InputError(f"{what}: {shown(name)} has a value already; give one")
        found[name] = number_in(value, f"{what}: the value", at_least=1 / LARGEST_ELEMENT, at_most=LARGEST_ELEMENT)
    return found
