"""The point estimate of the population against the closed forms of a damper and of a mass that is the same for all."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.population import em
from bayes_impedance.population.common_solutions import StateFrom
from bayes_impedance.population.em import DETERMINED_BOUNDED, DETERMINED_SD, Estimate, estimate, moved_to
from bayes_impedance.population.em_state import SMALLEST_DISPERSION, State
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.shared import Pooling
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.runtime.progress import Progress
from bayes_impedance.runtime.sharded import Kept

Found = tuple[State, float]
FREQUENCY = np.geomspace(5, 500, 12)
OMEGA = 2 * np.pi * FREQUENCY
ONE_THREAD = ThreadPoolExecutor(1)
SEED = np.random.SeedSequence(1)
CENTRE_SD = 3.0
NEAR, NEAR_SLOPE = 0.3, 0.2
"""Standard deviations of a prior that counts as much as some people."""


def people(
    notation: str, log_elements: np.ndarray, noise: float, repetitions: int = 1, moved: float = 0.0, seed: int = 0
) -> tuple[Likelihood, ...]:
    """Recordings of people (N, P) with noise relative to the magnitude, and elements that each repetition moves."""
    rng = np.random.default_rng(seed)
    kernel, made = Kernel(parse(notation)), []
    varying = Pooling.of(kernel).varying
    for theta in log_elements:
        own = np.zeros((repetitions, theta.size))
        own[:, varying] = moved * rng.normal(size=(repetitions, varying.size))
        clean = kernel.impedance(theta + own - own.mean(axis=0), FREQUENCY)
        sd = noise * np.abs(clean)
        z = clean + sd * (rng.normal(size=clean.shape) + 1j * rng.normal(size=clean.shape))
        made.append(Likelihood.make(FREQUENCY, z, sd, np.zeros((repetitions, varying.size))))
    return tuple(made)


def estimated(
    notation: str,
    likelihoods: tuple[Likelihood, ...],
    start: np.ndarray,
    covariates: np.ndarray | None = None,
    progress: Progress = lambda *_: None,
    checkpoint: Path | None = None,
    one_person: bool = False,
    centre_sd: float = CENTRE_SD,
) -> Estimate:
    """With the prior's centres at zero."""
    n, p = start.shape
    first = FirstFits(start, np.empty((n, 0, p)), start[None], None)
    kept = Kept.of(ONE_THREAD, likelihoods)
    covariates = np.zeros((n, 0)) if covariates is None else covariates
    pooling, prior = (
        Pooling.of(Kernel(parse(notation))),
        Prior(centre=np.zeros(p), centre_sd=centre_sd, slope_sd=NEAR_SLOPE),
    )
    return estimate(pooling, kept, first, prior, covariates, True, SEED, progress, one_person, checkpoint)


