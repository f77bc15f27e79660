"""The sampled loop: poles against a simulation in time, known limits, and a population's share."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampled_simulation import FINE, first_order, grows, mechanics
from strategies import repeatable

from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.loop.device import PHANTOM, Device, Section
from bayes_impedance.design.loop.hessenberg import all_inside, reduced
from bayes_impedance.design.loop.sampled_loop import MARGIN, largest_stiffness, sampled_loop, stable
from bayes_impedance.design.loop.stability import limit_of, loop_of, reason, stability_map
from bayes_impedance.design.loop.transparency import transparency
from bayes_impedance.design.representatives import representatives, spanning
from bayes_impedance.design.users import UserPopulation, Users
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.population.fingertip import FINGERTIP

CASES = 70
"""Of each of three kinds of mechanics: 210 together."""

NEAR = 2e-3
"""Loops whose largest pole is nearer to the unit circle than this are left out: they grow e-fold in 500 periods."""

PERIODS = 3000


def population(draws: int = 60, spread: float = 0.05, seed: int = 1) -> UserPopulation:
    """Virtual fingertips and a posterior about them."""
    network = parse(FINGERTIP.network)
    rng = np.random.default_rng(seed)
    tau = FINGERTIP.vector(FINGERTIP.between_persons)
    mu = np.log(FINGERTIP.vector(FINGERTIP.central)) + spread * rng.normal(size=(draws, tau.size))
    scale = tau * np.exp(spread * rng.normal(size=(draws, tau.size)))
    factor = scale[:, :, None] * np.linalg.cholesky(FINGERTIP.correlation_matrix())
    return UserPopulation(
        network=network, unit="N s/m", mu=mu, factor=factor, between_repetitions=0.05 * np.ones_like(mu)
    )


# -------------------------------------------------------------------- exact poles against time


@pytest.mark.parametrize("kind", ["structure", "rigid", "free"])
def test_poles_and_simulation_agree_on_stability(kind: str) -> None:
    rng = np.random.default_rng({"structure": 1, "rigid": 2, "free": 3}[kind])
    systems, period, delay, k, b, radius = [], [], [], [], [], []
    while len(systems) < CASES:
        user = {e: v * np.exp(0.5 * rng.normal()) for e, v in FINGERTIP.central.items()}
        device = {"m": 10 ** rng.uniform(-2, -0.5), "r": 10 ** rng.uniform(-3, 0), "mt": 10 ** rng.uniform(-3, -2)}
        sections = [Section("beside", "m1|r1", {"m1": device["m"], "r1": device["r"]})]
        network = PAPER_NETWORK
        if kind == "free":
            user = {e: v for e, v in user.items() if e not in ("r1", "n1")}
            network = "(n3|r3)-(m2|(m1-(n2|r2)))"
        if kind == "structure":
            device |= {"n": 10 ** rng.uniform(-4.5, -3), "rs": 10 ** rng.uniform(-1, 0.5)}
            sections.append(Section("between", "n1|r1", {"n1": device["n"], "r1": device["rs"]}))
        sections.append(Section("beside", "m1", {"m1": device["mt"]}))
        t, steps = 10 ** rng.uniform(-3.5, -2.5), int(rng.choice([0, 0, 7, FINE, 33, 2 * FINE + 5]))
        loop = sampled_loop(Device("any", tuple(sections), t, steps * t / FINE), realise(parse(network), user))
        damping = float(rng.choice([0.0, 10 ** rng.uniform(-1, 1)]))
        limit = largest_stiffness(loop, damping, 1e7)[0][0]
        stiffness = max(float(limit), 5.0) * 10 ** rng.uniform(-0.7, 0.7)
        largest = loop.radius(np.array([[stiffness]]), np.array([[damping]]))[0, 0]
        if abs(largest - 1) < NEAR:
            continue
        systems.append(first_order(*mechanics(user, device)))
        for rows, value in ((period, t), (delay, steps), (k, stiffness), (b, damping), (radius, largest)):
            rows.append(value)
    told = np.array(radius) >= 1
    assert 0.2 < told.mean() < 0.8
    seen = grows(systems, np.array(period), np.array(delay), np.array(k), np.array(b), PERIODS)
    np.testing.assert_array_equal(seen, told)


@pytest.mark.parametrize("delay", [0.0, 0.3e-3, 1e-3, 2.6e-3])
def test_fast_decision_is_the_radius_of_the_poles(delay: float) -> None:
    rng = np.random.default_rng(4)
    users = population().draw(12, seed=2)
    loop = loop_of(Device("late", PHANTOM.sections, 1e-3, delay), users)
    k, b = 10 ** rng.uniform(0, 6, (12, 150)), rng.uniform(0, 80, (12, 150)) * (rng.random((12, 150)) < 0.8)
    radius = loop.radius(k, b)
    clear = np.abs(radius - 1) > 1e-8
    np.testing.assert_array_equal(loop.inside(k, b)[clear], (radius < 1 + MARGIN)[clear])
    assert 0.1 < np.mean(radius < 1) < 0.9
    one = stable(loop, k[0], b[0], workers=1)
    np.testing.assert_array_equal(one, stable(loop, k[0], b[0], workers=2))


@repeatable
@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_one_changed_row_has_the_same_eigenvalues(size: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix, column, rows = rng.normal(size=(size, size)), rng.normal(size=size), rng.normal(size=(6, size))
    rows *= 10 ** rng.uniform(-2, 2, (6, 1))
    form, turned = reduced(matrix, column)
    largest = np.array([np.abs(np.linalg.eigvals(matrix + np.outer(column, row))).max() for row in rows])
    result = np.empty(6, dtype=np.int8)
    for limit in (*(largest * (1 + 1e-6)), *(largest * (1 - 1e-6))):
        all_inside(form, rows @ turned, limit, result)
        np.testing.assert_array_equal(result, largest < limit)


# -------------------------------------------------------------------- known limits


def test_limit_of_a_mass_with_a_damper_is_the_published_one() -> None:
    # Without a hand: K < b/(T/2 + delay) where the device is slow compared to T (Gil et al. 2004, Colgate 1997).
    nobody = realise(parse("m1|r1"), {"m1": 1e-9, "r1": 1e-9})
    for delay in (0.0, 0.5e-3, 1e-3, 3.2e-3):
        device = Device("slow", (Section("beside", "m1|r1", {"m1": 10.0, "r1": 2.0}),), 1e-3, delay)
        limit = largest_stiffness(sampled_loop(device, nobody), 0.0, 1e6)[0][0]
        assert limit == pytest.approx(2.0 / (0.5e-3 + delay), rel=0.01)


def test_the_classical_bound_is_safe_in_every_hand() -> None:
    users = population().draw(40, seed=5)
    device = Device("damped", (Section("beside", "m1|r1", {"m1": 0.05, "r1": 3.0}),), 1e-3)
    b = np.linspace(0, 2.9, 12)
    assert stable(loop_of(device, users), 0.999 * device.classical_stiffness(b), b).all()


def test_where_stability_ends_is_a_pole_on_the_circle_at_the_stated_frequency() -> None:
    loop = loop_of(PHANTOM, population().draw(5, seed=6))
    limit, hertz = largest_stiffness(loop, 2.0, 1e6)
    poles = loop.poles(limit[:, None], np.full((5, 1), 2.0))[:, 0]
    assert np.abs(poles).max(axis=1) == pytest.approx(1, abs=1e-8)
    on_circle = poles[np.arange(5), np.argmax(np.abs(poles), axis=1)]
    np.testing.assert_allclose(np.abs(np.angle(on_circle)) / (2 * np.pi * 1e-3), hertz, rtol=1e-6)
    none, at = largest_stiffness(loop, 2.0, 10.0)
    assert (none == 10.0).all()
    assert np.isnan(at).all()
    never, _ = largest_stiffness(loop, 1e4, 1e6)
    assert (never == 0).all()


# -------------------------------------------------------------------- population


def test_weights_turn_users_into_single_populations() -> None:
    p = population(spread=0.08)
    users = p.draw(20000, seed=7)
    rows = np.unique(np.linspace(0, len(p.mu) - 1, 5).astype(int))
    weights = p.weights(users, 5)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    for weight, row in zip(weights, rows, strict=True):
        mean = weight @ users.u
        spread = np.sqrt(np.diag(p.factor[row] @ p.factor[row].T))
        error = np.sqrt(np.sum(weight**2))
        assert np.all(np.abs(mean - p.mu[row]) < 5 * error * spread)
        away = users.u - mean
        np.testing.assert_allclose(np.sqrt(weight @ away**2), spread, rtol=6 * error)


def test_share_of_one_population_is_that_of_its_own_users() -> None:
    p = population(spread=0.1)
    users = p.draw(1500, seed=8)
    gains, damping = np.array([4000.0, 7000.0]), np.array([0.0])
    found = stability_map(p, users, PHANTOM, gains, damping, populations=20)
    assert np.all(found.low <= found.probability)
    assert np.all(found.probability <= found.high)
    k, b = (x.ravel() for x in np.meshgrid(gains, damping))
    rows = np.unique(np.linspace(0, len(p.mu) - 1, 20).astype(int))
    weights = p.weights(users, 20)
    estimated = weights @ stable(loop_of(PHANTOM, users), k, b)
    direct = np.empty_like(estimated)
    for i, row in enumerate(rows):
        alone = UserPopulation(
            network=p.network,
            unit=p.unit,
            mu=p.mu[[row]],
            factor=p.factor[[row]],
            between_repetitions=p.between_repetitions[[row]],
        )
        direct[i] = stable(loop_of(PHANTOM, alone.draw(300, seed=i)), k, b).mean(axis=0)
    middle = np.clip(0.5 * (estimated + direct), 0.01, 0.99)
    error = np.sqrt(middle * (1 - middle) * (1 / 300 + np.sum(weights**2, axis=1)[:, None]))
    away = (estimated - direct) / error
    assert np.sqrt(np.mean(away**2)) < 1.5
    assert abs(np.mean(away)) < 0.7
    assert np.ptp(direct[:, 1]) > 0.1  # populations do differ
    assert np.mean((direct >= found.low[0]) & (direct <= found.high[0])) > 0.75


def test_ignoring_the_population_promises_too_much() -> None:
    p = population()
    users = p.draw(600, seed=9)
    limit = limit_of(p, users, PHANTOM, 0.0)
    assert limit.low <= limit.stiffness <= limit.high < limit.mean_user
    assert np.mean(limit.each >= limit.mean_user) < 0.7  # the promise is broken for many
    assert limit.classical < limit.stiffness
    certain = UserPopulation(
        network=p.network,
        unit=p.unit,
        mu=p.centre[None],
        factor=p.factor[:1] * 1e-6,
        between_repetitions=p.between_repetitions[:1],
    )
    nobody_differs = limit_of(certain, certain.draw(50, seed=1), PHANTOM, 0.0)
    assert nobody_differs.stiffness == pytest.approx(limit.mean_user, rel=1e-4)


def test_reasons_add_up() -> None:
    p = population()
    users = p.draw(300, seed=10)
    limit = limit_of(p, users, PHANTOM, 0.0)
    why = reason(p, users, limit.worst, PHANTOM, 0.0)
    assert why.difference == pytest.approx(np.log(limit.each[limit.worst] / limit.mean_user), abs=1e-6)
    assert why.part.sum() == pytest.approx(why.difference, rel=0.02)
    assert list(np.abs(why.part)) == sorted(np.abs(why.part), reverse=True)
    swapped = users.u[limit.worst].copy()
    main = users.elements.index(why.elements[0])
    swapped[main] = p.centre[main]  # with an ordinary value there, most of the harm is undone
    healed = Users(users.network, users.unit, ("healed",), swapped[None])
    better = largest_stiffness(loop_of(PHANTOM, healed), 0.0, 1e6)[0][0]
    assert np.log(better / limit.each[limit.worst]) > 0.3 * abs(why.difference)


def test_representatives_follow_their_rules() -> None:
    p = population()
    users = p.draw(400, seed=11)
    chosen = representatives(p, users, (5.0, 5000.0), 6)
    names = chosen.users.names
    assert names[:5] == ("median", "stiff", "soft", "heavy", "light")
    assert len(chosen.rules) == len(names) == 11
    many = p.draw(4000, seed=12)
    low, high = np.abs(many.impedance([5.0])[:, 0].imag), np.abs(chosen.users.impedance([5.0])[:, 0].imag)
    assert np.mean(low < high[names.index("stiff")]) == pytest.approx(0.95, abs=0.015)
    assert np.mean(low < high[names.index("soft")]) == pytest.approx(0.05, abs=0.015)
    again, radius = spanning(p, users, 6)
    assert [users.names[i] in rule for i, rule in zip(again, chosen.rules[5:], strict=True)] == [True] * 6
    assert spanning(p, users, 12)[1] < radius


def test_users_vary_together_and_once_touched_a_little_more() -> None:
    p = population()
    many, touched = p.draw(8000, seed=13), p.draw(8000, seed=13, repetitions=True)
    np.testing.assert_allclose(np.cov(many.u.T), p.covariance, atol=0.008)
    assert np.all(touched.u.std(axis=0) > many.u.std(axis=0))
    np.testing.assert_array_equal(p.draw(7, seed=13).u, p.draw(7, seed=13).u)
    with pytest.raises(InputError, match="ask for at least one"):
        p.draw(0, seed=1)


# -------------------------------------------------------------------- transparency


def test_a_fast_controller_transmits_device_and_wall() -> None:
    users = population().draw(3, seed=14)
    device = Device("fast", PHANTOM.sections[:1], period_s=1e-7)
    frequency = np.geomspace(5, 500, 10)
    found = transparency(users, device, 800.0, 2.0, frequency)
    s = 2j * np.pi * frequency
    np.testing.assert_allclose(found.transmitted, np.tile(0.072 * s + 0.005 + 800 / s + 2.0, (3, 1)), rtol=1e-3)
    np.testing.assert_allclose(found.desired, 800 / s + 2.0)
    with pytest.raises(InputError, match="above zero"):
        transparency(users, device, 0.0, 0.0, frequency)
    with pytest.raises(InputError, match="no user is stable"):
        transparency(users, PHANTOM, 1e6, 0.0, frequency)


def test_transmitted_impedance_is_that_of_the_sampled_motion() -> None:
    # A user pushes with a sine; what moves at that frequency after the transient is compared, images included.
    from scipy.linalg import expm

    user = FINGERTIP.central
    period, steps, k, b, hertz = 2e-3, 13, 700.0, 1.0, 1 / (2e-3 * 16)
    parts = (Section("beside", "m1|r1", {"m1": 0.05, "r1": 0.1}), Section("beside", "m1", {"m1": 0.004}))
    device = Device("slow", parts, period, steps * period / FINE)
    a = first_order(*mechanics(user, {"m": 0.05, "r": 0.1, "mt": 0.004}))
    n = len(a) - 1
    # The active force acts on the tip as the motor does on a rigid device; sine and cosine are two more states.
    whole = np.zeros((n + 3, n + 3))
    whole[: n + 1, : n + 1] = a
    whole[:n, n + 1] = a[:n, n]
    omega = 2 * np.pi * hertz
    whole[n + 1, n + 2], whole[n + 2, n + 1] = omega, -omega
    step = expm(whole * period / FINE)
    state = np.zeros(n + 3)
    state[n + 2] = 1.0
    forces, previous, motion = [0.0] * 4, 0.0, []
    for sample in range(4000):
        forces = [-(k * state[0] + b * (state[0] - previous) / period), *forces[:3]]
        previous = state[0]
        for part in range(FINE):
            state[n] = forces[0] if part >= steps else forces[1]
            if sample >= 3984:
                motion.append(state[0])
            state = step @ state
    angle = omega * period / FINE * np.arange(len(motion))
    phasor = 2 * np.mean(np.array(motion) * np.exp(-1j * angle)) * 1j  # of sin
    z = parse(PAPER_NETWORK).impedance(2j * np.pi * hertz, user)
    seen = 1 / (phasor * 1j * omega) - z
    users = Users(parse(PAPER_NETWORK), "N s/m", ("one",), np.log([[user[e] for e in parse(PAPER_NETWORK).elements]]))
    found = transparency(users, device, k, b, np.array([hertz]))
    assert found.transmitted[0, 0] == pytest.approx(seen, rel=2e-3)
