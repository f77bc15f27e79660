"""Proposals of further measurements: against refits, against brute force, and where the answer is known."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from bayes_impedance.diagnosis.catalogue import body, rig
from bayes_impedance.diagnosis.catalogue.effect import Effect, Scales
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.model import Addition, Model, build
from bayes_impedance.diagnosis.fit.normal_equations import Equations, Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.next_experiment.expected_separation import Proposal, best_sentence, separation
from bayes_impedance.diagnosis.next_experiment.virtual_recordings import Port, present_recordings
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood
from bayes_impedance.population.fingertip import FINGERTIP

NETWORK = parse(FINGERTIP.network)
MU = np.log(FINGERTIP.vector(FINGERTIP.central))
TAU, RHO = FINGERTIP.vector(FINGERTIP.between_persons), FINGERTIP.vector(FINGERTIP.between_repetitions)
E = MU.size
LOW, HIGH = 2 * np.pi * 5, 2 * np.pi * 5000
SCALES = Scales(low=LOW, middle=np.sqrt(LOW * HIGH), high=HIGH, z_low=25.0, z_middle=5.0, z_high=28.0, unit="N s/m")
DELAY, LOWPASS, MASS = rig.RIG_DELAY, rig.RIG_LOWPASS, rig.RIG_MASS
MOUNT, HIGHPASS, STIFFNESS = rig.RIG_SERIES_COMPLIANCE, rig.RIG_HIGHPASS, rig.RIG_STIFFNESS
SIZE = 0.15

# The same physics under other names: nothing can tell these from what is in the catalogue.
TWIN = replace(MASS, id="rig.twin")
NAIL = replace(body.BODY_MASS, id="body.nail", operation="", coefficients=())
GLUE = replace(MOUNT, id="rig.glue", operation="", coefficients=())


def model(effect: Effect, pooling: str = "shared") -> Model:
    return build(NETWORK, [Addition(effect=effect, place="port", pooling=pooling)], SCALES, [{}])


def value(effect: Effect, size: float) -> float:
    """The parameter at which an effect has a size in units of its scale."""
    if effect is NAIL:
        return float(np.log(size * SCALES.z_high / SCALES.high))
    if effect is GLUE:
        return float(np.log(size / SCALES.z_high / SCALES.high))
    return size


def fitted(m: Model, data: list[Likelihood], u: np.ndarray, start: float) -> Refit:
    varying = int(np.sum(~m.shared)) - E
    population = Population(
        np.r_[MU, [start] * varying], np.diag(np.r_[TAU, [1.0] * varying] ** 2), np.r_[RHO, [1e-3] * varying]
    )
    with ThreadPoolExecutor(2) as executor:
        return Refitter(data, executor).fit(m, np.c_[u, np.full(len(u), start)], population, rounds=60)


@cache
def pair(
    truth: Effect,
    other: Effect,
    seed: int = 1,
    pooling: str = "shared",
    size: float = SIZE,
    people: int = 12,
    points: int = 81,
) -> tuple[Refit, Refit]:
    """Two repetitions of everybody with an effect, and the fits of it and of another one."""
    rng = np.random.default_rng(seed)
    m, f = model(truth, pooling), np.geomspace(5, 5000, points)
    u = (MU + TAU * rng.normal(size=(people, E)))[:, None] + RHO * rng.normal(size=(people, 2, E))
    own = np.full((people, 2, 1), value(truth, size))
    if pooling == "varying":
        own = own * np.exp(0.3 * rng.normal(size=(people, 1, 1)))
    z = m.kernel.impedance(np.concatenate([u, own], axis=2), f)
    sd = 0.01 * np.abs(z) * np.sqrt(1 + (8 / f) ** 4)
    z = z + sd * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))
    data = [Likelihood.make(f, z[i], sd[i], np.zeros((2, E))) for i in range(people)]
    u = u.reshape(-1, E)
    return fitted(m, data, u, value(truth, size)), fitted(model(other), data, u, value(other, 0.01))


def of(proposals: tuple[Proposal, ...], kind: str) -> Proposal:
    """The best of a kind."""
    return next(p for p in proposals if p.kind == kind)


def chosen(fit: Refit, people: list[int]) -> Refit:
    """The fit with people in another order, or more than once."""
    starts = np.r_[0, np.cumsum([d.z.shape[0] for d in fit.data])]
    rows = np.concatenate([np.arange(starts[i], starts[i + 1]) for i in people])
    e = fit.equations
    return replace(
        fit,
        data=tuple(fit.data[i] for i in people),
        u=fit.u[rows],
        persons=fit.persons[people],
        equations=Equations(e.chi[rows], e.gradient[rows], e.information[rows]),
        evidence=fit.evidence[people],
    )


# ------------------------------------------------------------------------------------- the present experiment


@pytest.mark.parametrize("other", [MASS, MOUNT])
def test_expects_what_refits_of_the_present_recordings_find(other):
    # A difference of log likelihoods with mean e has standard deviation sqrt(2 e).
    pairs = [pair(DELAY, other, seed) for seed in range(3)]
    expected = sum(of(separation(*p, people=12), "none").elpd for p in pairs)
    found = sum(float(np.sum(a.evidence - b.evidence)) for a, b in pairs)
    assert expected > 200
    assert found == pytest.approx(expected, abs=2.5 * np.sqrt(2 * expected))
    assert found == pytest.approx(expected, rel=0.25)


def test_misfits_that_pass_for_noise_count_as_in_the_evidence():
    # Without the unknown scale of the noise it would be more than twice as much.
    winner, alias = pair(HIGHPASS, STIFFNESS, size=0.3)
    found = float(np.sum(winner.evidence - alias.evidence))
    assert of(separation(winner, alias, people=12), "none").elpd == pytest.approx(found, rel=0.1)


def test_few_people_stand_for_all():
    winner, alias = pair(DELAY, MASS)
    few, all_of_them = (separation(winner, alias, people=n) for n in (6, 12))
    assert of(few, "none").elpd == pytest.approx(of(all_of_them, "none").elpd, rel=0.05)
    for kind in ("wider_high", "contactor_mass", "preload"):
        assert of(few, kind).elpd == pytest.approx(of(all_of_them, kind).elpd, rel=0.2)
        assert of(few, kind).elpd != of(all_of_them, kind).elpd


def test_equals_a_fit_by_brute_force():
    winner, alias = pair(DELAY, MASS, people=3, points=41)
    f = winner.data[0].omega / (2 * np.pi)
    rows = [0, 2, 4]
    z = winner.model.kernel.impedance(winner.u[rows], f)
    sd = np.array([1 / np.sqrt(w * d.weight.sum(axis=0)) for w, d in zip(winner.weight, winner.data, strict=True)])
    start = alias.u[rows, :E]

    def residuals(x):
        elements = start + x[:-1].reshape(start.shape)
        white = (alias.model.kernel.impedance(np.c_[elements, np.full(3, x[-1])], f) - z) / sd
        return np.concatenate([white.real.ravel(), white.imag.ravel(), x[:-1] / 3.0])

    best = least_squares(residuals, np.r_[np.zeros(start.size), alias.shared_value], x_scale="jac", xtol=1e-14)
    white = residuals(best.x)
    parts = white[: -start.size].reshape(2, 3, -1)
    misfit = np.sum(parts**2, axis=(0, 2)) + np.sum(white[-start.size :].reshape(start.shape) ** 2, axis=1)
    shape = SCALE_SHAPE + 2 * 41
    expected = np.sum(shape * np.log1p(0.5 * misfit / shape))
    assert of(separation(winner, alias), "none").elpd == pytest.approx(expected, rel=1e-3)


def test_coefficients_that_vary_are_compared_by_their_distribution():
    # The same formula, once with a coefficient of everybody's own: all that differs is how they are distributed.
    # Recordings a hundred times as good of people a hundred times as alike: then the impedance is linear in it.
    winner, _ = pair(DELAY, MASS, pooling="varying")
    u, mean = winner.u.copy(), winner.population.mu[E]
    u[:, E] = mean + 0.01 * (u[:, E] - mean)
    covariance = winner.population.covariance.copy()
    covariance[E, E] *= 0.01**2
    winner = replace(
        winner,
        u=u,
        data=tuple(replace(d, weight=1e4 * d.weight) for d in winner.data),
        population=replace(winner.population, covariance=covariance),
    )
    own = winner.u[::2, E]
    alias = replace(winner, model=model(DELAY), u=np.c_[u[:, :E], np.full(len(u), own.mean())])
    alias = replace(alias, population=Population(winner.population.mu[:E], np.diag(TAU**2), RHO))
    f = winner.data[0].omega / (2 * np.pi)
    dz = winner.model.kernel.derivative(winner.u[::2], f)[1]
    information = []
    for i, d in enumerate(winner.data):
        white = dz[i] * np.sqrt(winner.weight[i] * d.weight.sum(axis=0))
        columns = np.concatenate([white.real, white.imag], axis=1).T
        j, g = np.r_[columns[:, :E], np.eye(E) / 3], np.r_[columns[:, E], np.zeros(E)]
        information.append(np.sum((g - j @ np.linalg.lstsq(j, g, rcond=None)[0]) ** 2))
    d, tau = np.array(information), np.sqrt(winner.population.covariance[E, E])

    def spread(w):
        return w * (own - np.sum(w * own) / np.sum(w)) ** 2

    shape = SCALE_SHAPE + 2 * f.size
    shared = np.sum(shape * np.log1p(0.5 * spread(d) / shape))
    varying = np.sum(shape * np.log1p(0.5 * spread(d / (1 + d * tau**2)) / shape))
    varying += 0.5 * np.sum(np.log1p(d * tau**2) - d * tau**2 / (1 + d * tau**2))
    assert shared > 2 * varying > 2
    assert of(separation(winner, alias, people=12), "none").elpd == pytest.approx(shared - varying, rel=0.005)


# ------------------------------------------------------------------------------------- other experiments


@pytest.mark.parametrize(("truth", "other"), [(MASS, TWIN), (MASS, NAIL), (MOUNT, GLUE)])
def test_nothing_separates_two_names_of_the_same(truth, other):
    proposals = separation(*pair(truth, other))
    assert max(p.elpd for p in proposals) < 0.05
    assert max(p.gain for p in proposals) < 5
    assert best_sentence(proposals) == "none of the measurements considered"


@pytest.mark.parametrize(("truth", "other"), [(DELAY, MASS), (LOWPASS, DELAY), (MOUNT, LOWPASS), (HIGHPASS, STIFFNESS)])
def test_more_recordings_never_say_less(truth, other):
    proposals = separation(*pair(truth, other))
    present = of(proposals, "none")
    assert present.gain == 1
    assert min(p.elpd for p in proposals) > 0.999 * present.elpd
    assert [p.elpd for p in proposals] == sorted((p.elpd for p in proposals), reverse=True)
    assert all(p.gain == pytest.approx(p.elpd / present.elpd) for p in proposals if p.elpd > 0.01)


def test_a_heavier_contactor_tells_a_delay_from_a_mass():
    proposals = separation(*pair(DELAY, MASS))
    heavy = of(proposals, "contactor_mass")
    assert heavy.measurement == "a second contactor that is 2.7 g heavier"
    assert heavy.gain > 3  # twice is what the same recordings once more would bring
    masses = [p.elpd for p in proposals if p.kind == "contactor_mass"]
    assert len(masses) == 3
    assert masses[0] > 1.5 * masses[-1]


def test_a_heavier_contactor_finds_a_compliant_mount_by_its_resonance():
    assert of(separation(*pair(MOUNT, LOWPASS)), "contactor_mass").gain > 5


def test_a_wider_band_tells_a_lowpass_from_a_delay():
    proposals = separation(*pair(LOWPASS, DELAY))
    assert of(proposals, "none").elpd < 10
    assert of(proposals, "wider_high").elpd > 100
    assert of(proposals, "wider_low").gain < 1.1
    assert best_sentence(proposals).startswith(
        "the band extended to 15 kHz: expected to raise the difference of the log likelihoods from 3."
    )


def test_the_low_end_of_the_band_tells_a_highpass_from_a_spring():
    proposals = separation(*pair(HIGHPASS, STIFFNESS, size=0.02))
    assert of(proposals, "wider_low").measurement == "the band extended down to 1.7 Hz"
    assert of(proposals, "wider_low").gain > 3 * of(proposals, "wider_high").gain


def test_twice_the_people_say_twice_as_much():
    winner, alias = pair(DELAY, MASS)
    once = separation(winner, alias, people=12)
    for n in (12, 24):
        twice = separation(*(chosen(fit, [*range(12), *range(12)]) for fit in (winner, alias)), people=n)
        for kind in ("none", "wider_high", "wider_low", "contactor_mass", "preload"):
            assert of(twice, kind).elpd == pytest.approx(2 * of(once, kind).elpd, rel=1e-3)


def test_the_order_of_people_does_not_matter():
    winner, alias = pair(DELAY, MASS)
    order = np.random.default_rng(0).permutation(12).tolist()
    before = separation(winner, alias, people=5)
    after = separation(chosen(winner, order), chosen(alias, order), people=5)
    assert [p.measurement for p in after] == [p.measurement for p in before]
    np.testing.assert_allclose([p.elpd for p in after], [p.elpd for p in before], rtol=1e-6)


# ------------------------------------------------------------------------------------- recordings and ports


def test_a_wider_band_goes_on_as_it_began():
    winner, _ = pair(DELAY, MASS)
    present = present_recordings(winner)[3]
    wide = present.wider(3.0, 3.0)
    f = wide.frequency_hz
    np.testing.assert_allclose(np.diff(np.log(f)).max(), np.diff(np.log(f)).min(), rtol=0.1)
    assert f[[0, -1]] == pytest.approx([5 / 3, 15000])
    assert np.all(wide.relative_sd[f < 5] == present.relative_sd[0])
    assert np.all(wide.relative_sd[f > 5000] == present.relative_sd[-1])
    z = winner.model.kernel.impedance(winner.u[present.row], present.frequency_hz)
    weight = winner.weight[3] * winner.data[3].weight.sum(axis=0)
    np.testing.assert_allclose(present.relative_sd, 1 / np.sqrt(weight) / np.abs(z))


@pytest.mark.parametrize("effects", [(DELAY,), (MOUNT,), (GLUE,), (body.BODY_MASS, DELAY), (NAIL, GLUE, DELAY)])
def test_a_known_mass_stands_between_the_finger_and_the_rig(effects):
    m = build(
        NETWORK, [Addition(effect=e, place="port", pooling="shared") for e in effects], SCALES, [{}] * len(effects)
    )
    sizes = {p.name: value(effects[p.addition], 0.1 * (1 + p.addition)) for p in m.parameters}
    u = np.r_[MU, [sizes[p.name] for p in m.parameters]]
    f, known = np.geomspace(5, 15000, 40), 2e-3
    s = 2j * np.pi * f
    z = NETWORK.impedance(s, dict(zip(NETWORK.elements, np.exp(MU), strict=True)))
    unit = {"m": SCALES.z_high / SCALES.high, "n": 1 / SCALES.z_high / SCALES.high, "s": 1 / SCALES.high}
    change = {
        "body.mass": lambda z, x: z + s * x * unit["m"],
        "body.nail": lambda z, x: z + s * x * unit["m"],
        "rig.series_compliance": lambda z, x: 1 / (1 / z + s * x * unit["n"]),
        "rig.glue": lambda z, x: 1 / (1 / z + s * x * unit["n"]),
        "rig.delay": lambda z, x: z * np.exp(-s * x * unit["s"]),
    }
    for side in ("body", "rig"):
        if side == "rig":
            z = z + s * known
        for i, effect in enumerate(effects):
            if effect.side == side:
                z = change[effect.id](z, 0.1 * (1 + i))
    port = Port(m, known)
    np.testing.assert_allclose(port.impedance(u, f), z, rtol=1e-10)
    value_, slope = port.derivative(u, f)
    np.testing.assert_allclose(value_, z, rtol=1e-10)
    for k in range(u.size):
        step = 1e-5 * np.eye(u.size)[k]
        by_difference = (port.impedance(u + step, f) - port.impedance(u - step, f)) / 2e-5
        np.testing.assert_allclose(slope[k], by_difference, rtol=1e-5, atol=1e-6 * np.abs(z).max())


# ------------------------------------------------------------------------------------- words and wrong input


def proposed(kind: str, elpd: float) -> Proposal:
    return Proposal(f"measurement {kind}", kind, elpd, elpd / 4.2)


def test_the_sentence_names_the_best_measurement_that_is_worth_it():
    present = proposed("none", 4.2)
    assert best_sentence([present, proposed("position", 9.0), proposed("contactor_mass", 163.0)]) == (
        "measurement contactor_mass: expected to raise the difference of the log likelihoods from 4.2 to 160"
    )
    nothing = "none of the measurements considered"
    assert best_sentence([present, proposed("wider_high", 4.9)]) == nothing
    assert best_sentence([present, proposed("position", 8.3)]) == nothing  # as good as the same once more
    wider = best_sentence([proposed("position", 8.3), proposed("wider_low", 8.0), present])
    assert wider.startswith(
        "measurement wider_low: expected to raise the difference of the log likelihoods from 4.2 to 8.0"
    )
    assert best_sentence([]) == nothing


def test_wrong_input_is_refused():
    winner, alias = pair(DELAY, MASS)
    with pytest.raises(InputError, match="24 and 22 recordings"):
        separation(winner, chosen(alias, list(range(11))))
    with pytest.raises(InputError, match="at least one"):
        separation(winner, alias, people=0)
