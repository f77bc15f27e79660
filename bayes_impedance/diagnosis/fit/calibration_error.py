r"""What a calibration has left uncertain, estimated and removed before anything is looked for in the recordings.

A calibration's error is the same in all recordings (:mod:`bayes_impedance.recordings.calibration`): a small rig around
whatever is fitted, whose S parameters v have a prior, the calibration's own. A search that took the calibration as
exact would find this rig, and name it: a delay, a mass. Therefore the network is first fitted within the rig, which
gives the most probable :math:`\hat v` of the calibration's prior and of all recordings together, and the search is
given what lies within it. A load z within a rig of lumped wrappers is seen as

.. math:: w = T(z) = \frac{a z + b}{c z + 1}, \qquad z = \frac{w - b}{a - c w},
          \qquad \frac{dz}{dw} = \frac{a - b c}{(a - c w)^2}

with a, b and c of each frequency, which follow from what the rig makes of three dampers. Under the calibration

.. math:: d^T C^{-1} d, \quad d_k = (\hat v_k - \bar v_k)/\sigma_k,

is a chi-square with at most S degrees of freedom, as :math:`\hat v` is drawn towards the prior's centre. If it is
improbable, the calibration's standard deviations are too small, or something else looks like the rig: nothing is
removed then, and the search finds what it is.

What the network lacks moves :math:`\hat v` too, as far as the prior lets it. When something was found it is therefore
estimated once more, with what was found in the network, and the search is repeated if :math:`\hat v` has moved by
more than its own uncertainty.

The error of a calibration at each frequency is estimated and removed in the same way in :mod:`.map_calibration`.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.stats import chi2

from bayes_impedance.diagnosis.fit.baseline import point_estimate, shared_values
from bayes_impedance.diagnosis.fit.map_calibration import map_error, removed
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, Place, parse
from bayes_impedance.network.parameters import SIGNED, unit_of_parameter
from bayes_impedance.population.calibrated import prior_of, within_rig
from bayes_impedance.population.em import Estimate
from bayes_impedance.population.map_error import with_map_noise
from bayes_impedance.population.requirements import checked_model, network_of
from bayes_impedance.recordings.calibration import CommonError
from bayes_impedance.recordings.dataset import Subject
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.units import number_with_unit

IMPROBABLE = 0.01
"""Probability under the calibration below which an estimated error is none of the calibration's, and is not removed.
By choice: of calibrations that are right one in a hundred, or fewer, as the estimate is drawn towards the prior's
centre."""

_MOVED = 0.5
"""Change of an estimate, in its own standard deviations, from which on the search is repeated. By choice: a change by
half of what the recordings resolve cannot make a finding."""

_PROBES = (0.5, 1.0, 2.0)
"""Dampers from which the rig's map is found, over the recordings' median size: three, as it has three numbers."""


_NOT_REPEATED = (
    "The calibration's error could not be estimated again with what was found, and is that of the network without it: "
    "it may hold a part of what was found, whose values are then off by as much"
)

_MAP_REMOVED = (
    "The calibration's own error, which differs from frequency to frequency, was estimated from all recordings along "
    "with the network, with the calibration's variances, and removed before the search, so that it is no finding "
    "(p = {:.2g})."
)
_MAP_KEPT = (
    "With the calibration's own error, which differs from frequency to frequency, estimated along, the network would "
    "need one that is improbable under the calibration (p = {:.1g}): its variances are too small, or the network lacks "
    "something. Nothing was removed, so that a part of what was found may be the calibration's error."
)
_MAP_UNKNOWN = (
    "The calibration's own error differs from frequency to frequency and was not removed, because not all recordings "
    "come with their noise: what all have in common may be the calibration's."
)


@dataclass(frozen=True, kw_only=True)
class Corrected:
    """Recordings without the calibration's most probable error.

    Attributes
    ----------
    given : Recordings
        As measured, with what the calibration leaves uncertain.
    recordings : Recordings
        Without its most probable error; taken as exact.
    network : Network or str or None
        What is within the rig.
    values : dict of str to float
        Most probable parameters of the rig, in the dataset's units; empty without a calibration.
    uncertainty : ndarray, shape (S,)
        Their standard deviations by recordings and calibration, over those by the calibration alone.
    not_repeated : str
        Why the error was not estimated again with what was found; empty if it was, or nothing was found.
    map_remark : str or None
        What became of the error of a calibration at each frequency.
    """

    given: Recordings
    recordings: Recordings
    network: Network | str | None
    values: Mapping[str, float] = field(default_factory=dict)
    uncertainty: np.ndarray = field(default_factory=lambda: np.zeros(0))
    not_repeated: str = ""
    map_remark: str | None = None

    def as_given(self, clean: Recordings) -> Recordings:
        """The recordings as measured, at the frequencies at which `clean` has recordings of the same subjects."""
        if self.given.calibration is None and self.given.calibration_map is None:
            return clean
        kept = zip(self.given.subjects, clean.subjects, strict=True)
        subjects = tuple(own.at(np.isin(own.frequency_hz, some.frequency_hz)) for own, some in kept)
        return replace(self.given, subjects=subjects)

    def with_found(self, network: Network, seed: int, executor: Executor, progress: Progress) -> Corrected:
        """The same with an error that was estimated with a larger network: these recordings if it has not moved.

        They are also kept where the larger network cannot be fitted, which the remarks then say.
        """
        try:
            again = without_calibration_error(self.given, network, seed, executor, progress)
        except InputError as error:  # a network whose parameters no recordings determine, for example
            return replace(self, not_repeated=str(error))
        moved = np.abs(again.deviations - self.deviations) > _MOVED * again.uncertainty
        return replace(again, network=self.network) if moved.any() else self

    @property
    def deviations(self) -> np.ndarray:
        """Of the values from what the calibration says, in its standard deviations, shape (S,)."""
        return np.zeros(0) if self.given.calibration is None else deviations_of(self.given.calibration, self.values)

    @property
    def probability(self) -> float:
        """Of values that are as far from the calibration's, or further, if it is right; 1 without a calibration."""
        error = self.given.calibration
        return 1.0 if error is None else probability_of(error, self.deviations)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was removed, in sentences; none without a calibration."""
        error = self.given.calibration
        if error is None:
            return () if self.map_remark is None else (self.map_remark,)
        told = f"{listed(error, self.values, self.given.unit)} (sd: the calibration's standard deviations)"
        if self.probability < IMPROBABLE:
            return (
                f"With the calibration's own error estimated along, the network would need an error of {told}, which "
                f"is improbable under the calibration (p = {self.probability:.1g}): its standard deviations are too "
                "small, or the network lacks something. Nothing was removed for it, and the search finds what it is.",
            )
        removed = (
            "What the calibration leaves uncertain was estimated along with the network, with the calibration's own "
            f"prior, and removed before the search, so that it is no finding: {told}."
        )
        return (removed, f"{_NOT_REPEATED}: {self.not_repeated}.") if self.not_repeated else (removed,)


def deviations_of(error: CommonError, values: Mapping[str, float]) -> np.ndarray:
    """Of a rig's parameters from what a calibration says, in its standard deviations, shape (S,)."""
    rig = {p.name: p for p in parse(error.around("r1")).parameters}
    apart = [
        rig[name].u(values[name]) - rig[name].u(mean)
        for name, mean in zip(error.parameters, error.mean.tolist(), strict=True)
    ]
    return np.asarray(np.array(apart) / error.sd)


