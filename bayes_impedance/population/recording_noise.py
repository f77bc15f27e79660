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
out even where they exceed the noise. The weight of a point goes with the noise in the magnitude, which shifts the mean
of the weighted residuals by about :math:`\varepsilon` standard deviations: the same everywhere for the mean over
repetitions, a gain that the elements absorb, but twice that where the recording's own magnitude is taken. Of fifty
thousand points of 1 % the difference is two standard errors; three of twenty populations with nothing missing had
structure of p < 0.002 (with c = 0; none had p < 0.01 with c = 0.5).
"""

from __future__ import annotations

from concurrent.futures import Executor
from functools import partial

import numpy as np

from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.noise import NoiseModel
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.sharded import Kept

_BEYOND = 3.0
"""Standard deviations of noise by which a recording's log magnitude differs from the mean over repetitions where half
of the difference is taken for the recording's own. By choice: noise alone rarely reaches it."""

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
    return np.array([model.at(subject.frequency_hz, row) for row in np.exp(mean + own * difference)])


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
