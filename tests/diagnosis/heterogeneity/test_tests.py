"""Person likelihoods that are made from a fit, against direct formulas, and the structures found in recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Experiment, entry, recovered, toy

from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.heterogeneity import tests
from bayes_impedance.diagnosis.heterogeneity.correlations import CorrelationTest
from bayes_impedance.diagnosis.heterogeneity.subgroups import Subgroup
from bayes_impedance.diagnosis.heterogeneity.tests import (
    ElementTrends,
    added_parameters,
    covariates_of,
    find_structures,
    person_likelihoods,
    repetition_likelihoods,
)
from bayes_impedance.diagnosis.verdict.structure_entries import structure_entry
from bayes_impedance.recordings.dataset import Recordings, Subject

N = 36
FORCE = np.exp(np.random.default_rng(9).normal(0, 0.5, N))


def damper_times(factor: Callable[[int], np.ndarray]) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Everybody's damper multiplied by a factor (J,) of the person's number."""

    def hidden(_s: np.ndarray, z: np.ndarray, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        factors = np.array([factor(i) * np.ones(z.shape[1]) for i in range(len(z))])
        return z + z.real * (factors[..., None] - 1), factors[:, 0]

    return hidden


def recordings(experiment: Experiment, force: np.ndarray | None = None, noted: np.ndarray | None = None) -> Recordings:
    """An experiment's data as recordings, with a force of each person, or one noted of each repetition."""
    subjects = []
    for i, d in enumerate(experiment.data):
        subjects.append(
            Subject(
                name=f"P{i}",
                frequency_hz=d.omega / (2 * np.pi),
                z=d.z[:, 0] + 1j * d.z[:, 1],
                repetitions=tuple(str(j) for j in range(len(d.z))),
                covariates={} if force is None else {"contact_force_n": float(force[i])},
                circumstances={} if noted is None else {"contact_force_n": noted[i]},
            )
        )
    return Recordings(title="", unit="N s/m", network=None, source="", licence="", subjects=tuple(subjects))


def entries(experiment: Experiment, force: np.ndarray | None = None, diagonal: bool = False):
    fit = experiment.refitter.fit(experiment.model, experiment.u, experiment.population, 80)
    return find_structures(fit, recordings(experiment, force), diagonal, 1)


def test_deviations_between_repetitions_are_integrated_out() -> None:
    """A person's information is the sum of (H^-1 + R)^-1 over the recordings, its mode their weighted mean."""
    fit = toy(*TOY, seed=1, n=4, repetitions=3, rho=0.08).fit()
    found = person_likelihoods(fit)
    spread = np.diag(fit.population.rho**2)
    for i in range(4):
        total, pull = np.zeros((2, 2)), np.zeros(2)
        for row in np.flatnonzero(fit.owner == i):
            h = fit.weight[i] * fit.equations.information[row]
            mode = fit.u[row] - np.linalg.solve(h, fit.weight[i] * fit.equations.gradient[row])
            own = np.linalg.inv(np.linalg.inv(h) + spread)
            total, pull = total + own, pull + own @ mode
        np.testing.assert_allclose(found.information[i], total, rtol=1e-8)
        np.testing.assert_allclose(found.linear[i], pull, rtol=1e-8)


def test_repetitions_are_likelihoods_of_the_deviation_from_the_person() -> None:
    experiment = toy(*TOY, seed=2, n=5, repetitions=3)
    fit = experiment.fit()
    found = repetition_likelihoods(fit, recordings(experiment))
    assert [order.tolist() for order in found.order] == [[0, 1, 2]] * 5
    for i in range(5):
        mode = np.linalg.solve(found.information[i], found.linear[i][..., None])[..., 0]
        truth = experiment.u[fit.owner == i] - fit.persons[i]
        sd = np.sqrt(np.einsum("jpp->jp", np.linalg.inv(found.information[i])))
        assert np.all(np.abs(mode - truth) < 4.5 * sd)


def test_where_nothing_is_missing_there_is_no_entry() -> None:
    found, remarks = entries(toy(*TOY, seed=3, n=N, repetitions=3), FORCE, diagonal=True)
    assert found == ()
    assert remarks == []


def test_an_element_that_follows_a_covariate_is_an_entry() -> None:
    found, _ = entries(toy(*TOY, seed=4, n=N, hidden=damper_times(lambda i: FORCE[i] ** 0.5)), FORCE)
    (structure,) = found
    assert isinstance(structure, ElementTrends)
    assert structure.covariate == "contact_force_n"
    (trend,) = structure.trends
    assert trend.element == "r1"
    assert trend.q05 < 0.5 < trend.q95
    assert trend.transform == "log"
    assert trend.p_corrected < 0.003
    assert structure.gain > 2 * structure.gain_se > 0


def test_a_drift_over_the_repetitions_is_an_entry() -> None:
    drifting = damper_times(lambda i: np.exp(0.1 * np.arange(3)))
    found, _ = entries(toy(*TOY, seed=5, n=N, repetitions=3, hidden=drifting))
    (structure,) = found
    assert isinstance(structure, ElementTrends)
    assert structure.covariate is None
    trend = structure.trends[0]
    assert trend.element == "r1"
    assert trend.q05 < 0.1 < trend.q95


@pytest.mark.parametrize("gain", [-0.2, 0.0])
def test_what_predicts_nobody_else_is_no_entry(monkeypatch: pytest.MonkeyPatch, gain: float) -> None:
    monkeypatch.setattr(tests, "gain_within_persons", lambda *_: (gain, 1.0))
    monkeypatch.setattr(tests, "gain_of_covariate", lambda *_: (gain, 1.0))
    drifting = damper_times(lambda i: FORCE[i] ** 0.5 * np.exp(0.1 * np.arange(3)))
    found, _ = entries(toy(*TOY, seed=5, n=N, repetitions=3, hidden=drifting), FORCE)
    assert found == ()
    monkeypatch.setattr(tests, "gain_of_covariate", lambda *_: (0.1, 1.0))
    (structure,), _ = entries(toy(*TOY, seed=5, n=N, repetitions=3, hidden=drifting), FORCE)
    assert isinstance(structure, ElementTrends)
    assert structure.covariate == "contact_force_n"


def test_an_element_that_follows_what_was_noted_of_each_repetition_is_an_entry() -> None:
    noted = FORCE[:, None] * np.exp(np.random.default_rng(10).normal(0, 0.3, (N, 3)))
    experiment = toy(*TOY, seed=4, n=N, repetitions=3, hidden=damper_times(lambda i: (noted[i] / FORCE[i]) ** 0.5))
    fit = experiment.refitter.fit(experiment.model, experiment.u, experiment.population, 80)
    (structure,), _ = find_structures(fit, recordings(experiment, noted=noted), False, 1)
    assert isinstance(structure, ElementTrends)
    assert (structure.covariate, structure.within) == ("contact_force_n", True)
    (trend,) = structure.trends
    assert trend.element == "r1"
    assert trend.q05 < 0.5 < trend.q95
    assert structure.gain > 2 * structure.gain_se > 0
    entry = structure_entry(structure, experiment.model.network.elements, [f"P{i}" for i in range(N)])
    assert entry.name == "r1 follows contact_force_n from repetition to repetition"
    assert entry.covariate == "contact_force_n"
    driven = replace(structure, covariate="drive_level_v")
    assert structure_entry(driven, experiment.model.network.elements, ["P0"]).id == "body.amplitude"


def test_means_of_what_was_noted_are_covariates_of_the_persons() -> None:
    noted = np.array([[1.0, 2.0, np.nan], [3.0, 3.0, 6.0]])
    experiment = toy(*TOY, seed=4, n=2, repetitions=3)
    np.testing.assert_allclose(covariates_of(recordings(experiment, noted=noted))["contact_force_n"], [1.5, 4.0])
    both = recordings(experiment, np.array([7.0, 8.0]), noted)
    np.testing.assert_allclose(covariates_of(both)["contact_force_n"], [7.0, 8.0])
    same = recordings(experiment, noted=np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]))
    assert covariates_of(same) == {}


