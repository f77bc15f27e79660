"""The search from random starts: it ends where the best of many more starts ends."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import all_modes
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.simulate import FINGERTIP, simulate_recordings
from bayes_impedance.population.starting_fits import (
    _RANDOM_STARTS,
    _START_SPREAD,
    best_distinct,
    first_fits,
    search_modes,
)
from bayes_impedance.recordings.files import read_recordings

DATA = Path(__file__).parents[2] / "data" / "fingertip_71"


def test_single_curves_end_in_the_global_optimum() -> None:
    """Of people whom a search that follows the best two dozen starts, however alike, leaves in a local optimum."""
    recordings = read_recordings(DATA).select(["V02", "V06", "V16", "V23", "V34", "V46", "V58", "V64"])
    assert recordings.network is not None
    kernel = Kernel(parse(recordings.network))
    prior = default_prior(kernel, recordings)
    starts = prior.centre + np.random.default_rng(1).normal(0, _START_SPREAD, (_RANDOM_STARTS, 8))
    for subject in recordings.subjects:
        z = subject.mean[None, ::7]
        likelihood = Likelihood.make(subject.frequency_hz[::7], z, 0.01 * np.abs(z), np.zeros((1, 8)))
        # The population's truth is as good a start as there is.
        truth = np.log([6.76e-7, 61.4, 7.9e-4, 1.52, 1.15e-3, 0.0517, 4.73e-3, 3.82])[None]
        precision = np.eye(8) / prior.centre_sd**2
        best = all_modes(kernel, likelihood, truth, prior.centre, precision)[1].min()
        found = search_modes(kernel, likelihood, starts, prior, 4)
        assert all_modes(kernel, likelihood, found, prior.centre, precision, 5)[1].min() <= best + 0.1


@pytest.mark.parametrize("seed", [1, 6, 7, 9, 10, 401, 402, 403])
def test_people_of_few_frequencies_are_begun_in_the_right_valley(seed: int) -> None:
    """Random starts alone, the same for everybody, found a skin seven times as compliant in three of these."""
    made = simulate_recordings(FINGERTIP, 10, 3, np.geomspace(5, 5000, 30), seed)
    kernel = Kernel(parse(FINGERTIP.network))
    prior = default_prior(kernel, made.recordings)
    with ThreadPoolExecutor(2) as executor:
        first = first_fits(kernel, made.recordings, prior, np.random.SeedSequence(seed), executor, lambda *_: None)
    skin = kernel.elements.index("n3")
    off = [np.median(common[:, skin] - made.log_elements[:, skin]) for common in first.common]
    assert min(np.abs(off)) < 0.5


def test_the_best_ends_that_differ_are_kept() -> None:
    ends = np.array([[0.0, 0.0], [0.0, 0.05], [3.0, 0.0], [0.0, -3.0], [9.0, 9.0]])
    objectives = np.array([2.0, 1.0, 3.0, np.inf, 0.0])
    np.testing.assert_array_equal(best_distinct(ends, objectives, 2), ends[[4, 1]])
    np.testing.assert_array_equal(best_distinct(ends, objectives, 5), ends[[4, 1, 2, 4, 4]])
