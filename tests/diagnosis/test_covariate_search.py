"""The search for covariates: finds what is there, nothing where nothing is, and says what was tried."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from small_diagnoses import FREQUENCY

from bayes_impedance.commands.cli import main
from bayes_impedance.diagnosis.covariate_search import LEVEL, search_covariates
from bayes_impedance.errors import InputError
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings, write_recordings

EXPONENT = 1.2


def recordings_with_ages(exponent: float, people: int = 20, seed: int = 5) -> Recordings:
    """The damper grows with a power of the age; height goes with nothing."""
    rng = np.random.default_rng(seed)
    age, subjects = rng.uniform(20, 80, people), []
    for i in range(people):
        r1 = THREE_ELEMENTS.central["r1"] * (age[i] / 45) ** exponent
        own = replace(THREE_ELEMENTS, central={**THREE_ELEMENTS.central, "r1": r1})
        person = simulate_recordings(own, 1, 2, FREQUENCY[::2], 100 * seed + i).recordings.subjects[0]
        known = {"age_y": float(age[i]), "height_m": float(rng.normal(1.7, 0.1))}
        subjects.append(replace(person, name=f"s{i:02d}", covariates=known))
    made = simulate_recordings(THREE_ELEMENTS, 1, 2, FREQUENCY[::2], seed).recordings
    return replace(made, subjects=tuple(subjects))


def test_the_slope_that_is_there_is_found_and_no_other() -> None:
    found = search_covariates(recordings_with_ages(EXPONENT), "m1|r1|n1", workers=1)
    assert [(t.element, t.covariate) for t in found.found] == [("r1", "age_y")]
    slope = found.found[0]
    assert slope.transform == "log"
    assert slope.q05 < EXPONENT < slope.q95
    assert found.tried == len(found.trends) == 6  # three elements times two covariates
    assert set(found.gains) == {"age_y"}
    assert found.gains["age_y"][0] > 0
    table = found.to_dataframe()
    assert table["significant"].sum() == 1
    assert table["p_corrected"].is_monotonic_increasing
    assert np.all(table["p_corrected"] >= table["p_value"])
    assert "1 of 6" in repr(found)
    assert "age_y" in found._repr_html_()


def test_named_covariates_only() -> None:
    recordings = recordings_with_ages(EXPONENT)
    found = search_covariates(recordings, "m1|r1|n1", covariates=["height_m"], workers=1)
    assert {t.covariate for t in found.trends} == {"height_m"}
    assert not found.found
    with pytest.raises(InputError, match="weight"):
        search_covariates(recordings, "m1|r1|n1", covariates=["weight_kg"], workers=1)


def test_without_covariates_there_is_nothing_to_search() -> None:
    recordings = recordings_with_ages(0.0, people=6)
    bare = replace(recordings, subjects=tuple(replace(s, covariates={}) for s in recordings.subjects))
    with pytest.raises(InputError, match=r"subjects\.csv"):
        search_covariates(bare, "m1|r1|n1", workers=1)


def test_few_false_alarms_where_nothing_follows() -> None:
    """Twelve searches of six slopes each: at a level of 5 %, four or more would happen once in 450."""
    alarms = 0
    for seed in range(12):
        found = search_covariates(recordings_with_ages(0.0, people=12, seed=20 + seed), "m1|r1|n1", workers=1)
        alarms += bool(found.found)
        assert all(t.p_corrected >= min(1.0, t.p_value) for t in found.trends)
    assert alarms < 4
    assert LEVEL == 0.05


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recordings(recordings_with_ages(EXPONENT), tmp_path / "data")
    out = tmp_path / "out"
    assert main(["covariates", str(tmp_path / "data"), "-o", str(out), "--network", "m1|r1|n1"]) == 0
    told = capsys.readouterr().out
    assert "r1 follows age_y" in told
    assert "6 slopes tested" in told
    content = json.loads((out / "covariates.json").read_text(encoding="utf-8"))
    assert content["tried"] == 6
    assert content["gains"]["age_y"]["elpd_gain"] > 0
    with (out / "covariates.csv").open(encoding="utf-8", newline="") as opened:
        rows = list(csv.DictReader(opened))
    assert [row["significant"] for row in rows] == ["True"] + ["False"] * 5
    assert main(["covariates", str(tmp_path / "data"), "-o", str(tmp_path / "no"), "--covariate", "weight"]) == 2
    assert not (tmp_path / "no").exists()
