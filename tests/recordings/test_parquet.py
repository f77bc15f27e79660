"""Recordings as Parquet are the recordings of the CSV file; parted by subject, their numbers stay in the files."""

import pickle
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from conftest import THREE_ELEMENTS

from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.quality.checks import check_recordings
from bayes_impedance.recordings import out_of_core
from bayes_impedance.recordings.files import Recordings, read_recordings, write_recordings
from bayes_impedance.recordings.out_of_core import StoredSubject
from bayes_impedance.recordings.parquet import _cells, parquet_table
from bayes_impedance.results.predictive import predict
from bayes_impedance.runtime.executors import Cluster

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra: parquet)")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    people = simulate_recordings(FINGERTIP, 3, 2, np.geomspace(5, 5000, 21), 1).recordings
    write_recordings(people, tmp_path / "csv")
    return tmp_path / "csv"


def _moved(dataset: Path, partitioned: bool, name: str = "parquet", as_text: tuple[str, ...] = ()) -> Path:
    """The same dataset with its table as Parquet."""
    table = pd.read_csv(dataset / "recordings.csv", dtype=str, keep_default_na=False)
    for column in set(table.columns) - {"subject", "repetition", "comment", *as_text}:
        # To the last digit, which not every version of pandas reads.
        table[column] = np.array([float(cell or "nan") for cell in table[column]])
    target = dataset.parent / name
    target.mkdir()
    for file in dataset.iterdir():
        if file.name != "recordings.csv":
            (target / file.name).write_bytes(file.read_bytes())
    table.to_parquet(target / "recordings.parquet", index=False, partition_cols=["subject"] if partitioned else None)
    return target


@pytest.mark.parametrize("partitioned", [False, True])
@pytest.mark.parametrize("named", ["folder", "table"])
def test_parquet_gives_the_same_recordings(dataset: Path, partitioned: bool, named: str) -> None:
    folder = _moved(dataset, partitioned)
    expected = read_recordings(dataset)
    found = read_recordings(folder if named == "folder" else folder / "recordings.parquet")
    assert (found.unit, found.network, found.names) == (expected.unit, expected.network, expected.names)
    _require_same(found, expected)
    assert all(isinstance(s, StoredSubject) == partitioned for s in found.subjects)


def _require_same(found: Recordings, expected: Recordings) -> None:
    assert found.names == expected.names
    assert found.polar == expected.polar
    for one, other in zip(found.subjects, expected.subjects, strict=True):
        np.testing.assert_array_equal(one.z, other.z)
        np.testing.assert_array_equal(one.mean, other.mean)
        np.testing.assert_array_equal(one.frequency_hz, other.frequency_hz)
        assert one.repetitions == other.repetitions
        assert dict(one.covariates) == dict(other.covariates)
        assert (one.noise_sd is None) == (other.noise_sd is None)
        if one.noise_sd is not None and other.noise_sd is not None:
            np.testing.assert_array_equal(one.noise_sd, other.noise_sd)


def _polar(table: pd.DataFrame) -> pd.DataFrame:
    z = table.z_re + 1j * table.z_im
    return table.drop(columns=["z_re", "z_im"]).assign(magnitude=np.abs(z), phase_deg=np.angle(z, deg=True))


def _noisy(table: pd.DataFrame) -> pd.DataFrame:
    sd = 0.01 * np.abs(table.z_re) + 1e-6
    return table.assign(noise_sd=sd.where(table.subject != table.subject.iloc[0]))


def _with_gaps(table: pd.DataFrame) -> pd.DataFrame:
    table = table.assign(z_re=table.z_re.where(np.arange(len(table)) % 17 != 3))
    return table[np.arange(len(table)) % 23 != 5].reset_index(drop=True)