def probability_of(error: CommonError, deviations: np.ndarray) -> float:
    """Of deviations (S,) that are as improbable under the calibration, or more."""
    square = float(deviations @ np.linalg.solve(error.correlation, deviations))
    return float(chi2.sf(square, deviations.size))


def largest_deviation(error: CommonError) -> float:
    """Of one parameter from what a calibration says, in its standard deviations, that is not improbable."""
    return float(np.sqrt(chi2.isf(IMPROBABLE, len(error.parameters))))


def listed(error: CommonError, values: Mapping[str, float], unit: str) -> str:
    """A rig's parameters with their deviations, in words; `unit` is that of the recordings."""
    words = []
    for name, deviation in zip(error.parameters, deviations_of(error, values).tolist(), strict=True):
        size = number_with_unit(values[name], unit_of_parameter(name, unit), 4)
        words.append(f"{name} = {size} ({deviation:+.1f} sd)")
    return ", ".join(words)


def without_calibration_error(
    recordings: Recordings, network: Network | str | None, seed: int, executor: Executor, progress: Progress
) -> Corrected:
    """Recordings without the calibration's most probable error, as in the module's docstring.

    Parameters
    ----------
    recordings : Recordings
        Of any calibration, or of none: they are then as given.
    network : Network or str, optional
        The dataset's own if not given.
    seed : int
    executor : Executor
    progress : callable

    Raises
    ------
    InputError
        If the network cannot be fitted, or has parameters of the rig's names.
    """
    error = recordings.calibration
    if error is None:
        return _without_map_error(recordings, network, seed, executor, progress)
    kernel = checked_model(recordings, within_rig(recordings, network)).kernel
    point = point_estimate(recordings, kernel, prior_of(kernel, recordings), seed, executor, progress)
    values = {name: _value(point, kernel, name) for name in error.parameters}
    uncertainty = np.ones(len(values))  # of one person
    if point.pooling.names:
        sd = dict(zip(point.pooling.names, np.sqrt(np.diag(point.shared_covariance)), strict=True))
        unit = {p.name: kernel.scales.get(p.name, 1.0) if p.link == SIGNED else 1.0 for p in kernel.parameters}
        uncertainty = np.array([sd[name] * unit[name] for name in error.parameters]) / error.sd
    inside = Corrected(
        given=recordings,
        recordings=replace(recordings, calibration=None),
        network=_within(error, network_of(recordings, network)),
        values=values,
        uncertainty=uncertainty,
    )
    if inside.probability < IMPROBABLE:
        return inside
    subjects = tuple(_inside(error, values, subject) for subject in recordings.subjects)
    return replace(inside, recordings=replace(recordings, subjects=subjects, calibration=None))


