"""The network is searched anew beside what was added, where its elements were driven away."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, Serial, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate, registered
from bayes_impedance.diagnosis.fit.cold_start import driven_away
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.lost_elements import lost_elements
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection import far_starts
from bayes_impedance.diagnosis.selection.far_starts import at_the_port, network_from_afar, refits_from_afar
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import from_afar
from bayes_impedance.diagnosis.selection.trial import try_candidate

NETWORK = "((r1|n1)-n2-r2)|((m1|r3)-r4)"
CENTRES = {"r1": 27.7, "n1": 3.7e-4, "n2": 1.1e-4, "r2": 36.7, "m1": 0.045, "r3": 45.4, "r4": 13.5}
MASS = -1.1e-4


@pytest.fixture(scope="module")
def world() -> Experiment:
    return toy(
        NETWORK, CENTRES, seed=4, n=10, noise=0.005, frequency_hz=np.geomspace(3.5, 1500, 80),
        hidden=lambda s, z, _: (z + MASS * s, np.zeros(10)),
    )  # fmt: skip


def shape_values_of(fit: Refit) -> list[float]:
    """Values of the last addition's parameters."""
    model, scales = fit.model, fit.model.scales
    columns = model.columns(len(model.additions) - 1)
    coefficients = model.additions[-1].effect.coefficients
    return [float(c.value(fit.u[0, column], scales)) for c, column in zip(coefficients, columns, strict=True)]


@pytest.fixture(scope="module")
def right(world: Experiment) -> Refit:
    """The mass beside the elements of the recordings without it."""
    fit = world.fit()
    model = extended(fit.model, Candidate(entry("rig.mass"), "port", {}), "shared", 0.0)
    u, population = extended_start(fit, model)
    names = model.network.elements
    u[:, : len(names)] = np.log([CENTRES[name] for name in names])
    u[:, len(names)] = MASS / entry("rig.mass").coefficients[0].scale(model.scales)
    population.mu[:] = u[0, : len(names)]
    return world.refitter.fit(model, u, population, 100)


def test_elements_that_were_driven_away_come_back_beside_the_mass(world: Experiment, right: Refit) -> None:
    rng = np.random.default_rng(1)
    u, people = right.u.copy(), right.owner
    for name in ("n2", "r2", "m1"):
        u[:, right.model.network.elements.index(name)] += (-7 + 2 * rng.normal(size=people.max() + 1))[people]
    lost = world.refitter.fit(right.model, u, right.population, 30)
    assert driven_away(lost).any()
    missing = right.evidence.sum() - lost.evidence.sum()
    assert missing > 1000
    again = network_from_afar(world.refitter, lost, 1, 60)
    assert right.evidence.sum() - again.evidence.sum() < 0.02 * missing  # single people are searched afterwards
    np.testing.assert_allclose(again.population.mu, right.population.mu, atol=0.3)


def test_nothing_is_searched_where_everybody_has_the_elements(world: Experiment, right: Refit) -> None:
    assert not driven_away(right).any()
    assert network_from_afar(world.refitter, right, 1, 60) is right


