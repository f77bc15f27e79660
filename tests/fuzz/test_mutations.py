"""Random mutations of files that are in order: whatever comes of them is understood, or refused in one line.

A file is mutated in bytes (flipped, deleted, doubled, cut) or in words (a number or a key is replaced by something that
people and programs write). A seed makes each mutation, so that one that fails can be made again. The command must end
with status 0, 1 or 2, with exactly one line that begins with ``error:`` where it is not 0, without a traceback, and
must leave the dataset as it was.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import write_recordings

WORDS = ["nan", "inf", "-inf", "", "0", "-1", "1e300", "1e-300", "1e400", "9999", "true", "1,5", "1.2.3", "NULL"]
WORDS += ['"', "'", "[", "]", "{", "=", ",", "--", "\t", "\r\n", "\x00", "\x1b[2J", "é", "../x", "$(touch F)"]
WORDS += ["frequency_hz", "_" * 300]

TOKEN = re.compile(r"[-+\w.]+")


def flipped(text: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(text)
    for _ in range(int(rng.integers(1, 6))):
        changed[int(rng.integers(len(changed)))] = int(rng.integers(256))
    return bytes(changed)


def without_a_stretch(text: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(len(text)))
    return text[:start] + text[start + int(rng.integers(1, 200)) :]


def doubled(text: bytes, rng: np.random.Generator) -> bytes:
    start = int(rng.integers(len(text)))
    end = start + int(rng.integers(1, 200))
    return text[:end] + text[start:end] + text[end:]


def cut(text: bytes, rng: np.random.Generator) -> bytes:
    return text[: int(rng.integers(len(text)))]


def reworded(text: bytes, rng: np.random.Generator) -> bytes:
    words = text.decode("utf-8")
    tokens = list(TOKEN.finditer(words))
    for _ in range(int(rng.integers(1, 4))):
        token = tokens[int(rng.integers(len(tokens)))]
        if words[token.start() : token.end()] == token.group():  # still where it was
            words = words[: token.start()] + WORDS[int(rng.integers(len(WORDS)))] + words[token.end() :]
    return words.encode("utf-8")


Mutation = Callable[[bytes, np.random.Generator], bytes]
MUTATIONS: list[Mutation] = [flipped, without_a_stretch, doubled, cut, reworded, reworded]


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small dataset with a covariate, in order."""
    central = {"n1": 1e-3, "r1": 1.5, "m1": 1e-3}
    population = VirtualPopulation(network="n1|r1|m1", central=central, between_persons=dict.fromkeys(central, 0.2))
    folder = tmp_path_factory.mktemp("sound") / "dataset"
    write_recordings(simulate_recordings(population, 3, 2, np.geomspace(5, 500, 12), 1).recordings, folder)
    return folder


def mutated(sound: Path, folder: Path, seed: int) -> Path:
    """A copy of the dataset with one file mutated."""
    rng = np.random.default_rng(seed)
    target = folder / f"mutation_{seed}"
    shutil.copytree(sound, target)
    files = sorted(p for p in target.rglob("*") if p.is_file() and p.name[0] != ".")
    file = files[int(rng.integers(len(files)))]
    file.write_bytes(MUTATIONS[int(rng.integers(len(MUTATIONS)))](file.read_bytes(), rng))
    return target


def check(sound: Path, folder: Path, seed: int, capsys: pytest.CaptureFixture[str]) -> int:
    """Status of the check of a mutation; fails if it was not told as errors are."""
    dataset = mutated(sound, folder, seed)
    before = {p: p.read_bytes() for p in dataset.rglob("*") if p.is_file()}
    status = main(["check", str(dataset)])
    told = capsys.readouterr()
    errors = [line for line in told.err.splitlines() if line.startswith("error:")]
    assert status in (0, 1, 2), seed
    assert len(errors) == (status != 0), (seed, told.err)
    assert "Traceback" not in told.err + told.out, seed
    assert all(c.isprintable() for line in (told.err + told.out).splitlines() for c in line), seed
    assert {p: p.read_bytes() for p in dataset.rglob("*") if p.is_file()} == before, seed
    shutil.rmtree(dataset)
    return status


def test_mutations_of_a_dataset(sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    statuses = [check(sound, tmp_path, seed, capsys) for seed in range(250)]
    assert {0, 2} <= set(statuses)  # some are harmless, some are not: both ways are tried


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_ten_thousand_mutations(block: int, sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for seed in range(1000 * (block + 1), 1000 * (block + 2)):
        check(sound, tmp_path, seed, capsys)
