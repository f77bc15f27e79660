"""Damaged results and checkpoints: one sentence, status 2, nothing touched; or the same numbers again."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from corpus_results import POPULATIONS, RESULTS, Damage, cut, flipped
from tiny_fits import fit_arguments, tiny_dataset

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.runtime.checkpoint import claim, load_arrays, save_arrays


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    capsys.readouterr()
    status = main(arguments)
    said = capsys.readouterr().err
    assert status == 2, said
    assert said.startswith("error: ")
    assert said.count("\n") == 1
    assert not said.startswith("error: :")
    return said


def test_the_corpus_is_large() -> None:
    assert len(RESULTS) + len(POPULATIONS) >= 60


@pytest.mark.parametrize("name", RESULTS)
def test_a_damaged_result_is_refused(name: str, tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    shutil.copytree(tiny / "out", out)
    RESULTS[name](out)
    before = sorted(p.name for p in out.iterdir())
    for arguments in (["report", str(out)], ["export", str(out), "-o", str(tmp_path / "design")]):
        assert str(out) in refused(arguments, capsys)
    assert sorted(p.name for p in out.iterdir()) == before
    assert not (tmp_path / "design").exists()


@pytest.mark.parametrize("name", POPULATIONS)
def test_a_population_that_is_none_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "population.json"
    file.write_text(json.dumps(POPULATIONS[name]), encoding="utf-8")
    refused(["simulate", "-o", str(tmp_path / "new"), "--population", str(file)], capsys)
    assert not (tmp_path / "new").exists()


def test_results_of_two_fits_are_not_mixed(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = tmp_path / "other"
    data = tiny_dataset(tmp_path / "data", seed=2)
    assert main(fit_arguments(data, other)) == 0
    for mixed, name in ((tmp_path / "one", "summary.json"), (tmp_path / "two", "result.nc")):
        shutil.copytree(tiny / "out", mixed)
        shutil.copy(other / name, mixed / name)
        assert "are of different fits" in refused(["report", str(mixed)], capsys)
    said = refused(["report", str(other), "--dataset", str(tiny / "data")], capsys)
    assert "is a fit of other recordings" in said


@pytest.mark.parametrize(
    "damage",
    [
        *(cut("a.npz", share) for share in (0.0, 0.01, 0.5, 0.99)),
        *(flipped("a.npz", seed, 1) for seed in range(30)),
    ],
)
def test_a_damaged_piece_of_a_checkpoint_is_as_good_as_none(damage: Damage, tmp_path: Path) -> None:
    claim(tmp_path, ["digest"], 1)
    arrays = {"a": np.arange(12.0).reshape(3, 4), "b": np.array([True])}
    save_arrays(tmp_path / "a.npz", arrays)
    damage(tmp_path)
    found = load_arrays(tmp_path / "a.npz")
    # A wrong bit may be one that says nothing, such as the time of a member of the archive.
    assert found is None or all(np.array_equal(found[name], arrays[name]) for name in arrays)


def test_a_piece_of_another_fit_is_as_good_as_none(tmp_path: Path) -> None:
    for seed in (1, 2):
        claim(tmp_path / str(seed), ["digest"], seed)
        save_arrays(tmp_path / str(seed) / "a.npz", {"a": np.arange(3.0)})
    shutil.copy(tmp_path / "1" / "a.npz", tmp_path / "2" / "a.npz")
    assert load_arrays(tmp_path / "1" / "a.npz") is not None
    assert load_arrays(tmp_path / "2" / "a.npz") is None
    (tmp_path / "1" / "belongs_to.txt").unlink()
    assert load_arrays(tmp_path / "1" / "a.npz") is None
    with pytest.raises(InputError, match="is not a checkpoint"):
        claim(tmp_path / "1", ["digest"], 3)
