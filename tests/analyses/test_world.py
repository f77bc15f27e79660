"""The virtual world obeys its physics, and what is true of it is computed rightly."""

import importlib
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse

FOLDER = DATA.parent / "analyses" / "concealed"
sys.path.insert(0, str(FOLDER))  # the scripts import each other by name, as when they are run
tissue, rig, friction, kinds, experiment = (
    importlib.import_module(f"world.{name}") for name in ("tissue", "rig", "friction", "kinds", "experiment")
)
people, equivalence, visible, nearest_entry = (
    importlib.import_module(name) for name in ("people", "equivalence", "visible_in_world", "nearest_entry")
)

F = np.geomspace(5, 5000, 61)
S = 2j * np.pi * F


def _plan(name: str, strength: float = 0.3, **sizes: Any) -> Any:
    return experiment.Plan(kinds=(name,), strengths=(strength,), seed=3, **({"n_subjects": 8, "n_points": 41} | sizes))


def test_the_world_imports_nothing_that_it_checks() -> None:
    for path in (FOLDER / "world").glob("*.py"):
        assert "bayes_impedance" not in path.read_text(encoding="utf-8"), path.name


def test_with_nothing_switched_on_the_world_is_the_network() -> None:
    e = experiment.conduct(_plan("nothing"))
    kernel = Kernel(parse(people.NETWORK))
    theta = np.ascontiguousarray(e.fingers.log_elements.reshape(-1, 8))
    expected = kernel.impedance(theta, e.plan.frequency_hz).reshape(e.clean.shape)
    # The sensor is stiff and not rigid: far below the noise of all recordings together.
    assert np.abs(e.clean / expected - 1).max() < 2e-4
    assert np.all(e.clean == e.without)


def test_calibration_and_quantisation_are_far_below_the_noise() -> None:
    e = experiment.conduct(_plan("nothing"))
    s = 2j * np.pi * e.plan.frequency_hz
    plan = e.plan
    pooled = e.sd.mean(axis=(0, 1)) / np.sqrt(120)
    rng = np.random.default_rng(1)
    errors = np.array([plan.rig.calibration_error(s, rng) for _ in range(50)])
    assert np.max(np.sqrt(np.mean(np.abs(errors) ** 2, axis=0) / 2) / pooled) < 0.3
    assert np.max(plan.rig.quantisation_sd(s, e.clean) / e.sd) < 0.3


def test_line_is_many_sections() -> None:
    mass, z0 = 2e-3, 1 / (S * 7e-7) + 60.0
    sections = 2000
    z = np.full_like(S, 1e15)  # held
    piece = tissue.common_velocity(S * mass / sections)
    spring = tissue.common_force(1 / (z0 * sections))
    for _ in range(sections):
        z = (spring @ piece).seen(z) if _ == 0 else piece.seen(spring.seen(z))
    exact = tissue.layer_on_rigid_base(S, mass, z0)
    assert np.abs(z / exact - 1).max() < 3e-3
    # Slow motion sees the layer's spring and a third of its mass.
    low = tissue.layer_on_rigid_base(S[:1], mass, z0[:1])
    assert low[0] == pytest.approx(z0[0] + S[0] * mass / 3, rel=1e-6)


def test_two_ports_are_reciprocal_and_chain() -> None:
    chain = rig.Rig(adhesive_compliance=1e-7, pad=(1e-4, 1e-7, 0.3), mode=(1e-4, 700.0, 0.05), added_mass=1e-5)
    for loaded in (True, False):
        port = chain.chain(S, loaded)
        assert np.allclose(port.a * port.d - port.b * port.c, 1, rtol=1e-9)
    first, second, z = tissue.common_velocity(0.02 * S), tissue.common_force(1e-6 * S), 3 + 1 / (1e-3 * S)
    assert np.allclose((first @ second).seen(z), first.seen(second.seen(z)))
    assert np.allclose(first.seen(z), z + 0.02 * S)
    assert np.allclose(1 / second.seen(z), 1 / z + 1e-6 * S)


def test_subtraction_leaves_what_the_algebra_says() -> None:
    z = 20 + S * 1e-3
    chain = rig.Rig(adhesive_compliance=2e-7)
    port = chain.chain(S, False)
    assert np.allclose(chain.measured(S, z), z / (port.d * (port.c * z + port.d)), rtol=1e-6)
    heavier = rig.Rig(sensor_compliance=0.0, added_mass=3e-5)
    assert np.allclose(heavier.measured(S, z), z + 3e-5 * S)
    assert np.allclose(rig.Rig(sensor_compliance=0.0).measured(S, z), z)


def test_electronics_cancel_when_equal_and_shift_the_phase_when_not() -> None:
    assert np.allclose(rig.Rig().electronics(S), 1)
    assert np.allclose(rig.Rig(skew_s=2e-6).electronics(S), np.exp(-2e-6 * S))
    unequal = rig.Rig(highpass_hz=(0.55, 0.05)).electronics(S)
    assert np.allclose(unequal, S / (S + 2 * np.pi * 0.5), atol=0.006)