def modes_and_variances(point: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Each person's mode and posterior variance, of one element."""
    modes = point.modes
    return np.array([m.theta[0] for m in modes]), np.array([1 / m.precision[0, 0] for m in modes])


@pytest.fixture(scope="module")
def dampers() -> Estimate:
    """Forty people, of whom each damper is known to a quarter of what people differ by."""
    theta = 0.7 + 0.2 * np.random.default_rng(2).normal(size=(40, 1))
    return estimated("r1", people("r1", theta, noise=0.25), theta, centre_sd=NEAR)


def test_the_mean_and_the_variance_are_those_of_the_m_step(dampers: Estimate) -> None:
    """Mean of the modes, drawn to the prior by T / sd^2 people; mean square of the deviations, plus their variance.

    The pseudo-persons have the variance of the estimate, so at rest they change nothing.
    """
    theta, variance = modes_and_variances(dampers)
    t = dampers.covariance[0, 0]
    assert dampers.mu[0] == pytest.approx(theta.sum() / (40 + t / NEAR**2), rel=1e-3)
    assert t == pytest.approx(np.mean((theta - dampers.mu[0]) ** 2 + variance), rel=0.02)
    assert dampers.converged.all()


def test_the_mean_of_people_known_with_error_has_the_error_of_both(dampers: Estimate) -> None:
    """The variance of the mean is that between people plus that of a person's value, over the number of people."""
    own = np.array([m.information[0, 0] for m in dampers.modes])
    expected = (NEAR**-2 + np.sum(1 / (dampers.covariance[0, 0] + 1 / own))) ** -0.5
    assert dampers.mu_sd[0] == pytest.approx(expected, rel=1e-3)
    assert dampers.data_sd[0] == pytest.approx(own.sum() ** -0.5, rel=1e-9)


@pytest.mark.parametrize(("noise", "determined"), [(0.25, True), (6.0, False)])
def test_an_element_is_determined_below_the_limit(noise: float, determined: bool) -> None:
    """The information of 12 frequencies on ln r is 12 / noise^2 for each of four people."""
    theta = np.zeros((4, 1))
    point = estimated("r1", people("r1", theta, noise), theta)
    assert point.limits.tolist() == [DETERMINED_SD]
    assert (noise / np.sqrt(48) < DETERMINED_SD) == determined
    assert point.determined.tolist() == [determined]


def test_an_element_between_two_bounds_has_a_wider_limit() -> None:
    """The exponent of a power law lies between zero and one; its logit is estimated."""
    theta = np.tile([0.7, 0.0], (3, 1))
    point = estimated("p1^a1", people("p1^a1", theta, 0.05), theta)
    assert point.pooling.kernel.elements == ("p1", "a1")
    assert point.limits.tolist() == [DETERMINED_SD, DETERMINED_BOUNDED]


def test_dispersion_does_not_vanish_where_all_are_equal() -> None:
    theta = np.full((12, 1), 0.7)
    point = estimated("r1", people("r1", theta, 1e-4), theta)
    assert point.covariance[0, 0] == SMALLEST_DISPERSION**2


def test_a_covariate_takes_its_part() -> None:
    """Ridge regression: a slope of one person's worth T / sd^2 of prior, and the dispersion is of what is left."""
    rng = np.random.default_rng(3)
    x = rng.normal(size=(30, 1))
    x = (x - x.mean()) / x.std()
    theta = 0.4 + 0.5 * x + 0.1 * rng.normal(size=(30, 1))
    point = estimated("r1", people("r1", theta, 0.01), theta, covariates=x, centre_sd=NEAR)
    modes, _ = modes_and_variances(point)
    design, t = np.hstack([np.ones((30, 1)), x]), point.covariance[0, 0]
    weight = np.diag([t / NEAR**2, t / NEAR_SLOPE**2])
    expected = np.linalg.solve(design.T @ design + weight, design.T @ modes)
    np.testing.assert_allclose([point.mu[0], point.slopes[0, 0]], expected, rtol=1e-3)
    assert np.sqrt(t) == pytest.approx(np.std(modes - design @ expected), rel=0.02)


def test_repetitions_have_their_own_dispersion() -> None:
    """Known almost without noise: mean square of the contrasts, with two of 5 % from the prior."""
    theta = 0.7 + 0.2 * np.random.default_rng(2).normal(size=(25, 1))
    likelihoods = people("r1", theta, 0.002, repetitions=3, moved=0.1)
    point = estimated("r1", likelihoods, theta)
    logs = np.log([d.z[:, 0].mean(axis=-1) for d in likelihoods])
    square = np.sum((logs - logs.mean(axis=1, keepdims=True)) ** 2)
    assert point.between_repetitions[0] == pytest.approx(np.sqrt((square + 2 * 0.05**2) / (25 * 2 + 2)), rel=0.01)
    for own, log in zip(point.deviations, logs, strict=True):
        np.testing.assert_allclose(own[:, 0], log - log.mean(), atol=3e-3)


def test_one_person_is_fitted_under_the_prior() -> None:
    theta = np.array([[0.7]])
    point = estimated("r1", people("r1", theta, 0.02, repetitions=2), theta, one_person=True)
    assert point.mu.tolist() == [0.0]
    assert point.covariance.tolist() == [[CENTRE_SD**2]]
    assert point.mu_sd[0] == pytest.approx(point.modes[0].precision[0, 0] ** -0.5)


def test_a_mass_that_is_the_same_for_all_is_a_weighted_mean() -> None:
    """z = s m + r: linear in the mass, whose estimate is least squares over everybody, each with the own noise."""
    rng, n = np.random.default_rng(5), 10
    theta = np.column_stack([np.full(n, np.log(2e-3)), 0.5 + 0.3 * rng.normal(size=n)])
    likelihoods = people("m1*|r1", theta, 0.05)
    start = theta + np.array([0.4, 0.0])
    point = estimated("m1*|r1", likelihoods, start)
    weight = np.array([d.weight[0] for d in likelihoods]) / point.scale[:, None] ** 2
    imaginary = np.array([d.z[0, 1] for d in likelihoods])
    information = np.sum(weight * OMEGA**2)
    expected = np.sum(weight * OMEGA * imaginary) / information
    se = information**-0.5 / expected  # of its logarithm
    assert point.shared[0] == pytest.approx(np.log(expected), abs=0.1 * se)
    assert point.shared_covariance[0, 0] ** 0.5 == pytest.approx(se, rel=0.05)
    assert point.shared_determined.tolist() == [True]
    assert point.mu.shape == (1,)


# -------------------------------------------------------------------- an interruption


class StoppedError(Exception):
    """An interruption."""


def same(one: Estimate, other: Estimate) -> None:
    """The same numbers, to the last bit."""
    for name in ("mu", "slopes", "covariance", "between_repetitions", "scale", "shared", "mu_sd", "data_sd"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for a, b in zip(one.deviations, other.deviations, strict=True):
        np.testing.assert_array_equal(a, b)
    assert one.rounds == other.rounds


def stopping(after: int) -> Progress:
    """Interrupts the step that follows so many."""

    def progress(_stage: str, done: int, _total: int) -> None:
        if done > after:
            raise StoppedError

    return progress


def stopping_at_call(which: int) -> Progress:
    """Interrupts in the call of this number, the first is zero."""
    calls = iter(range(which + 1))

    def progress(_stage: str, _done: int, _total: int) -> None:
        if next(calls) == which:
            raise StoppedError

    return progress


@pytest.mark.parametrize("stopped_after", [1, 3])
def test_an_interrupted_estimation_goes_on_to_the_same_numbers(tmp_path: Path, stopped_after: int) -> None:
    theta = np.random.default_rng(2).normal(size=(8, 2)) * 0.2 + np.log([2e-3, 2.0])
    likelihoods = people("m1|r1", theta, 0.05, repetitions=2, moved=0.05)
    whole, file = estimated("m1|r1", likelihoods, theta), tmp_path / "point.npz"
    with pytest.raises(StoppedError):
        estimated("m1|r1", likelihoods, theta, progress=stopping(stopped_after), checkpoint=file)
    rounds: list[int] = []
    for first in (stopped_after + 1, 60):  # from the round that was lost; then, finished, only the last fits
        rounds.clear()
        resumed = estimated(
            "m1|r1", likelihoods, theta, progress=lambda _, done, __: rounds.append(done), checkpoint=file
        )
        same(resumed, whole)
        assert rounds[0] == first


def test_an_interrupted_estimation_that_began_again_goes_on_to_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Everybody begins anew from a more probable solution, at most four times; evidences of those before are kept."""
    theta = np.random.default_rng(2).normal(size=(8, 2)) * 0.2 + np.log([2e-3, 2.0])
    likelihoods, file = people("m1|r1", theta, 0.05, repetitions=2, moved=0.05), tmp_path / "point.npz"
    monkeypatch.setattr(em, "APART", -1.0)  # so that everybody counts as gone elsewhere

    def another(_: object, __: object, state_from: StateFrom, data: Kept, state: State, *___: object) -> Found:
        return state_from(state.theta + 0.5, data, np.arange(8)), 3.0

    monkeypatch.setattr(em, "from_another", another)
    rounds: list[int] = []
    whole = estimated("m1|r1", likelihoods, theta, progress=lambda _, done, __: rounds.append(done))
    assert rounds.count(1) == 5
    assert whole.rivals == (3.0, 6.0, 9.0, 12.0)
    second = rounds.index(1, 1)
    with pytest.raises(StoppedError):
        estimated("m1|r1", likelihoods, theta, progress=stopping_at_call(second + 3), checkpoint=file)
    resumed = estimated("m1|r1", likelihoods, theta, checkpoint=file)
    same(resumed, whole)
    assert resumed.rivals == whole.rivals


@pytest.mark.parametrize("notation", ["m1|r1", "m1*|r1"])
def test_a_restored_state_iterates_like_the_one_it_was_taken_from(notation: str) -> None:
    """Everything that the next iteration needs is in the snapshot, in people of one, two and three repetitions."""
    rng = np.random.default_rng(4)
    theta = np.column_stack([np.full(6, np.log(2e-3)), 0.7 + 0.2 * rng.normal(size=6)])
    likelihoods = tuple(
        people(notation, theta[i : i + 1], 0.05, repetitions=1 + i % 3, moved=0.05, seed=i)[0] for i in range(6)
    )
    pooling = Pooling.of(Kernel(parse(notation)))

    def state() -> State:
        prior = Prior(centre=np.zeros(2), centre_sd=CENTRE_SD)
        return State(pooling, Kept.of(ONE_THREAD, likelihoods), prior, np.zeros((6, 0)), True, theta, True, False)

    one, other = state(), state()
    for _ in range(3):
        one.iterate(None)
    taken = one.snapshot()
    kept = {name: value.copy() for name, value in taken.items()}
    assert taken["repetitions"].tolist() == [1, 2, 3, 1, 2, 3]
    other.restore(taken)
    for name, value in other.snapshot().items():
        np.testing.assert_array_equal(value, taken[name], err_msg=name)
    if not pooling.names:
        assert one.iterate(None) == other.iterate(None)
        for name, value in other.snapshot().items():
            np.testing.assert_array_equal(value, one.snapshot()[name], err_msg=name)
    for name, value in taken.items():
        np.testing.assert_array_equal(value, kept[name], err_msg=f"{name} of the snapshot has changed since")


def test_an_interruption_changes_no_number_of_shared_parameters(tmp_path: Path) -> None:
    """A step of what is the same for all needs everybody's mode, noise scale and deviations as they were."""
    theta = np.column_stack([np.full(8, np.log(2e-3)), 0.7 + 0.2 * np.random.default_rng(2).normal(size=8)])
    likelihoods, start = people("m1*|r1", theta, 0.05, repetitions=2, moved=0.05), theta + np.array([0.4, 0.0])
    whole = estimated("m1*|r1", likelihoods, start)
    with pytest.raises(StoppedError):
        estimated("m1*|r1", likelihoods, start, progress=stopping(after=2), checkpoint=tmp_path / "point.npz")
    resumed = estimated("m1*|r1", likelihoods, start, checkpoint=tmp_path / "point.npz")
    np.testing.assert_array_equal(resumed.shared, whole.shared)
    np.testing.assert_array_equal(resumed.mu, whole.mu)
    np.testing.assert_array_equal(resumed.covariance, whole.covariance)


# -------------------------------------------------------------------- which optimum everybody starts in


def test_modes_follow_a_population_that_is_moved() -> None:
    """Under a narrow population everybody is at the mean; under the estimated one everybody stays."""
    theta = 0.7 + 0.2 * np.random.default_rng(2).normal(size=(6, 1))
    point = estimated("r1", people("r1", theta, 0.1), theta)
    own = np.array([m.theta for m in point.modes])
    stays = moved_to(point, point.shared, np.tile(point.mu, (6, 1)), point.covariance)
    np.testing.assert_allclose(np.array([m.theta for m in stays.modes]), own, atol=1e-4)
    narrow = moved_to(point, point.shared, np.ones((6, 1)), np.array([[1e-8]]))
    np.testing.assert_allclose(np.array([m.theta for m in narrow.modes]), 1.0, atol=1e-4)
