"""Covariates of the persons come along, from a table of any kind."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, table

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings

Z = impedance()


@pytest.fixture
def people(tmp_path: Path) -> list[str]:
    """Files of four persons."""
    for name in ("01", "02", "03", "04"):
        text = table({"f": FREQUENCY, "z_re": Z.real * int(name), "z_im": Z.imag})
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
    return sorted(map(str, tmp_path.glob("*.csv")))


def test_covariates_come_along(people: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = ["Person;Alter;Hand", "01;23,5;links", "03;31;rechts", "04;;rechts", "09;40;links", "02;28;links"]
    (tmp_path / "people.txt").write_text("\n".join(rows), encoding="cp1252")
    out = tmp_path / "out"
    assert main(["import", *people, "-o", str(out), "--subjects", str(tmp_path / "people.txt")]) == 0
    found = {s.name: dict(s.covariates) for s in read_recordings(out).subjects}
    assert found["01"] == {"Alter": 23.5, "Hand=rechts": 0.0}
    assert found["03"] == {"Alter": 31.0, "Hand=rechts": 1.0}
    assert np.isnan(found["04"]["Alter"])
    said = capsys.readouterr().out
    assert "no recordings of 1 of its 5 subjects" in said
    assert 'people.txt: guessed from the names: subject from "Person", and the other columns are covariates' in said
    assert "not used" not in said


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("a;b\n1;2\n2;3\n", "no column is clearly the subject"),
        ("subject;b\n01;2\n01;3\n", "is there twice"),
        ("subject;b\nA;2\nB;3\n", "none of the subjects"),
        ("subject;b\n01;2\n02;3\n03;x\n04;1\n", "which is not a number"),
    ],
)
def test_tables_that_cannot_be_used_are_refused(
    content: str, sentence: str, people: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "people.txt").write_text(content, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["import", *people, "-o", str(out), "--subjects", str(tmp_path / "people.txt")]) == 2
    assert sentence in capsys.readouterr().err
    assert not out.exists()
