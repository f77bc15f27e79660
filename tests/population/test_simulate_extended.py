"""Virtual people of networks with delays, exponents and corner frequencies: values in their units, at any sign."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings

GRID = np.geomspace(5.0, 500.0, 9)
STILL = VirtualPopulation(
    network="delay[d1*](highpass[f1](m1|p1^a1*@50))",
    central={"d1": -2e-5, "f1": 3.0, "m1": 1e-3, "p1": 2.0, "a1": 0.3},
    between_persons={},
    noise=0.0,
)


def test_impedances_are_those_of_the_values() -> None:
    s, corner = 2j * np.pi * GRID, 2 * np.pi * 3.0
    inside = s * 1e-3 + 2.0 * (s / (2j * np.pi * 50) * 1j) ** (0.3 - 1)
    expected = inside * s / (s + corner) * np.exp(s * 2e-5)
    simulation = simulate_recordings(STILL, 2, 1, GRID, seed=1)
    for subject in simulation.recordings.subjects:
        np.testing.assert_allclose(subject.z[0], expected, rtol=1e-10)
    assert simulation.truth["elements"]["d1"]["central"] == -2e-5


def test_people_differ_in_the_logarithm_of_what_is_their_own() -> None:
    people = replace(STILL, between_persons={"f1": 0.2, "m1": 0.3})
    drawn = simulate_recordings(people, 3000, 1, GRID[:2], seed=2).log_elements
    assert np.sort(drawn.std(axis=0)) == pytest.approx([0, 0, 0, 0.2, 0.3], abs=0.015)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"between_persons": {"d1": 0.1}}, "the same for all"),
        ({"between_repetitions": {"a1": 0.1}}, "the same for all"),
        ({"force_exponent": {"d1": 0.3}}, "the same for all"),
        ({"central": {**STILL.central, "a1": 1.3}}, "between 0 and 1"),
        ({"central": {**STILL.central, "f1": -3.0}}, "must be a finite number at least"),
        ({"central": {**STILL.central, "d1": float("nan")}}, "is nan"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        simulate_recordings(replace(STILL, **change), 1, 1, GRID, seed=1)  # type: ignore[arg-type]
