"""The error by the finite number of draws, against posteriors from many sets of draws; and what follows from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from experiments import Serial

from bayes_impedance.mcmc.ensemble import Chains, SamplerSettings
from bayes_impedance.person.importance_draws import Draws
from bayes_impedance.population import sampling
from bayes_impedance.population.diagnostics import BEYOND_LIMIT, ERROR_LIMIT
from bayes_impedance.population.draw_error import ERROR_WANTED, POPULATIONS, DrawError, draw_error
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.importance_likelihood import ImportanceLikelihood
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.posterior import Posterior
from bayes_impedance.population.sharded_likelihood import KeptDraws, Part
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings

PERSONS, OWN_SD, REFERENCE_SD = 8, 0.3, 1.0


def kept(n_draws: int, seed: int, others: int = 0) -> KeptDraws:
    """Independent draws of PERSONS and others persons of one element each, whose likelihoods are normal."""
    rng = np.random.default_rng(seed)
    n = PERSONS + others
    observed = np.linspace(-0.7, 0.7, n)
    draws = []
    for y in observed:
        theta = REFERENCE_SD * rng.normal(size=(n_draws, 1))
        ratio = -0.5 * ((theta[:, 0] - y) / OWN_SD) ** 2 + 0.5 * (theta[:, 0] / REFERENCE_SD) ** 2
        draws.append(Draws(theta, ratio, ratio - np.logaddexp.reduce(ratio)))
    square = np.array([[REFERENCE_SD**2]])
    marginal = ImportanceLikelihood(draws, np.zeros((n, 1)), square, np.ones(n, dtype=int), np.zeros((n, 0)), ())
    return KeptDraws([Part.of(marginal, draws, np.ones(1))], Serial())


def populations() -> tuple[np.ndarray, PopulationParameters]:
    """Coordinates (POPULATIONS, 2), mean and logarithmic dispersion, and the populations."""
    u = np.random.default_rng(5).normal(size=(POPULATIONS, 2))
    mu, tau = 0.2 * u[:, :1], 0.4 * np.exp(0.25 * u[:, 1:])
    none = np.zeros((POPULATIONS, 1))
    return u, PopulationParameters(
        mu=mu,
        between_persons=tau,
        correlation_cholesky=np.ones((POPULATIONS, 1, 1)),
        between_repetitions=none,
        slopes=np.zeros((POPULATIONS, 1, 0)),
    )


def exact(parameters: PopulationParameters) -> np.ndarray:
    """Log likelihood of the populations, (W,), in closed form."""
    variance = parameters.between_persons[:, 0] ** 2 + OWN_SD**2
    offset = np.linspace(-0.7, 0.7, PERSONS) - parameters.mu
    return np.asarray(-0.5 * np.sum(offset**2, axis=1) / variance - 0.5 * PERSONS * np.log(variance))


def test_error_is_the_scatter_of_interval_ends_over_sets_of_draws() -> None:
    """The posterior here is the set of populations; draws change their weights by exp(error of the log likelihood)."""
    u, parameters = populations()
    z = (u - u.mean(axis=0)) / u.std(axis=0)  # nearly normal, so that ranks change little
    ends, predicted = [], []
    for seed in range(200):
        marginal = kept(128, seed)
        log_weight = marginal(parameters) - exact(parameters)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        mean = weight @ z
        sd = np.sqrt(weight @ (z - mean) ** 2)
        ends.append(np.concatenate([mean + 1.645 * sd, mean - 1.645 * sd]))
        predicted.append(draw_error(marginal, u, parameters).interval_end)
    scatter = np.std(ends, axis=0).max()
    assert 0.02 < scatter < 0.3
    assert np.sqrt(np.mean(np.square(predicted))) == pytest.approx(scatter, rel=0.2)


def test_error_falls_as_the_root_of_the_number_of_draws() -> None:
    u, parameters = populations()
    few, many = (draw_error(kept(n, 1), u, parameters) for n in (256, 4096))
    assert few.interval_end / many.interval_end == pytest.approx(4, rel=0.25)
    assert many.least_effective / few.least_effective == pytest.approx(16, rel=0.25)


def test_one_far_population_does_not_determine_the_error() -> None:
    u, parameters = populations()
    far = u.copy()
    far[np.argmax(u[:, 0]), 0] = 50.0
    assert draw_error(kept(256, 1), far, parameters) == draw_error(kept(256, 1), u, parameters)


def test_weights_that_are_no_numbers_are_no_small_error() -> None:
    u, parameters = populations()
    broken = replace(parameters, between_persons=np.where(u[:, 1:] > 2, 1e-30, parameters.between_persons))
    error = draw_error(kept(64, 1), u, broken)
    assert error.interval_end > ERROR_LIMIT


SHORT = FitSettings(draws=64, sampler=SamplerSettings(ensembles=2, burn_in=(10, 10), chunk=20, longest=20))


@pytest.fixture(scope="module")
def six() -> Recordings:
    population = VirtualPopulation(
        network="r1|m1", central={"r1": 1.5, "m1": 1e-3}, between_persons={"r1": 0.2, "m1": 0.2}, noise_corner_hz=0.0
    )
    return simulate_recordings(population, 6, 1, np.geomspace(5, 500, 12), 3).recordings


@pytest.fixture(scope="module")
def plain(six: Recordings) -> PopulationFit:
    return fit_population(six, settings=SHORT, seed=4, workers=1)


def same(one: PopulationFit, other: PopulationFit) -> bool:
    names = ("log_probability", "person_draws", "person_log_likelihood")
    return all(getattr(one, name).tobytes() == getattr(other, name).tobytes() for name in names)


def test_draws_that_hold_are_kept(plain: PopulationFit) -> None:
    assert plain.diagnostics.draw_error.interval_end <= ERROR_WANTED
    assert plain.diagnostics.redrawn == 0


def test_other_draws_are_made_until_the_error_is_met(
    six: Recordings, plain: PopulationFit, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = plain.diagnostics.draw_error
    with monkeypatch.context() as patched:
        patched.setattr(sampling, "ERROR_WANTED", 0.7 * first.interval_end)
        again = fit_population(six, settings=SHORT, seed=4, workers=1)
    assert 1 <= again.diagnostics.redrawn <= 2
    assert again.diagnostics.draw_error.interval_end < 0.7 * first.interval_end
    assert not same(plain, again)


def test_draws_made_anew_are_compared_by_densities_that_do_not_depend_on_them(
    six: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A set of draws leaves a constant out of the likelihood that is sampled, and each set another one."""
    heights, relative = [], []

    def watched(posterior: Posterior, height=sampling._height) -> float:
        heights.append(height(posterior))
        relative.append(float(posterior.log_probability(posterior.mode[None])[0]))
        return heights[-1]

    monkeypatch.setattr(sampling, "ERROR_WANTED", 1e-9)
    monkeypatch.setattr(sampling, "_height", watched)
    fit_population(six, settings=SHORT, seed=4, workers=1)
    assert len(heights) == 4  # twice, both sets of draws
    assert np.ptp(heights) < 0.1
    assert np.ptp(relative) > 3 * np.ptp(heights)


