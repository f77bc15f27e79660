r"""Recordings of another quantity than impedance: accelerance, receptance, dynamic stiffness, apparent mass, mobility.

Their real part is negative over part of the band, as that of an impedance behind a filter is: accelerance of a damped
resonance, :math:`s^2 / (m s^2 + r s + k)`, is exactly the impedance of *some* passive load behind a high-pass. So
neither sign nor slope nor phase of a curve decides, at one end of the band or at both: in none of 22 populations of
random networks did they exclude that a first-order filter and a lag of a channel turn some passive load to the recorded
accelerance, receptance, dynamic stiffness or apparent mass. What decides is the network. The recordings are refused if
the network describes them as another quantity to :data:`DESCRIBED`, and as impedance much less well, also behind a lag,
a high-pass or a low-pass of either channel, whose size is fitted. The other quantity too may be behind a lag. Filters
are tried of impedance only, as one of first order turns the one into the other. Much less well is

- :data:`TIMES` the error, if more than noise is left of both, or Re z is not negative and nothing needs an explanation;
- a log likelihood that is lower by :data:`DECIDES`, if Re z is clearly negative, and the other quantity leaves nothing
  but noise: no other explanation can then be better.

Measured with populations of ``analyses/other_worlds`` (random networks, with and without effects that the network
lacks), how many were refused; the limits were set on the 22 populations of seed 601, of which those behind a lag or a
filter are, and the others are of seed 801:

==================================================  =======================
recordings                                          refused
==================================================  =======================
impedance                                           0 of 30
behind a lag of either sign; behind a high-pass or  0 of 126
low-pass of either channel with a corner in the
middle of the band
impedance with the network of another population    1 of 28 (mobility)
accelerance                                         24 of 30
receptance                                          23 of 30
dynamic stiffness                                   14 of 30
apparent mass                                       16 of 30
mobility                                            19 of 30
==================================================  =======================

No population of another quantity was given a wrong name. What is not refused is described by the network about equally
well both ways: of the shipped population accelerance and dynamic stiffness are refused, but its apparent mass is to
within noise an impedance of the same network behind a high-pass in the motion channel, with a corner in the band.
Mobility is passive as impedance is, and describes the dual network: the likelihood alone never decides for it, and the
message says that | and - of the network may be exchanged.

**Doubted.** Where the likelihood would decide, but Re z is not clearly negative or it would be for mobility, the other
quantity is named and nothing is refused: the network may be that of other recordings. Of 37 small populations of seed
901 and 36 with the network of another one,

==================================================  =======  =======
recordings                                          refused  doubted
==================================================  =======  =======
impedance                                           0        0
behind a lag or a filter, 6 kinds                   0        1 of 222
impedance with the network of another population    1        0
accelerance                                         27       0
receptance                                          33       1
dynamic stiffness                                   16       4
apparent mass                                       17       3
mobility                                            24       3
==================================================  =======  =======

Two of the doubts name another quantity than the right one (apparent mass for mobility and the reverse, of one network).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import Network
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.person.bounded_search import modes_from
from bayes_impedance.population.calibrated import prior_of
from bayes_impedance.population.requirements import checked_model, network_of
from bayes_impedance.population.starting_fits import search_modes, thinned, typical
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.recordings.plausibility import negative_without_cause, some_subjects

DESCRIBED = 0.1
"""Largest relative rms error with which a network describes recordings of the right quantity. By choice: ten per cent,
or six degrees, is more than noise and most effects that a network lacks."""

TIMES = 3.0
"""Smallest ratio of the errors as impedance and as the other quantity, where more than noise is left of both. By
choice: physics that the network lacks is in both, so that a network that describes both has a ratio of about one."""

NOISE = 1.3
"""Ratio of an error to the noise that its roughness over frequency shows, up to which it is noise. By choice: the
elements take a part of the noise, and its size is known to a tenth."""

DECIDES = 10.0
"""Log likelihood by which the other quantity must be better, where it leaves nothing but noise. By choice: odds of
20 000 to 1, as whoever asks has said nothing of another quantity."""

CONVERGED = 1.05
"""Smallest ratio of the errors all the same. By choice: the ends of two searches from random starts differ by less."""

_STARTS = 48
"""Random starts for each of the persons that are fitted, whose ends are tried for all. By choice: more cost time."""

_SPREAD = 2.5
"""Standard deviation of the starts' log elements, in place of the prior's 3, as in :mod:`.starting_fits`."""

Conversion = Callable[[np.ndarray, np.ndarray], np.ndarray]

MOBILITY = "mobility"

QUANTITIES: dict[str, tuple[str, Conversion]] = {
    "accelerance": ("acceleration per force", lambda x, s: s / x),
    "receptance": ("displacement per force", lambda x, s: 1 / (s * x)),
    "dynamic stiffness": ("force per displacement", lambda x, s: x / s),
    "apparent mass": ("force per acceleration", lambda x, s: x * s),
    MOBILITY: ("velocity per force", lambda x, _: 1 / x),
}
"""What each quantity is, and impedance from its values (J, F) and s (F,)."""

_LAG, _HIGHPASS, _LOWPASS = "delay[d_lag*]({})", "highpass[f_cut{}]({})", "lowpass[t_cut{}]({})"
"""The network behind what turns the phase of an impedance; of either sign, that is in either channel."""

WITHIN = 10.0
"""Largest ratio of a filter's corner to the nearer end of the band. A high-pass with a corner a decade above the band
is a differentiator to six degrees throughout, and its output is another quantity."""


def require_impedance(recordings: Recordings, network: Network | str | None = None, seed: int = 1) -> str | None:
    """Refuse recordings that a network describes as another quantity, and not as impedance.

    Parameters
    ----------
    recordings : Recordings
    network : Network or str, optional
        The dataset's own if not given.
    seed : int
        For the starts of the searches.

    Returns
    -------
    str or None
        A doubt, in a sentence, where the recordings may be another quantity but are not refused.

    Raises
    ------
    InputError
        If the recordings are another quantity, unless they are declared to be impedances; if there is no network.
    """
    tree = str(network_of(recordings, network))
    if recordings.quantity is not None:
        return None
    unexplained = negative_without_cause(recordings)
    some = some_subjects(recordings)
    own = _converted(recordings, some, lambda x, _: x)
    plain = _errors(own, tree, seed)
    if not some or plain.is_noise:  # nothing describes them better
        return None
    as_other = _as_others(recordings, some, (tree, _LAG.format(tree)), seed)
    name = min(as_other, key=lambda key: as_other[key].error)
    best = as_other[name]
    points = sum(subject.frequency_hz.size for subject in some)
    if best.error > DESCRIBED or not _is_better(best, plain.error, points):
        return None
    as_impedance = min(plain.error, _as_impedance(own, tree, seed))
    if not _is_better(best, as_impedance, points):
        return None
    dual = " (or | and - of the network are exchanged)" if name == MOBILITY else ""
    said = (
        f"{recordings.title}: the network {tree} describes these recordings to {best.error:.1%} if they are {name} "
        f"({QUANTITIES[name][0]}), but as impedance only to {as_impedance:.1%}, whatever lag or filter of a channel is "
        f"assumed{dual}: import them with --form '{name}', or, if they are impedances (force per velocity), "
        'with --form impedance, or write quantity = "impedance" in dataset.toml'
    )
    decisive = points if unexplained and name != MOBILITY else 0
    if _is_better(best, as_impedance, decisive):
        raise InputError(said)
    return f"{said}; this is not sure, since an impedance that the network lacks something of may look like it"


def better_as(recordings: Recordings, network: str, seed: int = 1) -> tuple[str, float, float] | None:
    """The quantity as which a network describes recordings better than as impedance, though that need not be sure.

    Parameters
    ----------
    recordings : Recordings
    network : str
    seed : int
        For the starts of the searches.

    Returns
    -------
    tuple of (str, float, float), or None
        Its name, and the relative rms errors as this quantity and as impedance. Mobility is passive as impedance is,
        and not asked for.
    """
    some = some_subjects(recordings)
    if not some or recordings.quantity is not None:
        return None
    plain = _errors(_converted(recordings, some, lambda x, _: x), network, seed).error
    as_other = _as_others(recordings, some, (network,), seed)
    name = min(as_other.keys() - {MOBILITY}, key=lambda key: as_other[key].error)
    return (name, as_other[name].error, plain) if as_other[name].error < plain else None


def _as_others(
    recordings: Recordings, subjects: Sequence[Subject], networks: Sequence[str], seed: int
) -> dict[str, _Error]:
    """How well the best of some networks describes recordings as each of the other quantities."""
    found = {}
    for name, (_, convert) in QUANTITIES.items():
        other = _converted(recordings, subjects, convert)
        found[name] = min((_errors(other, text, seed) for text in networks), key=lambda own: own.error)
    return found


def _is_better(other: _Error, as_impedance: float, points: int) -> bool:
    """Whether another quantity describes the recordings better than impedance.

    `points` is their number if the likelihood may decide where only noise is left, and else 0.
    """
    ratio = as_impedance / max(other.error, np.finfo(float).tiny)
    if ratio > TIMES:
        return True
    return other.is_noise and ratio > CONVERGED and 2 * points * math.log(ratio) > DECIDES


def _as_impedance(recordings: Recordings, network: str, seed: int) -> float:
    """Error of the network behind a lag, or behind a filter whose corner is not far outside of the band."""
    ends = [(s.frequency_hz[0], s.frequency_hz[-1]) for s in recordings.subjects]
    low, high = (float(np.median(end)) for end in zip(*ends, strict=True))
    found = [_errors(recordings, _LAG.format(network), seed).error]
    for rig, limit in ((_HIGHPASS, WITHIN * high), (_LOWPASS, WITHIN / (2 * np.pi * low))):
        fitted = _errors(recordings, rig.format("*", network), seed)
        if abs(fitted.first) > limit:
            held = f"={math.copysign(limit, fitted.first):g}"
            fitted = _errors(recordings, rig.format(held, network), seed)
        found.append(fitted.error)
    return min(found)


def _converted(recordings: Recordings, subjects: Sequence[Subject], convert: Conversion) -> Recordings:
    """Some subjects with other values, without what belongs to the given ones."""
    changed = tuple(
        replace(one, z=convert(one.z, 2j * np.pi * one.frequency_hz), noise_sd=None, covariates={}, circumstances={})
        for one in subjects
    )
    return replace(recordings, subjects=changed, calibration=None, calibration_map=None)


@dataclass(frozen=True)
class _Error:
    """How well a network describes recordings: medians over persons.

    Attributes
    ----------
    error : float
        Relative rms error of the best fit; infinite if there is none.
    noise : float
        Of these errors, by their roughness over frequency.
    first : float
        The network's first parameter: that of a wrapper, if there is one.
    """

    error: float
    noise: float
    first: float

    @property
    def is_noise(self) -> bool:
        return self.error < NOISE * self.noise


def _errors(recordings: Recordings, network: str, seed: int) -> _Error:
    """How well a network describes recordings."""
    try:
        kernel = checked_model(recordings, network).kernel
    except InputError:  # values that no impedance has
        return _Error(np.inf, 0.0, 0.0)
    prior, rng = prior_of(kernel, recordings), np.random.default_rng(seed)
    n, precision = prior.centre.size, prior.precision
    ends = []
    for subject in recordings.subjects:
        starts = prior.centre + rng.normal(0, _SPREAD / 3, (_STARTS, n)) * prior.centre_sds
        starts[0] = prior.centre
        ends.append(search_modes(kernel, thinned(subject, n), starts, prior, 4))
    errors = []
    for subject in recordings.subjects:
        likelihood = typical(subject, n, slice(None))
        tried, objectives = modes_from(kernel, likelihood, np.concatenate(ends), prior.centre, precision, 40)
        real, imaginary = likelihood.z[0]
        theta = tried[int(np.argmin(objectives))]
        parameter = kernel.parameters[0]
        scale = kernel.scales.get(parameter.name, 1.0) if parameter.link == SIGNED else 1.0
        first, best = float(parameter.value(theta[0] * scale)), kernel.impedance(theta, subject.frequency_hz)
        ratio = best / (real + 1j * imaginary) - 1
        # The second difference of independent values has six times their variance.
        errors.append((_rms(ratio), _rms(np.diff(ratio, 2)) / np.sqrt(6), first))
    return _Error(*np.median(errors, axis=0).tolist())


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