@pytest.mark.parametrize("f", [31.0, 48.0, 50.0, 333.0])
def test_leakage_is_that_of_the_lock_in(f: float) -> None:
    phase, hum = 0.7, 50.0
    t = (np.arange(200_000) + 0.5) / 200_000 * rig.AVERAGED_PERIODS / f
    direct = 2 * np.mean(np.cos(2 * np.pi * hum * t + phase) * np.exp(-2j * np.pi * f * t))
    found = rig.leakage(np.array([2 * np.pi * f]), 2 * np.pi * hum, np.array([phase]))[0]
    assert found == pytest.approx(direct, abs=1e-6)


def test_quantisation_noise_is_that_of_the_lock_in() -> None:
    rng = np.random.default_rng(2)
    q, n = 0.02, 1000
    t = np.arange(n) / n * rig.AVERAGED_PERIODS
    signal = np.cos(2 * np.pi * t + rng.uniform(0, 2 * np.pi, size=(2000, 1))) + 0.02 * rng.normal(size=(2000, n))
    error = 2 * np.mean((np.round(signal / q) * q - signal) * np.exp(-2j * np.pi * t), axis=1)
    assert error.real.std() == pytest.approx(q / np.sqrt(6 * n), rel=0.1)


def test_sweep_goes_from_low_to_high_and_takes_ten_periods_a_point() -> None:
    at = rig.measured_at(F, 0.1)
    assert np.all(np.diff(at) > 0)
    assert at[0] == pytest.approx(7.5 / 5 + 0.1)
    assert rig.sweep_seconds(F, 0.1) == pytest.approx(np.sum(10 / F) + 6.1)
    e = experiment.conduct(_plan("body.drift.sweep"))
    fall = np.log(np.abs(experiment._creep(e.plan, "creep.sweep", {"change": np.ones((8, 1, 1))}))[0, 0])
    assert np.all(np.diff(fall) > 0)  # softer and softer
    session = experiment._creep(e.plan, "creep.session", {"change": 0.2})
    assert np.all(np.diff(session.mean(axis=-1)[0]) > 0)
    assert session[0, -1].mean() - session[0, 0].mean() == pytest.approx(0.2)


def test_spectrum_of_relaxations_is_a_power_law() -> None:
    for a in (0.3, 0.5):
        found = tissue.relaxation_spectrum(S, 2.0, a)
        # What the truncated spectrum lacks is a spring and a damper, which the network has anyway.
        assert np.abs(found / (2.0 * S ** (a - 1)) - 1).max() < 0.02


def test_poroelastic_layer_between_its_limits() -> None:
    low, high = 2j * np.pi * np.array([1e-4]), 2j * np.pi * np.array([1e6])
    assert tissue.poroelastic(low, 1e3, 0.05)[0] == pytest.approx(1e3 * 0.05 / 3, rel=1e-3)
    assert (high * tissue.poroelastic(high, 1e3, 0.05))[0] == pytest.approx(1e3, rel=1e-2)


def test_everything_of_the_body_is_passive() -> None:
    for name, kind in kinds.KINDS.items():
        if kind.body is None or name.startswith(("body.reflex", "trap")):  # muscles are active
            continue
        own = kind.start(np.random.default_rng(1))
        z = kind.body(S, 1 / (1e-6 * S) + 5.0, own)
        assert np.all(z.real > 0), name


@pytest.mark.parametrize(
    ("place", "frequency", "stiffness", "breakaway"),
    [("skin", (2000.0, 3000.0, 4500.0), 8e5, 8e-8), ("tissue", (40.0, 80.0, 160.0), 1000.0, 3e-5)],
)
def test_friction_by_harmonic_balance_agrees_with_an_integration_in_time(
    place: str, frequency: tuple[float, ...], stiffness: float, breakaway: float
) -> None:
    f, velocity = np.array(frequency), np.full(3, 0.05)
    s, log_elements = 2j * np.pi * f, np.log([people.CENTRAL[e] for e in people.ELEMENTS])
    seen = []

    def note(_s: np.ndarray, z: np.ndarray) -> np.ndarray:
        seen.append(z)
        return z

    z = people.impedance(log_elements, f, {place: note})
    other = 1 / (1 / z - 1 / seen[0])
    balanced = friction.sliding(
        s, seen[0], lambda part: 1 / (1 / other + 1 / part), lambda z: velocity + 0 * z.real, stiffness, breakaway
    )
    stuck = people.impedance(log_elements, f, {place: lambda s, z: z + stiffness / s})
    # The skin's mass and damping make a fast pole: steps must be shorter than it.
    timed = friction.simulate(
        people.CENTRAL, f, velocity, stiffness, breakaway, place, steps=600 if place == "skin" else 2500
    )
    assert np.abs(timed / balanced - 1).max() < 0.006
    # It slides and yet holds, which the agreement would not notice otherwise.
    assert np.abs(balanced / stuck - 1).max() > 0.04
    assert np.abs(balanced / z - 1).max() > 0.015


