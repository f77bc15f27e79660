"""The noise estimate: what is motion of the elements and what is not."""

from __future__ import annotations

import numpy as np
import pytest

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.person.noise import (
    NoiseModel,
    Scatter,
    contrasts,
    pool,
    scatter_of_repetitions,
    scatter_of_roughness,
)

FREQUENCY = np.geomspace(5.0, 5000.0, 80)
KERNEL = Kernel(parse(PAPER_NETWORK))
CENTRE = np.log([8e-4, 1.5, 3e-4, 1.2, 6e-4, 0.02, 2e-3, 2.5])


def complex_normal(rng, shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def population(n, noise_sd, repetitions=3, motion=0.15, spread=0.4, seed=0, frequency=FREQUENCY):
    """Recordings (N, J, F) that differ by noise plus motion in the tangent space, and the derivatives (N, P, F)."""
    rng = np.random.default_rng(seed)
    theta = CENTRE + rng.normal(0, spread, (n, 8))
    z, derivative = KERNEL.derivative(theta, frequency)
    moved = z[:, None] + rng.normal(0, motion, (n, repetitions, 8)) @ derivative
    return moved + noise_sd(moved) * complex_normal(rng, moved.shape), derivative, z


def relative(z):
    return 0.01 * np.abs(z)


@pytest.mark.parametrize("n", [1, 2, 3, 7])
def test_contrasts_are_orthonormal_and_sum_to_zero(n):
    rows = contrasts(n)
    assert rows.shape == (n - 1, n)
    np.testing.assert_allclose(rows @ rows.T, np.eye(n - 1), atol=1e-15)
    np.testing.assert_allclose(rows.sum(axis=1), 0, atol=1e-15)


@pytest.mark.parametrize("repetitions", [2, 3, 5])
def test_motion_of_the_elements_is_not_noise(repetitions):
    z, derivative, _ = population(100, relative, repetitions)
    scatters = [scatter_of_repetitions(FREQUENCY, *person) for person in zip(z, derivative, strict=True)]
    freedom = sum(s.freedom.sum() for s in scatters)
    assert freedom == pytest.approx(100 * (repetitions - 1) * (2 * FREQUENCY.size - 8), rel=1e-9)
    square = sum(np.sum(s.square / s.magnitude**2) for s in scatters)
    assert square / freedom == pytest.approx(0.01**2, rel=5 * np.sqrt(2 / freedom))


def test_squares_are_chi_square_at_every_frequency():
    z, derivative, true = population(400, relative, motion=0.0)
    scatters = [scatter_of_repetitions(FREQUENCY, *person) for person in zip(z, derivative, strict=True)]
    square = sum(s.square / relative(t) ** 2 for s, t in zip(scatters, true, strict=True))
    freedom = sum(s.freedom for s in scatters)
    deviation = (square - freedom) / np.sqrt(2 * freedom)
    assert np.abs(deviation).max() < 4.5
    # The projection correlates neighbours, so the deviations are only nearly independent.
    assert np.mean(deviation**2) == pytest.approx(1, abs=5 * np.sqrt(2 / FREQUENCY.size))


def test_without_the_projection_the_motion_counts_as_noise():
    z, derivative, _ = population(100, relative)
    nothing = np.zeros((1, FREQUENCY.size))
    with_projection, without = (
        pool([scatter_of_repetitions(FREQUENCY, one, d) for one, d in people], 1e-4)
        for people in (zip(z, derivative, strict=True), [(one, nothing) for one in z])
    )
    assert with_projection.relative
    estimate = with_projection.at(FREQUENCY, np.ones(FREQUENCY.size))
    assert np.median(estimate) == pytest.approx(0.01, rel=0.02)
    assert np.median(without.at(FREQUENCY, np.ones(FREQUENCY.size))) > 0.05


def resonant(n, repetitions=3, seed=0):
    """People whose narrow resonance lies elsewhere in every recording, noise 1 %: kernel, elements (N, J, P), z."""
    rng, kernel = np.random.default_rng(seed), Kernel(parse("n1|r1|m1"))
    middle = np.log([1e-3, 0.02, 1e-2]) + rng.normal(0, 0.2, (n, 1, 3))
    own = middle + rng.normal(0, 0.03, (n, repetitions, 3))
    z = kernel.impedance(own, FREQUENCY)
    return kernel, own, z * (1 + 0.01 * complex_normal(rng, z.shape))


def test_a_narrow_resonance_that_moves_is_not_noise():
    """Recordings differ by a factor of forty near it, and everyone's noise is a hundredth of its own magnitude."""
    kernel, own, z = resonant(60)
    scatters = []
    for elements, one in zip(own, z, strict=True):
        model, derivative = (
            np.array(part) for part in zip(*(kernel.derivative(u, FREQUENCY) for u in elements), strict=True)
        )
        scatters.append(scatter_of_repetitions(FREQUENCY, one, derivative, model=model))
    estimate = pool(scatters, 1e-4).at(FREQUENCY, np.ones(FREQUENCY.size))
    np.testing.assert_allclose(estimate, 0.01, rtol=5 * np.sqrt(1 / 400))


@pytest.mark.parametrize("people", [11, 71])
def test_what_few_people_have_somewhere_is_not_everybodys_noise(people):
    """A resonance that the network does not describe, somewhere else in everybody: five points of forty times."""
    rng, size, scatters = np.random.default_rng(4), FREQUENCY.size, []
    for centre in np.linspace(20, size - 20, people).astype(int):
        square = 0.01**2 * rng.chisquare(2, size)
        square[centre - 2 : centre + 3] *= 40**2
        scatters.append(Scatter(FREQUENCY, np.ones(size), square, np.full(size, 2.0)))
    estimate = pool(scatters, 1e-4).at(FREQUENCY, np.ones(size))
    # One in 200 squares is small enough to be believed.
    np.testing.assert_allclose(estimate, 0.01, rtol=5 * np.sqrt(1 / 400))


@pytest.mark.parametrize("people", [1, 2, 3, 6])
def test_noise_that_everybody_has_in_a_narrow_band_is_believed(people):
    """Twenty times the noise at three points, of few people: the windows are far wider."""
    rng, size = np.random.default_rng(5), FREQUENCY.size
    shape = np.where(np.abs(np.arange(size) - 40) < 2, 0.2, 0.01)
    squares = shape**2 * rng.chisquare(2, (people, size))
    scatters = [Scatter(FREQUENCY, np.ones(size), square, np.full(size, 2.0)) for square in squares]
    estimate = pool(scatters, 1e-4)
    own = squares.sum() / (2 * people)  # with all points, whatever the windows: the sum is kept
    assert np.sum(estimate.at(FREQUENCY, np.ones(size)) ** 2) == pytest.approx(own, rel=0.5)


def test_a_direction_that_the_band_does_not_see_costs_nothing():
    z, derivative, _ = population(1, relative)
    one = scatter_of_repetitions(FREQUENCY, z[0], derivative[0])
    twice = scatter_of_repetitions(FREQUENCY, z[0], np.vstack([derivative[0], 1e-14 * derivative[0, ::-1] ** 2]))
    np.testing.assert_allclose(twice.freedom, one.freedom, rtol=1e-9)
    np.testing.assert_allclose(twice.square, one.square, rtol=1e-9)


def test_shape_over_frequency_is_recovered():
    """Four times the noise below 20 Hz, within the error of about 200 degrees of freedom per estimate."""
    shape = np.where(FREQUENCY < 20, 0.04, 0.01)
    z, derivative, _ = population(150, lambda z: shape * np.abs(z), motion=0.02)
    model = pool([scatter_of_repetitions(FREQUENCY, *p) for p in zip(z, derivative, strict=True)], 1e-4)
    assert model.relative
    away = np.abs(np.arange(FREQUENCY.size) - np.searchsorted(FREQUENCY, 20) + 0.5) > 4
    estimate = model.at(FREQUENCY, np.ones(FREQUENCY.size))[away]
    assert np.abs(estimate / shape[away] - 1).max() < 4.5 * np.sqrt(1 / (2 * 200))


def test_one_person_is_smoothed_to_about_200_degrees_of_freedom():
    """The relative error of the variance, over many persons, is sqrt(2/200)."""
    z, derivative, true = population(300, lambda z: np.full(z.shape, 0.02), motion=0.0)
    middle = slice(30, 50)
    errors = [
        np.log(pool([scatter_of_repetitions(FREQUENCY, one, d)], 1e-6).at(FREQUENCY, np.abs(t))[middle] / 0.02)
        for one, d, t in zip(z, derivative, true, strict=True)
    ]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.sqrt(1 / 400), rel=0.25)


