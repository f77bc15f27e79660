"""Parts of a person's data."""

from __future__ import annotations

import numpy as np

from bayes_impedance.person.likelihood import Likelihood


def test_one_recording_alone_has_its_share_of_the_values() -> None:
    z = np.exp(1j * np.arange(12.0)).reshape(3, 4)
    both = Likelihood.make(np.arange(1.0, 5.0), z, np.full((3, 4), 0.1), np.ones((3, 2)))
    one = both.recording(1, 5)
    np.testing.assert_array_equal(one.z[0], [z[1].real, z[1].imag])
    assert (one.values, one.count) == (4, both.count / 3)
    np.testing.assert_array_equal(one.deviations, np.zeros((1, 5)))