def _without_map_error(
    recordings: Recordings, network: Network | str | None, seed: int, executor: Executor, progress: Progress
) -> Corrected:
    """Recordings without the most probable error of a map, if they have one."""
    if recordings.calibration_map is None:
        return Corrected(given=recordings, recordings=recordings, network=network)
    found = map_error(recordings, network, seed, executor, progress)
    kept = replace(with_map_noise(recordings), calibration_map=None)
    if found is None:
        return Corrected(given=recordings, recordings=kept, network=network, map_remark=_MAP_UNKNOWN)
    if found.probability < IMPROBABLE:
        said = _MAP_KEPT.format(found.probability)
        return Corrected(given=recordings, recordings=kept, network=network, map_remark=said)
    said = _MAP_REMOVED.format(found.probability)
    return Corrected(given=recordings, recordings=removed(recordings, found), network=network, map_remark=said)


def _within(error: CommonError, network: Network) -> Network:
    """What is in the calibration's rig if the network has it already, as that of an earlier fit; else the network."""
    path = next(path for path, node in parse(error.around("m1")).walk() if str(node) == "m1")
    if len(path) < len(list(network.walk())) and set(error.parameters) <= {p.name for p in network.parameters}:
        return network.at(Place(path, ""))
    return network


def _value(point: Estimate, kernel: Kernel, name: str) -> float:
    """Estimate of a parameter of the rig, in its unit."""
    shared = shared_values(point)
    if name in shared:
        return shared[name]
    k = kernel.elements.index(name)  # one person: nothing is shared
    theta = point.modes[0].theta[k] * kernel.scales.get(name, 1.0)
    return float(kernel.parameters[k].value(np.array(theta)))


def _inside(error: CommonError, values: Mapping[str, float], subject: Subject) -> Subject:
    """A subject's recordings as they are within the rig."""
    probes = np.median(np.abs(subject.z)) * np.array(_PROBES)
    kernel = Kernel(parse(error.around("r1")).holding(values))
    seen = kernel.impedance(np.log(probes)[:, None], subject.frequency_hz).T
    equations = np.stack([np.broadcast_to(probes, seen.shape), np.ones_like(seen), -probes * seen], axis=-1)
    a, b, c = np.moveaxis(np.linalg.solve(equations, seen[..., None])[..., 0], -1, 0)
    w = subject.z
    slope = np.abs((a - b * c) / (a - c * w) ** 2)
    noise = None if subject.noise_sd is None else subject.noise_sd * slope
    return replace(subject, z=(w - b) / (a - c * w), noise_sd=noise)
