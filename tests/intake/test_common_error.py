"""What a calibration leaves uncertain, as a rig with a prior: against the errors themselves, and in dataset.toml."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from calibration_runs import FREQUENCY, PEOPLE, Rig, person, write_all

from bayes_impedance.commands.cli import main
from bayes_impedance.errors import InputError
from bayes_impedance.intake.common_error import common_error
from bayes_impedance.intake.smooth_rig import SmoothRig
from bayes_impedance.intake.spectrum import Spectrum
from bayes_impedance.network import Kernel, parse
from bayes_impedance.recordings import read_recordings, write_recordings
from bayes_impedance.recordings.calibration import CommonError

S = 2j * np.pi * FREQUENCY
SDS = np.array([0.02, 1e-6, 1e-5, 0.02, 3.0, 1e-11])


def rig_of(truth: Rig, sds: np.ndarray = SDS, seed: int = 0) -> SmoothRig:
    """With errors that are correlated at random."""
    own = np.random.default_rng(seed).normal(size=(6, 12))
    covariance = own @ own.T
    size = np.sqrt(np.diag(covariance))
    covariance *= np.outer(sds / size, sds / size)
    return SmoothRig(values=np.array(truth.values), covariance=covariance, misfit=1.0)


def spectra() -> list[Spectrum]:
    return [
        Spectrum(subject=name, repetition="1", frequency_hz=FREQUENCY, z=person(name), unit="N s/m", source=name)
        for name in PEOPLE
    ]


def predicted_sd(left: CommonError, z: np.ndarray) -> np.ndarray:
    """Standard deviations of real and imaginary part of a load (F,) within the rig, by derivatives of its network."""
    kernel = Kernel(parse(left.around("r1")))
    assert set(kernel.elements) == {*left.parameters, "r1"}
    slopes = np.stack([z, -S * z, S, np.ones_like(S), 1 / S], axis=1)
    # The network's own derivatives at the mean agree with what is used here for any load, such as a damper.
    u = np.array([0.0 if name != "r1" else np.log(3.0) for name in kernel.elements])
    at = kernel.derivative(u, FREQUENCY)[1]
    for k, name in enumerate(left.parameters):
        expected = np.stack([3.0 + 0 * S, -S * 3.0, S, np.ones_like(S), 1 / S], axis=1)[:, k]
        np.testing.assert_allclose(at[kernel.elements.index(name)], expected, rtol=1e-9)
    covariance = left.correlation * np.outer(left.sd, left.sd)
    parts = [np.einsum("fi,ij,fj->f", part, covariance, part) for part in (slopes.real, slopes.imag)]
    return np.sqrt(np.stack(parts, axis=1))


def test_the_rig_that_is_left_has_the_errors_of_the_calibration() -> None:
    """Exactly where the rig is rigid and carries nothing; else a delay times what it carries is not among the five."""
    rigid = Rig(mount=0.0, mass_kg=0.0, damper=0.0, stiffness=0.0)
    rig = rig_of(rigid, SDS * np.array([1, 1, 1, 1, 1, 1e-6]))
    left = common_error(rig, spectra())
    assert left is not None
    assert left.share > 1 - 1e-6
    for name in PEOPLE:
        measured = rigid.measures(person(name))
        exact = rig.at(FREQUENCY).common_sd(measured)
        assert exact is not None
        size = np.abs(person(name))[:, None]
        np.testing.assert_allclose(predicted_sd(left, person(name)) / size, exact / size, rtol=1e-3, atol=1e-6)


def test_errors_that_were_made_are_those_of_the_prior() -> None:
    """Loads that are corrected with wrong rigs, exactly: the five parameters explain what has become of them."""
    rig, rng = rig_of(Rig(), 0.1 * SDS), np.random.default_rng(1)
    left = common_error(rig, spectra())
    assert left is not None
    z = np.concatenate([person(name) for name in PEOPLE])
    s = np.tile(S, len(PEOPLE))
    columns = np.stack([z, -s * z, s, np.ones_like(s), 1 / s], axis=1) / np.abs(z)[:, None]
    columns = np.concatenate([columns.real, columns.imag])
    root, found = np.linalg.cholesky(rig.covariance), []
    for _ in range(400):
        wrong = SmoothRig(values=rig.values + root @ rng.normal(size=6), covariance=rig.covariance, misfit=1.0)
        error = wrong.at(s.imag / (2 * np.pi)).load(rig.at(s.imag / (2 * np.pi)).measured(z)) - z
        error = error / np.abs(z)
        found.append(np.linalg.lstsq(columns, np.concatenate([error.real, error.imag]), rcond=None)[0])
    whitened = np.linalg.solve(np.linalg.cholesky(left.correlation), (np.array(found) / left.sd).T)
    np.testing.assert_allclose(np.cov(whitened), np.eye(5), atol=0.25)  # 0.05 to 0.07 are the errors of 400 draws


def test_a_share_that_the_rig_does_not_describe_is_told() -> None:
    left = common_error(rig_of(Rig(), SDS * np.array([0.01, 0.01, 0.01, 0.01, 0.01, 1e5])), spectra())
    assert left is not None
    assert left.share < 0.9


def test_nothing_is_left_of_what_is_not_known() -> None:
    unknown = SmoothRig(values=np.array(Rig().values), covariance=np.full((6, 6), np.inf), misfit=None)
    assert common_error(unknown, spectra()) is None


def test_it_goes_to_the_dataset_and_comes_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=0.02)
    assert main(["import", *people, "--known-load", *runs, "-o", str(tmp_path / "out")]) == 0
    assert "and fits estimate 9" in capsys.readouterr().out
    recordings = read_recordings(tmp_path / "out")
    assert recordings.calibration is not None
    assert not recordings.warnings
    again = write_recordings(recordings, tmp_path / "again")
    other = read_recordings(again).calibration
    assert other is not None
    assert other.toml() == recordings.calibration.toml()
    assert (
        main(["import", *people, "--known-load", *runs, "--rig", "each frequency", "-o", str(tmp_path / "each")]) == 0
    )
    assert "and fits carry it on, at each frequency" in capsys.readouterr().out
    each = read_recordings(tmp_path / "each")
    assert each.calibration is None
    assert each.calibration_map is not None
    again = write_recordings(each, tmp_path / "each again")
    assert (again / "calibration.csv").read_bytes() == (tmp_path / "each" / "calibration.csv").read_bytes()
    other = read_recordings(again)
    assert other.calibration_map is not None
    assert other.calibration_map.csv() == each.calibration_map.csv()
    assert not other.warnings


def test_a_single_run_that_corrects_all_is_carried_on_too(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(gain=1.0, delay_s=0.0, mount=0.0), noise=0.02)
    run = runs[0].removeprefix("open:")
    assert main(["import", *people, "--unloaded", run, "-o", str(tmp_path / "out")]) == 0
    recordings = read_recordings(tmp_path / "out")
    error = recordings.calibration_map
    assert error is not None
    np.testing.assert_allclose(error.a, 1.0)
    sd = 0.02 * np.abs(Rig(gain=1.0, delay_s=0.0, mount=0.0).measures(0 * S))
    for one in recordings.subjects:
        # The noise of the run is averaged over neighbouring lines.
        np.testing.assert_allclose(np.sqrt(error.variance(FREQUENCY, one.z)), sd[None], rtol=0.4)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("calibration", 3, "calibration must be a table"),
        ("network", '"gain[g_rig*](m1)"', "must contain NETWORK once"),
        ("network", "3", "must be text"),
        ("parameters", "[]", "parameters must be a list of names"),
        ("mean", "[1.0]", "mean must be 5 finite numbers"),
        ("sd", "[1.0, 1.0, 1.0, 1.0, nan]", "sd must be 5 finite numbers"),
        ("sd", "[1.0, 1.0, 1.0, 1.0, 0.0]", "standard deviations must be above zero"),
        ("correlation", "[[1.0]]", "correlation must be 5 by 5 finite numbers"),
        ("share", "1.5", "share is 1.5, but must be"),
        ("shares", "1", 'key "shares" is not used'),
    ],
)
def test_a_table_that_cannot_be_used_is_refused(key: str, value: object, said: str, tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=0.02)
    assert main(["import", *people, "--known-load", *runs, "-o", str(tmp_path / "out")]) == 0
    file = tmp_path / "out" / "dataset.toml"
    text = file.read_text(encoding="utf-8")
    if key == "calibration":
        start, end = text.index("[calibration]"), text.index("[import]")
        text = f"calibration = 3\n{text[:start]}{text[end:]}"
    else:
        lines = [line for line in text.split("\n") if not line.startswith(f"{key} = ")]
        lines.insert(lines.index("[calibration]") + 1, f"{key} = {value}")
        text = "\n".join(lines)
    tomllib.loads(text)
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_recordings(tmp_path / "out")