def test_a_group_is_an_entry_with_its_people() -> None:
    found, _ = entries(toy(*TOY, seed=6, n=N, hidden=damper_times(lambda i: 4.0 if i < 10 else 1.0)))
    (group,) = found
    assert isinstance(group, Subgroup)
    assert group.element == "r1"
    assert np.flatnonzero(group.membership > 0.5).tolist() == list(range(10))
    k = TOY[0].split("|").index("r1")
    assert abs(group.shift[k] - np.log(4)) < 3 * (group.shift_q95[k] - group.shift_q05[k]) / 3.29
    assert group.share_q05 < 10 / N < group.share_q95


def test_elements_that_vary_together_are_an_entry_only_against_a_diagonal_claim() -> None:
    def together(s: np.ndarray, z: np.ndarray, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Everybody's damper is divided by the person's own compliance, to the power of 0.9."""
        compliance = 1 / np.mean((z * s).real, axis=(1, 2))
        factor = (compliance / np.median(compliance)) ** 0.9
        return z + z.real * (factor[:, None, None] - 1), factor

    experiment = toy(*TOY, seed=7, n=N, hidden=together)
    assert entries(experiment)[0] == ()
    (together_found,) = entries(experiment, diagonal=True)[0]
    assert isinstance(together_found, CorrelationTest)
    (pair,) = together_found.pairs
    assert {pair.first, pair.second} == {"n1", "r1"}
    assert pair.q05 > 0.2


def test_covariates_are_collected_by_name_with_nan_where_unknown() -> None:
    given = recordings(toy(*TOY, seed=8, n=3), np.array([1.0, np.nan, 3.0]))
    found = covariates_of(given)
    assert list(found) == ["contact_force_n"]
    np.testing.assert_array_equal(found["contact_force_n"], [1.0, np.nan, 3.0])


def test_what_cannot_be_tested_is_remarked_upon() -> None:
    _, remarks = entries(toy(*TOY, seed=9, n=4), np.ones(4))
    assert remarks == ["Covariates: only 4 subjects; at least 5 are needed"]
    _, remarks = entries(toy(*TOY, seed=9, n=1), np.ones(1))
    assert remarks == ["Covariates: only 1 subject; at least 5 are needed"]


TEMPERATURE = np.random.default_rng(12).uniform(5.0, 40.0, N)


def with_power_law(exponent: np.ndarray) -> Experiment:
    def hidden(s: np.ndarray, z: np.ndarray, _rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        return z.real + 1j * z.imag * (s / 400.0) ** exponent[:, None, None], exponent

    return toy(*TOY, seed=8, n=N, hidden=hidden)


def with_its_fit(exponent: np.ndarray) -> tuple[Experiment, Refit]:
    experiment = with_power_law(exponent)
    return experiment, recovered(experiment, entry("body.springpot", "power"), "n1", "varying")


def test_a_parameter_of_an_addition_that_follows_a_covariate_is_an_entry() -> None:
    rng = np.random.default_rng(2)
    experiment, fit = with_its_fit(0.2 * np.exp(-0.03 * (TEMPERATURE - 22.5) + 0.1 * rng.normal(size=N)))
    given = recordings(experiment, TEMPERATURE)
    given = replace(
        given,
        subjects=tuple(
            replace(s, covariates={"temperature_c": t}) for s, t in zip(given.subjects, TEMPERATURE, strict=True)
        ),
    )
    found, _ = find_structures(fit, given, False, 1)
    (structure,) = found
    assert isinstance(structure, ElementTrends)
    assert structure.place == "n1"
    (trend,) = structure.trends
    assert trend.element == "exponent of power-law tissue at n1"
    assert trend.q05 < -0.03 < trend.q95
    assert trend.transform == "linear"
    assert structure.gain > 2 * structure.gain_se > 0


def test_a_parameter_of_an_addition_that_follows_nothing_is_no_entry() -> None:
    experiment, fit = with_its_fit(0.2 * np.exp(0.3 * np.random.default_rng(3).normal(size=N)))
    (added,) = added_parameters(fit)
    assert (added.place, added.column) == ("n1", fit.model.n_elements)
    found, _ = find_structures(fit, recordings(experiment, FORCE), False, 1)
    assert found == ()


def test_likelihoods_with_added_parameters_are_those_of_the_elements_and_more() -> None:
    """Elements alone are a slice of the whole; in logarithms a linear coefficient is scaled by its mean."""
    _, fit = with_its_fit(0.2 * np.exp(0.3 * np.random.default_rng(3).normal(size=N)))
    added = added_parameters(fit)
    whole, plain = person_likelihoods(fit, added), person_likelihoods(fit)
    mode = np.linalg.solve(whole.information, whole.linear[..., None])[..., 0]
    relative = fit.persons[:, -1] / fit.u[:, added[0].column].mean()
    sd = np.sqrt(np.linalg.inv(whole.information)[:, -1, -1])
    assert np.all(np.abs(mode[:, -1] - relative) < 5 * sd)  # persons are drawn to the population's mean
    assert whole.elements == (*plain.elements, added[0].name)
