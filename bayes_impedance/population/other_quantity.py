r"""Recordings of another quantity than impedance: accelerance, receptance, dynamic stiffness or apparent mass.

Their real part is negative over part of the band, as that of an impedance behind a filter is: accelerance of a damped
resonance, :math:`s^2 / (m s^2 + r s + k)`, is exactly the impedance of *some* passive load behind a high-pass. So
neither sign nor slope nor phase of a curve decides, at one end of the band or at both: in none of 22 populations of
random networks did they exclude that a first-order filter and a lag of a channel turn some passive load to the recorded
accelerance, receptance, dynamic stiffness or apparent mass. What decides is the network. The recordings are refused if
the network describes them as another quantity to :data:`DESCRIBED`, and as impedance at least :data:`TIMES` less well
(:data:`TIMES_NOISE` if the other's error is nothing but noise), also behind a lag, a high-pass or a low-pass of either
channel, whose size is fitted. Measured with populations of ``analyses/other_worlds`` (random networks, with and without
effects that the network lacks), how many were refused:

==================================================  =======================
recordings                                          refused
==================================================  =======================
impedance; behind a lag of either sign; behind a    0 of 30 populations
high-pass or low-pass of either channel with a      in each of seven ways
corner in the band
the same with the network of another population     1 of 240 (accelerance)
accelerance                                         19 of 30
receptance                                          22 of 30
dynamic stiffness                                   13 of 30
apparent mass                                       13 of 30
==================================================  =======================

What is not refused has no clearly negative real part, or is described by the network about equally well both ways: of
the shipped population accelerance and dynamic stiffness are refused, but its apparent mass is to within noise an
impedance of the same network behind a high-pass in the motion channel, with a corner in the band. Mobility is not
tried: it is passive like impedance, and a network that describes it as well as its dual is a wrong network rather than
a wrong quantity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

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

TIMES, TIMES_NOISE = 3.0, 1.5
"""Smallest ratio of the errors as impedance and as the other quantity; and where the latter is nothing but noise. By
choice: noise is the same in both, so that a network that describes both has a ratio of one."""

NOISE = 1.3
"""Ratio of an error to the noise that its roughness over frequency shows, up to which it is noise. By choice: the
elements take a part of the noise, and its size is known to a tenth."""

_STARTS = 48
"""Random starts for each of the persons that are fitted, whose ends are tried for all. By choice: more cost time."""

_SPREAD = 2.5
"""Standard deviation of the starts' log elements, in place of the prior's 3, as in :mod:`.starting_fits`."""

Conversion = Callable[[np.ndarray, np.ndarray], np.ndarray]

QUANTITIES: dict[str, tuple[str, Conversion]] = {
    "accelerance": ("acceleration per force", lambda x, s: s / x),
    "receptance": ("displacement per force", lambda x, s: 1 / (s * x)),
    "dynamic stiffness": ("force per displacement", lambda x, s: x / s),
    "apparent mass": ("force per acceleration", lambda x, s: x * s),
}
"""What each quantity is, and impedance from its values (J, F) and s (F,)."""

_LAG, _HIGHPASS, _LOWPASS = "delay[d_lag*]({})", "highpass[f_cut{}]({})", "lowpass[t_cut{}]({})"
"""The network behind what turns the phase of an impedance; of either sign, that is in either channel."""

WITHIN = 10.0
"""Largest ratio of a filter's corner to the nearer end of the band. A high-pass with a corner a decade above the band
is a differentiator to six degrees throughout, and its output is another quantity."""


def require_impedance(recordings: Recordings, network: Network | str | None = None, seed: int = 1) -> None:
    """Refuse recordings that a network describes as another quantity, and not as impedance.

    Parameters
    ----------
    recordings : Recordings
    network : Network or str, optional
        The dataset's own if not given.
    seed : int
        For the starts of the searches.

    Raises
    ------
    InputError
        If the recordings are another quantity, unless they are declared to be impedances; if there is no network.
    """
    tree = network_of(recordings, network)
    if recordings.quantity is not None or not negative_without_cause(recordings):
        return
    some = some_subjects(recordings)
    as_other = {
        name: _errors(_converted(recordings, some, convert), str(tree), seed)
        for name, (_, convert) in QUANTITIES.items()
    }
    name = min(as_other, key=lambda key: as_other[key])
    error, noise, _ = as_other[name]
    if error > DESCRIBED:
        return
    own = _converted(recordings, some, lambda x, _: x)
    as_impedance = _as_impedance(own, str(tree), seed)
    if as_impedance < (TIMES_NOISE if error < NOISE * noise else TIMES) * error:
        return
    raise InputError(
        f"{recordings.title}: the network {tree} describes these recordings to {error:.1%} if they are {name} "
        f"({QUANTITIES[name][0]}), but as impedance only to {as_impedance:.1%}, whatever lag or filter of a channel is "
        f"assumed: import them with --form '{name}', or, if they are impedances (force per velocity), "
        'with --form impedance, or write quantity = "impedance" in dataset.toml'
    )


def _as_impedance(recordings: Recordings, network: str, seed: int) -> float:
    """Error of the network, behind a lag, or behind a filter whose corner is not far outside of the band."""
    ends = [(s.frequency_hz[0], s.frequency_hz[-1]) for s in recordings.subjects]
    low, high = (float(np.median(end)) for end in zip(*ends, strict=True))
    found = [_errors(recordings, text, seed)[0] for text in (network, _LAG.format(network))]
    for rig, limit in ((_HIGHPASS, WITHIN * high), (_LOWPASS, WITHIN / (2 * np.pi * low))):
        error, _, size = _errors(recordings, rig.format("*", network), seed)
        if abs(size) > limit:
            held = f"={math.copysign(limit, size):g}"
            error, _, _ = _errors(recordings, rig.format(held, network), seed)
        found.append(error)
    return min(found)


def _converted(recordings: Recordings, subjects: Sequence[Subject], convert: Conversion) -> Recordings:
    """Some subjects with other values, without what belongs to the given ones."""
    changed = tuple(
        replace(one, z=convert(one.z, 2j * np.pi * one.frequency_hz), noise_sd=None, covariates={}, circumstances={})
        for one in subjects
    )
    return replace(recordings, subjects=changed, calibration=None)


def _errors(recordings: Recordings, network: str, seed: int) -> tuple[float, float, float]:
    """Relative rms error of each person's best fit, the noise by its roughness over frequency, the first parameter.

    Medians over persons. Infinite if there is no fit. The first parameter is that of a wrapper, if there is one.
    """
    try:
        kernel = checked_model(recordings, network).kernel
    except InputError:  # values that no impedance has
        return np.inf, np.inf, 0.0
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
    error, noise, size = np.median(errors, axis=0)
    return float(error), float(noise), float(size)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))