@pytest.mark.long
def test_an_interrupted_repetition_is_continued(
    six: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sampling, "ERROR_WANTED", 1e-9)
    whole = fit_population(six, settings=SHORT, seed=4, workers=1)
    kept_on_disk = fit_population(six, settings=SHORT, seed=4, workers=1, checkpoint=tmp_path)
    files = sorted(tmp_path.glob("ensemble_*.h5"))
    assert [file.name for file in files] == [f"ensemble_{i}.h5" for i in range(6)]
    before = files[0].read_bytes()
    for file in files[3:]:  # as if killed while the second set of chains was sampled
        file.unlink()
    resumed = fit_population(six, settings=SHORT, seed=4, workers=1, checkpoint=tmp_path)
    assert files[0].read_bytes() == before
    assert same(whole, kept_on_disk)
    assert same(whole, resumed)


@pytest.mark.parametrize(
    ("end", "least", "refused"),
    [
        (0.5 * ERROR_WANTED, 1.5, False),
        (1.2 * ERROR_WANTED, 20.0, False),
        (1.2 * ERROR_WANTED, 1.5, True),
        (1.1 * ERROR_LIMIT, 200.0, True),
        (np.inf, 0.0, True),
        (np.nan, np.nan, True),
    ],
)
def test_draws_that_do_not_hold_are_a_problem(plain: PopulationFit, end: float, least: float, refused: bool) -> None:
    told = replace(plain.diagnostics, draw_error=DrawError(interval_end=end, least_effective=least)).problems
    assert any("importance draws do not hold" in sentence for sentence in told) == refused


def test_draws_are_made_anew_while_the_chain_lies_where_they_are_not_known(
    six: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However small their error is; and a set of draws whose chain lies where they are known is the better one."""
    shares, errors = iter([0.5, 0.0]), iter([1e-3, 2e-3])

    def error(self: Posterior, chains: Chains) -> DrawError:
        return DrawError(interval_end=next(errors), least_effective=100.0, beyond=next(shares))

    monkeypatch.setattr(Posterior, "error", error)
    again = fit_population(six, settings=SHORT, seed=4, workers=1)
    assert again.diagnostics.redrawn == 1
    assert again.diagnostics.draw_error.beyond == 0.0
    assert again.diagnostics.draw_error.interval_end == 2e-3


@pytest.mark.parametrize(("beyond", "refused"), [(0.0, False), (0.5 * BEYOND_LIMIT, False), (1.1 * BEYOND_LIMIT, True)])
def test_a_dispersion_beyond_its_range_is_a_problem(plain: PopulationFit, beyond: float, refused: bool) -> None:
    known = DrawError(interval_end=0.01, least_effective=100.0, beyond=beyond)
    told = replace(plain.diagnostics, draw_error=known).problems
    assert any("likelihoods are not known" in sentence for sentence in told) == refused