# One repetition


def test_roughness_recovers_the_noise_under_a_smooth_misfit():
    frequency = np.geomspace(5.0, 5000.0, 2000)
    rng = np.random.default_rng(3)
    model = KERNEL.impedance(CENTRE, frequency)
    misfit = 1 + 0.2 * np.sin(np.log(frequency))
    z = model * misfit + 0.02 * complex_normal(rng, model.shape)
    scatter = scatter_of_roughness(frequency, z, model)
    assert scatter.frequency_hz.size == frequency.size - 2
    # Second differences of neighbours correlate by -2/3 and 1/6: 1 + 2 (4/9 + 1/36) times the variance of the sum.
    error = np.sqrt(2 / scatter.freedom.sum() * (1 + 2 * (4 / 9 + 1 / 36)))
    assert scatter.square.sum() / scatter.freedom.sum() == pytest.approx(0.02**2, rel=5 * error)


def test_curvature_of_the_network_is_not_roughness():
    """On a coarse grid a resonance is rough; what is compared is the residual from the fitted network."""
    frequency = np.geomspace(5.0, 5000.0, 25)
    kernel = Kernel(parse("n1|r1|m1"))
    model = kernel.impedance(np.log([1e-3, 0.05, 1e-2]), frequency)
    z = model + 1e-3 * complex_normal(np.random.default_rng(1), model.shape)
    with_model, without = (
        np.sqrt(s.square.sum() / s.freedom.sum())
        for s in (scatter_of_roughness(frequency, z, model), scatter_of_roughness(frequency, z, 0 * model))
    )
    assert with_model == pytest.approx(1e-3, rel=0.5)
    assert without > 0.5


