"""The network with everything that was found missing, in the one notation of networks.

An effect of the catalogue acts at a place of the network; each has a form in the language of networks
(:data:`bayes_impedance.network.constructs.CONSTRUCTS`), so that what a diagnosis proposes can be fitted, compared and
exported like any other network:

==================  =======================================  =====================================
effect              where it differs between people          where it is the same for all
==================  =======================================  =====================================
add (m, r, k)       place|m9, place|r9, place|n9             offset[m9*](place), of either sign
delay               delay[d9](place)                         delay[d9*](place)
highpass, lowpass   highpass[f9](place), lowpass[t9](place)  with *
power               p9^a9 in the spring's place              p9*^a9*
hysteresis          hysteretic[e9](place)                    with *
line                line_free[m9](place)                     with *
free_line           line_fixed[element](n9) in its place     with *
beside_power        place|p9^a9                              with *
relaxation          place|(r9-n9)                            with *
resonator           place|(m9-(n9|r9))                       with *
bypass              place|r9|n9                              with *
reflex              reflex[k9, d9, f9](place), with r9 too   with *
squeeze_film        squeeze_film[r9, t9](place)              with *
semi_inductance     place|p9^b9                              with *
series_compliance   place-n9                                 with *
series_layer        place-(r9|n9)                            with *
==================  =======================================  =====================================

Where only the coefficient of an effect differs, its shapes (an exponent, a latency) are the same for all; a time
constant or a resonance becomes elements that differ. What changes during the sweep or with the amplitude, and
structures of the population, are no networks.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from string import Formatter

from bayes_impedance.diagnosis.fit.model import TEMPORARY_LABEL, Addition, Model
from bayes_impedance.network.notation import Network, Place, parse
from bayes_impedance.network.operations import TRAITS, Operation
from bayes_impedance.network.parameters import Symbol

_MARK = "effect_place_"
_OWN = "own_"
"""Beginning of a field that belongs to what is at the place."""

_ELEMENTS = "mnr"
_ELEMENT_OF_UNIT = {"k": "n"}
"""Letter of the element beside a place whose impedance has a unit: a stiffness is a spring."""


@dataclass(frozen=True)
class ExtendedNetwork:
    """A network with effects in it.

    Attributes
    ----------
    network : Network
    symbols : tuple of dict
        For each addition of the model, names in the network by the letters in which the operation is written
        (:attr:`bayes_impedance.network.operation_traits.Traits.written`); empty if it is no network.
    """

    network: Network
    symbols: tuple[dict[str, str], ...]


def extended_network(model: Model, shared: Collection[str] = ()) -> ExtendedNetwork:
    """The network with all additions of a model that are networks; the others are :func:`no_networks`.

    Parameters
    ----------
    model : Model
    shared : collection of str
        Parameters that the model holds, and that are to be estimated, the same for everybody.
    """
    tree, kernel = model.kernel.network, model.kernel
    additions = dict(zip(kernel.operations, _additions_of(model), strict=True))
    names = _Names(tree)
    symbols: list[dict[str, str]] = [{} for _ in model.additions]
    for p in model.parameters:
        if not model.additions[p.addition].effect.operation:  # a branch has its elements already
            symbols[p.addition][p.name] = p.name
    paths = sorted({operation.path for operation in kernel.operations}, key=lambda path: -len(path))
    marks = dict[tuple[int, ...], str]()
    for k, path in enumerate(paths):
        # Labels stay where they are when other parts of the network change.
        there = tree.at(Place(path, ""))
        marks[path] = there.label or f"{_MARK}{k}"
        tree = tree.replaced(Place(path, ""), there.labelled(marks[path]))
    for path in paths:  # the innermost first
        place = Place(_path_of(tree, marks[path]), "")
        changed = tree.at(place)
        if _is_temporary(marks[path]):
            changed = tree.at(place).labelled(None)
        for operation in kernel.operations:
            if operation.path == path and TRAITS[operation.name].written:
                own = _symbols(operation, model.additions[additions[operation]], names)
                symbols[additions[operation]] = {letter: symbol.name for letter, symbol in own.items()}
                changed = parse(_written(operation, model.additions[additions[operation]]).format(z=changed, **own))
        tree = tree.replaced(place, changed)
    network = _without_marks(tree.sharing({p.name for p in model.parameters if p.shared} | set(shared)))
    return ExtendedNetwork(network, tuple(symbols))


def no_networks(model: Model) -> tuple[str, ...]:
    """Ids of the additions of a model that have no form in the language of networks."""
    return tuple(
        sorted({a.effect.id for a in model.additions if a.effect.operation and not TRAITS[a.effect.operation].written})
    )


def _additions_of(model: Model) -> list[int]:
    """The number of the addition to which each operation belongs."""
    by_name = {p.name: p.addition for p in model.parameters}
    return [by_name[operation.parameters[0]] for operation in model.kernel.operations]


def _written(operation: Operation, addition: Addition) -> str:
    """The changed place, with the letters of the addition's unit."""
    traits = TRAITS[operation.name]
    unit = addition.effect.coefficients[0].unit
    written = (addition.pooling == "shared" and traits.written_shared) or traits.written
    return written.replace("{element}", f"{{{_ELEMENT_OF_UNIT.get(unit, unit)}}}").replace("{unit}", f"{{{unit}}}")


def _symbols(operation: Operation, addition: Addition, names: _Names) -> dict[str, Symbol]:
    """A name for each letter with which the operation is written."""
    fields = [field for _, field, _, _ in Formatter().parse(_written(operation, addition)) if field and field != "z"]
    symbols, first = dict[str, Symbol](), True
    for field in fields:
        letter = field.removeprefix(_OWN)
        if letter != field:
            shared = False
        elif first or letter in _ELEMENTS:  # a coefficient
            shared, first = addition.pooling == "shared", False
        else:
            shared = addition.pooling != "free"
        symbols[field] = Symbol(names.new(letter), shared=shared)
    return symbols


class _Names:
    """Names that are free in a network."""

    def __init__(self, network: Network) -> None:
        self.taken = {p.name for p in network.parameters} | {n.label for _, n in network.walk() if n.label}

    def new(self, letter: str) -> str:
        number = next(k for k in range(1, len(self.taken) + 2) if f"{letter}{k}" not in self.taken)
        self.taken.add(f"{letter}{number}")
        return f"{letter}{number}"


def _is_temporary(label: str) -> bool:
    return label.startswith((_MARK, TEMPORARY_LABEL))


def _path_of(network: Network, label: str) -> tuple[int, ...]:
    return next(path for path, node in network.walk() if node.label == label)


def _without_marks(network: Network) -> Network:
    parts: Sequence[Network] = [_without_marks(part) for part in network.parts]
    label = network.label
    kept = None if label is None or _is_temporary(label) else label
    bare = network.labelled(None)
    return (bare.with_parts(parts) if parts else bare).labelled(kept)