@pytest.mark.parametrize("off", [False, True])
def test_masses_are_searched_from_afar_unless_the_network_describes_nothing(
    world: Experiment, off: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(far_starts, "wholly_off", lambda _: off)
    names = {candidate.effect.id for candidate in at_the_port(world.fit(), registered())}
    assert {"rig.delay", "rig.highpass", "rig.lowpass"} <= names
    added = {"rig.mass", "rig.stiffness", "rig.damping", "rig.resonance", "rig.semi_inductance"}
    added |= {"body.mass", "body.bypass", "body.resonator"}
    assert (added <= names) is not off
    assert not (off and added & names)


def test_a_semi_inductance_is_found_from_elements_that_it_has_driven_away() -> None:
    """Its exponent lies between values of the grid; its coefficient is that in the middle of the band."""
    size, exponent = 2.0, 0.42
    coil = toy(
        NETWORK, CENTRES, seed=4, n=10, noise=0.005, frequency_hz=np.geomspace(3.5, 1500, 80),
        hidden=lambda s, z, _: (z + size * s**exponent, np.zeros(10)),
    )  # fmt: skip
    fit = coil.fit()
    (candidate,) = [c for c in at_the_port(fit, registered()) if c.effect.id == "rig.semi_inductance"]
    best = max(refits_from_afar(coil.refitter, fit, candidate, 1, 40), key=lambda g: float(g.evidence.sum()))
    assert best.evidence.sum() > fit.evidence.sum() + 100
    found = dict(zip(("coefficient", "exponent"), shape_values_of(best), strict=True))
    assert found["exponent"] == pytest.approx(exponent, abs=0.02)
    assert found["coefficient"] == pytest.approx(size * fit.model.scales.middle**exponent, rel=0.05)


def test_where_the_network_took_the_place_of_the_rigs_damper_it_is_found_from_afar() -> None:
    """Its weak branch has become the damper, and nobody's recordings feel the spring in it: it differs in nobody."""
    damping = 11.0
    centres = {"m1": 1.6, "n1": 1.8e-4, "r2": 24.0, "n2": 4.8e-3}
    frequency_hz = np.geomspace(0.64, 516, 61)
    hidden = toy(
        "m1|n1|(r2-n2)", centres, seed=1, noise=0.016, tau=0.35, frequency_hz=frequency_hz,
        hidden=lambda s, z, _: (z + damping, np.zeros(20)),
    )  # fmt: skip
    names = hidden.model.network.elements
    r2, n2 = names.index("r2"), names.index("n2")
    u, mu = hidden.u.copy(), hidden.population.mu.copy()
    u[:, r2] = mu[r2] = np.log(damping)
    u[:, n2] = mu[n2] = np.log(5e-7)
    fit = hidden.refitter.fit(hidden.model, u, replace(hidden.population, mu=mu), 60)
    assert not driven_away(fit).any()
    assert lost_elements(fit).tolist() == [name == "n2" for name in names]
    trials = from_afar(hidden.refitter, fit, [entry("rig.damping")], 1)
    best = max(trials, key=lambda t: t.gain)
    assert best.physical
    assert best.gain > 100
    size = entry("rig.damping").coefficients[0].scale(hidden.model.scales)
    assert best.fit.u[0, -1] * size == pytest.approx(damping, rel=0.02)


def test_a_low_pass_that_the_elements_have_absorbed_is_found_from_afar() -> None:
    """A mass behind it has a resistance, as one in series with a large damper has: the scan is blind to it."""
    constant = 7e-6
    centres = {"r1": 0.0225, "m1": 5.2e-4, "m2": 3.4e-4, "r2": 0.536}
    behind = toy(
        "(r1-m1)|m2|r2", centres, seed=2, n=12, noise=0.003, frequency_hz=np.geomspace(11, 4500, 81),
        hidden=lambda s, z, _: (z / (1 + constant * s), np.zeros(12)),
    )  # fmt: skip
    u, mu = behind.u.copy(), behind.population.mu.copy()
    u[:] = mu[:] = [3.7, -8.1, -10.7, -0.57]
    fit = behind.refitter.fit(behind.model, u, replace(behind.population, mu=mu), 80)
    assert not lost_elements(fit).any()
    assert fit.evidence.sum() > behind.fit().evidence.sum()
    (lowpass,) = [e for e in registered() if e.id == "rig.lowpass"]
    residuals = person_residuals(fit, [f"p{i}" for i in range(12)], Serial())
    screening = screen(fit, residuals, registered(), 1, Serial())
    (k,) = [k for k, c in enumerate(screening.candidates) if c.effect == lowpass]
    (near,) = try_candidate(behind.refitter, fit, screening.candidates[k], float(screening.size[k]), ("shared",), 30)
    assert near.gain < 5
    assert from_afar(behind.refitter, fit, [lowpass], 1) == []
    (trial,) = from_afar(behind.refitter, fit, [lowpass], 1, screening)
    assert trial.gain > 1000
    assert shape_values_of(trial.fit)[0] == pytest.approx(constant, rel=0.02)


def test_a_mass_that_differs_between_people_is_found_where_the_network_has_taken_its_place() -> None:
    """Its own mass has become the one at the port, and others of its elements nobody has."""
    mass = 6.2e-6
    centres = {"n2": 0.018, "r2": 0.27, "m1": 5.7e-3, "r1": 0.69, "n1": 0.019}

    def with_own_mass(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = mass * np.exp(0.37 * rng.normal(size=14))
        return z + own[:, None, None] * s, own

    padded = toy(
        "(n2|r2)-(m1|r1|n1)", centres, seed=3, n=14, noise=0.006, frequency_hz=np.geomspace(2.3, 835, 90),
        hidden=with_own_mass,
    )  # fmt: skip
    u, mu = padded.u.copy(), padded.population.mu.copy()
    u[:] = mu[:] = [-4.75, -0.18, -11.17, -0.88, -3.67]
    fit = padded.refitter.fit(padded.model, u, replace(padded.population, mu=mu), 100)
    assert lost_elements(fit).any()
    masses = [e for e in registered() if e.id in ("rig.mass", "body.mass")]
    by_side = {t.effect.side: t for t in from_afar(padded.refitter, fit, masses, 1)}
    assert by_side["body"].candidate.place == "port"
    assert by_side["body"].physical
    assert by_side["body"].gain > by_side["rig"].gain + 100
    column = by_side["body"].fit.model.columns(0)[0]
    size = entry("body.mass").coefficients[0].scale(padded.model.scales)
    assert by_side["body"].fit.u[:, column].mean() * size == pytest.approx(mass, rel=0.2)