def test_straight_lines_over_log_frequency_are_not_rough():
    frequency = np.array([1.0, 2.0, 7.0, 8.0, 30.0])
    line = (3 + 1j) * np.log(frequency) - 2j
    assert scatter_of_roughness(frequency, line, np.zeros(5)).square.max() < 1e-28


# Proportional to the magnitude or not, and how small


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(("noise_sd", "choice"), [(relative, True), (lambda z: np.full(z.shape, 0.02), False)])
@pytest.mark.parametrize("by", ["repetitions", "roughness"])
def test_relative_or_absolute(noise_sd, choice, by, seed):
    z, derivative, model = population(30, noise_sd, seed=seed, motion=0.03 if by == "repetitions" else 0.0)
    if by == "repetitions":
        scatters = [scatter_of_repetitions(FREQUENCY, *person) for person in zip(z, derivative, strict=True)]
    else:
        scatters = [scatter_of_roughness(FREQUENCY, one[0], m) for one, m in zip(z, model, strict=True)]
    result = pool(scatters, 1e-4)
    assert result.relative is choice
    expected = 0.01 if choice else 0.02
    at_hundred = result.at(np.array([100.0]), np.array([1.0]))[0]
    assert at_hundred == pytest.approx(expected, rel=5 * np.sqrt(1 / 400) + 0.02)


def test_choice_does_not_depend_on_the_persons_scales():
    """Some fingers are noisier than others as a whole; only the shape decides."""
    z, derivative, model = population(30, relative, motion=0.0)
    scale = np.exp(np.random.default_rng(8).normal(0, 1, 30))[:, None, None]
    noisy = model[:, None] + scale * (z - model[:, None])
    scatters = [scatter_of_repetitions(FREQUENCY, *person) for person in zip(noisy, derivative, strict=True)]
    assert pool(scatters, 1e-4).relative


@pytest.mark.parametrize("floor", [1e-4, 1e-3])
def test_floor(floor):
    z, derivative, _ = population(5, lambda z: 0 * np.abs(z), motion=0.0)
    model = pool([scatter_of_repetitions(FREQUENCY, *person) for person in zip(z, derivative, strict=True)], floor)
    magnitude = np.abs(z[0, 0])
    sd = model.at(FREQUENCY, magnitude)
    assert np.all(sd >= floor * magnitude)
    if model.relative:
        np.testing.assert_allclose(sd, floor * magnitude, rtol=1e-12)


def test_floor_holds_for_every_recording():
    """A noise in absolute units may be nothing beside one person's impedance."""
    model = NoiseModel(np.array([1.0, 100.0]), np.array([1e-3, 1e-1]), relative=False, floor=1e-3)
    np.testing.assert_allclose(model.at(np.array([10.0, 10.0]), np.array([1.0, 500.0])), [1e-2, 0.5], rtol=1e-12)


def test_interpolation_is_linear_in_the_logarithms_and_constant_outside():
    model = NoiseModel(np.array([1.0, 100.0]), np.array([1e-3, 1e-1]), relative=True, floor=1e-9)
    sd = model.at(np.array([0.1, 1.0, 10.0, 100.0, 1e3]), np.full(5, 2.0))
    np.testing.assert_allclose(sd, 2 * np.array([1e-3, 1e-3, 1e-2, 1e-1, 1e-1]), rtol=1e-12)


def test_grids_may_differ():
    grids = (FREQUENCY, FREQUENCY[::2], np.geomspace(7.0, 3000.0, 61))
    scatters = []
    for seed, grid in enumerate(grids * 15):
        z, derivative, _ = population(1, relative, motion=0.02, seed=seed, frequency=grid)
        scatters.append(scatter_of_repetitions(grid, z[0], derivative[0]))
    model = pool(scatters, 1e-4)
    assert model.relative
    assert np.median(model.sd) == pytest.approx(0.01, rel=0.05)
    assert np.all(np.diff(model.frequency_hz) > 0)


