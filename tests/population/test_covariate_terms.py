"""Categories and interactions among covariates: written out, fitted, and left out of a fit by person."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS
from results_by_hand import make_result as make_by_hand
from tiny_fits import fit_arguments

from bayes_impedance.commands.cli import main
from bayes_impedance.design.users import population_of
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.covariate_terms import correlations_of, with_terms
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.fit import fit_population
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.files import read_recordings, write_recordings
from bayes_impedance.results.leave_one_out import leave_one_out, refit_without
from bayes_impedance.results.predictive import drawn_covariates, predict
from bayes_impedance.results.result import make_result

GROUPS = "abcab"


def people(n: int = 10) -> Recordings:
    made = simulate_recordings(THREE_ELEMENTS, n, 1, np.geomspace(5, 5000, 12), seed=3).recordings
    subjects = tuple(
        replace(
            s,
            covariates={
                "age_y": 20.0 + 7 * ((3 * i) % n),
                "group=b": float(GROUPS[i % 5] == "b"),
                "group=c": float(GROUPS[i % 5] == "c"),
            },
        )
        for i, s in enumerate(made.subjects)
    )
    return replace(made, subjects=subjects)


def test_a_column_of_text_stands_for_its_categories() -> None:
    recordings = people()
    same, names = with_terms(recordings, ("group", "age_y"))
    assert names == ("group=b", "group=c", "age_y")
    assert same is recordings
    assert with_terms(recordings, ("nothing",))[1] == ("nothing",)
    assert with_terms(recordings, ("group=b",))[1] == ("group=b",)


def test_an_interaction_is_the_product_of_standardised_covariates() -> None:
    recordings = people()
    with_products, names = with_terms(recordings, ("age_y:group",))
    assert names == ("age_y", "group=b", "group=c", "age_y:group=b", "age_y:group=c")
    x = standardised_covariates(recordings, ("age_y", "group=c"))
    found = [s.covariates["age_y:group=c"] for s in with_products.subjects]
    np.testing.assert_allclose(found, x[:, 0] * x[:, 1])
    assert "age_y:group=c" not in recordings.subjects[0].covariates
    design = standardised_covariates(with_products, names)
    assert np.linalg.cond(design) < 10
    again, same = with_terms(with_products, names)
    assert again is with_products
    assert same == names
    assert with_terms(recordings, ("age_y", "age_y:group=b"))[1] == ("age_y", "group=b", "age_y:group=b")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("age:group", r'"age" is not in the dataset \(did you mean "age_y"'),
        ("age_y:age_y", "two different covariates"),
        ("group:group=b", "two different covariates"),
        ("age_y:group:age_y", "of two covariates"),
    ],
)
def test_an_interaction_that_is_none_is_refused(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_population(people(), settings=replace(SHORT, covariates=(name,)))


def test_a_missing_value_names_the_person() -> None:
    recordings = people()
    first = replace(recordings.subjects[0], covariates={"group=b": 1.0, "group=c": 0.0})
    some = replace(recordings, subjects=(first, *recordings.subjects[1:]))
    with pytest.raises(InputError, match=f"missing for subject {first.name}"):
        with_terms(some, ("age_y:group=b",))


def with_an_interaction() -> tuple[Recordings, float]:
    """24 people whose damper rises with age in one group and falls in the other; and the slope of the interaction."""
    kernel, frequency, rng = Kernel(parse("m1|r1|n1")), np.geomspace(5, 5000, 12), np.random.default_rng(1)
    x, group = np.linspace(-1.5, 1.5, 12).repeat(2), np.tile([0.0, 1.0], 12)
    centre = np.array([np.log(THREE_ELEMENTS.central[e]) for e in kernel.elements])
    subjects = []
    for i in range(24):
        u = centre + 0.1 * rng.normal(size=3)
        u[kernel.elements.index("r1")] += 0.4 * x[i] * (2 * group[i] - 1)
        z = kernel.impedance(u, frequency)
        z = (z * (1 + 0.01 * (rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape))))[None]
        covariates = {"age_y": 45 + 15 * x[i], "sex=m": group[i]}
        one = Subject(name=f"s{i:02d}", repetitions=("1",), frequency_hz=frequency, z=z, covariates=covariates)
        subjects.append(replace(one, noise_sd=0.014 * np.abs(z)))
    made = Recordings(title="t", unit="N s/m", network="m1|r1|n1", source="", licence="", subjects=tuple(subjects))
    return made, 0.4 * float(x.std())


def test_an_effect_that_differs_between_groups_is_found() -> None:
    """Its own slope of age is about zero."""
    recordings, slope = with_an_interaction()
    settings = replace(SHORT, covariates=("age_y:sex",))
    fit = fit_population(recordings, settings=settings, seed=1)
    assert fit.settings.covariates == ("age_y", "sex=m", "age_y:sex=m")
    slopes = fit.parameters.slopes[:, fit.kernel.elements.index("r1")]
    assert np.quantile(slopes[:, 2], 0.05) > 0.25
    assert slopes[:, 2].mean() == pytest.approx(slope, abs=0.1)
    for q in (0, 1):
        assert np.quantile(slopes[:, q], 0.02) < 0 < np.quantile(slopes[:, q], 0.98)
    assert sample_prior(recordings, settings=settings, n=5).parameters.slopes.shape == (5, 3, 3)


@pytest.mark.long
def test_a_diagnosis_finds_an_interaction_among_the_covariates_that_are_named(tmp_path: Path) -> None:
    recordings, slope = with_an_interaction()
    write_recordings(recordings, tmp_path / "data")
    out = tmp_path / "out"
    assert main(["diagnose", str(tmp_path / "data"), "-o", str(out), "--quick", "--covariate", "age_y:sex"]) == 0
    (found,) = json.loads((out / "verdict.json").read_text(encoding="utf-8"))["physics"]
    assert (found["id"], found["place"]) == ("body.covariate", "r1")
    (own,) = found["parameters"].values()
    assert own["q05"] - 0.05 < slope < own["q95"] + 0.05
    assert "age_y:sex=m" in (out / "verdict.json").read_text(encoding="utf-8")


@pytest.mark.long
def test_whoever_is_left_out_has_the_interaction_of_everybody() -> None:
    recordings = people()
    fit = fit_population(recordings, settings=replace(SHORT, covariates=("age_y:group=b",)), seed=1)
    result = make_result(fit, predict(fit, n_draws=20, n_replicates=4), {})
    together = result.groups["constant_data"]["covariate_correlation"]
    assert together.shape == (3, 3)
    np.testing.assert_allclose(np.diag(together), 1)
    left_out = leave_one_out(result)
    refitted = refit_without(recordings, [0], left_out, result, fit.settings, 1, lambda *_: None)
    assert np.all(np.isfinite(refitted.elpd))


@pytest.mark.long
def test_the_command_line_takes_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recordings = people()
    write_recordings(recordings, tmp_path / "data")
    rows = [f"{s.name},{s.covariates['age_y']},{GROUPS[i % 5]}" for i, s in enumerate(recordings.subjects)]
    (tmp_path / "data" / "subjects.csv").write_text("\n".join(["subject,age_y,group", *rows]) + "\n", encoding="utf-8")
    out = tmp_path / "out"
    assert main(fit_arguments(tmp_path / "data", out, "--covariate", "age_y:group=b")) == 0
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert list(summary["elements"]["r1"]["slopes"]) == ["age_y", "group=b", "age_y:group=b"]
    assert "age_y:group=b" in capsys.readouterr().out
    assert main(fit_arguments(tmp_path / "data", tmp_path / "none", "--covariate", "age_y:grou")) == 2
    assert '"grou" is not in the dataset' in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
    assert with_terms(read_recordings(tmp_path / "data"), ("group",))[1] == ("group=b", "group=c")


def test_people_in_predictions_have_covariates_that_exist() -> None:
    """An interaction is the product of the two others, and a category has two values; alone, covariates are normal."""
    recordings, names = with_terms(with_an_interaction()[0], ("age_y:sex",))
    fit: Any = SimpleNamespace(recordings=recordings, settings=SimpleNamespace(covariates=names))
    drawn = drawn_covariates(fit, 2000, np.random.default_rng(1))
    measured = standardised_covariates(recordings, names)
    assert {tuple(row) for row in drawn} <= {tuple(row) for row in measured}
    assert np.abs(drawn.mean(axis=0)).max() < 0.1
    assert len({*drawn[:, 1]}) == 2
    fit.settings.covariates = ("age_y",)
    alone = drawn_covariates(fit, 2000, np.random.default_rng(1))
    np.testing.assert_array_equal(alone, np.random.default_rng(1).normal(size=(2000, 1)))


def test_correlations_of_covariates_are_kept_only_where_they_matter() -> None:
    recordings, names = with_terms(with_an_interaction()[0], ("age_y:sex",))
    together = correlations_of(recordings, names)
    assert together is not None
    np.testing.assert_allclose(np.diag(together), 1)
    assert abs(together[0, 1]) < 0.1  # groups are of equal age
    assert correlations_of(recordings, ("age_y",)) is None


def test_users_have_covariates_that_go_together() -> None:
    """Two covariates that are one: their effects cancel, and independent ones would add."""
    result = make_by_hand(covariates=("a", "b=x"))
    slope = result.groups["posterior"]["slope"]
    slope[..., 0], slope[..., 1] = 0.5, -0.5
    result.groups["posterior"]["correlation"][:] = np.eye(len(result.elements))
    added = population_of(result).factor
    known = result.groups["constant_data"] | {"covariate_correlation": np.ones((2, 2))}
    cancelled = population_of(replace(result, groups=result.groups | {"constant_data": known})).factor
    difference = added @ np.swapaxes(added, 1, 2) - cancelled @ np.swapaxes(cancelled, 1, 2)
    np.testing.assert_allclose(difference, 0.5, rtol=1e-6)
