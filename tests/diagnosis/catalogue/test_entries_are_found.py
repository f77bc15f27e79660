"""Physics that a network lacks is named: small populations made by formulas of this file, with the whole catalogue.

A pad on a mass, ``(n2|r2)-(m1|r1|n1)``: 14 people, two repetitions, 1 % noise. People differ by 30 % in what they have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.offered import withheld
from bayes_impedance.diagnosis.verdict_types import Verdict
from bayes_impedance.recordings.dataset import Recordings, Subject

NETWORK = "(n2|r2)-(m1|r1|n1)"
CENTRE = {"n2": 5e-5, "r2": 12.0, "m1": 5e-3, "r1": 1.5, "n1": 1e-3}
PEOPLE, REPETITIONS = 14, 2
FREQUENCY = np.geomspace(2, 1000, 51)

Change = Callable[[np.ndarray, np.ndarray, float], np.ndarray]
"""s (F,), impedance of the place (F,) and the person's own factor to the changed impedance."""


@dataclass(frozen=True, kw_only=True)
class Hidden:
    """What the network lacks, where, and how the verdict has to call it."""

    change: Change
    place: str
    id: str
    truth: dict[str, float]
    spread: float = 0.3
    rivals: tuple[str, ...] = ()
    frequency: tuple[float, float] = (2.0, 1000.0)