def test_very_fine_grids_are_binned():
    frequency = np.geomspace(5.0, 5000.0, 1500)
    z, derivative, _ = population(4, relative, motion=0.02, frequency=frequency)
    model = pool([scatter_of_repetitions(frequency, *person) for person in zip(z, derivative, strict=True)], 1e-4)
    assert model.frequency_hz.size <= 400 + 2  # and one beyond either end
    assert np.median(model.sd) == pytest.approx(0.01, rel=0.05)


def test_ends_that_are_far_from_their_neighbours_have_noise_of_their_own() -> None:
    """On a linear grid noise that rises below 10 Hz is seen at the first point only: its neighbours cannot tell."""
    kernel = Kernel(parse("m1|r1|n1"))
    frequency = np.linspace(5.8, 2400, 125)
    rng = np.random.default_rng(1)
    relative = 0.01 * (1 + 3.6 / (1 + (frequency / 9.7) ** 2))
    centre = np.log([4e-4, 3.4, 2.7e-3])
    scatters = []
    for _ in range(24):
        theta = centre + rng.normal(0, 0.3, 3)
        true, slope = kernel.derivative(theta, frequency)
        noise = relative * np.abs(true) * (rng.normal(size=(2, 125)).T @ [1, 1j])
        # As a fit with weights 1/|z| takes it up, to first order.
        jac = np.concatenate([(slope / np.abs(true)).real, (slope / np.abs(true)).imag], axis=1).T
        own = np.concatenate([(noise / np.abs(true)).real, (noise / np.abs(true)).imag])
        step = np.linalg.lstsq(jac, own, rcond=None)[0]
        z = true + noise
        model, derivative = kernel.derivative(theta + step, frequency)
        scatters.append(scatter_of_roughness(frequency, z, model, derivative))
    assert all(s.frequency_hz[0] == frequency[0] and s.frequency_hz[-1] != frequency[-1] for s in scatters)
    found = pool(scatters, 1e-3).at(frequency, np.ones(125))
    assert found[0] / relative[0] == pytest.approx(1.0, abs=0.3)
    np.testing.assert_allclose(found[3:] / relative[3:], 1.0, atol=0.25)


def test_a_dense_grid_has_no_scatter_at_its_ends() -> None:
    kernel = Kernel(parse("m1|r1|n1"))
    model, derivative = kernel.derivative(np.log([4e-4, 3.4, 2.7e-3]), FREQUENCY)
    z = model * (1 + 0.01 * np.random.default_rng(1).normal(size=model.size))
    for one, other in zip(
        vars(scatter_of_roughness(FREQUENCY, z, model, derivative)).values(),
        vars(scatter_of_roughness(FREQUENCY, z, model)).values(),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("corner", [0.0, 8.0, 50.0])
def test_noise_that_rises_to_an_end_goes_on_rising(corner: float) -> None:
    """At the ends there are no second differences; a flat continuation has a fifth too little at the first of 51."""
    frequency, rng = np.geomspace(5.0, 5000.0, 51), np.random.default_rng(3)
    relative = 0.01 * np.sqrt(1 + (corner / frequency) ** 4)
    found = []
    for _ in range(12):
        scatters = []
        for _ in range(71):
            noise = relative * (rng.normal(size=(2, 51)).T @ [1, 1j])
            scatters.append(scatter_of_roughness(frequency, 1 + noise, np.ones(51, dtype=complex)))
        model = pool(scatters, 1e-3)
        found.append(model.at(frequency, np.ones(51)) / relative)
        far = model.at(np.array([1e-3, 1e9]), np.ones(2))
        assert np.all(np.abs(np.log(far / model.sd[[0, -1]])) < 1e-9)  # no farther than the next point could be
    middle = np.exp(np.mean(np.log(found), axis=0))
    np.testing.assert_allclose(middle[[0, 1, -2, -1]], 1.0, atol=0.1)
    assert np.std(np.log(found), axis=0)[[0, -1]].max() < 0.15


def test_the_slope_at_an_end_is_not_taken_from_chance() -> None:
    """Of one person the level at the ends is nearly that of the neighbours: a slope is not known."""
    frequency, rng = np.geomspace(5.0, 5000.0, 101), np.random.default_rng(4)
    changes = []
    for _ in range(50):
        noise = 0.01 * (rng.normal(size=(2, 101)).T @ [1, 1j])
        at = pool([scatter_of_roughness(frequency, 1 + noise, np.ones(101, dtype=complex))], 1e-3).at(
            frequency, np.ones(101)
        )
        changes += [np.log(at[0] / at[1]), np.log(at[-1] / at[-2])]
    assert np.abs(changes).max() < 0.05
