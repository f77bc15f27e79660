"""Folders of results while a command runs: what is locked and kept, what an error discards, what is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.result_folders import (
    CHECKPOINT_FOLDER,
    EXTENDED_FOLDER,
    FIT_FILES,
    PICTURE_FOLDER,
    REPORT_FILE,
    discarded_if_useless,
    extended_files,
    fit_folder,
    interrupted,
    page_files,
    pictures,
    remove,
    remove_extended,
    require_extended,
)
from bayes_impedance.errors import BusyError, InputError
from bayes_impedance.plots import PICTURES
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.persons_file import PERSONS_FILE
from bayes_impedance.results.result import RESULT_FILE, SECONDS_FILE, SUMMARY_FILE
from bayes_impedance.runtime.checkpoint import claim, save_arrays
from bayes_impedance.runtime.output_folder import output_folder


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return simulate_recordings(THREE_ELEMENTS, 3, 1, np.geomspace(5, 5000, 12), 1).recordings


def checkpoint_in(folder: Path) -> Path:
    """Of some fit, with one file."""
    checkpoint = folder / CHECKPOINT_FOLDER
    claim(checkpoint, ["digest"], 1)
    save_arrays(checkpoint / "first_fits.npz", {"theta": np.ones(2)})
    return checkpoint


def test_the_names_are_those_of_the_files_that_a_result_has() -> None:
    """They are written again in the module, so that the command line starts without the result's own module."""
    assert FIT_FILES == (RESULT_FILE, SUMMARY_FILE, SECONDS_FILE, PERSONS_FILE)
    names = page_files()
    assert names[0] == REPORT_FILE
    assert len(names) == len(set(names)) == 1 + 2 * len(PICTURES)
    assert pictures(["a", "b"]) == [f"{PICTURE_FOLDER}/{name}" for name in ("a.svg", "a.png", "b.svg", "b.png")]


def test_an_earlier_result_of_an_extended_network_goes_and_what_is_the_users_stays(tmp_path: Path) -> None:
    folder = tmp_path / EXTENDED_FOLDER
    remove_extended(tmp_path, False)  # there is none
    for users in ("notes.txt", None):
        with output_folder(folder, extended_files()):
            for name in ("summary.json", f"{PICTURE_FOLDER}/bands.png"):
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_text("{}")
        if users:
            (folder / users).write_text("mine")
        require_extended(tmp_path, False)
        remove_extended(tmp_path, False)
        assert folder.exists() == bool(users)
        if users:
            assert [file.name for file in folder.iterdir()] == [users]
            (folder / users).unlink()


def test_a_file_of_the_users_in_the_place_of_an_extended_result_refuses_the_folder(tmp_path: Path) -> None:
    (tmp_path / EXTENDED_FOLDER).mkdir()
    file = tmp_path / EXTENDED_FOLDER / "summary.json"
    file.write_text("a year of work")
    for refuse in (require_extended, remove_extended):
        with pytest.raises(InputError, match="not written by this package"):
            refuse(tmp_path, False)
    require_extended(tmp_path, True)
    assert file.read_text() == "a year of work"


def test_only_the_named_files_are_removed(tmp_path: Path) -> None:
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text("x")
    remove(tmp_path, ["a.txt", "c.txt"])
    assert [file.name for file in tmp_path.iterdir()] == ["b.txt"]


@pytest.mark.parametrize(
    ("error", "resume", "kept"),
    [(None, False, True), (KeyboardInterrupt, False, True), (InputError, False, False), (InputError, True, True)],
)
def test_a_checkpoint_goes_only_with_input_that_is_of_no_use(
    tmp_path: Path, error: type[BaseException] | None, resume: bool, kept: bool
) -> None:
    """An interruption leaves it; a fit that is resumed had passed the checks when it was begun."""
    checkpoint = checkpoint_in(tmp_path)

    def work() -> None:
        with discarded_if_useless(checkpoint, resume):
            if error is not None:
                raise error("stop")

    if error is None:
        work()
    else:
        with pytest.raises(error, match="stop"):
            work()
    assert checkpoint.exists() == kept


def test_the_innermost_interruption_says_what_remains() -> None:
    with pytest.raises(KeyboardInterrupt, match="inner"), interrupted("outer"), interrupted("inner"):
        raise KeyboardInterrupt
    with pytest.raises(ValueError, match="own"), interrupted("outer"):
        raise ValueError("own")


@pytest.mark.parametrize(("resume", "kept"), [(False, False), (True, True)])
def test_a_new_fit_begins_without_the_checkpoint_of_the_last(
    recordings: Recordings, tmp_path: Path, resume: bool, kept: bool
) -> None:
    checkpoint = checkpoint_in(tmp_path)
    with fit_folder(tmp_path, FIT_FILES, recordings, FitOptions(), resume):
        assert checkpoint.exists() == kept
        with (
            pytest.raises(BusyError, match="is writing there"),
            fit_folder(tmp_path, FIT_FILES, recordings, FitOptions(), resume),
        ):
            pass


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (FitOptions(network="m1|"), "network"),
        (FitOptions(covariates=("age_y",)), "age_y"),
    ],
)
def test_wrong_options_are_refused_before_the_folder_is_changed(
    recordings: Recordings, tmp_path: Path, options: FitOptions, said: str
) -> None:
    checkpoint = checkpoint_in(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=said), fit_folder(tmp_path, FIT_FILES, recordings, options, False):
        pass
    assert sorted(tmp_path.rglob("*")) == before
    assert checkpoint.exists()


def test_a_folder_of_the_user_is_no_checkpoint(recordings: Recordings, tmp_path: Path) -> None:
    mine = tmp_path / CHECKPOINT_FOLDER / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("precious")
    with (
        pytest.raises(InputError, match="is not a checkpoint"),
        fit_folder(tmp_path, FIT_FILES, recordings, FitOptions(), False),
    ):
        pass
    assert mine.read_text() == "precious"
