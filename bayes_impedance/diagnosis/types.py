"""Results of a diagnosis: everything that the report and ``verdict.json`` need, fully computed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bayes_impedance.diagnosis.verdict_types import ParameterDifference, Verdict
from bayes_impedance.display import Brief
from bayes_impedance.population.fit import PopulationFit
from bayes_impedance.units import counted

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True, repr=False)
class Snapshot(Brief):
    """How well one model describes the recordings: the network as given, or with what was found.

    Attributes
    ----------
    label : str
        ``before`` or ``after``, or what else the model is.
    network : str
        Notation.
    frequency_hz : ndarray, shape (F,)
        Common grid.
    magnitude, phase_deg : ndarray, shape (3, F)
        5 %, 50 % and 95 % quantiles of a new person's recording.
    residual_magnitude, residual_phase : ndarray, shape (N, F)
        Whitened residual of each person along |z| and across it (phase), averaged over the repetitions and scaled to
        unit variance if nothing is missing; NaN outside of a person's range.
    delta_magnitude, delta_phase_deg : ndarray, shape (F,)
        Eq. 5 of the population network.
    subject_rms_relative : ndarray, shape (N,)
        Complex relative error of each person's fitted network.
    coverage90 : ndarray, shape (2, F)
        Share of people inside the 90 % bands of magnitude and of phase.
    person_curve : ndarray, complex, shape (N, F)
        Impedance of each person's fitted model, averaged over the repetitions; NaN outside of a person's range.
    """

    label: str
    network: str
    frequency_hz: np.ndarray
    magnitude: np.ndarray
    phase_deg: np.ndarray
    residual_magnitude: np.ndarray
    residual_phase: np.ndarray
    delta_magnitude: np.ndarray
    delta_phase_deg: np.ndarray
    subject_rms_relative: np.ndarray
    coverage90: np.ndarray
    person_curve: np.ndarray


@dataclass(frozen=True, kw_only=True, repr=False)
class Ranked(Brief):
    """A candidate in the ranking of the first screening.

    Attributes
    ----------
    id, place : str
    pooling : str
        ``shared``, ``varying`` or ``some`` (only some people have it).
    shape : str
        The nonlinear parameter at which the score is highest, for a reader ("corner 0.12 Hz"); empty if there is none.
    score : float
        Chi-square statistic, one degree of freedom when shared.
    p_value : float
        Corrected for all tests.
    size : str
        One-step estimate of the coefficient with its unit.
    physical : bool
        Whether the sign is admissible for the effect.
    likeness : float
        Cosine between this candidate's signature and the first's, elements projected out; at 1 they are inseparable.
    note : str
        For a reader: ``found``, ``alias, 3.1 behind``, ``unphysical sign``, or empty.
    """

    id: str
    place: str
    pooling: str
    shape: str
    score: float
    p_value: float
    size: str
    physical: bool
    likeness: float
    note: str


@dataclass(frozen=True, repr=False)
class OnePort(Brief):
    """The missing one-port at one place: the change of its impedance that would explain the mismatch.

    Attributes
    ----------
    place : str
    frequency_hz : ndarray, shape (G,)
    ratio : ndarray, complex, shape (G,)
        (z_needed - z_place) / z_place, averaged coherently over the population.
    sd : ndarray, shape (G,)
        Standard error of its real and of its imaginary part.
    share : float
        Fraction of the mismatch that this change explains, between 0 and 1.
    """

    place: str
    frequency_hz: np.ndarray
    ratio: np.ndarray
    sd: np.ndarray
    share: float

    def to_dataframe(self) -> pd.DataFrame:
        """One row for each frequency: frequency_hz, real and imaginary part of the ratio, and their standard error."""
        import pandas as pd

        columns = {"ratio_re": self.ratio.real, "ratio_im": self.ratio.imag, "sd": self.sd}
        return pd.DataFrame({"frequency_hz": self.frequency_hz, **columns})


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Results of a diagnosis.

    Attributes
    ----------
    title, unit : str
        Of the recordings.
    subjects : tuple of str
    repetitions : int
        Largest number per person.
    verdict : Verdict
    before : Snapshot
    after : Snapshot or None
        None if nothing is missing.
    observed : ndarray, complex, shape (N, F)
        Mean recording of each person on the snapshots' grid.
    ranking : tuple of Ranked
        Best first.
    one_ports : tuple of OnePort
        Best place first.
    differences : tuple of ParameterDifference
        From a claimed simulation; empty without one.
    fit : PopulationFit or None
        Posterior of the population of the network with what was found; None if nothing was, or it was not asked for.
    seconds : dict of str to float
    """

    title: str
    unit: str
    subjects: tuple[str, ...]
    repetitions: int
    verdict: Verdict
    before: Snapshot
    after: Snapshot | None
    observed: np.ndarray
    ranking: tuple[Ranked, ...]
    one_ports: tuple[OnePort, ...]
    differences: tuple[ParameterDifference, ...]
    fit: PopulationFit | None
    seconds: dict[str, float]

    def __repr__(self) -> str:
        return f"<Diagnosis of {counted(len(self.subjects), 'subject')}: {self.verdict.summary}>"

    def _repr_html_(self) -> str:
        return self.verdict._repr_html_()

    def to_dataframe(self) -> pd.DataFrame:
        """The ranking of the first screening, best first: one row for each candidate, columns as :class:`Ranked`."""
        import pandas as pd

        return pd.DataFrame([vars(row) for row in self.ranking], columns=list(Ranked.__dataclass_fields__))