def test_jenkins_element_by_its_own_hysteresis_loop() -> None:
    k, breakaway, amplitude = 3.0, 1.0, 2.5
    t = np.arange(0, 3, 1e-4)
    x, slip, force = amplitude * np.cos(2 * np.pi * t), 0.0, np.empty(t.size)
    for i, value in enumerate(x):
        slip = min(max(slip, value - breakaway), value + breakaway)
        force[i] = k * (value - slip)
    last = t >= 2
    found = 2 * np.mean(force[last] * np.exp(-2j * np.pi * t[last])) / amplitude
    assert friction.describing_function(np.array(amplitude), k, breakaway) == pytest.approx(found, rel=2e-3)
    assert friction.describing_function(np.array(0.5), k, breakaway) == pytest.approx(k)


@pytest.mark.parametrize("name", [n for n, k in kinds.KINDS.items() if k.power and k.special != "hum"])
def test_strength_is_what_was_asked_for(name: str) -> None:
    plan = _plan(name, 0.2)
    e = experiment.conduct(plan)
    kind = kinds.KINDS[name]
    without, with_it = experiment.calibration_readings(plan, e.population, kind, e.values[0], 0)
    moved = np.abs((with_it - without).mean(axis=0)) / experiment.between_persons(without)
    assert moved.max() == pytest.approx(0.2, rel=2e-3)


def test_force_explains_the_skin_by_hertz_and_total_dispersion_stays() -> None:
    e = experiment.conduct(_plan("body.covariate", 0.6, n_subjects=3000, n_points=5, n_repetitions=1))
    x = e.fingers.log_elements + experiment._hertz(e.fingers.force_n)
    i = people.ELEMENTS.index("n3")
    slope = np.polyfit(np.log(e.covariates["contact_force_n"]), x[:, 0, i], 1)[0]
    assert slope == pytest.approx(-1 / 3, abs=0.05)
    assert x[:, 0, i].std() == pytest.approx(np.hypot(0.35, 0.065), rel=0.06)


def test_switching_something_on_changes_neither_people_nor_noise() -> None:
    nothing, delay = (experiment.conduct(_plan(name)) for name in ("nothing", "rig.delay"))
    assert np.array_equal(nothing.fingers.log_elements, delay.fingers.log_elements)
    noise, same = ((e.recorded - e.clean) / e.sd for e in (nothing, delay))
    assert np.allclose(noise, same, atol=0.02)  # but for the converters' part, which follows the size of the signal


def test_traps_are_invisible_and_effects_are_seen_where_they_act() -> None:
    for name in ("trap.spring", "trap.mass", "trap.damper"):
        e = experiment.conduct(_plan(name, 0.3))
        _, rest = visible.imitated(e, e.clean)
        assert np.sqrt(np.sum(rest**2)) < 0.1, name  # standard errors
        assert not visible.truth_of(e)["mismatch"]
    delay = visible.truth_of(experiment.conduct(_plan("rig.delay")))
    assert delay["effects"][0]["visible_bands_hz"][-1][1] == pytest.approx(5000)
    assert delay["visible"] > 6


def test_equivalence_tells_the_same_from_the_different() -> None:
    e = experiment.conduct(_plan("rig.delay", n_subjects=30, n_points=81))
    assert equivalence.same(e, [("rig.delay", "port")])
    assert not equivalence.same(e, [("rig.damping", "port")])
    assert not equivalence.same(e, [])
    lowpass = experiment.conduct(_plan("rig.lowpass"))
    assert equivalence.same(lowpass, [("rig.delay", "port")])


def test_true_values_are_those_in_the_terms_of_the_entry() -> None:
    plan = _plan("rig.highpass")
    kind = kinds.KINDS["rig.highpass"]

    def corner(**changes: Any) -> tuple[float, float]:
        e = experiment.conduct(replace(plan, **changes))
        return nearest_entry.true_parameters(e, kind, 0)["corner_hz"][0], e.values[0]["size"]

    # With the other channel's corner far below the band the world's filter is the entry's.
    found, size = corner(rig=replace(plan.rig, highpass_hz=(1e-6, 1e-6)))
    assert found == pytest.approx(size, rel=1e-3)
    found, size = corner(rig=replace(plan.rig, highpass_hz=(1.0, 1.0)))
    assert 0.5 * size < found < 0.99 * size
    # A gain of the rig is part of what has an impedance's unit.
    e = experiment.conduct(replace(_plan("rig.mass"), conditions=people.Conditions(gain_error=0.02)))
    mass, unit = nearest_entry.true_parameters(e, kinds.KINDS["rig.mass"], 0)["mass"]
    assert (mass, unit) == (pytest.approx(1.02 * e.values[0]["size"]), "kg")