def _ending_early(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(z_im=table.z_im.where(table.repetition != table.repetition.iloc[-1]))


def _interleaved(table: pd.DataFrame) -> pd.DataFrame:
    return table.sort_values(
        ["subject", "frequency_hz", "repetition"], ascending=[True, True, False], ignore_index=True
    )


TABLES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "polar": _polar,
    "noise of some": _noisy,
    "gaps": _with_gaps,
    "last repetition without values": _ending_early,
    "gaps and noise, interleaved": lambda table: _interleaved(_with_gaps(_noisy(table))),
    "numbers of repetitions": lambda table: table.assign(repetition=table.repetition.astype(int)),
    "as text": lambda table: table.assign(z_re=table.z_re.map(repr)),
    "another column": lambda table: table.assign(comment="x"),
}


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("partitioned", [False, True])
def test_every_kind_of_table_gives_the_numbers_of_the_csv_file(dataset: Path, name: str, partitioned: bool) -> None:
    table = pd.read_csv(dataset / "recordings.csv", dtype={"subject": str, "repetition": str})
    TABLES[name](table).to_csv(dataset / "recordings.csv", index=False)
    toml = (dataset / "dataset.toml").read_text(encoding="utf-8")
    if name == "polar":
        toml = toml.replace('"N s/m"', '"mN s/mm"')
    (dataset / "dataset.toml").write_text(toml, encoding="utf-8")
    folder = _moved(dataset, partitioned, as_text=("z_re",) if name == "as text" else ())
    expected, found = read_recordings(dataset), read_recordings(folder)
    _require_same(found, expected)
    _require_same(found.in_memory(), expected)
    assert bool(found.warnings) == bool(expected.warnings)
    if name == "another column":
        assert sum("is not used" in w for w in found.warnings) == 1


def test_numbers_stay_in_the_files(dataset: Path) -> None:
    """A subject travels as a place; whoever wants numbers of it that are not in the file has an ordinary subject."""
    subject = read_recordings(_moved(dataset, partitioned=True)).subjects[1]
    assert not {"z", "noise_sd"} & vars(subject).keys()
    assert len(pickle.dumps(subject)) < 1500
    assert type(replace(subject, z=2 * subject.z)).__name__ == type(subject.at(np.arange(3))).__name__ == "Subject"
    there = pickle.loads(pickle.dumps(subject))
    np.testing.assert_array_equal(there.z, subject.z)
    assert there.noise_sd is None


def test_files_that_change_after_the_check_are_refused(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=True)
    recordings = read_recordings(folder)
    file = next((folder / "recordings.parquet" / f"subject={recordings.names[0]}").glob("*"))
    table = pd.read_parquet(file, partitioning=None)
    table.assign(z_re=2 * table.z_re).to_parquet(file, index=False)
    out_of_core._read.cache_clear()
    with pytest.raises(InputError, match="has changed since it was checked"):
        _ = recordings.subjects[0].z
    assert read_recordings(folder).sha256 != recordings.sha256


def test_a_worker_without_the_dataset_says_so(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=True)
    recordings = read_recordings(folder)
    folder.rename(folder.with_name("elsewhere"))
    out_of_core._read.cache_clear()
    with pytest.raises(InputError, match="every worker needs the dataset at this path"):
        _ = recordings.subjects[0].z


def test_names_of_folders_are_names_of_subjects(dataset: Path) -> None:
    """Zeros in front stay, signs that a file's name cannot have are coded, and a subject's files are one table."""
    folder = _moved(dataset, partitioned=True)
    table = folder / "recordings.parquet"
    expected = read_recordings(dataset)
    for old, new in zip(expected.names, ("007", "A%2FB", "C"), strict=True):
        (table / f"subject={old}").rename(table / f"subject={new}")
    (table / "_SUCCESS").write_bytes(b"")
    (folder / "subjects.csv").unlink()
    one = next((table / "subject=C").iterdir())
    rows = pd.read_parquet(one, partitioning=None)
    rows[:20].to_parquet(table / "subject=C" / "part-0.parquet", index=False)
    rows[20:].to_parquet(table / "subject=C" / "part-1.parquet", index=False)
    one.unlink()
    found = read_recordings(folder)
    assert found.names == ("007", "A/B", "C")
    for own, other in zip(found.subjects, expected.subjects, strict=True):
        np.testing.assert_array_equal(own.z, other.z)


