r"""Networks side by side: how well each predicts people whom it has not seen, and how well it describes those it has.

The order is by elpd, the sum over people of the log predictive density
(:mod:`bayes_impedance.results.leave_one_out`). Differences are to the best of the reliable fits, with the standard
error of the pairs; within :data:`UNDECIDED` standard errors nothing is decided.

Every fit has estimated its own noise, and this noise is part of the model that is compared, as the elements are.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.display import heading, joined, table
from bayes_impedance.network.spellings import in_both
from bayes_impedance.population.heavy_tails import NORMAL
from bayes_impedance.results.leave_one_out import LeftOut
from bayes_impedance.results.result import Result
from bayes_impedance.runtime.atomic_files import finite_or_none

if TYPE_CHECKING:
    import pandas as pd

UNDECIDED = 3.0
"""Standard errors of a difference within which two networks predict equally well. By choice: few people make a standard
error uncertain, and where structure remains in the residuals it is too small."""

SCHEMA = 1
"""Version of the layout of ``networks.json``."""


@dataclass(frozen=True)
class Entry:
    """One network of a comparison.

    Attributes
    ----------
    given : str
        As the user named it.
    folder : str
        Of its result.
    result : Result
    left_out : LeftOut
    """

    given: str
    folder: str
    result: Result
    left_out: LeftOut

    @property
    def shown(self) -> str:
        """The network: of electrical recordings in both spellings; with the distributions that are not normal."""
        network = in_both(self.result.attributes["network"], self.result.attributes["unit"])
        own = "" if self.distribution == NORMAL else f", {self.distribution}"
        return network + own + ("" if self.noise_distribution == NORMAL else f", {self.noise_distribution} noise")

    @property
    def place(self) -> str:
        """Where the fit is: the folder of a finished one as it was given, or that of one made by the comparison."""
        return f"fit in {self.folder}" if self.folder == self.given else f"folder {self.folder}"

    @property
    def distribution(self) -> str:
        """Of people's log elements: ``normal``, ``student_t`` or ``mixture``."""
        return str(self.result.attributes.get("distribution", NORMAL))

    @property
    def noise_distribution(self) -> str:
        """Of the noise: ``normal`` or ``student_t``."""
        return str(self.result.attributes.get("noise_distribution", NORMAL))


@dataclass(frozen=True)
class NetworkComparison:
    """Networks of the same recordings.

    Attributes
    ----------
    entries : tuple of Entry
        The largest sum over people first.
    """

    entries: tuple[Entry, ...]

    @classmethod
    def of(cls, entries: Sequence[Entry]) -> NetworkComparison:
        """Put in order."""
        return cls(tuple(sorted(entries, key=lambda e: -e.left_out.total[0])))

    @property
    def best(self) -> Entry:
        """The best of the reliable fits; of all, if none is reliable."""
        return next((e for e in self.entries if not e.result.problems), self.entries[0])

    @property
    def as_good(self) -> tuple[Entry, ...]:
        """Reliable fits that the people do not separate from the best."""
        others = [e for e in self.entries if e is not self.best and not e.result.problems]
        behind = [(e, *e.left_out.less(self.best.left_out)) for e in others]
        return tuple(e for e, difference, error in behind if abs(difference) <= UNDECIDED * error)

    def label(self, entry: Entry) -> str:
        """The network of an entry as it is shown, with the place of the fit where another has the same network."""
        same = sum(e.shown == entry.shown for e in self.entries)
        return entry.shown if same == 1 else f"{entry.shown} ({entry.place})"

    def __repr__(self) -> str:
        return f"<NetworkComparison of {len(self.entries)}: best {self.label(self.best)}>"

    def _repr_html_(self) -> str:
        names = ("network", "elpd", "elpd_se", "difference", "difference_se", "doubtful", "reliable")
        rows = [
            [self.label(e), *(row[name] for name in names[1:])]
            for e, row in zip(self.entries, self.rows(), strict=True)
        ]
        return joined(heading(repr(self).strip("<>")), table([name.replace("_", " ") for name in names], rows))

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each network, the best first, with the columns of ``networks.csv``."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """One row for each network; numbers that are not finite are None."""
        return [self._row(entry) for entry in self.entries]

    def _row(self, entry: Entry) -> dict[str, Any]:
        left_out, summary = entry.left_out, entry.result.summary
        (elpd, error), (difference, of_pairs) = left_out.total, left_out.less(self.best.left_out)
        errors = summary["errors"]
        row = {
            "network": entry.result.attributes["network"],
            "distribution": entry.distribution,
            "noise_distribution": entry.noise_distribution,
            "given": entry.given,
            "folder": entry.folder,
            "reliable": not entry.result.problems,
            "elpd": elpd,
            "elpd_se": error,
            "difference": difference,
            "difference_se": of_pairs,
            "p_loo": left_out.p_loo,
            "pareto_k_max": float(np.max(left_out.pareto_k)),
            "refitted": int(np.sum(left_out.refitted)),
            "doubtful": int(np.sum(left_out.doubtful)),
            "delta_magnitude": errors["population_network"]["delta_magnitude"],
            "delta_phase_deg": errors["population_network"]["delta_phase_deg"],
            "relative_rms_median": errors["subjects"]["relative_rms_median"],
        }
        return {k: finite_or_none(v) if isinstance(v, float) else v for k, v in row.items()}

    def summary(self) -> dict[str, Any]:
        """Contents of ``networks.json``."""
        first = self.entries[0]
        return {
            "schema": SCHEMA,
            "unit": first.result.attributes["unit"],
            "data_sha256": first.result.attributes["data_sha256"],
            "subjects": list(first.left_out.subjects),
            "best": self.best.result.attributes["network"],
            "best_folder": self.best.folder,
            "as_good": [e.result.attributes["network"] for e in self.as_good],
            "as_good_folders": [e.folder for e in self.as_good],
            "networks": [
                row
                | {
                    "problems": entry.result.problems,
                    "misfit": list(entry.result.summary["adequacy"]["misfit"]),
                    "persons": {
                        "elpd": [finite_or_none(v) for v in entry.left_out.elpd],
                        "pareto_k": [finite_or_none(v) for v in entry.left_out.pareto_k],
                        "refitted": entry.left_out.refitted.tolist(),
                    },
                }
                for entry, row in zip(self.entries, self.rows(), strict=True)
            ],
        }

    def csv(self) -> str:
        """The table as text, one line for each network."""
        text, rows = io.StringIO(), self.rows()
        writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
        return text.getvalue()
