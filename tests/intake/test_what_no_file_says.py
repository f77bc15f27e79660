"""What neither a file nor an option says is asked for where the values speak against what would be assumed."""

from pathlib import Path

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance, table
from lagged_recordings import LOADS, Chain, delayed, recorded

from bayes_impedance.commands.cli import main
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings import Recordings, Subject, read_recordings, write_recordings

S, Z = 2j * np.pi * FREQUENCY, impedance()


def imports(
    folder: Path, values: np.ndarray, *options: str, names: str = "frequency_hz z_re z_im", f=FREQUENCY
) -> bool:
    """Whether a file is imported; else nothing is written."""
    columns = dict(zip(names.split(" "), (f, values.real, values.imag), strict=True))
    (folder / "a.csv").write_text(table(columns), encoding="utf-8")
    status = main(["import", str(folder / "a.csv"), "-o", str(folder / "out"), "--overwrite", *options])
    assert status in (0, 2)
    assert (folder / "out").exists() is (status == 0)
    return status == 0


@pytest.mark.parametrize(
    ("values", "form"), [(S / Z, "accelerance"), (S * Z, "dynamic stiffness"), (Z / S, "apparent mass")]
)
def test_another_quantity_with_the_letter_z_is_asked_for(
    values: np.ndarray, form: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not imports(tmp_path, values)
    said = capsys.readouterr().err
    assert f"--form '{form}'" in said
    assert "--form impedance" in said
    assert imports(tmp_path, values, "--form", form)
    np.testing.assert_allclose(read_recordings(tmp_path / "out").subjects[0].z[0], Z, rtol=1e-9)


def test_a_network_that_describes_it_both_ways_is_no_answer(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Apparent mass of a fingertip is an impedance of the same network behind a high-pass in the motion channel."""
    people = simulate_recordings(FINGERTIP, 6, 1, np.geomspace(5, 5000, 40), seed=1).recordings
    rows = ["subject,frequency_hz,z_re,z_im"]
    for one in people.subjects:
        values = one.z[0] / (2j * np.pi * one.frequency_hz)
        rows += [f"{one.name},{f},{z.real},{z.imag}" for f, z in zip(one.frequency_hz, values, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")

    def status(network: str) -> int:
        arguments = ["import", str(tmp_path / "a.csv"), "-o", str(tmp_path / "out"), "--overwrite"]
        return main([*arguments, "--network", network])

    network = str(people.network)
    assert status(network) == 2
    assert "nothing but the letter Z" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert status(f"highpass[f1*]({network})") == 0  # says what makes Re z negative


@pytest.mark.parametrize(
    ("names", "options"),
    [
        ("frequency_hz z_re z_im", ["--form", "impedance"]),
        ("frequency_hz z_re z_im", ["--unit", "N s/m"]),
        ("frequency_hz impedance_re impedance_im", []),
        ("frequency_hz Re(Z)/(Ns/m) Im(Z)/(Ns/m)", []),
    ],
)
def test_who_says_impedance_is_believed(
    names: str, options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where only a unit or a name says so, it may be wrong: that is remarked on."""
    assert imports(tmp_path, S / Z, *options, names=names)
    said = (
        "as accelerance or dynamic stiffness these recordings would be those of a passive load"
        in capsys.readouterr().out
    )
    assert said is ("--form" not in options)
    assert imports(tmp_path, Z, *options, names=names)
    assert "would be those of a passive load" not in capsys.readouterr().out


def test_signals_are_told_of_their_units(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Velocity that is called acceleration."""
    s = 2j * np.pi * np.maximum(np.fft.rfftfreq(2500, 1 / 5000), 1.0)
    lines = np.arange(s.size) % 2 * (np.abs(s) > 100) * (np.abs(s) < 6000)
    velocity = lines * np.exp(2j * np.pi * np.random.default_rng(1).random(s.size))
    force = velocity * (0.01 * s + 3 + 1000 / s)
    signals = {name: np.tile(np.fft.irfft(one), 5) for name, one in (("force", force), ("motion", velocity))}
    np.savez(tmp_path / "a.npz", fs=5000.0, **signals)
    for unit, doubted in (("m/s^2", True), ("m/s", False)):
        channels = ["--force", "force[N]", "--motion", f"motion[{unit}]"]
        assert main(["import", str(tmp_path / "a.npz"), *channels, "-o", str(tmp_path / "out"), "--overwrite"]) == 0
        assert ("correct channel and unit of --force and --motion" in capsys.readouterr().out) is doubted


@pytest.mark.parametrize("load", LOADS)
@pytest.mark.parametrize("chain", [lambda s, z: z, delayed(2e-4), delayed(-2e-4), lambda s, z: z - 1e-4 * s])
def test_impedances_are_not_asked_for(load: str, chain: Chain, tmp_path: Path) -> None:
    """Also late ones, with most of Re z negative."""
    one = recorded(load, chain, subjects=1).subjects[0]
    assert imports(tmp_path, one.mean, f=one.frequency_hz)


def test_slow_frequencies_without_a_unit_are_asked_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names, slow = "freq z_re z_im", FREQUENCY / 1e3
    assert not imports(tmp_path, Z, names=names, f=slow)
    assert "--frequency-unit kHz, or --frequency-unit Hz" in capsys.readouterr().err
    assert imports(tmp_path, Z, "--frequency-unit", "Hz", names=names, f=slow)
    assert imports(tmp_path, Z, f=slow)  # frequency_hz


@pytest.mark.parametrize("load", [0.01 * S, 100 / S])
@pytest.mark.parametrize("noise", [0.0, 1e-3, 0.02])
def test_hardly_any_loss_and_the_wrong_sign(
    load: np.ndarray, noise: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Conjugate or negative is the same here; the same people as they are, are imported."""
    rng = np.random.default_rng(1)
    people = load * (1 + noise * (rng.normal(size=(5, S.size)) + 1j * rng.normal(size=(5, S.size))))

    def checks(sign: float) -> int:
        subjects = [
            Subject(name=f"S{i}", frequency_hz=FREQUENCY, z=sign * (1 + 0.1 * i) * z[None], repetitions=("1",))
            for i, z in enumerate(people)
        ]
        whole = Recordings(title="t", unit="N s/m", network=None, source="", licence="", subjects=tuple(subjects))
        return main(["check", str(write_recordings(whole, tmp_path / f"in{sign}"))])

    assert checks(1.0) == 0
    assert checks(-1.0) == 2
    said = capsys.readouterr().err
    assert "complex conjugates" in said
    assert 'convention = "exp(-jwt)"' in said
    assert imports(tmp_path, people[0])
    (tmp_path / "b").mkdir()
    assert not imports(tmp_path / "b", -people[0])
    said = capsys.readouterr().err
    assert "--conjugated" in said or "--negated" in said  # noise may make Re z negative at most points
    assert imports(tmp_path / "b", -people[0], "--negated")
