"""How results and predictions show themselves in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.display import curves, heading, interval, joined, lines, table
from bayes_impedance.network.spellings import in_both
from bayes_impedance.units import who

if TYPE_CHECKING:
    import pandas as pd

    from bayes_impedance.results.predictive import Predictive
    from bayes_impedance.results.result import Result


def one_line(result: Result) -> str:
    """Network, people and whether the numbers may be used."""
    n, problems = int(result.summary["subjects"]), len(result.problems)
    state = "reliable" if not problems else f"{problems} problem{'s' if problems > 1 else ''}"
    network = in_both(result.attributes["network"], result.attributes["unit"])
    return f"<Result {network} of {n} subject{'s' if n > 1 else ''}: {state}>"


def result_html(result: Result) -> str:
    """The table of elements, problems and remarks."""
    rows = [
        (
            name,
            entry["unit"],
            interval(entry["central"]),
            interval(entry["dispersion_between_persons"]),
            interval(entry["dispersion_between_repetitions"]),
        )
        for name, entry in result.summary["elements"].items()
    ]
    between = f"between {who(result.attributes['unit'])} (ln)"
    return joined(
        heading(one_line(result).strip("<>")),
        lines(result.problems),
        table(["element", "unit", "central", between, "between repetitions (ln)"], rows),
        lines(result.summary["remarks"]),
    )


def predictive_html(predictive: Predictive) -> str:
    """The median of a new person's recording, with the 90 % band, and errors."""
    f = predictive.frequency_hz.tolist()
    chosen = [0, 2, 4]  # 5 %, 50 % and 95 %
    rows = [
        (name.replace("_", " "), errors["delta_magnitude"], errors["delta_phase_deg"])
        for name, errors in ((name, curve.summary()) for name, curve in predictive.errors.items())
    ]
    return joined(
        heading(repr(predictive).strip("<>")),
        curves([f] * 3, predictive.recording.magnitude[chosen].tolist(), "|z| of a new recording over Hz, 90 % band"),
        curves(
            [f] * 3,
            predictive.recording.phase_deg[chosen].tolist(),
            "phase in degrees over Hz, 90 % band",
            logarithmic=False,
        ),
        table(["model", "mean error of |z|", "of phase in degrees"], rows),
    )


def predictive_table(predictive: Predictive) -> pd.DataFrame:
    """Bands over frequency: see :meth:`~bayes_impedance.results.predictive.Predictive.to_dataframe`."""
    import pandas as pd

    from bayes_impedance.results.predictive import PROBABILITIES

    columns: dict[str, np.ndarray] = {}
    for name in ("centre", "person", "recording"):
        band = getattr(predictive, name)
        for quantity in ("magnitude", "phase_deg"):
            for probability, values in zip(PROBABILITIES, getattr(band, quantity), strict=True):
                columns[f"{name}_{quantity}_q{100 * probability:02.0f}"] = values
    columns["network_magnitude"], columns["network_phase_deg"] = (
        predictive.network_magnitude,
        predictive.network_phase_deg,
    )
    return pd.DataFrame(columns, index=pd.Index(predictive.frequency_hz, name="frequency_hz"))
