"""Sweeps of noted direction: which changes during a sweep can be looked for, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.catalogue.offered import about_direction, not_shown, offered
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings


def recorded(directions: tuple[int, int] | None, noted: str = "sweep_direction=up") -> Recordings:
    made = simulate_recordings(THREE_ELEMENTS, 4, 2, np.geomspace(10, 1000, 12), 1).recordings
    table = {} if directions is None else {noted: np.array(directions, dtype=float)}
    return replace(made, subjects=tuple(replace(one, circumstances=table) for one in made.subjects))


@pytest.mark.parametrize("directions", [None, (1, 1), (0, 0), (1, 0)])
def test_a_change_during_the_sweep_is_one_curve_of_one_direction(directions: tuple[int, int] | None) -> None:
    made = recorded(directions)
    shown = {effect.id for effect in offered(registered(), made)}
    both = directions == (1, 0)
    assert ("body.drift" in shown) != both
    assert "body.amplitude" in shown
    assert not_shown(made) == (("body.drift in sweeps of both directions",) if both else ())


def test_what_directions_mean_is_said() -> None:
    assert about_direction(recorded(None), ["body.drift"]) == ()
    assert about_direction(recorded((1, 1)), ["body.drift"]) == ()
    down = recorded((1, 1), "sweep_direction=down")
    assert "in time it has the opposite sign" in about_direction(down, ["body.drift"])[0]
    assert about_direction(down, ["body.mass"]) == ()
    assert "Sweeps of both directions are noted" in about_direction(recorded((0, 1)), [])[0]


def test_downwards_the_curve_is_that_of_the_opposite_change() -> None:
    """A factor exp(x q) from the other end is exp(x) exp(-x q): module docstring."""
    w, p, x = np.geomspace(10.0, 1000.0, 30), 0.7, 0.3
    up = (1 - (w / w[0]) ** -p) / (1 - (w[-1] / w[0]) ** -p)
    down = (1 - (w / w[-1]) ** -p) / (1 - (w[0] / w[-1]) ** -p)
    assert down[-1] == 0.0
    np.testing.assert_allclose(down[0], 1.0)
    np.testing.assert_allclose(np.exp(x * down), np.exp(x) * np.exp(-x * up))
