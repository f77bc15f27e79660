"""The job behind ``compare``: which finished fit is taken, what is refused, and the files with their identity."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results_by_hand
from conftest import THREE_ELEMENTS

from bayes_impedance import classical, plots
from bayes_impedance.commands import comparison
from bayes_impedance.commands.comparison import compare_dataset
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.errors import InputError
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings, read_recordings, write_recordings
from bayes_impedance.results import result as results
from bayes_impedance.results.result import Result

NETWORK = "m1|r1|n1"


class Compared:
    """Stands for the comparison of methods."""

    def __init__(self, recordings: Recordings, fit: Result, seed: int) -> None:
        self.recordings, self.fit, self.seed = recordings, fit, seed

    def summary(self) -> dict[str, Any]:
        return {"methods": [], "seed": "to be replaced"}

    def csv(self) -> str:
        return "id\nown\n"


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("compared")
    recordings = simulate_recordings(THREE_ELEMENTS, 3, 1, np.geomspace(5, 5000, 12), 1).recordings
    write_recordings(recordings, folder, significant_digits=6)
    return folder


@pytest.fixture
def finished(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> Result:
    """A finished fit of the dataset, which is read from any folder; the comparison itself is not computed."""
    fit = results_by_hand.make_result()
    fit.attributes.update(data_sha256=read_recordings(dataset).sha256, network=NETWORK)
    monkeypatch.setattr(results, "load_result", lambda _: fit)
    monkeypatch.setattr(
        classical, "compare_methods", lambda recordings, fit, *, seed, progress: Compared(recordings, fit, seed)
    )
    monkeypatch.setattr(plots, "write_comparison", lambda _, folder: (folder / "errors.png").write_bytes(b"picture"))
    return fit


def compared(dataset: Path, out: Path, result: Path | None, **options: Any) -> Any:
    return compare_dataset(dataset, out, FitOptions(**options), result, False, lambda *_: None)


def test_a_finished_fit_is_compared_on_its_recordings(dataset: Path, tmp_path: Path, finished: Result) -> None:
    found = compared(dataset, tmp_path / "out", Path("fit"), seed=9)
    assert (found.fit, found.seed) == (finished, 9)
    assert found.recordings.names == read_recordings(dataset).names
    written = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert (written["seed"], written["data_sha256"]) == (9, finished.attributes["data_sha256"])
    assert written["methods"] == []
    assert written["version"]
    assert (tmp_path / "out" / "comparison.csv").read_text(encoding="utf-8") == "id\nown\n"


def test_a_network_that_is_the_fit_s_in_other_words_is_accepted(
    dataset: Path, tmp_path: Path, finished: Result
) -> None:
    assert compared(dataset, tmp_path, Path("fit"), network=" m1 | r1|n1 ").fit is finished
    with pytest.raises(InputError, match=r"fit: is a fit of the network m1\|r1\|n1; leave out --network"):
        compared(dataset, tmp_path, Path("fit"), network="m1|r1")


def test_a_fit_of_other_recordings_is_refused_before_anything_is_written(
    dataset: Path, tmp_path: Path, finished: Result
) -> None:
    finished.attributes["data_sha256"] = "0" * 64
    with pytest.raises(InputError, match="is a fit of other recordings than"):
        compared(dataset, tmp_path / "out", Path("fit"))
    assert not (tmp_path / "out").exists()


def test_without_a_fit_one_is_made_in_a_folder_of_its_own(
    dataset: Path, tmp_path: Path, finished: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def fit_dataset(*arguments: Any) -> Result:
        asked.append(arguments[:2])
        return finished

    monkeypatch.setattr(comparison, "fit_dataset", fit_dataset)
    assert compared(dataset, tmp_path / "out", None).fit is finished
    assert asked == [(dataset, tmp_path / "out" / "fit")]


def test_a_user_s_file_is_seen_before_the_fit(
    dataset: Path, tmp_path: Path, finished: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit takes long: what would be refused after it is refused before."""

    def never(*_: Any) -> Result:
        raise AssertionError("fitted")

    monkeypatch.setattr(comparison, "fit_dataset", never)
    (tmp_path / "comparison.csv").write_text("mine")
    with pytest.raises(InputError, match="was not written by this package"):
        compared(dataset, tmp_path, None)
    assert (tmp_path / "comparison.csv").read_text() == "mine"
