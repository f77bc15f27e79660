"""Fits of two groups of people: groups that are there and are not, files, users, people left out, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from populations_of_groups import groups_apart, people_of_groups
from populations_with_tails import CENTRE, SCALE, people_with_tails
from saved_fits import read_again
from scipy.stats import kstest, norm

from bayes_impedance import FitSettings, fit_population
from bayes_impedance.commands.slope_lines import group_lines
from bayes_impedance.design.users import population_of
from bayes_impedance.errors import InputError
from bayes_impedance.population.described_population import population_from
from bayes_impedance.population.fit import QUICK_SETTINGS, PopulationFit
from bayes_impedance.population.held_out_person import held_out_log_densities
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.population.two_components import SEPARATION, Groups
from bayes_impedance.report import write_report
from bayes_impedance.results import make_result, predict, save_result
from bayes_impedance.results.leave_one_out import leave_one_out
from bayes_impedance.results.result import Result

MIXTURE = replace(QUICK_SETTINGS, distribution="mixture")
TRUE = groups_apart(0.35, 5.0)


@pytest.fixture(scope="module")
def two() -> dict[str, PopulationFit]:
    """Forty people of two groups that are five standard deviations apart, fitted with both distributions."""
    recordings, _ = people_of_groups(40, TRUE, 1, repetitions=2)
    return {s.distribution: fit_population(recordings, settings=s, seed=5) for s in (QUICK_SETTINGS, MIXTURE)}


@pytest.fixture(scope="module")
def saved(two: dict[str, PopulationFit], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Result]:
    return read_again(two, tmp_path_factory)


def test_groups_that_are_there_are_found(two):
    fit, (_, second) = two["mixture"], people_of_groups(40, TRUE, 1, repetitions=2)
    assert not fit.diagnostics.problems
    groups = fit.parameters.groups
    low, high = np.quantile(groups.distance, (0.05, 0.95))
    assert 3 < low < 5 < high < 7.5
    low, high = np.quantile(groups.share, (0.05, 0.95))
    assert low < second.mean() < high
    assert high - low < 0.35
    difference = groups.difference(fit.parameters.covariance_cholesky)
    expected = TRUE.difference(np.diag(SCALE)[None])[0]
    assert np.all(np.abs(difference.mean(axis=0) - expected) < 3 * difference.std(axis=0))
    assert np.all(difference.std(axis=0) < SCALE)


def test_moments_are_those_of_the_normal_population(two):
    normal, mixture = two["normal"].parameters, two["mixture"].parameters
    error = SCALE / np.sqrt(40)
    assert np.all(np.abs(normal.mu.mean(axis=0) - mixture.mu.mean(axis=0)) < 0.7 * error)
    ratio = mixture.between_persons.mean(axis=0) / normal.between_persons.mean(axis=0)
    assert np.all(np.abs(ratio - 1) < 0.15)


def test_people_left_out_are_predicted_better_with_their_groups(saved):
    better, error = leave_one_out(saved["mixture"]).less(leave_one_out(saved["normal"]))
    assert better > 5
    assert better > 2 * error > 0


def test_of_one_kind_of_people_no_clear_groups_are_found():
    fit = fit_population(people_with_tails(40, np.inf, 3), settings=MIXTURE, seed=1)
    assert not fit.diagnostics.problems
    assert np.quantile(fit.parameters.groups.distance, 0.05) < 1.5
    p = fit.parameters
    assert np.all(np.abs(p.mu.mean(axis=0) - CENTRE) < 3 * SCALE / np.sqrt(40))


def test_result_says_who_belongs_to_which_group(saved):
    result, (_, second) = saved["mixture"], people_of_groups(40, TRUE, 1, repetitions=2)
    probability = result.groups["constant_data"]["second_group_probability"]
    assert np.mean((probability > 0.5) == second) >= 0.95
    np.testing.assert_array_equal(result.persons_table()["second_group_probability"], probability)
    said = result.summary["distribution"]
    share = result.groups["posterior"]["second_group_share"]
    assert said["second_group_share"]["median"] == pytest.approx(np.median(share))
    difference = result.groups["posterior"]["group_difference"]
    assert said["difference"]["r1"]["q05"] == pytest.approx(np.quantile(difference[..., 1], 0.05))
    assert list(said["difference"]) == ["m1", "r1", "n1"]
    assert any("two groups" in remark for remark in result.summary["remarks"])
    assert result.attributes["distribution"] == "mixture"
    assert result.elements_table().attrs["distribution"] == said
    assert "degrees_of_freedom" not in result.elements_table().attrs
    assert {"second_group_share", "group_difference"} <= set(result.groups["prior"])
    assert "distribution" not in saved["normal"].summary
    assert "second_group_probability" not in saved["normal"].groups["constant_data"]
    lines = group_lines(result.summary)
    assert lines[1].startswith("two groups: share of the second 0.")
    assert [line.split()[0] for line in lines[3:]] == ["m1", "r1", "n1"]
    assert group_lines(saved["normal"].summary) == []


def test_page_names_the_groups_and_their_members(saved, tmp_path):
    _, second = people_of_groups(40, TRUE, 1, repetitions=2)
    page = write_report(saved["mixture"], tmp_path, (), {}).read_text(encoding="utf-8")
    assert "Two groups of people" in page
    members = page.split("with a probability of more than one half: ")[1].split(".</p>")[0].split(", ")
    surely = {f"s{i:03d}" for i in np.flatnonzero(second)}
    assert len(surely ^ set(members)) <= 2
    assert "geometric mean" in page
    assert "--distribution mixture" in page
    (tmp_path / "normal").mkdir()
    other = write_report(saved["normal"], tmp_path / "normal", (), {}).read_text(encoding="utf-8")
    assert "Two groups" not in other


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_functions_of_arviz_take_the_result(two, tmp_path):
    import arviz as az
    from matplotlib import pyplot as plt

    fit = two["mixture"]
    save_result(make_result(fit, predict(fit, seed=1), {}), tmp_path)
    data = az.from_netcdf(tmp_path / "result.nc")
    table = az.summary(data)
    assert {"second_group_share", "group_difference[r1]"} <= set(table.index)
    assert np.all(np.isfinite(table.select_dtypes("number")))
    assert "smaller" in data["posterior"]["second_group_share"].attrs["description"]
    az.plot_trace(data, var_names=["second_group_share", "group_difference"])
    az.plot_ppc(data, var_names=["recordings"], num_pp_samples=10)
    plt.close("all")


def test_users_are_drawn_from_the_two_groups(saved):
    """Along the difference of their own population: the density of two normal ones."""
    population = population_of(saved["mixture"])
    users = population.draw(4000, seed=2)
    rows = np.linspace(0, len(population.mu) - 1, 4000).astype(int)
    white = np.linalg.solve(population.factor[rows], (users.u - population.mu[rows])[..., None])[..., 0]
    groups = population.groups[rows]
    direction = groups.separation / np.linalg.norm(groups.separation, axis=1)[:, None]
    along, centres = np.sum(white * direction, axis=1), np.einsum("wkp,wp->wk", groups.offsets, direction)
    sd = 1 / np.sqrt(1 + np.sum(groups.separation**2, axis=1))
    uniform = (1 - groups.share) * norm.cdf((along - centres[:, 0]) / sd)
    uniform += groups.share * norm.cdf((along - centres[:, 1]) / sd)
    assert kstest(uniform, "uniform").pvalue > 0.01
    assert kstest(along, "norm").pvalue < 1e-6
    weights = population.weights(users, 5)
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    assert np.min(1 / np.sum(weights**2, axis=1)) > 200
    assert "two groups" in population.note
    stored = two_groups_of(saved["mixture"])
    np.testing.assert_allclose(population.groups.distance, stored, rtol=1e-4)


def two_groups_of(result: Result) -> np.ndarray:
    """Distances of the groups by their definition, from share, difference and covariance of the file."""
    own = {k: v.reshape(-1, *v.shape[2:]) for k, v in result.groups["posterior"].items()}
    tau, d, w = own["dispersion_between_persons"], own["group_difference"], own["second_group_share"]
    covariance = tau[:, :, None] * own["correlation"] * tau[:, None]
    within = covariance - (w * (1 - w))[:, None, None] * d[:, :, None] * d[:, None]
    return np.sqrt(np.sum(d * np.linalg.solve(within, d[..., None])[..., 0], axis=1))


def test_recordings_are_simulated_from_the_summary_of_a_fit(saved):
    summary = saved["mixture"].summary
    population = population_from(summary, "summary.json")
    said = summary["distribution"]
    assert population.second_group_share == said["second_group_share"]["median"]
    assert population.group_difference == {name: own["median"] for name, own in said["difference"].items()}
    made = simulate_recordings(population, 1000, 1, np.geomspace(5, 500, 5), 1)
    along = made.log_elements @ np.array(list(population.group_difference.values()))
    assert kstest((along - along.mean()) / along.std(), "norm").pvalue < 1e-6


def test_simulated_people_are_of_two_groups():
    population = VirtualPopulation(
        network="m1|r1|n1",
        central={"m1": 0.02, "r1": 2.0, "n1": 1e-3},
        between_persons={"m1": 0.2, "r1": 0.5, "n1": 0.2},
        second_group_share=0.3,
        group_difference={"r1": 1.0},
    )
    made = simulate_recordings(population, 3000, 1, np.geomspace(5, 500, 2), 1)
    away = made.log_elements - np.log([0.02, 2.0, 1e-3])
    assert np.all(np.abs(away.std(axis=0) / [0.2, 0.5, 0.2] - 1) < 0.05)
    assert np.all(np.abs(away.mean(axis=0)) < [0.02, 0.04, 0.02])
    inside = np.sqrt(0.25 - 0.21)
    assert kstest((away[:, 1] + 0.3) / inside, "norm").pvalue < 1e-6
    first = away[:, 1] < 0.2  # half way between the centres, at -0.3 and 0.7
    assert first.mean() == pytest.approx(0.7, abs=0.03)
    assert away[first, 1].mean() == pytest.approx(-0.3, abs=0.03)
    assert made.truth["distribution"]["difference"] == {"r1": 1.0}
    again = population_from(made.truth, "truth.json")
    assert (again.second_group_share, dict(again.group_difference)) == (0.3, {"r1": 1.0})
    for change, words in (
        ({"group_difference": {"r1": 1.2}}, "farther apart"),
        ({"group_difference": {"q1": 0.1}}, "no such element"),
        ({"group_difference": {"m1": 0.1}, "between_persons": {"r1": 0.5}}, "does not differ"),
        ({"degrees_of_freedom": 4.0}, "not both"),
        ({"second_group_share": 1.0}, "second_group_share"),
    ):
        with pytest.raises(InputError, match=words):
            simulate_recordings(replace(population, **change), 4, 1, np.geomspace(5, 500, 2), 1)


def test_somebody_left_out_of_the_smaller_group_is_less_improbable(two):
    recordings, second = people_of_groups(40, TRUE, 1, repetitions=2)
    found = {}
    for name, fit in two.items():
        values = []
        for i in (int(np.flatnonzero(second)[0]), int(np.flatnonzero(~second)[0])):
            noisy = replace(recordings.subjects[i], noise_sd=np.asarray(fit.noise[i]))
            draws = held_out_log_densities(fit, noisy, np.random.SeedSequence(3))
            assert np.all(np.isfinite(draws))
            # The mean density over draws of a fit with this person: the one that the fit itself has.
            own = fit.person_log_likelihood[..., i].ravel()
            values.append(np.logaddexp.reduce(own) - np.logaddexp.reduce(draws))
        found[name] = values
    assert np.all(np.abs(np.concatenate(list(found.values()))) < 0.3)


@pytest.mark.long
def test_same_seed_same_numbers_and_an_interrupted_fit_continues(tmp_path):
    recordings, _ = people_of_groups(10, TRUE, 4)
    whole = fit_population(recordings, settings=MIXTURE, seed=7, workers=1)

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "sampling":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_population(recordings, settings=MIXTURE, seed=7, workers=2, checkpoint=tmp_path, progress=stop)
    continued = fit_population(recordings, settings=MIXTURE, seed=7, workers=2, checkpoint=tmp_path)
    assert np.array_equal(whole.parameters.groups.share, continued.parameters.groups.share)
    assert np.array_equal(whole.person_draws, continued.person_draws)


@pytest.mark.long
def test_covariates_and_parameters_that_are_shared_go_with_groups():
    recordings, _ = people_of_groups(30, TRUE, 8)
    age = np.random.default_rng(1).normal(size=30)
    subjects = [
        replace(s, covariates={"age_y": float(40 + 10 * a)}) for s, a in zip(recordings.subjects, age, strict=True)
    ]
    settings = replace(MIXTURE, covariates=("age_y",))
    fit = fit_population(replace(recordings, subjects=tuple(subjects)), "m1|r1|n1*", settings=settings, seed=2)
    result = make_result(fit, predict(fit, seed=1), {})
    assert list(result.summary["distribution"]["difference"]) == ["m1", "r1"]
    assert np.all(fit.parameters.groups.separation[:, 2] == 0)
    probability = result.groups["constant_data"]["second_group_probability"]
    assert np.all((probability >= 0) & (probability <= 1))
    assert np.all(np.isfinite(population_of(result, unreliable=True).draw(50, seed=1).u))


def test_what_has_no_groups_is_refused():
    with pytest.raises(InputError, match="'mixture'"):
        FitSettings(distribution="two")
    with pytest.raises(InputError, match="covariance 'full'"):
        FitSettings(distribution="mixture", covariance="diagonal")
    few = people_with_tails(4, np.inf, 1)
    with pytest.raises(InputError, match=r"4 subjects are too few for two groups .* which take 5"):
        fit_population(few, settings=MIXTURE)
    with pytest.raises(InputError, match="too few for two groups"):
        sample_prior(few, settings=MIXTURE)
    one = fit_population(people_with_tails(1, np.inf, 1), settings=MIXTURE, seed=1)
    assert one.settings.distribution == "normal"
    assert one.parameters.groups is None


def test_prior_of_people_has_groups():
    recordings = people_with_tails(8, 3.0, 4)
    sample = sample_prior(recordings, settings=MIXTURE, n=20_000, seed=1)
    groups, factor = sample.parameters.groups, sample.parameters.covariance_cholesky
    assert np.sqrt(np.mean(np.sum(groups.separation**2, axis=1))) == pytest.approx(SEPARATION, rel=0.05)
    white = np.linalg.solve(factor, (sample.people - sample.parameters.mu)[..., None])[..., 0]
    direction = groups.separation / np.linalg.norm(groups.separation, axis=1)[:, None]
    along = np.sum(white * direction, axis=1)
    assert along.std() == pytest.approx(1, rel=0.05)
    assert kstest(along, "norm").pvalue < 1e-4
    across = np.cross(direction, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across, axis=1)[:, None]
    assert kstest(np.sum(white * across, axis=1), "norm").pvalue > 0.01


@pytest.mark.slow
def test_share_distance_and_moments_are_calibrated():
    """Over small populations whose share and separation are drawn from the prior: how often 90 % intervals hold them.

    Of the share only what does not depend on labels: that of the smaller group.
    """
    inside, count = np.zeros(4), np.zeros(4)
    rng = np.random.default_rng(5)
    for k in range(20):
        groups = Groups(rng.uniform(0.1, 0.9, 1), SEPARATION / np.sqrt(3) * rng.normal(size=(1, 3)))
        fit = fit_population(people_of_groups(24, groups, 100 + k)[0], settings=MIXTURE, seed=k)
        assert not fit.diagnostics.problems
        p, own = fit.parameters, fit.parameters.groups
        smaller = np.minimum(own.share, 1 - own.share)[:, None]
        truths = [
            (p.mu, CENTRE),
            (p.between_persons, SCALE),
            (own.distance[:, None], groups.distance),
            (smaller, np.minimum(groups.share, 1 - groups.share)),
        ]
        for q, (values, truth) in enumerate(truths):
            low, high = np.quantile(values, (0.05, 0.95), axis=0)
            inside[q] += np.sum((low <= truth) & (truth <= high))
            count[q] += truth.size
    share = inside / count
    assert np.all(share > 0.9 - 3 * np.sqrt(0.09 / count)), share
