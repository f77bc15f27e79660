"""dataset.toml: which units and keys are accepted, and the message about those that are not."""

from __future__ import annotations

from pathlib import Path

import pytest
from datasets import dataset

from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.recordings.metadata import parse_unit


def test_unknown_key_and_scaled_unit_and_surplus_covariates(tmp_path: Path) -> None:
    toml = 'titel = "T"\nunit = "mN s/m"\nversion = 3\n[table]\nx = 1\n'
    data = read_recordings(dataset(tmp_path, subjects="subject,age\nA,1\nB,2\nC,3\n", toml=toml))
    surplus, titel, version, table, unit = data.warnings
    assert "no recordings of C" in surplus
    assert 'line 1: key "titel"' in titel
    assert 'did you mean "title"?' in titel
    assert 'line 3: key "version"' in version
    assert 'line 4: key "table"' in table
    assert "line 2" in unit
    assert "multiplied by 0.001" in unit
    assert data.subjects[0].z[0, 0] == pytest.approx(1e-3 - 0.5e-3j)


@pytest.mark.parametrize(
    ("spelling", "unit", "factor"),
    [
        ("N s/m", "N s/m", 1),
        ("N*s/m", "N s/m", 1),
        ("Ns/m", "N s/m", 1),
        ("N\u00b7s/m", "N s/m", 1),
        ("N s m^-1", "N s/m", 1),
        ("N s m\u207b\u00b9", "N s/m", 1),
        ("kg/s", "N s/m", 1),
        ("mN s/m", "N s/m", 1e-3),
        ("\u00b5N s/m", "N s/m", 1e-6),
        ("N s/mm", "N s/m", 1e3),
        ("g/s", "N s/m", 1e-3),
        ("dyn s/cm", "N s/m", 1e-3),
        ("Ohm", "ohm", 1),
        ("\u2126", "ohm", 1),
        ("\u03a9", "ohm", 1),
        ("mohm", "ohm", 1e-3),
        ("k\u03a9", "ohm", 1e3),
        ("MOhm", "ohm", 1e6),
        ("N m s/rad", "N m s/rad", 1),
        ("mN m s/rad", "N m s/rad", 1e-3),
        ("Pa s/m3", "Pa s/m3", 1),
        ("Pa\u00b7s/m\u00b3", "Pa s/m3", 1),
        ("kPa s/m^3", "Pa s/m3", 1e3),
        ("rayl", "Pa s/m", 1),
    ],
)
def test_units(spelling: str, unit: str, factor: float) -> None:
    kept, by = parse_unit(spelling, "here")
    assert kept == unit
    assert by == pytest.approx(factor)


@pytest.mark.parametrize(
    ("spelling", "words"),
    [
        ("mm", "a displacement"),
        ("N/m", "a stiffness"),
        ("dB", "a level"),
        ("m/(N s)", "a mobility"),
        ("S", "an admittance"),
        ("furlong", "is unknown"),
        ("", "is unknown"),
        ("ns/m", "is unknown"),
    ],
)
def test_refused_units(spelling: str, words: str) -> None:
    with pytest.raises(InputError, match="an impedance F/v is expected") as caught:
        parse_unit(spelling, "dataset.toml, line 7")
    message = str(caught.value)
    assert words in message
    assert "line 7" in message
    assert all(f'"{unit}"' in message for unit in ("N s/m", "ohm", "N m s/rad", "Pa s/m3"))


BAD_TOML: dict[str, tuple[str, list[str]]] = {
    "syntax": ('title = "T"\nunit = N s/m\n', ["line 2 is not valid TOML", "correct it"]),
    "unfinished": ('title = "T', ["not valid TOML", "line"]),
    "key_twice": ('title = "T"\ntitle = "U"\n', ["line 2 is not valid TOML"]),
    "type": ('title = "T"\n\nsource = 3\n', ["line 3", "source is 3", "quotation marks"]),
    "table": ("[network]\nx = 1\n", ["line 1", "network is", "must be text"]),
    "unit": ('title = "T"\nunit = "N/m"\n', ["line 2", '"N/m" belongs to a stiffness', "F/v"]),
    "sign": ('sign = "positive"\n', ["line 1", '"positive" is unknown', '"passive positive"', '"passive negative"']),
}


@pytest.mark.parametrize(("content", "words"), BAD_TOML.values(), ids=BAD_TOML.keys())
def test_bad_toml(tmp_path: Path, content: str, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        read_recordings(dataset(tmp_path, toml=content))
    assert str(caught.value).startswith(str(tmp_path / "dataset.toml"))
    for word in words:
        assert word in str(caught.value)


def test_toml_in_another_encoding(tmp_path: Path) -> None:
    dataset(tmp_path).joinpath("dataset.toml").write_bytes('title = "T"\nsource = "J\u00f6rg"'.encode("latin-1"))
    with pytest.raises(InputError, match=r"dataset\.toml, row 2: the text is not UTF-8"):
        read_recordings(tmp_path)
