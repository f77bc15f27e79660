"""Prior knowledge of the user: values of elements and how far people may differ, in place of the default prior.

As a file of TOML, in which everything is optional:

.. code-block:: toml

    concentration = 4.0        # LKJ, of the correlations between people
    dispersion = 0.5           # scale of the half-normal prior of all dispersions, in natural logarithms
    slope = 0.5                # standard deviation of the effect of one standard deviation of a covariate
    [elements.m1]
    centre = 0.02              # prior median of the population's central value
    unit = "kg"                # for information; checked
    scale = 0.4                # standard deviation of its natural logarithm
    dispersion = 0.3           # of this element
    kind = "student_t"         # of the central value's prior: tails that recordings may overrule; or "normal"

Of elements that could be mistaken for each other, such as those of two branches that are written alike, it may say
which population's central value is the lowest, the next one and so on (:mod:`bayes_impedance.population.order`), before
the tables of elements:

.. code-block:: toml

    order = [["n1", "n2"], ["r3", "r4", "r5"]]

What is not given keeps its default (:mod:`bayes_impedance.population.natural_scales`). The scale of a parameter is that
on which it is estimated: the natural logarithm of an element, the logit of an exponent, the value itself of a signed
parameter, in its unit.

A prior is no knowledge that replaces recordings: an element that they do not determine still has no number.
"""

from __future__ import annotations

import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from bayes_impedance.display import Chosen
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.population.order import order_in
from bayes_impedance.population.ordered_centres import Centres
from bayes_impedance.population.prior import Prior
from bayes_impedance.runtime.input_files import read_toml
from bayes_impedance.runtime.user_table import UserTable, hint, number_in, shown, text_in

_NUMBERS = ("concentration", "dispersion", "slope")
_KEYS = ("elements", *_NUMBERS, "order")
_ELEMENT_KEYS = ("centre", "unit", "scale", "dispersion", "kind")
KINDS = ("normal", "student_t")
"""Distributions of a central value on the scale on which it is estimated; of an element "normal" is lognormal."""
LARGEST_SCALE = 10.0
"""Largest standard deviation of a logarithm: a factor of twenty thousand either way. By choice: a wider prior says
nothing, and is a mistaken unit more often than not."""


@dataclass(frozen=True, kw_only=True, repr=False)
class ElementPrior(Chosen):
    """What is known of one element of the population.

    Attributes
    ----------
    centre : float, optional
        Prior median of the population's central value, in `unit`.
    unit : str, optional
        Checked against the element's unit if it is given.
    scale : float, optional
        Standard deviation of the central value's natural logarithm (on the scale on which a parameter is estimated).
    dispersion : float, optional
        Scale of the half-normal priors of both dispersions.
    kind : str, optional
        Distribution of the central value's natural logarithm: ``"normal"``, the default, or ``"student_t"`` with four
        degrees of freedom, of which `scale` is the scale. Where recordings contradict it, they decide.
    """

    centre: float | None = None
    unit: str | None = None
    scale: float | None = None
    dispersion: float | None = None
    kind: str | None = None

    def __post_init__(self) -> None:
        if self.centre is not None:
            number_in(self.centre, "prior: centre")
        if self.unit is not None:
            text_in(self.unit, "prior: unit")
        for name in ("scale", "dispersion"):
            value = getattr(self, name)
            if value is not None:
                number_in(value, f"prior: {name}", above=0, at_most=LARGEST_SCALE)
        if self.kind is not None and self.kind not in KINDS:
            raise InputError(f"prior: kind is {shown(self.kind)}, but must be one of {', '.join(KINDS)}")


