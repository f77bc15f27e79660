"""Results as tables: pandas DataFrames with units in their ``attrs``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.network.parameters import values_of
from bayes_impedance.results.distribution import is_student_t
from bayes_impedance.results.meanings import MEMBER
from bayes_impedance.units import INTERVAL

if TYPE_CHECKING:
    import pandas as pd

    from bayes_impedance.results.result import Result

PERSON_UNITS = {
    "repetitions": "1",
    "noise_scale": "1",
    "person_relative_rms": "1",
    "person_delta_magnitude": "",
    "person_delta_phase_deg": "deg",
    "pareto_k": "1",
    "effective_draws": "1",
    MEMBER: "1",
}
"""Quantities of a person besides the elements, with their units (empty for the unit of the impedance): number of
repetitions; residual over noise; distance of the person's own network from the mean recording (relative root mean
square, mean in magnitude, mean in phase); Pareto k and effective number of the person's importance draws; of a fit of
two groups, the probability to belong to the second."""


def elements_table(result: Result) -> pd.DataFrame:
    """The population's elements, with the values of ``summary.json``.

    Returns
    -------
    DataFrame
        One row for each element, whose name is the index. Columns unit, identified and marked; then central,
        between_persons and between_repetitions, each a posterior median followed by the ends of its 90 % interval
        (``_q05``, ``_q95``), NaN where there is no number. The central value is in the row's unit;
        ``attrs["units"]`` says so, and that dispersions are standard deviations of the natural logarithm; between
        persons of a Student t population its scales. What the summary says of a distribution that is not normal is in
        ``attrs["distribution"]``, the degrees of freedom of a Student t also in ``attrs["degrees_of_freedom"]``.
    """
    import pandas as pd

    quantities = {
        "central": "central",
        "between_persons": "dispersion_between_persons",
        "between_repetitions": "dispersion_between_repetitions",
    }
    rows = []
    for entry in result.summary["elements"].values():
        row: dict[str, Any] = {"unit": entry["unit"], "identified": entry["identified"], "marked": entry["marked"]}
        for name, key in quantities.items():
            for quantile, ending in (("median", ""), ("q05", "_q05"), ("q95", "_q95")):
                value = entry[key][quantile]
                row[name + ending] = np.nan if value is None else value
        rows.append(row)
    frame = pd.DataFrame(rows, index=pd.Index(list(result.summary["elements"]), name="element", dtype=object))
    units = {"central": "column unit", "between_persons": "ln", "between_repetitions": "ln"}
    frame.attrs["units"] = {c: unit for c in frame for name, unit in units.items() if str(c).startswith(name)}
    distribution = result.summary.get("distribution")
    if distribution is not None:
        frame.attrs["distribution"] = distribution
    if is_student_t(result.summary):
        frame.attrs["degrees_of_freedom"] = result.summary["distribution"]["degrees_of_freedom"]
    return frame


def persons_table(result: Result, intervals: bool = False, rows: slice = slice(None)) -> pd.DataFrame:
    """Each person's elements and how well the network describes the person.

    Parameters
    ----------
    result : Result
    intervals : bool
        Whether each element is followed by the ends of its 90 % interval (``_q05``, ``_q95``).
    rows : slice
        Of which subjects; all if not given.

    Returns
    -------
    DataFrame
        One row for each subject, whose name is the index. One column for each element, the posterior median of
        the person's value, NaN where the recordings do not determine it or the fit must not be used; then what
        :data:`PERSON_UNITS` lists, as far as the result has it. ``attrs["units"]`` holds the unit of each column.
    """
    import pandas as pd

    own = np.asarray(result.groups["posterior"]["person_log_elements"][:, :, rows], dtype=float)
    draws = own.reshape(-1, *own.shape[2:])
    low, middle, high = (values_of(result.parameters, np.quantile(draws, q, axis=0)) for q in INTERVAL)
    endings = {"": middle} | ({"_q05": low, "_q95": high} if intervals else {})
    columns = {
        e + ending: np.full(len(values), np.nan) if result.problems else values[:, i]
        for i, e in enumerate(result.elements)
        for ending, values in endings.items()
    }
    frame = pd.DataFrame(
        columns, index=pd.Index([str(s) for s in result.coords["subject"][rows]], name="subject", dtype=object)
    )
    units = {e + ending: result.element_unit(e) for e in result.elements for ending in endings}
    for name, unit in PERSON_UNITS.items():
        values = result.groups["constant_data"].get(name)
        if values is not None:
            frame[name], units[name] = values[rows], unit or result.attributes["unit"]
    frame.attrs["units"] = units
    return frame
