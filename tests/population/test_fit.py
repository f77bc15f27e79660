"""The fit as a whole: it recovers the truth, reports what it cannot know, and repeats itself with the same seed."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from conftest import SHORT, SMALL

from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.recording_noise import noise_of
from bayes_impedance.population.requirements import network_of
from bayes_impedance.population.simulate import Simulation, simulate_recordings
from bayes_impedance.population.starting_fits import first_fits
from bayes_impedance.recordings.files import Recordings, Subject


def test_truth_lies_inside_wide_intervals(small_fit: PopulationFit, small_simulation: Simulation) -> None:
    assert not small_fit.diagnostics.problems
    assert small_fit.identified.all()
    p = small_fit.parameters
    for i, name in enumerate(small_fit.kernel.elements):
        truth = small_simulation.truth["elements"][name]
        for values, true in (
            (np.exp(p.mu[:, i]), truth["central"]),
            (p.between_persons[:, i], truth["dispersion_between_persons"]),
            (p.between_repetitions[:, i], truth["dispersion_between_repetitions"]),
        ):
            low, high = np.quantile(values, (0.0005, 0.9995))
            assert low < true < high


def test_everybodys_posterior_covers_their_elements(small_fit: PopulationFit, small_simulation: Simulation) -> None:
    # What a person is: the mean over the repetitions, whose deviations are part of it in these virtual recordings.
    draws = small_fit.person_draws.reshape(-1, *small_fit.person_draws.shape[2:])
    assert draws.dtype == np.float32
    np.testing.assert_allclose(small_fit.person_means, draws.astype(float).mean(axis=0), rtol=1e-12)
    spread = np.hypot(draws.std(axis=0), small_fit.parameters.between_repetitions.mean(axis=0) / np.sqrt(3))
    z = (draws.mean(axis=0) - small_simulation.log_elements) / spread
    assert 0.7 < z.std() < 1.3
    assert np.abs(z).max() < 5


def test_correlations_are_found(small_fit: PopulationFit) -> None:
    correlation = small_fit.parameters.correlation
    names = small_fit.kernel.elements
    found = correlation[:, names.index("n3"), names.index("r3")]
    assert np.quantile(found, 0.05) < -0.5 < np.quantile(found, 0.95)
    assert np.allclose(np.diagonal(correlation, axis1=1, axis2=2), 1)


def test_deviations_of_repetitions_sum_to_zero(small_fit: PopulationFit) -> None:
    for deviations in small_fit.deviations:
        assert np.allclose(deviations.sum(axis=0), 0, atol=1e-9)


def test_noise_is_estimated_for_those_whose_recordings_come_without(small_simulation: Simulation) -> None:
    subjects = small_simulation.recordings.subjects[:4]
    given = 0.02 * np.abs(subjects[1].z)
    subjects = (subjects[0], replace(subjects[1], noise_sd=given), *subjects[2:])
    recordings = replace(small_simulation.recordings, subjects=subjects)
    kernel = Kernel(network_of(recordings, None))
    prior = default_prior(kernel, recordings)
    with ThreadPoolExecutor(1) as executor:
        first = first_fits(kernel, recordings, prior, np.random.SeedSequence(1), executor, lambda *_: None)
    assert first.model is not None
    assert np.array_equal(noise_of(subjects[1], first.model), given)
    assert np.all(noise_of(subjects[0], first.model) < given.max())


@pytest.mark.long
def test_same_seed_same_numbers_whatever_the_threads(small_simulation: Simulation) -> None:
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:6])
    one, two, other = (
        fit_population(recordings, settings=SHORT, seed=seed, workers=workers)
        for seed, workers in ((7, 1), (7, 2), (8, 2))
    )
    assert np.array_equal(one.parameters.mu, two.parameters.mu)
    assert np.array_equal(one.person_draws, two.person_draws)
    assert not np.array_equal(one.parameters.mu, other.parameters.mu)


def test_an_element_that_the_band_cannot_see_gets_no_number() -> None:
    # A mass of 0.1 mg in parallel with a damper of 5 N s/m: at 5 kHz its impedance is a thousandth of the damper's.
    hidden = replace(
        SMALL,
        network="m1|r1|n1",
        central={"m1": 1e-7, "r1": 5.0, "n1": 1e-3},
        between_persons={"m1": 0.3, "r1": 0.3, "n1": 0.3},
        between_repetitions={},
        correlation={},
    )
    recordings = simulate_recordings(hidden, 10, 2, np.geomspace(5, 5000, 30), seed=1).recordings
    fit = fit_population(recordings, settings=SHORT, seed=1)
    assert dict(zip(fit.kernel.elements, fit.identified.tolist(), strict=True)) == {"m1": False, "r1": True, "n1": True}
    assert not fit.diagnostics.problems
    for i in (1, 2):
        truth = np.log(list(hidden.central.values())[i])
        assert abs(fit.parameters.mu[:, i].mean() - truth) < 4 * fit.parameters.mu[:, i].std()


def test_one_person_has_a_posterior_but_no_dispersion(small_simulation: Simulation) -> None:
    recordings = small_simulation.recordings.select([small_simulation.recordings.names[0]])
    fit = fit_population(recordings, settings=SHORT, seed=1)
    assert fit.one_person
    assert not fit.diagnostics.problems
    assert np.all(np.isnan(fit.parameters.between_persons))
    spread = np.hypot(fit.parameters.mu.std(axis=0), 0.06)
    assert np.all(np.abs(fit.parameters.mu.mean(axis=0) - small_simulation.log_elements[0]) < 4 * spread)


def test_one_repetition_merges_the_dispersions(small_simulation: Simulation) -> None:
    single = tuple(
        Subject(name=s.name, frequency_hz=s.frequency_hz, z=s.z[:1], repetitions=s.repetitions[:1])
        for s in small_simulation.recordings.subjects
    )
    fit = fit_population(replace(small_simulation.recordings, subjects=single), settings=SHORT, seed=1)
    assert not fit.repeated
    assert np.all(fit.parameters.between_repetitions == 0)
    assert not fit.diagnostics.problems


def test_unequal_numbers_of_repetitions_and_grids(small_simulation: Simulation) -> None:
    subjects = []
    for i, s in enumerate(small_simulation.recordings.subjects):
        j, step = 1 + i % 3, slice(i % 2, None)
        subjects.append(
            Subject(name=s.name, frequency_hz=s.frequency_hz[step], z=s.z[:j, step], repetitions=s.repetitions[:j])
        )
    fit = fit_population(replace(small_simulation.recordings, subjects=tuple(subjects)), settings=SHORT, seed=1)
    assert not fit.diagnostics.problems
    truth = np.log(SMALL.vector(SMALL.central))
    assert np.all(np.abs(fit.parameters.mu.mean(axis=0) - truth) < 4.5 * fit.parameters.mu.std(axis=0))


def test_a_covariate_that_elements_follow_is_found(small_simulation: Simulation) -> None:
    rng = np.random.default_rng(0)
    age = rng.normal(40, 12, len(small_simulation.recordings.subjects))
    shifted = []
    from bayes_impedance.network.kernel import Kernel
    from bayes_impedance.network.notation import parse

    kernel = Kernel(parse(SMALL.network))
    effect = np.array([0, 0, 0, 0, 0.4])  # of one standard deviation, on n1 alone
    for s, theta, years in zip(
        small_simulation.recordings.subjects, small_simulation.log_elements, (age - age.mean()) / age.std(), strict=True
    ):
        clean = kernel.impedance(theta + effect * years, s.frequency_hz)
        noise = 0.01 * np.abs(clean) * (rng.normal(size=s.z.shape) + 1j * rng.normal(size=s.z.shape))
        shifted.append(
            Subject(
                name=s.name,
                frequency_hz=s.frequency_hz,
                z=clean + noise,
                repetitions=s.repetitions,
                noise_sd=None,
                covariates={"age_y": float(years)},
            )
        )
    recordings = replace(small_simulation.recordings, subjects=tuple(shifted))
    fit = fit_population(recordings, settings=replace(SHORT, covariates=("age_y",)), seed=1)
    slope = fit.parameters.slopes[:, :, 0]
    z = (slope.mean(axis=0) - effect) / slope.std(axis=0)
    assert np.all(np.abs(z) < 3.5)
    assert np.quantile(slope[:, 4], 0.02) > 0


def test_a_network_that_misses_something_widens_the_noise_scale(small_simulation: Simulation) -> None:
    fit = fit_population(small_simulation.recordings, "r3-(m2|r1|n1)", settings=SHORT, seed=1)
    assert np.median(fit.noise_scale) > 3


def test_chains_that_are_too_short_are_refused(small_simulation: Simulation) -> None:
    hopeless = FitSettings(draws=128, sampler=SamplerSettings(ensembles=2, burn_in=(2,), chunk=4, longest=4))
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:6])
    fit = fit_population(recordings, settings=hopeless, seed=1)
    assert any("too short" in problem for problem in fit.diagnostics.problems)


def _with(recordings: Recordings, **changes: object) -> Recordings:
    return replace(recordings, **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("network", "settings", "message"),
    [
        ("m2|", SHORT, "ends too early"),
        ("q1|r1", SHORT, "no known kind"),
        ("m1|m1", SHORT, "twice"),
        ("m2|r1|n1", replace(SHORT, covariates=("age_y",)), 'covariate "age_y" is not in the dataset'),
    ],
)
def test_what_cannot_be_fitted_is_said(
    small_simulation: Simulation, network: str, settings: FitSettings, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        fit_population(small_simulation.recordings, network, settings=settings)


def test_no_network_and_too_few_points_are_said(small_simulation: Simulation) -> None:
    recordings = small_simulation.recordings
    with pytest.raises(InputError, match="no network"):
        fit_population(_with(recordings, network=None))
    first = recordings.subjects[0]
    short = Subject(name="short", frequency_hz=first.frequency_hz[:2], z=first.z[:, :2], repetitions=first.repetitions)
    with pytest.raises(InputError, match="subject short has 2 frequencies, too few for 5 elements"):
        fit_population(_with(recordings, subjects=(*recordings.subjects, short)))
    with pytest.raises(InputError, match="'half'"):
        FitSettings(covariance="half")


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_the_population_settles_in_the_right_one_of_two_optima(seed: int) -> None:
    """Measured before solutions were compared as populations: n3 came out 17 or 2 times too large, with no warning."""
    two = replace(
        SMALL,
        central={"n3": 2e-6, "r3": 60.0, "m2": 8e-4, "r1": 4.0, "n1": 1.2e-3},
        between_persons={"n3": 0.4, "r3": 0.3, "m2": 0.25, "r1": 0.4, "n1": 0.3},
        noise=0.025,
    )
    recordings = simulate_recordings(two, 16, 3, np.geomspace(5, 5000, 30), seed=3).recordings
    fit = fit_population(recordings, settings=SHORT, seed=seed)
    assert not fit.diagnostics.problems
    n3 = np.exp(fit.parameters.mu[:, 0])
    assert np.quantile(n3, 0.01) < 2e-6 < np.quantile(n3, 0.99)
    assert np.median(n3) == pytest.approx(2e-6, rel=0.6)
    assert np.median(fit.parameters.between_persons[:, 0]) < 0.9


@pytest.mark.long
def test_equal_parts_that_change_places_are_no_rival_solution() -> None:
    """Two arcs of one shape: each order fits equally well, and everybody must use the same one."""
    arcs = replace(
        SMALL,
        network="r0|(r1-n1)|(r2-n2)",
        central={"r0": 0.2, "r1": 1.5, "n1": 0.05, "r2": 0.5, "n2": 0.0015},
        between_persons=dict.fromkeys(("r0", "r1", "n1", "r2", "n2"), 0.2),
        between_repetitions={},
        correlation={},
    )
    recordings = simulate_recordings(arcs, 12, 1, np.geomspace(0.02, 5000, 40), seed=1).recordings
    fit = fit_population(recordings, settings=SHORT, seed=1)
    assert not fit.diagnostics.problems
    assert not [remark for remark in fit.diagnostics.remarks if "Another solution" in remark]
    # Either order, but one order: the dispersions are those of an element, not those of two mixed ones.
    assert np.all(np.median(fit.parameters.between_persons, axis=0) < 0.5)
    found = sorted(np.exp(np.median(fit.parameters.mu[:, [1, 3]], axis=0)))
    assert found == pytest.approx([0.5, 1.5], rel=0.3)


@pytest.mark.long
def test_two_persons_get_no_correlations(small_simulation: Simulation) -> None:
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:2])
    fit = fit_population(recordings, settings=SHORT, seed=1)
    assert fit.settings.covariance == "diagonal"
    assert np.all(fit.parameters.correlation == np.eye(5))
    # Dispersions from two persons: hardly better than the prior, whose median is 0.67.
    width = np.quantile(fit.parameters.between_persons, 0.95, axis=0) / np.quantile(
        fit.parameters.between_persons, 0.05, axis=0
    )
    assert np.all(width > 3)
