"""The verdict as a tree of values: what ``verdict.json`` says, with a type for each of its parts.

:mod:`bayes_impedance.diagnosis.verdict` makes the tree, :mod:`bayes_impedance.diagnosis.verdict_file` writes and reads
it, and whoever shows a verdict reads its attributes. Fields are named as in the file. What the file leaves out for
some kinds of verdict has a value here that means the same for all (``subjects`` is "all", ``elements`` is empty).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from bayes_impedance.diagnosis.verdict_tables import dataframe_of, html_of
from bayes_impedance.display import Brief

Subjects = Literal["all"] | tuple[str, ...]
"""Names of people, or all of them."""

Kind = Literal["effect", "hum", "trend", "subgroup", "correlation", "unknown"]
"""What an entry of the verdict's physics is: an effect of the catalogue on the curves; hum of the mains; elements that
follow a covariate or the repetitions; a group of people; elements that vary together; other physics."""

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True, repr=False)
class Where(Brief):
    """Where the mismatch is.

    Attributes
    ----------
    bands_hz : tuple of (float, float)
        Disjoint, ascending; empty if there is no mismatch.
    part : {"magnitude", "phase", "both"}
    place : str or None
        Of the first entry of the physics.
    side : {"rig", "body"} or None
        Of the first entry; None if not decided.
    subjects : "all" or tuple of str
    covariate : str or None
        Which the elements follow.
    """

    bands_hz: tuple[Pair, ...]
    part: str
    place: str | None
    side: str | None
    subjects: Subjects
    covariate: str | None


@dataclass(frozen=True, kw_only=True)
class LocatedBand:
    """A band with structure in the residuals of the network alone.

    Attributes
    ----------
    low_hz, high_hz : float
    part : {"magnitude", "phase"}
    kind : {"coherent", "incoherent"}
        Whether the structure is the same in all people.
    z : float
        Normal score of the null hypothesis.
    p_value : float
        Corrected for all tests.
    """

    low_hz: float
    high_hz: float
    part: str
    kind: str
    z: float
    p_value: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Located(Brief):
    """Structure in the residuals of the network alone, before anything was added.

    Attributes
    ----------
    p_value : float
        Of the null hypothesis that there is none.
    bands : tuple of LocatedBand
        Most significant first.
    magnitude_share : float or None
        Part of the structure that is in magnitude; None if there is no structure.
    subjects_p_value : float
        Largest corrected p-value of a named person; 1 if nobody is named.
    """

    p_value: float
    bands: tuple[LocatedBand, ...]
    magnitude_share: float | None
    subjects_p_value: float


@dataclass(frozen=True, repr=False)
class Parameter(Brief):
    """A parameter of an effect: median and 90 % interval in its unit.

    Attributes
    ----------
    unit : str
    median, q05, q95 : float
    dispersion : float or None
        Relative standard deviation between people; 0 if the parameter is shared, None if it was not estimated.
    """

    unit: str
    median: float
    q05: float
    q95: float
    dispersion: float | None


@dataclass(frozen=True, repr=False)
class EvidenceOfEffect(Brief):
    """Statistical evidence for an effect; None where its kind has no such value.

    Attributes
    ----------
    score : float or None
        Chi-square statistic of the screening.
    p_value : float or None
        Corrected for all tests.
    elpd_gain, elpd_gain_se : float or None
        Expected log predictive density gained on held-out people, with its standard error.
    """

    score: float | None
    p_value: float | None
    elpd_gain: float | None
    elpd_gain_se: float | None


@dataclass(frozen=True, kw_only=True, repr=False)
class Alias(Brief):
    """Another explanation of the same structure.

    Attributes
    ----------
    id, name, place : str
    elpd_behind : float
        Deficit of log evidence, in natural logarithms; negative if it explains the recordings better.
    separated : bool
        Whether the recordings separate the two.
    would_separate : str
        The measurement that would separate them.
    """

    id: str
    name: str
    place: str
    elpd_behind: float
    separated: bool
    would_separate: str


@dataclass(frozen=True, kw_only=True, repr=False)
class Physics(Brief):
    """One effect or structure that was missing.

    Attributes
    ----------
    kind : Kind
        Says which fields the file has (:data:`~bayes_impedance.diagnosis.verdict_file.PHYSICS_KEYS`).
    id, name : str
        Of the catalogue, or ``unknown``.
    place : str
        Where in the network; of a structure of the population, the element it concerns most.
    side : {"rig", "body"} or None
        None if not decided.
    pooling : {"shared", "varying", "some"}
    parameters : mapping of str to Parameter
    evidence : EvidenceOfEffect
    aliases : tuple of Alias
        The closest first.
    story, formula : str
    look_for, source : str
        Empty for unknown physics.
    side_decided : bool
        Whether the spread between people agrees with the side.
    subjects : "all" or tuple of str
        Who has it.
    dispersion_interval : (float, float) or None
        90 % interval of the first parameter's dispersion; where it is shared, of what the dispersion would be if it
        were not. None if it was not estimated.
    covariate : str or None
        Which elements follow.
    elements : tuple of str
        Which follow a covariate or the repetitions, or differ in a group; the most significant first.
    frequencies_hz : tuple of float
        Points that are affected by hum.
    network, connection : str
        Of unknown physics: notation of the network that stands in (empty for a sum of several, and if none does), and
        its connection: ``beside`` the place, in ``series`` with it, or ``instead`` of the whole claimed network.
    """

    kind: Kind
    id: str
    name: str
    place: str
    side: str | None
    pooling: str
    parameters: Mapping[str, Parameter]
    evidence: EvidenceOfEffect
    aliases: tuple[Alias, ...] = ()
    story: str
    formula: str
    look_for: str = ""
    source: str = ""
    side_decided: bool = True
    subjects: Subjects = "all"
    dispersion_interval: Pair | None = None
    covariate: str | None = None
    elements: tuple[str, ...] = ()
    frequencies_hz: tuple[float, ...] = ()
    network: str = ""
    connection: str = ""


@dataclass(frozen=True)
class BlockGain:
    """Expected log predictive density gained on left-out blocks of frequencies; None if they were not left out."""

    gain: float | None
    se: float | None


@dataclass(frozen=True, kw_only=True, repr=False)
class Improvement(Brief):
    """What the additions change, each as (before, after), and what they gain on held-out recordings.

    Attributes
    ----------
    delta_magnitude, delta_phase_deg : (float, float)
        Eq. 5 of the population network, mean over frequency.
    subject_rms_relative : (float, float)
        Relative error of the median person's own network.
    coverage90 : (float, float)
        Share of recordings inside the predicted 90 % band.
    elpd_gain, elpd_gain_se : float or None
        On what `held_out` says.
    blocks : BlockGain or None
        None where nothing was fitted again to a part of the recordings.
    held_out : str
        What was held out, for a reader.
    """

    delta_magnitude: Pair
    delta_phase_deg: Pair
    subject_rms_relative: Pair
    coverage90: Pair
    elpd_gain: float | None
    elpd_gain_se: float | None
    blocks: BlockGain | None
    held_out: str


@dataclass(frozen=True, kw_only=True, repr=False)
class Detectable(Brief):
    """Detection limit of one effect at one place.

    Attributes
    ----------
    id, name, place : str
    parameter : str
        Whose size is meant.
    above : float
        Smallest size that is found nine times out of ten.
    unit : str
    shape : mapping of str to float
        Nonlinear parameters at which the limit holds.
    """

    id: str
    name: str
    place: str
    parameter: str
    above: float
    unit: str
    shape: Mapping[str, float]


@dataclass(frozen=True)
class Joint:
    """Correlations (P, P) of P parameters in the joint posterior of several effects."""

    parameters: tuple[str, ...]
    correlation: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class ParameterDifference:
    """How an element differs between simulation and recordings.

    Attributes
    ----------
    element, unit : str
    what : str
        ``central`` or ``dispersion_between_persons`` or ``dispersion_between_repetitions``.
    simulation, recordings : float
    ratio, q05, q95 : float
        Recordings over simulation, with its 90 % interval.
    p_value : float
        Corrected for all that were compared.
    """

    element: str
    unit: str
    what: str
    simulation: float
    recordings: float
    ratio: float
    q05: float
    q95: float
    p_value: float


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """Verdict of a diagnosis.

    Attributes
    ----------
    summary : str
        One sentence.
    where : Where
    located : Located
    physics : tuple of Physics
        Missing effects and structures, unknown physics last; empty if nothing is missing.
    improvement : Improvement or None
        None if nothing is missing.
    network : (str, str)
        Notation before and after.
    detectable : tuple of Detectable
    not_identifiable : tuple of str
        Effects that such recordings cannot show.
    elements_not_identified : tuple of str
    seed : int
    data_sha256 : str
        Empty if the recordings did not come from a file.
    title, unit : str
        Of the recordings.
    reliable : bool
        Whether the network's fit came to rest, and what was found describes recordings of different people at all.
    remarks : tuple of str
    version : str
        Of this package.
    joint : Joint or None
        None unless several effects of the catalogue were found.
    parameters_differ : tuple of ParameterDifference or None
        What differs significantly from a claimed simulation; None without one.
    shortcomings : tuple of str
        What is left that is large in absolute terms, whatever explanations were compared; the gravest first.
    extended_network : str or None
        Notation of the network with all effects that were found, which can be fitted like any other; None without any.
    start : dict of str to float, or None
        Medians over people of its parameters in their units, near which a fit of it begins.
    """

    summary: str
    where: Where
    located: Located
    physics: tuple[Physics, ...]
    improvement: Improvement | None
    network: tuple[str, str]
    detectable: tuple[Detectable, ...]
    not_identifiable: tuple[str, ...]
    elements_not_identified: tuple[str, ...]
    seed: int
    data_sha256: str
    title: str
    unit: str
    reliable: bool
    remarks: tuple[str, ...]
    version: str
    joint: Joint | None = None
    parameters_differ: tuple[ParameterDifference, ...] | None = None
    shortcomings: tuple[str, ...] = ()
    extended_network: str | None = None
    start: Mapping[str, float] | None = None

    def __repr__(self) -> str:
        return f"<Verdict: {self.summary}>"

    _repr_html_ = html_of
    to_dataframe = dataframe_of

    @property
    def mismatch(self) -> bool:
        """Whether anything is missing."""
        return bool(self.physics)

    @property
    def unexplained(self) -> Physics | None:
        """The entry of physics outside of the catalogue, if there is one."""
        return next((entry for entry in self.physics if entry.kind == "unknown"), None)