def test_people_are_in_the_order_of_the_folders_names(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever order a file system lists them in, and without a person whose folder is a note or has no name."""
    table = _moved(dataset, partitioned=True) / "recordings.parquet"
    for old, new in zip(("V1", "V2", "V3"), ("A-1", "A", "12"), strict=True):
        (table / f"subject={old}").rename(table / f"subject={new}")
    (table.parent / "subjects.csv").unlink()
    (table / "_temporary").mkdir()
    (table / "subject=A" / ".notes.parquet").write_bytes(b"no table")
    listed = Path.iterdir
    names = []
    for backwards in (False, True):
        monkeypatch.setattr(Path, "iterdir", lambda p, b=backwards: iter(sorted(listed(p), reverse=b)))
        names.append(read_recordings(table).names)
    assert names == [("12", "A", "A-1")] * 2
    (table / "subject=").mkdir()
    with pytest.raises(InputError, match="the folder contains no files"):
        read_recordings(table)


def test_folders_may_say_more_than_the_subject(dataset: Path) -> None:
    """Keys of folders are columns; numbers in them stay text, and a key without a value is empty."""
    folder = _moved(dataset, partitioned=False)
    whole = folder / "recordings.parquet"
    table = pd.read_parquet(whole)
    whole.unlink()
    table = table.assign(lab=np.where(table.subject == "V1", "01", None))
    table.to_parquet(whole, index=False, partition_cols=["lab", "subject"])
    expected, found = read_recordings(dataset), read_recordings(folder)
    assert sorted(found.names) == sorted(expected.names)
    assert any('"lab" is not used' in w for w in found.warnings)
    cells = dict(parquet_table(whole, ())[0].columns)
    assert set(cells["lab"]) == {"01", ""}


FAULTS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "frequency": (lambda t: t.assign(frequency_hz=t.frequency_hz.where(t.index != 4, -1.0)), r"row 6: frequency_hz is"),
    "column": (lambda t: t.drop(columns="z_im"), r'row 1: column "z_im" is missing'),
    "twice": (lambda t: pd.concat([t, t[3:4]], ignore_index=True), r"row 44: .* was already given in row 5"),
    "unsorted": (lambda t: t[::-1], r"frequency_hz falls"),
    "few": (lambda t: t[:2], r"row 2: .* has 2 usable frequencies"),
    "text": (lambda t: t.assign(z_im=t.z_im.map(repr).where(t.index != 7, "1,5")), r"row 9: z_im .* decimal comma"),
    "no name": (lambda t: t.assign(repetition=""), r"row 2: repetition is empty"),
    "nothing": (lambda t: t[:0], r"no rows of data"),
    "other subject": (lambda t: t.assign(subject="X"), r"the column subject differs from the name of its folder"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_of_a_partition_name_it_and_the_row(dataset: Path, name: str) -> None:
    folder = _moved(dataset, partitioned=True)
    change, message = FAULTS[name]
    file = next((folder / "recordings.parquet" / "subject=V2").glob("*"))
    change(pd.read_parquet(file, partitioning=None)).to_parquet(file, index=False)
    with pytest.raises(InputError, match=r"recordings\.parquet.subject=V2.*" + message):
        read_recordings(folder)


def test_faults_of_the_whole_dataset_are_found_in_partitions(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=True)
    files = sorted((folder / "recordings.parquet").rglob("*.parquet"))
    tables = [pd.read_parquet(file, partitioning=None) for file in files]
    (folder / "subjects.csv").write_text("subject,age\nV1,3\nV9,4\nV3,4\n", encoding="utf-8")
    with pytest.raises(InputError, match=r'subject "V2" \(.*subject=V2, row 2\) is missing here'):
        read_recordings(folder)
    (folder / "subjects.csv").write_text("subject,age\nV1,3\nV9,4\nV3,4\nV2,5\n", encoding="utf-8")
    found = read_recordings(folder)
    assert any("no recordings of V9" in w for w in found.warnings)
    assert found.subjects[1].covariates == {"age": 5.0}
    for file, table in zip(files, tables, strict=True):
        table.assign(z_re=-table.z_re).to_parquet(file, index=False)
    with pytest.raises(InputError, match=r"100% of the rows \(the first is row 2\) have a negative real part"):
        read_recordings(folder)
    for file, table in zip(files, tables, strict=True):
        table.assign(z_re=np.nan).to_parquet(file, index=False)
    with pytest.raises(InputError, match="no partition has a row"):
        read_recordings(folder)
    tables[0].assign(z_re=np.nan).to_parquet(files[0], index=False)
    for file, table in zip(files[1:], tables[1:], strict=True):
        table.to_parquet(file, index=False)
    found = read_recordings(folder)
    assert found.names == ("V2", "V3")
    assert any("has no usable row and was left out" in w for w in found.warnings)


def test_check_finds_the_same(dataset: Path) -> None:
    expected = check_recordings(read_recordings(dataset))
    assert check_recordings(read_recordings(_moved(dataset, partitioned=True))) == expected


SETTINGS = FitSettings(draws=64, sampler=SamplerSettings(ensembles=2, burn_in=(20,), chunk=20, longest=20))


@pytest.mark.long
def test_fits_of_all_kinds_of_files_are_the_same(tmp_path: Path) -> None:
    """On threads of this process, and on a cluster whose workers read the files."""
    people = simulate_recordings(THREE_ELEMENTS, 7, 2, np.geomspace(5, 5000, 41), 4).recordings
    csv = write_recordings(people, tmp_path / "csv")
    whole = _moved(csv, partitioned=False, name="whole")
    parted = _moved(csv, partitioned=True, name="parted")
    fits = [fit_population(read_recordings(f), settings=SETTINGS, seed=2) for f in (csv, whole, parted)]
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra: dask)")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with (
            distributed.LocalCluster(
                n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=50
            ) as cluster,
            distributed.Client(cluster, set_as_default=False) as client,
        ):
            for folder in (csv, parted):
                executor = Cluster(client)
                fits.append(fit_population(read_recordings(folder), settings=SETTINGS, seed=2, executor=executor))
    for fit in fits[1:]:
        _require_same_fit(fit, fits[0])
    first, last = predict(fits[0]), predict(fits[-1])
    np.testing.assert_array_equal(last.observed, first.observed)
    np.testing.assert_array_equal(last.recording.magnitude, first.recording.magnitude)
    np.testing.assert_array_equal(last.person_relative_rms, first.person_relative_rms)


def _require_same_fit(one: PopulationFit, other: PopulationFit) -> None:
    np.testing.assert_array_equal(one.log_probability, other.log_probability)
    np.testing.assert_array_equal(one.person_draws, other.person_draws)
    np.testing.assert_array_equal(one.noise_scale, other.noise_scale)
    for own, its in zip(one.noise, other.noise, strict=True):
        np.testing.assert_array_equal(own, its)


def test_a_broken_table_is_one_sentence(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=False)
    (folder / "recordings.parquet").write_bytes(b"not parquet at all")
    with pytest.raises(InputError, match="cannot be read as Parquet"):
        read_recordings(folder)


def test_faults_of_the_table_name_the_row(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=False)
    table = pd.read_parquet(folder / "recordings.parquet")
    table.loc[4, "frequency_hz"] = -1.0
    table.to_parquet(folder / "recordings.parquet", index=False)
    with pytest.raises(InputError, match=r"recordings\.parquet, row 6: frequency_hz is -1"):
        read_recordings(folder)


def test_two_tables_are_one_too_many(dataset: Path) -> None:
    folder = _moved(dataset, partitioned=True)
    (folder / "recordings.csv").write_bytes((dataset / "recordings.csv").read_bytes())
    with pytest.raises(InputError, match=r"has both recordings\.csv and recordings\.parquet; delete"):
        read_recordings(folder)


@pytest.mark.parametrize("kind", ["plain", "large", "dictionary", "in chunks"])
def test_names_are_shared_by_their_rows(kind: str) -> None:
    """Millions of rows do not take a string each, and what is missing is empty."""
    import pyarrow as pa

    words = ["left", None, "right", "left", "left"]
    column = pa.chunked_array([pa.array(words, pa.large_string() if kind == "large" else pa.string())])
    if kind == "dictionary":
        column = column.dictionary_encode()
    if kind == "in chunks":
        column = pa.chunked_array([column.chunks[0][:2], column.chunks[0][2:]])
    cells = _cells(column)
    assert cells.dtype == object
    assert cells.tolist() == ["left", "", "right", "left", "left"]
    assert cells[3] is cells[4]
    assert _cells(column[:0]).size == 0