@dataclass(frozen=True, kw_only=True, repr=False)
class GivenPrior(Chosen):
    """Prior of a user: everything that is not given keeps its default.

    >>> prior = GivenPrior(elements={"m1": ElementPrior(centre=0.02, unit="kg", scale=0.4)}, concentration=4.0)
    >>> prior.elements["m1"].scale
    0.4

    Attributes
    ----------
    elements : mapping of str to ElementPrior
    concentration : float, optional
        LKJ concentration of the correlations between people.
    dispersion : float, optional
        Scale of the half-normal priors of all dispersions that are not given for an element.
    slope : float, optional
        Standard deviation of the effect of one standard deviation of a covariate on a log element.
    order : sequence of sequence of str
        Lists of elements of one kind whose central values increase; of one person, the person's own values. An element
        may be in one list only.
    file : str
        Where it was read from, for messages; it takes no part in comparisons.

    Raises
    ------
    InputError
        If a number is not in its range, or a list of the order is none.
    """

    elements: Mapping[str, ElementPrior] = field(default_factory=dict)
    concentration: float | None = None
    dispersion: float | None = None
    slope: float | None = None
    order: Sequence[Sequence[str]] = ()
    file: str = field(default="", compare=False, repr=False)

    def __post_init__(self) -> None:
        for name, value in self.elements.items():
            if not isinstance(value, ElementPrior):
                raise InputError(f"prior: elements[{shown(name)}] is {shown(value)}, but must be an ElementPrior")
        # In one order, because checkpoints know a fit by the text of its settings.
        object.__setattr__(self, "elements", dict(sorted(self.elements.items())))
        for name in _NUMBERS:
            value = getattr(self, name)
            if value is not None:
                number_in(value, f"prior: {name}", above=0)
        object.__setattr__(self, "order", _lists(self.order))

    def text(self) -> str:
        """As JSON, from which :meth:`of_text` makes the same prior."""
        content = asdict(self)
        del content["file"]
        if not self.order:
            del content["order"]
        for own in content["elements"].values():  # checkpoints of earlier versions have no kind
            if own["kind"] is None:
                del own["kind"]
        return json.dumps(content)

    @classmethod
    def of_text(cls, text: str) -> GivenPrior | None:
        """The prior of a text; None if it is empty."""
        if not text:
            return None
        content = json.loads(text)
        elements = {name: ElementPrior(**own) for name, own in content.pop("elements").items()}
        return cls(elements=elements, **content)

    def only(self, names: Collection[str]) -> GivenPrior:
        """What it says of some of the elements, and of all of them."""
        order = [[name for name in own if name in names] for own in self.order]
        return replace(
            self,
            elements={name: own for name, own in self.elements.items() if name in names},
            order=[own for own in order if len(own) > 1],
        )

    def applied(self, prior: Prior, kernel: Kernel, unit: str) -> Prior:
        """Replace what is given.

        Parameters
        ----------
        prior : Prior
            The default prior, and what a calibration says.
        kernel : Kernel
            Of the network that is fitted.
        unit : str
            Of the impedance.

        Raises
        ------
        InputError
            If an element is not in the network or is the calibration's, its unit or value is impossible, or the order
            cannot be.
        """
        try:
            return self._applied(prior, kernel, unit)
        except InputError as error:
            raise InputError(f"{self.file}: {error}" if self.file else str(error)) from None

    def _applied(self, prior: Prior, kernel: Kernel, unit: str) -> Prior:
        centre, sd = prior.centre.copy(), prior.centre_sds.copy()
        dispersion = prior.dispersion_sds.copy() if self.dispersion is None else np.full(centre.size, self.dispersion)
        heavy = prior.tailed.copy()
        for name, own in self.elements.items():
            if name not in kernel.elements:
                raise InputError(
                    f"prior: {shown(name)} is not an element of the fitted network ({hint(name, kernel.elements)}); "
                    "leave it out, or give the network"
                )
            row = kernel.elements.index(name)
            if prior.known[row]:
                raise InputError(f"prior: {name} has the prior of the recordings' calibration; leave it out")
            parameter = kernel.parameters[row]
            if own.unit is not None and own.unit != parameter.unit(unit):
                raise InputError(
                    f"prior: {name} is given in {shown(own.unit)}, but must be in {parameter.unit(unit) or 'no unit'}; "
                    "convert its centre"
                )
            size = kernel.scales.get(name, 1.0) if parameter.link == SIGNED else 1.0
            if own.centre is not None:
                centre[row] = float(parameter.u(own.centre)) / size
            if own.scale is not None:
                sd[row] = own.scale / size
            if own.dispersion is not None:
                if parameter.shared:
                    raise InputError(f"prior: {name} is the same for all and has no dispersion; leave it out")
                dispersion[row] = own.dispersion / size
            if own.kind == "student_t":
                heavy[row] = True
        result = replace(
            prior,
            centre=centre,
            centre_sd=sd,
            heavy=heavy if heavy.any() else None,
            dispersion_sd=dispersion,
            concentration=self.concentration or prior.concentration,
            slope_sd=self.slope or prior.slope_sd,
            order=order_in(self.order, kernel, self.file or "prior"),
        )
        Centres(result).require_possible()
        return result


def read_prior(file: str | os.PathLike[str]) -> GivenPrior:
    """Read a prior from a file of TOML in the form above.

    Raises
    ------
    InputError
        If the file cannot be read, has an unknown key, or a value that is not possible.
    """
    table = UserTable(read_toml(Path(file), "a prior"), str(file), _KEYS)
    given = table.get("elements", {})
    if not isinstance(given, Mapping):
        raise InputError(f"{file}: elements is {shown(given)}, but must be tables such as [elements.m1]")
    rows = {str(name): UserTable(row, f"{file}: elements.{name}", _ELEMENT_KEYS) for name, row in given.items()}
    if not rows and not any(key in table for key in _KEYS):
        raise InputError(f"{file}: says nothing; give {', '.join(_KEYS)}, or leave it out")
    try:
        return GivenPrior(
            elements={
                name: ElementPrior(**{key: row.get(key, None) for key in _ELEMENT_KEYS}) for name, row in rows.items()
            },
            **{key: table.get(key, None) for key in _NUMBERS},
            order=table.get("order", ()),
            file=str(file),
        )
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _lists(given: object) -> tuple[tuple[str, ...], ...]:
    """Lists of two or more names, each name once."""
    form = 'lists of two or more elements, the lowest first, such as [["n1", "n2"]]'
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise InputError(f"prior: order is {shown(given)}, but must be {form}")
    for own in given:
        if isinstance(own, str) or not isinstance(own, Sequence) or len(own) < 2:
            raise InputError(f"prior: order has {shown(own)} in it, but must be {form}")
        for name in own:
            text_in(name, "prior: an element in order")
    names = [name for own in given for name in own]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(
            f"prior: order names {shown(twice[0])} twice; write what belongs together as one list, the lowest first"
        )
    return tuple(tuple(own) for own in given)
