"""Files with bytes changed, cut out or put in: imported or refused in one sentence, never anything else."""

from pathlib import Path

import numpy as np
import pytest
from kinds_of_files import KINDS

from bayes_impedance.commands.cli import main


def damaged(whole: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one kind of damage."""
    data, kind = bytearray(whole), rng.integers(4)
    place = int(rng.integers(len(data)))
    if kind == 0:
        del data[max(1, place) :]
    elif kind == 1:
        for _ in range(int(rng.integers(1, 8))):
            data[int(rng.integers(min(len(data), 3000)))] = int(rng.integers(256))
    elif kind == 2:
        del data[place : place + int(rng.integers(1, 200))]
    else:
        data[place:place] = data[place : place + 50] if rng.random() < 0.5 else rng.bytes(int(rng.integers(1, 20)))
    return bytes(data)


@pytest.mark.parametrize("name", KINDS)
def test_damage_is_refused_in_one_sentence_or_does_no_harm(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    kind, rng = KINDS[name], np.random.default_rng(sorted(KINDS).index(name))
    file, out = tmp_path / kind.file, tmp_path / "out"
    kind.write(file)
    whole = file.read_bytes()
    for _ in range(12):
        file.write_bytes(damaged(whole, rng))
        done = main(["import", str(file), "-o", str(out), "--overwrite", *kind.options])
        said = capsys.readouterr().err
        assert done in (0, 2)
        assert len(said.splitlines()) == (1 if done == 2 else 0)
        assert out.exists() == (done == 0)
        for written in out.glob(".*") if out.exists() else ():
            written.unlink()
        for written in out.glob("*") if out.exists() else ():
            written.unlink()
        if out.exists():
            out.rmdir()
