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
beside_power        place|p9^a9                              with *
relaxation          place|(r9-n9)                            with *
resonator           place|(m9-(n9|r9))                       with *
bypass              place|r9|n9                              with *
reflex              reflex[k9, d9, f9](place)                with *
series_compliance   place-n9                                 with *
series_layer        place-(r9|n9)                            with *
==================  =======================================  =====================================

Where only the coefficient of an effect differs, its shapes (an exponent, a latency) are the same for all; a time
constant or a resonance becomes elements that differ. A change during the sweep and structures of the population are no
networks.
"""

from __future__ import annotations

from collections.abc import Sequence
from string import Formatter

from bayes_impedance.diagnosis.fit.model import TEMPORARY_LABEL, Addition, Model
from bayes_impedance.network.notation import Network, Place, parse
from bayes_impedance.network.operations import TRAITS, Operation
from bayes_impedance.network.parameters import Symbol

_MARK = "effect_place_"
_ELEMENT_OF_UNIT = {"k": "n"}
"""Letter of the element beside a place whose impedance has a unit: a stiffness is a spring."""


def extended_network(model: Model) -> Network:
    """The network with all additions of a model that are networks; the others are :func:`no_networks`.

    Parameters
    ----------
    model : Model
    """
    tree, kernel = model.kernel.network, model.kernel
    additions = dict(zip(kernel.operations, _additions_of(model), strict=True))
    names = _Names(tree)
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
                changed = _changed(changed, operation, additions[operation], names)
        tree = tree.replaced(place, changed)
    return _without_marks(tree.sharing({p.name for p in model.parameters if p.shared}))


def no_networks(model: Model) -> tuple[str, ...]:
    """Ids of the additions of a model that have no form in the language of networks."""
    return tuple(sorted({a.effect.id for a in model.additions if not TRAITS[a.effect.operation].written}))


def _additions_of(model: Model) -> list[Addition]:
    """The addition to which each operation belongs."""
    by_name = {p.name: model.additions[p.addition] for p in model.parameters}
    return [by_name[operation.parameters[0]] for operation in model.kernel.operations]


def _changed(node: Network, operation: Operation, addition: Addition, names: _Names) -> Network:
    """A place with the operation, written as the table of operations has it."""
    everything, shapes = addition.pooling == "shared", addition.pooling != "free"
    traits = TRAITS[operation.name]
    written = (everything and traits.written_shared) or traits.written
    unit = addition.effect.coefficients[0].unit
    letters = {"element": _ELEMENT_OF_UNIT.get(unit, unit), "unit": unit}
    fields = [field for _, field, _, _ in Formatter().parse(written) if field and field != "z"]
    symbols = {}
    for k, field in enumerate(fields):
        letter = letters.get(field, field)
        shape = k > 0 and letter not in "mnr"
        symbols[field] = Symbol(names.new(letter), shared=everything or (shape and shapes))
    return parse(written.format(z=node, **symbols))


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
