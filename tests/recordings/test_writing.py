"""Writing datasets: what is read again is what was written; an interrupted write leaves the old files."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from datasets import assert_same, recordings, subject
from hypothesis import given, settings
from hypothesis import strategies as st

from bayes_impedance.recordings.files import Recordings, Subject, read_recordings, write_recordings


@pytest.mark.parametrize("compress", [False, True])
def test_round_trip(tmp_path: Path, compress: bool) -> None:
    data = recordings(
        subject("A", noise=True, age_y=31.0, Force=0.1), subject("B, jr", 1, 7, age_y=np.nan), subject('"C"', 3, 3)
    )
    assert write_recordings(data, tmp_path / "a" / "b", compress=compress) == tmp_path / "a" / "b"
    files = {path.name for path in (tmp_path / "a" / "b").iterdir()}
    assert files == {"recordings.csv.gz" if compress else "recordings.csv", "subjects.csv", "dataset.toml"}
    again = read_recordings(tmp_path / "a" / "b")
    assert_same(data, again)
    assert len(again.sha256) == 64


def test_digest_does_not_depend_on_compression(tmp_path: Path) -> None:
    data = recordings(subject(age=1.0))
    folders = [write_recordings(data, tmp_path / str(compress), compress=compress) for compress in (False, True)]
    assert len({read_recordings(folder).sha256 for folder in folders}) == 1


def test_same_data_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = write_recordings(recordings(subject()), tmp_path / "1", compress=True) / "recordings.csv.gz"
    now = time.time()
    monkeypatch.setattr(time, "time", lambda: now + 86400)
    second = write_recordings(recordings(subject()), tmp_path / "2", compress=True) / "recordings.csv.gz"
    assert first.read_bytes() == second.read_bytes()


def test_significant_digits(tmp_path: Path) -> None:
    data = recordings(subject(noise=True))
    again = read_recordings(write_recordings(data, tmp_path, significant_digits=4))
    assert_same(data, again, rtol=6e-4)
    assert not np.array_equal(data.subjects[0].z, again.subjects[0].z)


def test_writing_replaces_a_dataset(tmp_path: Path) -> None:
    write_recordings(recordings(subject("A", age=1.0)), tmp_path, compress=True)
    (tmp_path / "report.html").write_text("kept")
    write_recordings(recordings(subject("B")), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"recordings.csv", "dataset.toml", "report.html"}
    assert read_recordings(tmp_path).names == ("B",)


def test_no_half_written_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_recordings(recordings(subject("A")), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write = Path.write_bytes

    def full_disk(path: Path, content: bytes) -> int:
        if "dataset" in path.name:
            raise OSError(28, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match="No space left"):
        write_recordings(recordings(subject("B")), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


_texts = st.text(st.characters(codec="utf-8"), max_size=20)
_names = st.text(st.characters(codec="utf-8", exclude_categories=["C", "Z"]), min_size=1, max_size=8)
_positive = st.floats(1e-12, 1e12)
_reals = st.floats(-1e12, 1e12).map(lambda value: value + 0.0)


@st.composite
def _subjects(draw: st.DrawFn) -> tuple[Subject, ...]:
    subjects = []
    for name in draw(st.lists(_names, min_size=1, max_size=3, unique=True)):
        f = np.array(sorted(draw(st.sets(_positive, min_size=3, max_size=6))))
        repetitions = draw(st.lists(st.sampled_from(["1", "02", "x"]), min_size=1, max_size=3, unique=True).map(sorted))
        shape = len(repetitions), f.size
        values = st.lists(_positive, min_size=f.size * shape[0], max_size=f.size * shape[0])
        real, noise = (np.reshape(draw(values), shape) for _ in range(2))
        imaginary = np.reshape(draw(st.lists(_reals, min_size=real.size, max_size=real.size)), shape)
        z = real + 1j * imaginary
        covariates = draw(st.dictionaries(st.sampled_from(["age_y", "Force N"]), _reals))
        subjects.append(
            Subject(
                name=name,
                frequency_hz=f,
                z=z,
                repetitions=tuple(repetitions),
                noise_sd=noise if draw(st.booleans()) else None,
                covariates=covariates,
            )
        )
    return tuple(subjects)


@settings(max_examples=60, deadline=None)
@given(subjects=_subjects(), title=_texts, source=_texts, compress=st.booleans())
def test_round_trip_of_anything(
    tmp_path_factory: pytest.TempPathFactory, subjects: tuple[Subject, ...], title: str, source: str, compress: bool
) -> None:
    data = Recordings(
        title=title.strip() or "T", unit="ohm", network=None, source=source, licence="", subjects=subjects
    )
    folder = write_recordings(data, tmp_path_factory.mktemp("round"), compress=compress)
    again = read_recordings(folder)
    # Repetitions come back in the order in which their names first appear in the file.
    order = [name for one in subjects for name in one.repetitions]
    for one in again.subjects:
        assert list(one.repetitions) == sorted(one.repetitions, key=order.index)
    by_name = {one.name: dict(zip(one.repetitions, one.z, strict=True)) for one in again.subjects}
    for one in subjects:
        for repetition, z in zip(one.repetitions, one.z, strict=True):
            np.testing.assert_array_equal(by_name[one.name][repetition], z)
    if all(list(s.repetitions) == sorted(s.repetitions, key=order.index) for s in subjects):
        assert_same(data, again)


@pytest.mark.skipif(not os.environ.get("BAYES_IMPEDANCE_REAL_DATA"), reason="BAYES_IMPEDANCE_REAL_DATA is not set")
@pytest.mark.parametrize(("name", "subjects", "points"), [("battery_130", 130, 57), ("fuel_cell_1", 1, 66)])
def test_real_data(tmp_path: Path, name: str, subjects: int, points: int) -> None:
    data = read_recordings(Path(os.environ["BAYES_IMPEDANCE_REAL_DATA"]) / name)
    assert len(data) == subjects
    assert {subject.z.shape for subject in data.subjects} == {(1, points)}
    assert (data.unit, data.network, data.warnings) == ("ohm", "r0|(r1-n1)|(r2-n2)", ())
    assert_same(data, read_recordings(write_recordings(data, tmp_path)))
