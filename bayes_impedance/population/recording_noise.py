r"""Noise of every recording, from the noise model that all recordings have in common.

Where nothing is known about the noise of single recordings, its standard deviation is a function of frequency that is
the same for everybody, mostly relative to the magnitude (:mod:`bayes_impedance.person.noise`), times a scale of the
person. The magnitude of one recording contains its own noise, so its mean over repetitions is taken,

.. math:: \overline{\ln |z|}(\omega) = \tfrac 1 J \sum_j \ln |z_j(\omega)|.

But beside a sharp resonance that repositioning moves, the recordings differ by much more than their noise, and the mean
is the magnitude of none of them. With the difference :math:`d_j = \ln |z_j| - \overline{\ln |z|}`, and the noise
:math:`\varepsilon` relative to the mean, the magnitude of recording j is

.. math:: \overline{\ln |z|} + d_j \, \frac{d_j^2}{d_j^2 + (3 \varepsilon)^2 + c^2}, \qquad c = 0.5,

the mean's where the difference is noise or small, its own where it is a large factor. Small differences have to be left
out even where they exceed the noise: how far the weight of a point goes with its own noise must not vary. Of twenty
populations with nothing missing three had structure of p < 0.002 with c = 0, and none p < 0.01 with c = 0.5.

A weight that goes with the noise in the magnitude draws the curve down: with :math:`z_j = z(1 + \eta)` of noise
:math:`\varepsilon` in each part and the weight of the mean over J repetitions,

.. math:: \frac{\mathrm E\,[w\,z\,\eta]}{\mathrm E\,[w]} \approx -\frac{2 \varepsilon^2}{J}\, z .

For noise of 7 % of one recording that is 1 % of z; where the noise grows towards one end of the band, elements cannot
absorb it (a stiffness of the rig of 11.0 N/m, 4 % of z, became 13.1 with a standard error of 0.4). So the magnitude at
a point is predicted from the other points beside it, by a parabola in log frequency, whose noise is independent of the
point's own. Where the point differs from that by more than noise can, beside a resonance that the grid barely resolves,
its own magnitude is taken: of a difference e the part :math:`e^4/(e^4 + (6\varepsilon)^4)`.
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import lru_cache, partial

import numpy as np

from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.sharded import Kept

_BEYOND = 3.0
"""Standard deviations of noise by which a recording's log magnitude differs from the mean over repetitions where half
of the difference is taken for the recording's own. By choice: noise alone rarely reaches it."""

_NARROW = 6.0
"""Standard deviations of noise by which a point's log magnitude differs from what the points beside it predict where
half of the difference is taken. By choice: chance does not reach it, and noise that is wrong by less costs little."""

_BESIDE, _EACH_SIDE = 6, 2
"""Number of points from which another is predicted, and how many of them a parabola needs on either side; at the ends
of the band it is a line. By choice: the fewest whose noise averages out."""

_MATTERS = 0.5
"""Difference of log magnitudes of which half is taken for the recording's own, however small the noise. By choice:
noise that is wrong by a factor below 1.6 costs little precision; beside moved resonances factors are far larger."""


def noise_of(subject: Subject, model: NoiseModel | None) -> np.ndarray:
    """Standard deviation of the noise of a person's recordings, before the person's own scale, shape (J, F).

    Parameters
    ----------
    subject : Subject
    model : NoiseModel or None
        Of all recordings; not needed where the subject's recordings come with their noise.
    """
    if subject.noise_sd is not None:
        return subject.noise_sd
    assert model is not None  # made whenever a recording has no noise of its own
    log_magnitude = np.log(np.abs(subject.z))
    mean = np.mean(log_magnitude, axis=0)
    noise = model.at(subject.frequency_hz, np.exp(mean)) * np.exp(-mean)
    difference = log_magnitude - mean
    own = difference**2 / (difference**2 + (_BEYOND * noise) ** 2 + _MATTERS**2)
    followed = mean + own * difference
    if subject.frequency_hz.size > _BESIDE:
        others, weights = _from_others(subject.frequency_hz.tobytes())
        beside = np.einsum("jfk,fk->jf", followed[:, others], weights)
        e, limit = (followed - beside) ** 4, np.maximum((_NARROW * noise) ** 4, np.finfo(float).tiny)
        followed = beside + (followed - beside) * e / (e + limit)
    return np.array([model.at(subject.frequency_hz, row) for row in np.exp(followed)])


@lru_cache(maxsize=8)
def _from_others(grid: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Which other points (F, K) predict a smooth function of log frequency at each point, and their weights (F, K).

    `grid` has the frequencies in Hz, as bytes, so that people with the same grid share them.
    """
    log_f = np.log(np.frombuffer(grid))
    point = np.arange(log_f.size)[:, None]
    first = np.clip(point - _BESIDE // 2, 0, log_f.size - 1 - _BESIDE)
    others = first + np.arange(_BESIDE)
    others = others + (others >= point)
    powers = (log_f[others] - log_f[point])[..., None] ** np.arange(3)
    between = np.minimum(np.sum(others < point, axis=1), np.sum(others > point, axis=1)) >= _EACH_SIDE
    powers[~between, :, 2] = 0.0  # a line
    return others, np.linalg.pinv(powers)[:, 0]


def scaled_noise(model: NoiseModel | None, subject: Subject, scale: float) -> np.ndarray:
    """The same times the person's own scale."""
    return noise_of(subject, model) * scale


def initial_likelihoods(recordings: Recordings, model: NoiseModel | None, n_elements: int, executor: Executor) -> Kept:
    """Each person's likelihood with this noise, and deviations between repetitions of zero.

    Each likelihood is made in the process where the executor keeps it, from the recordings available or read there.
    """
    return Kept.of(executor, recordings.subjects).each(partial(_likelihood, model, n_elements))


def _likelihood(model: NoiseModel | None, n_elements: int, subject: Subject) -> Likelihood:
    nothing = np.zeros((len(subject.repetitions), n_elements))
    return Likelihood.make(subject.frequency_hz, subject.z, noise_of(subject, model), nothing)