def free_line(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    x = np.sqrt(s * z * 4e-6 * own)
    return z * np.tanh(x) / x


def film(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    k = np.arange(1, 80, 2)[:, None]
    return z + 4.0 * own * np.sum(96 / (np.pi * k) ** 4 / (1 + 4 * s * 0.02 / (np.pi * k) ** 2), axis=0)


def broad_relaxation(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    """A springpot of 3 N s/m at 300 rad/s that ends in a spring around 50 Hz."""
    return z + 1 / ((s / 300) ** 0.5 / (3.0 * own) + s * 8e-4 / own)


def layer_beside(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    x = np.sqrt(s * 0.03)
    return z + 4.0 * own * np.tanh(x) / x


def velocity_reflex(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    p = 2 * np.pi * 8.0
    return z + 1.5 * own * np.exp(-0.04 * s) * p**2 / (s**2 + 2 * p * s + p**2)


def softening(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    amplitude = 15.0 / (s.imag / (2 * np.pi))  # of a motion whose velocity is constant
    return z * np.exp(-0.2 * own * amplitude**2 / (1 + amplitude**2))


def coil(s: np.ndarray, z: np.ndarray, own: float) -> np.ndarray:
    return z + 0.03 * own * s**0.6


HIDDEN = {
    "free line": Hidden(
        change=free_line,
        place="m1",
        id="body.free_line",
        truth={"compliance": 4e-6},
        rivals=("body.diffusion",),  # behind the pad's damper, where a layer ends too
    ),
    "diffusion": Hidden(
        change=lambda s, z, own: free_line(s, z, 80 * own),
        place="r1",
        id="body.diffusion",
        truth={"compliance": 3.2e-4},
        rivals=("body.relaxation", "body.squeeze_film"),
    ),
    "broad relaxation": Hidden(
        change=broad_relaxation,
        place="port",
        id="body.broad_relaxation",
        truth={"exponent": 0.5, "compliance": 8e-4},
    ),
    "layer beside": Hidden(
        change=layer_beside,
        place="port",
        id="body.diffusion",
        truth={"damper": 4.0, "compliance": 0.03 / 4.0},
        rivals=("body.broad_relaxation",),
    ),
    "film": Hidden(
        change=film,
        place="port",
        id="body.squeeze_film",
        truth={"damping": 4.0, "time_constant": 0.02},
        rivals=("body.relaxation",),
    ),
    "reflex": Hidden(
        change=velocity_reflex,
        place="port",
        id="body.reflex_velocity",
        truth={"damping": 1.5, "latency": 0.04, "corner": 8.0},
        frequency=(1.0, 300.0),
    ),
    "amplitude": Hidden(
        change=softening, place="n1", id="body.amplitude", truth={"change": -0.2, "corner": 15.0, "steepness": 1.0}
    ),
    "coil": Hidden(
        change=coil,
        place="port",
        id="rig.semi_inductance",
        truth={"coefficient": 0.03, "exponent": 0.6},
        spread=0.0,
    ),
}


def recordings(hidden: Hidden | None, seed: int = 1, repetitions: int = REPETITIONS) -> tuple[Recordings, np.ndarray]:
    """Recordings, and everybody's factor."""
    rng = np.random.default_rng(seed)
    low, high = (2.0, 1000.0) if hidden is None else hidden.frequency
    f = np.geomspace(low, high, FREQUENCY.size)
    s, centre = 2j * np.pi * f, np.log(list(CENTRE.values()))
    factors = np.exp((0.0 if hidden is None else hidden.spread) * rng.normal(size=PEOPLE))
    subjects = []
    for i in range(PEOPLE):
        person, rows = centre + 0.25 * rng.normal(size=5), []
        for _ in range(repetitions):
            n2, r2, m1, r1, n1 = np.exp(person + 0.02 * rng.normal(size=5))
            parts = {"n2": 1 / (s * n2), "r2": r2 + 0 * s, "m1": s * m1, "r1": r1 + 0 * s, "n1": 1 / (s * n1)}
            if hidden is not None and hidden.place in parts:
                parts[hidden.place] = hidden.change(s, parts[hidden.place], factors[i])
            z = 1 / (1 / (parts["n2"] + parts["r2"]) + 1 / (parts["m1"] + parts["r1"] + parts["n1"]))
            if hidden is not None and hidden.place == "port":
                z = hidden.change(s, z, factors[i])
            rows.append(z * (1 + 0.007 * (rng.normal(size=f.size) + 1j * rng.normal(size=f.size))))
        names = tuple(str(j) for j in range(repetitions))
        subjects.append(Subject(name=f"P{i}", frequency_hz=f, z=np.array(rows), repetitions=names))
    made = Recordings(title="", unit="N s/m", network=NETWORK, source="", licence="", subjects=tuple(subjects))
    return made, factors


@cache
def verdict_of(name: str) -> tuple[Verdict, np.ndarray]:
    made, factors = recordings(HIDDEN[name])
    return diagnose(made, quick=True, workers=1).verdict, factors


@pytest.mark.long
@pytest.mark.parametrize("name", HIDDEN)
def test_it_is_named_or_left_undecided_with_its_usual_rival(name: str) -> None:
    hidden = HIDDEN[name]
    verdict, _ = verdict_of(name)
    (entry,) = verdict.physics
    undecided = {alias.id for alias in entry.aliases if not alias.separated}
    assert {entry.id, *undecided} <= {hidden.id, *hidden.rivals}
    assert hidden.id in {entry.id, *undecided}
    names = {hidden.id, *hidden.rivals}
    assert hidden.place in {entry.place, *(a.place for a in entry.aliases if not a.separated and a.id in names)}
    assert verdict.reliable


@pytest.mark.parametrize("name", ["free line", "reflex", "amplitude", "coil"])
def test_its_parameters_are_recovered(name: str) -> None:
    """Within the width of the 90 % interval, 3.3 standard errors: one population does not show that it covers."""
    hidden = HIDDEN[name]
    verdict, factors = verdict_of(name)
    for parameter, true in hidden.truth.items():
        found = verdict.physics[0].parameters[parameter]
        first = parameter == next(iter(hidden.truth))
        assert abs(found.median - true * (factors.mean() if first else 1.0)) < found.q95 - found.q05
        assert found.q95 - found.q05 < abs(true)


@pytest.mark.long
def test_what_no_network_contains_is_measured_without_one() -> None:
    """Not a quick diagnosis, which ends with the posterior of the network with what was found, if there is one."""
    made, _ = recordings(HIDDEN["amplitude"])
    diagnosis = diagnose(made, workers=1)
    (entry,) = diagnosis.verdict.physics
    assert entry.id == "body.amplitude"
    assert all(p.q05 < p.median < p.q95 for p in entry.parameters.values())
    assert diagnosis.fit is None
    assert any("body.amplitude cannot be written as a network" in remark for remark in diagnosis.verdict.remarks)


@pytest.mark.slow
@pytest.mark.ci
def test_one_sweep_of_each_shows_no_change_with_time_or_amplitude() -> None:
    made, _ = recordings(HIDDEN["amplitude"], repetitions=1)
    verdict = diagnose(made, quick=True, workers=1).verdict
    assert not {e.id for e in verdict.physics} & {"body.drift", "body.amplitude"}
    assert verdict.physics  # something remains, without that name
    assert withheld(made) == ("body.amplitude", "body.drift")
    assert "body.drift in one sweep of each" in verdict.not_identifiable
    again, _ = recordings(None)
    assert withheld(again) == ()
    few = replace(again, subjects=(*again.subjects[:3], *made.subjects[3:]))
    assert withheld(few) == ("body.amplitude", "body.drift")


@pytest.mark.parametrize("seed", range(3))
def test_where_nothing_is_missing_the_whole_catalogue_names_nothing(seed: int) -> None:
    made, _ = recordings(None, seed)
    assert diagnose(made, quick=True, workers=1).verdict.physics == ()
