"""How a fit shows itself: one line, a table of the population's elements, a DataFrame."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from bayes_impedance.display import heading, interval, joined, lines, table
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import unit_of_parameter
from bayes_impedance.population.diagnostics import Diagnostics
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.units import INTERVAL, who

if TYPE_CHECKING:
    import pandas as pd


class _Fit(Protocol):
    """What of a fit is shown."""

    @property
    def recordings(self) -> Recordings: ...
    @property
    def kernel(self) -> Kernel: ...
    @property
    def parameters(self) -> PopulationParameters: ...
    @property
    def identified(self) -> np.ndarray: ...
    @property
    def diagnostics(self) -> Diagnostics: ...
    @property
    def repeated(self) -> bool: ...
    @property
    def noise(self) -> tuple[np.ndarray, ...]: ...
    @property
    def noise_weights(self) -> tuple[np.ndarray, ...] | None: ...


class ShownFit:
    """Part of :class:`~bayes_impedance.population.fit.PopulationFit`."""

    @property
    def effective_noise(self: _Fit) -> tuple[np.ndarray, ...]:
        """Standard deviations of normal noise that say as much as noise with tails and its weights do, (J, F) each."""
        if self.noise_weights is None:
            return self.noise
        return tuple(sd / np.sqrt(w) for sd, w in zip(self.noise, self.noise_weights, strict=True))

    def __repr__(self: _Fit) -> str:
        n, draws = len(self.recordings), len(self.parameters.mu)
        problems = len(self.diagnostics.problems)
        state = "reliable" if not problems else f"{problems} problem{'s' if problems > 1 else ''}"
        return f"<PopulationFit {self.kernel.network} of {n} subject{'s' if n > 1 else ''}: {draws} draws, {state}>"

    def _repr_html_(self: _Fit) -> str:
        rows = [
            (name, unit_of_parameter(name, self.recordings.unit), *(interval(level) for level in levels.values()))
            for name, levels in _intervals(self).items()
        ]
        between = f"between {who(self.recordings.unit)} (ln)"
        return joined(
            heading(repr(self).strip("<>")),
            lines(self.diagnostics.problems),
            table(["element", "unit", "central", between, "between repetitions (ln)"], rows),
        )

    def to_dataframe(self: _Fit) -> pd.DataFrame:
        """The population's elements, with the columns of :func:`bayes_impedance.results.tables.elements_table`.

        Returns
        -------
        DataFrame
            One row for each element, whose name is the index: unit and identified, then central, between_persons and
            between_repetitions, each a posterior median followed by the ends of its 90 % interval (``_q05``,
            ``_q95``). NaN for an element that the recordings do not determine, and for everything if the fit has
            problems.
        """
        import pandas as pd

        rows = []
        for (name, levels), known in zip(_intervals(self).items(), self.identified.tolist(), strict=True):
            row: dict[str, Any] = {"unit": unit_of_parameter(name, self.recordings.unit), "identified": known}
            for level, entry in levels.items():
                for quantile, ending in (("median", ""), ("q05", "_q05"), ("q95", "_q95")):
                    row[level + ending] = np.nan if entry[quantile] is None else entry[quantile]
            rows.append(row)
        return pd.DataFrame(rows, index=pd.Index(self.kernel.elements, name="element", dtype=object))


def _intervals(fit: _Fit) -> dict[str, dict[str, dict[str, float | None]]]:
    """Median and 90 % interval of each element's levels; None where there is no number."""
    p, one = fit.parameters, len(fit.recordings) == 1
    found = {}
    for i, parameter in enumerate(fit.kernel.parameters):
        known = bool(fit.identified[i]) and not fit.diagnostics.problems
        varies = known and not parameter.shared and not one
        levels = {
            "central": (parameter.value(p.mu[:, i]), known),
            "between_persons": (p.between_persons[:, i], varies),
            "between_repetitions": (p.between_repetitions[:, i], varies and fit.repeated),
        }
        found[parameter.name] = {name: _quantiles(values, shown) for name, (values, shown) in levels.items()}
    return found


def _quantiles(values: np.ndarray, known: bool) -> dict[str, float | None]:
    low, middle, high = np.quantile(values, INTERVAL).tolist() if known else (None, None, None)
    return {"median": middle, "q05": low, "q95": high}
