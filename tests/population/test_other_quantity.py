"""Recordings of another quantity are refused with the quantity's name; an impedance behind a lag or a filter is not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.network import Kernel, parse
from bayes_impedance.population.other_quantity import _Error, _is_better, require_impedance
from bayes_impedance.recordings import Recordings, Subject, read_recordings, write_recordings
from bayes_impedance.recordings.plausibility import negative_without_cause

NETWORK = "m1|r1|n1"
FREQUENCY = np.geomspace(5.0, 500.0, 60)
S = 2j * np.pi * FREQUENCY
CORNER = 2 * np.pi * 60.0

Change = Callable[[np.ndarray], np.ndarray]


def people(change: Change = lambda z: z, **said: str) -> Recordings:
    """Six people with two repetitions, 1 % of noise, and other values than impedance."""
    rng, kernel = np.random.default_rng(3), Kernel(parse(NETWORK))
    values = {"m1": 2e-3, "r1": 0.3, "n1": 1e-3}
    centre = np.log([values[name] for name in kernel.elements])
    subjects = []
    for i in range(6):
        z = kernel.impedance(centre + 0.2 * rng.normal(size=centre.size), FREQUENCY)
        noise = 0.01 * np.abs(z) * (rng.normal(size=(2, 60)) + 1j * rng.normal(size=(2, 60)))
        subjects.append(Subject(name=f"P{i}", frequency_hz=FREQUENCY, z=change(z + noise), repetitions=("1", "2")))
    return Recordings(
        title="test", unit="N s/m", network=NETWORK, source="", licence="", subjects=tuple(subjects), **said
    )


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("accelerance", lambda z: S / z),
        ("receptance", lambda z: 1 / (S * z)),
        ("dynamic stiffness", lambda z: z * S),
        ("apparent mass", lambda z: z / S),
        ("mobility", lambda z: 1 / z),
        ("accelerance", lambda z: S / z * np.exp(-3e-4 * S)),  # with a late channel
    ],
)
def test_another_quantity_is_named(name: str, change: Change) -> None:
    with pytest.raises(InputError, match=f"if they are {name} .*--form '{name}'"):
        require_impedance(people(change))


def test_a_quantity_that_looks_passive_is_named_too() -> None:
    """Mobility has a positive real part at all frequencies, and nothing needs an explanation but the network."""
    given = people(lambda z: 1 / z)
    assert not negative_without_cause(given)
    with pytest.raises(InputError, match=r"or \| and - of the network are exchanged"):
        require_impedance(given)


def test_what_is_better_by_the_likelihood_alone_needs_a_negative_real_part() -> None:
    noise = _Error(error=0.01, noise=0.01, first=0.0)
    structure = replace(noise, error=0.02)
    assert _is_better(noise, 0.012, 200)
    assert not _is_better(noise, 0.012, 0)
    assert not _is_better(noise, 0.0104, 2000)  # searches end so near to each other
    assert not _is_better(structure, 0.05, 200)
    assert _is_better(structure, 0.07, 0)


@pytest.mark.parametrize(
    "change",
    [
        lambda z: z,
        lambda z: z * np.exp(-2e-3 * S),
        lambda z: z * S / (S + CORNER),
        lambda z: z * (S + CORNER) / S,
        lambda z: z / (1 + S / CORNER),
        lambda z: z * (1 + S / CORNER),
    ],
)
def test_an_impedance_behind_a_lag_or_filter_is_none(change: Change) -> None:
    assert require_impedance(people(change)) is None


FINGER = "(n3|r3)-(m2|r1|n1|(m1-(n2|r2)))"
OF_A_FINGER = {"n3": 2e-4, "r3": 3.0, "m2": 2e-4, "r1": 1.5, "n1": 6e-4, "m1": 2e-2, "n2": 3e-3, "r2": 8.0}
WIDE = 2j * np.pi * np.geomspace(5.0, 2000.0, 80)


def fingers(change: Change) -> Recordings:
    """Six fingers whose other quantities have a positive real part at most frequencies."""
    rng, kernel, subjects = np.random.default_rng(4), Kernel(parse(FINGER)), []
    for i in range(6):
        u = np.log([OF_A_FINGER[name] for name in kernel.elements]) + 0.2 * rng.normal(size=8)
        z = kernel.impedance(u, WIDE.imag / (2 * np.pi))
        z = z * (1 + 0.005 * (rng.normal(size=80) + 1j * rng.normal(size=80)))
        subjects.append(
            Subject(name=f"P{i}", frequency_hz=WIDE.imag / (2 * np.pi), z=change(z)[None], repetitions=("1",))
        )
    return Recordings(title="test", unit="N s/m", network=FINGER, source="", licence="", subjects=tuple(subjects))


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("dynamic stiffness", lambda z: z * WIDE),
        ("receptance", lambda z: 1 / (WIDE * z)),
        ("mobility", lambda z: 1 / z),
    ],
)
def test_what_a_filter_explains_less_well_is_doubted_and_not_refused(name: str, change: Change) -> None:
    doubt = require_impedance(fingers(change))
    assert doubt is not None
    assert f"--form '{name}'" in doubt
    assert "this is not sure" in doubt
    assert require_impedance(replace(fingers(change), quantity="impedance")) is None


def test_fingers_are_not_doubted() -> None:
    assert require_impedance(fingers(lambda z: z)) is None


def test_a_doubt_is_told_by_import_and_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recordings(fingers(lambda z: z * WIDE), tmp_path / "in")
    assert main(["check", str(tmp_path / "in")]) == 0
    assert "if they are dynamic stiffness" in capsys.readouterr().out
    words = [str(tmp_path / "in" / "recordings.csv"), "--network", FINGER]
    assert main(["import", *words, "-o", str(tmp_path / "out")]) == 0
    assert "if they are dynamic stiffness" in capsys.readouterr().out


def test_who_declares_an_impedance_is_believed(tmp_path: Path) -> None:
    write_recordings(people(lambda z: S / z, quantity="impedance"), tmp_path)
    recordings = read_recordings(tmp_path)
    assert recordings.quantity == "impedance"
    require_impedance(recordings)


@pytest.mark.parametrize("command", ["check", "fit", "diagnose", "import"])
def test_commands_refuse_accelerance(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset, out = tmp_path / "dataset", tmp_path / "out"
    write_recordings(people(lambda z: S / z), dataset)
    options = [] if command == "check" else ["-o", str(out)]
    source = [str(dataset / "recordings.csv"), "--network", NETWORK] if command == "import" else [str(dataset)]
    assert main([command, *source, *options]) == 2
    assert "--form 'accelerance'" in capsys.readouterr().err
    assert not out.exists()


def test_an_import_of_what_is_said_to_be_impedance_is_believed(tmp_path: Path) -> None:
    write_recordings(people(lambda z: S / z), tmp_path / "in")
    words = [str(tmp_path / "in" / "recordings.csv"), "--network", NETWORK, "--form", "impedance"]
    assert main(["import", *words, "-o", str(tmp_path / "out")]) == 0
    assert main(["check", str(tmp_path / "out")]) == 0


def test_without_a_network_it_is_not_decided(tmp_path: Path) -> None:
    write_recordings(people(lambda z: S / z), tmp_path)
    text = (tmp_path / "dataset.toml").read_text(encoding="utf-8")
    (tmp_path / "dataset.toml").write_text(text.replace(f'network = "{NETWORK}"', ""), encoding="utf-8")
    assert main(["check", str(tmp_path)]) == 0
    assert main(["check", str(tmp_path), "--network", NETWORK]) == 2
