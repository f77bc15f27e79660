"""Calibration by runs with known loads: exact without noise, its error covered with noise, and said where it ends."""

import csv
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from calibration_runs import FREQUENCY, LOADS, PEOPLE, Rig, circular, load, person, write, write_all

from bayes_impedance.commands.cli import main
from bayes_impedance.intake.smooth_rig import PARAMETERS, SmoothRig, smooth_rig
from bayes_impedance.intake.two_port import TwoPort, smoothed_noise, two_port
from bayes_impedance.network import parse
from bayes_impedance.recordings import read_recordings

RIGID = Rig(mount=0.0)
S = 2j * np.pi * FREQUENCY


def calibrated(folder: Path, *arguments: str) -> Path:
    """Dataset of a successful import."""
    out = folder / "out"
    assert main(["import", *arguments, "-o", str(out), "--overwrite"]) == 0
    return out


def said(out: Path) -> str:
    """Everything that an import has noted."""
    return " ".join(tomllib.loads((out / "dataset.toml").read_text(encoding="utf-8"))["import"]["notes"])


def require_people(out: Path, rtol: float) -> None:
    for subject in read_recordings(out).subjects:
        np.testing.assert_allclose(subject.z[0], person(subject.name), rtol=rtol)


@pytest.mark.parametrize(
    ("rig", "count", "how"),
    [
        (Rig(), 3, "smooth"),
        (Rig(), 3, "each frequency"),
        (Rig(), 2, "smooth"),
        (RIGID, 2, "each frequency"),
        (RIGID, 3, "smooth"),
        (Rig(delay_s=-2e-5, damper=0.0, stiffness=0.0, mount=4e-6), 3, "smooth"),
    ],
)
def test_without_noise_the_load_comes_back(rig: Rig, count: int, how: str, tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, rig)
    out = calibrated(tmp_path, *people, "--known-load", *runs[:count], "--rig", how)
    require_people(out, 1e-8)


def test_parameters_of_the_rig_come_back(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-9)
    out = calibrated(tmp_path, *people, "--known-load", *runs)
    rig = tomllib.loads((out / "rig.toml").read_text(encoding="utf-8"))
    assert [one["name"] for one in rig["parameters"]] == [name for name, _ in PARAMETERS]
    np.testing.assert_allclose([one["mean"] for one in rig["parameters"]], Rig().values, rtol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(rig["covariance"])), [one["sd"] for one in rig["parameters"]])
    assert "gain 1.06" in said(out)


def test_any_load_of_which_the_impedance_is_known_will_do(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig())
    spring = write(tmp_path / "spring.csv", Rig().measures(2000 / S))
    damper = write(tmp_path / "damper.csv", Rig().measures(5 + 0 * S))
    loads = [runs[0], f"stiffness=2 N/mm:{spring}", f"damper=5 N s/m:{damper}"]
    require_people(calibrated(tmp_path, *people, "--known-load", *loads), 1e-8)


def test_the_unloaded_run_is_one_of_the_known_loads(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig())
    unloaded = runs[0].removeprefix("open:")
    out = calibrated(tmp_path, *people, "--unloaded", unloaded, "--known-load", *runs[1:])
    require_people(out, 1e-8)
    assert "are taken as 1" not in said(out)


def test_subtraction_is_exact_for_what_adds_and_says_what_it_leaves(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(gain=1.0, delay_s=0.0, mount=0.0))
    out = calibrated(tmp_path, *people, "--unloaded", runs[0].removeprefix("open:"))
    require_people(out, 1e-10)
    assert re.search(r"does not determine gain, skew and mount.*--known-load", said(out))
    people, runs = write_all(tmp_path, Rig(delay_s=0.0, mount=0.0))
    out = calibrated(tmp_path, *people, "--unloaded", runs[0].removeprefix("open:"))
    for subject in read_recordings(out).subjects:
        np.testing.assert_allclose(subject.z[0], 1.06 * person(subject.name), rtol=1e-10)


def test_every_recording_may_have_its_own_unloaded_run(tmp_path: Path) -> None:
    rigs = {"A": Rig(1.0, 0.0, 2e-3, 0.1, 10.0, 0.0), "B": Rig(1.0, 0.0, 4e-3, 0.5, 20.0, 0.0)}
    (tmp_path / "empty").mkdir()
    sd = np.full(FREQUENCY.size, 3e-3)
    people = [write(tmp_path / f"{n}.csv", rig.measures(person(n)), noise_sd=sd) for n, rig in rigs.items()]
    for name, rig in rigs.items():
        write(tmp_path / "empty" / f"{name}.csv", rig.measures(0 * S), noise_sd=4 / 3 * sd)
    out = calibrated(tmp_path, *people, "--unloaded", str(tmp_path / "empty"))
    require_people(out, 1e-10)
    for subject in read_recordings(out).subjects:
        assert subject.noise_sd is not None
        np.testing.assert_allclose(subject.noise_sd, 5e-3)  # 3, 4, 5: both runs' noise is that recording's own
    assert not (out / "calibration_sd.csv").exists()
    assert "its own unloaded run" in said(out)


def test_the_error_of_a_common_run_is_beside_the_noise_and_not_in_it(tmp_path: Path) -> None:
    sd = np.full(FREQUENCY.size, 3e-3)
    rig = Rig(gain=1.0, delay_s=0.0, mount=0.0)
    people = [write(tmp_path / f"{n}.csv", rig.measures(person(n)), noise_sd=sd) for n in PEOPLE]
    run = write(tmp_path / "empty.csv", rig.measures(0 * S), noise_sd=2 * sd)
    out = calibrated(tmp_path, *people, "--unloaded", run)
    for subject in read_recordings(out).subjects:
        assert subject.noise_sd is not None
        np.testing.assert_allclose(subject.noise_sd, 3e-3)
    with (out / "calibration_sd.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(PEOPLE) * FREQUENCY.size
    found = [[float(row["calibration_sd_re"]), float(row["calibration_sd_im"])] for row in rows]
    np.testing.assert_allclose(found, 6e-3)
    relative = 0.6 / np.abs([person(n) for n in PEOPLE])
    assert f"deviation {np.median(relative):.2g} % of |z|, at most {relative.max():.2g} %" in said(out)


def test_sensitivities_of_the_load_are_its_derivatives() -> None:
    rng = np.random.default_rng(3)
    a, b, c = (rng.normal(size=(3, 1)) + 1j * rng.normal(size=(3, 1))) * np.array([[1.0], [0.3], [0.2]])
    z = person("A")
    h = (a * z + b) / (c * z + 1)
    exact = TwoPort(frequency_hz=FREQUENCY, a=a + 0 * z, b=b + 0 * z, c=c + 0 * z)
    np.testing.assert_allclose(exact.load(exact.measured(z)), z)
    step = 1e-7
    slope = np.abs(exact.load(h * (1 + step)) - exact.load(h * (1 - step))) / (2 * step * np.abs(h))
    np.testing.assert_allclose(exact.noise_factor(h), slope, rtol=1e-6)
    for k, name in enumerate("abc"):
        covariance = np.zeros((FREQUENCY.size, 3, 3), dtype=complex)
        covariance[:, k, k] = 1.0
        arrays = {"a": exact.a, "b": exact.b, "c": exact.c}
        up, down = (
            TwoPort(frequency_hz=FREQUENCY, **(arrays | {name: arrays[name] + sign * step})).load(h) for sign in (1, -1)
        )
        common = TwoPort(frequency_hz=FREQUENCY, **arrays, covariance=covariance).common_sd(h)
        assert common is not None
        np.testing.assert_allclose(common[:, 0], np.abs(up - down) / (2 * step), rtol=1e-5)


@pytest.mark.parametrize("how", ["smooth", "each frequency"])
def test_the_error_that_is_carried_on_covers(how: str) -> None:
    """What is measured of a person is exact here, so that all the error of z is the calibration's."""
    loads = np.array([load(name) for name in LOADS])
    exact = Rig().measures(loads)
    sd = 3e-3 * np.abs(exact) + 1e-4
    z, h = person("A"), Rig().measures(person("A"))
    errors = []
    for seed in range(60):
        measured = exact + circular(sd, np.random.default_rng(seed))
        if how == "smooth":
            rig = smooth_rig(FREQUENCY, loads, measured, sd)
            assert rig is not None
            found = rig.at(FREQUENCY)
        else:
            found = two_port(FREQUENCY, loads, measured, sd, 3)
        common = found.common_sd(h)
        assert common is not None
        error = found.load(h) - z
        errors.append(np.stack([error.real, error.imag], axis=-1) / common)
    # Of 7200 parts; those of one smooth rig are six numbers' worth, so that the share is known to about 2 %.
    assert 0.91 < np.mean(np.abs(errors) < 1.96) < 0.98
    assert 0.85 < np.std(errors) < 1.15


def test_standard_deviations_of_the_rig_cover() -> None:
    loads = np.array([load(name) for name in LOADS])
    exact = Rig().measures(loads)
    sd = 3e-3 * np.abs(exact) + 1e-4
    fits = [smooth_rig(FREQUENCY, loads, exact + circular(sd, np.random.default_rng(k)), sd) for k in range(60)]
    deviations = np.array([(fit.values - Rig().values) / fit.sds for fit in fits if fit is not None])
    assert deviations.shape == (60, 6)
    # 60 standard normal numbers: their mean is within 0.13, their standard deviation within 9 % of one.
    assert np.abs(deviations.mean(axis=0)).max() < 0.45
    assert np.abs(deviations.std(axis=0) - 1).max() < 0.3


def test_a_rig_that_six_numbers_do_not_describe_is_taken_at_each_frequency(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-4)
    fixture = 1 + 0.05 / (1 + (200 / FREQUENCY - FREQUENCY / 200) ** 2 * 4)  # gain of one channel near 200 Hz
    for file in [*people, *(run.partition(":")[2] for run in runs)]:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
        z = (rows[:, 1] + 1j * rows[:, 2]) * fixture
        write(Path(file), z, noise_sd=rows[:, 3])
    out = calibrated(tmp_path, *people, "--known-load", *runs)
    require_people(out, 0.02)
    assert "each frequency is taken" in said(out)
    assert not (out / "rig.toml").exists()


def test_networks_of_the_rig_are_the_rig(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-9)
    out = calibrated(tmp_path, *people, "--known-load", *runs)
    rig = tomllib.loads((out / "rig.toml").read_text(encoding="utf-8"))
    held = parse(rig["held"].replace("NETWORK", "m1|r1|n1"))
    mass, damper, stiffness = PEOPLE["A"]
    values = {"m1": mass, "r1": damper, "n1": 1 / stiffness}
    np.testing.assert_allclose(held.impedance(S, values), Rig().measures(person("A")), rtol=1e-6)
    shared = parse(rig["shared"].replace("NETWORK", "m1|r1|n1"))
    assert {p.name for p in shared.parameters if p.shared} == {name for name, _ in PARAMETERS}


def test_the_map_in_the_dataset_is_the_one_that_was_used(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-3)
    out = calibrated(tmp_path, *people, "--known-load", *runs, "--rig", "each frequency")
    with (out / "calibration.csv").open(encoding="utf-8", newline="") as stream:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(stream)]
    a, b, c = (np.array([row[f"{x}_re"] + 1j * row[f"{x}_im"] for row in rows]) for x in "abc")
    measured = np.loadtxt(people[0], delimiter=",", skiprows=1)
    h = measured[:, 1] + 1j * measured[:, 2]
    np.testing.assert_allclose(read_recordings(out).subjects[0].z[0], (h - b) / (a - c * h))
    assert all(row["var_a"] > 0 and row["var_b"] > 0 and row["var_c"] > 0 for row in rows)


def test_an_import_with_calibration_can_be_made_again(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-3)
    out = calibrated(tmp_path, *people, "--known-load", *runs)
    again = tmp_path / "again"
    assert main(["import", "--again", str(out), "-o", str(again)]) == 0
    for name in ("recordings.csv", "calibration.csv", "calibration_sd.csv", "rig.toml", "dataset.toml"):
        assert (again / name).read_bytes() == (out / name).read_bytes()
    recipe = tomllib.loads((out / "dataset.toml").read_text(encoding="utf-8"))["import"]
    assert len(recipe["sources"]) == len(PEOPLE) + len(LOADS)
    without = calibrated(tmp_path, *people)  # what belonged to the calibration does not stay behind
    assert {file.name for file in without.glob("*.*") if not file.name.startswith(".")} == {
        "recordings.csv",
        "dataset.toml",
    }


def test_noise_is_averaged_over_lines_of_about_one_frequency() -> None:
    close = np.linspace(100.0, 101.0, 9)
    noise = np.array([1.0, 2.0, 1.0, 2.0, 3.0, 2.0, 1.0, 2.0, 1.0])
    assert smoothed_noise(close, noise)[4] == pytest.approx(np.sqrt(np.mean(noise**2)))
    assert smoothed_noise(close, noise)[0] == pytest.approx(np.sqrt(np.mean(noise[:5] ** 2)))
    np.testing.assert_array_equal(smoothed_noise(np.geomspace(1.0, 1e3, 9), noise), noise)


def test_noise_of_few_degrees_of_freedom_explains_its_errors() -> None:
    """Errors over a standard deviation that was estimated from few values are larger than one in the mean square."""
    rng = np.random.default_rng(2)
    close, apart = np.geomspace(1.0, 1e6, 2000), 2.0 ** np.arange(60)
    for frequency, times in ((close, 20), (apart, 600)):
        noise = [np.sqrt(rng.chisquare(8, frequency.size) / 8) for _ in range(times)]
        sd = np.concatenate([smoothed_noise(frequency, one, 8.0) for one in noise])
        # The standard deviation of a square is at most 2, of the mean of 36 000 about 1 %.
        assert np.mean((rng.normal(size=sd.size) / sd) ** 2) == pytest.approx(1.0, abs=0.05)


def test_runs_in_the_folder_of_the_recordings_are_not_people(tmp_path: Path) -> None:
    _, runs = write_all(tmp_path / "all", Rig())
    out = calibrated(tmp_path, str(tmp_path / "all"), "--known-load", *runs)
    assert {one.name for one in read_recordings(out).subjects} == set(PEOPLE)
    require_people(out, 1e-8)


@pytest.mark.parametrize(
    ("count", "how", "sentence"),
    [
        (1, None, r"does not determine gain, skew and mount"),
        (2, "each frequency", r"the mount is taken as rigid there; a third load"),
        (3, "each frequency", None),
    ],
)
def test_what_is_left_undetermined_is_said(count: int, how: str | None, sentence: str | None, tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, RIGID, noise=1e-4)
    out = calibrated(tmp_path, *people, "--known-load", *runs[:count], *([] if how is None else ["--rig", how]))
    assert (sentence is None) == ("taken as" not in said(out))
    assert sentence is None or re.search(sentence, said(out))


def test_a_mount_that_cannot_be_told_from_a_rigid_one_is_said_to_be_that(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, RIGID, noise=1e-3)
    out = calibrated(tmp_path, *people, "--known-load", *runs)
    assert "compliance cannot be told from zero" in said(out)
    shared = tomllib.loads((out / "rig.toml").read_text(encoding="utf-8"))["shared"]
    assert "n_rig" not in shared


def test_one_load_that_is_not_none_leaves_gain_and_seismic_mass_together(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(gain=1.0, delay_s=0.0, mount=0.0))
    out = calibrated(tmp_path, *people, "--known-load", runs[1])
    require_people(out, 1e-8)
    assert "does not separate gain and seismic mass" in said(out)


def test_without_noise_of_the_runs_its_error_is_said_to_be_unknown(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig())
    out = calibrated(tmp_path, *people, "--known-load", *runs, "--rig", "each frequency")
    assert "noise of the calibration runs is not known" in said(out)
    assert not (out / "calibration_sd.csv").exists()


def refused(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The sentence of an import that writes nothing."""
    out = folder / "refused"
    assert main(["import", *arguments, "-o", str(out)]) == 2
    message = capsys.readouterr().err
    assert len(message.splitlines()) == 1
    assert not out.exists()
    return message


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["--known-load", "10 g.csv"], "names no file"),
        (["--known-load", "mass:{mass}"], "no value above zero"),
        (["--known-load", "mass=0 g:{mass}"], "no value above zero"),
        (["--known-load", "mass=1.2.3 g:{mass}"], "no value above zero"),
        (["--known-load", "mass=10:{mass}"], "no value above zero with a unit"),
        (["--known-load", "mass=10 N/m:{mass}"], "is that of dynamic stiffness"),
        (["--known-load", "mas=10 g:{mass}"], 'did you mean "mass"'),
        (["--known-load", "open:{mass}", "mass=10 g:{mass}"], "although the loads (open and mass=10 g) differ"),
        (["--known-load", "open:missing.csv"], "missing.csv"),
        (["--known-load", "inertia=1 kg m^2:{mass}"], "N m s/rad"),
        (["--rig", "smooth"], "give --known-load"),
        (["--rig", "smooth", "--known-load", "open:{open}"], "two different known loads"),
        (["--unloaded", "{person}"], "no recording"),
        (["--unloaded", "{elsewhere}"], "record the runs at the frequencies"),
        (["--unloaded", "{copy}"], "must not be the recording itself"),
        (["--known-load", "open:{open}", "mass=10 g:{elsewhere}"], "same frequencies"),
    ],
)
def test_calibration_that_cannot_be_is_refused(
    given: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    people, runs = write_all(tmp_path, Rig())
    h = Rig().measures(person("A"))
    files = {
        "person": people[0],
        "open": runs[0].partition(":")[2],
        "mass": runs[1].partition(":")[2],
        "elsewhere": write(tmp_path / "elsewhere.csv", h, FREQUENCY * 1.01),
        "copy": write(tmp_path / "copy.csv", h),
    }
    assert sentence in refused(tmp_path, capsys, people[0], *(word.format(**files) for word in given))


def test_loads_that_are_not_what_they_are_said_to_be(tmp_path: Path) -> None:
    people, runs = write_all(tmp_path, Rig(), noise=1e-3)
    wrong = [runs[0], runs[1].replace("10 g", "40 g"), runs[2]]  # not in the proportion of the masses
    out = calibrated(tmp_path, *people, "--known-load", *wrong)
    assert "misfit" in said(out)
    assert "each frequency is taken" in said(out)


def test_a_rig_has_a_covariance_where_a_map_has_two() -> None:
    """Errors of the smooth map are real combinations, so real and imaginary parts of z differ in their error."""
    rig = SmoothRig(values=np.array(Rig().values), covariance=np.diag([1e-4, 0, 0, 0, 0, 0.0]), misfit=None)
    common = rig.at(FREQUENCY).common_sd(Rig().measures(person("A")))
    assert common is not None
    gained = Rig(gain=1.06 + 1e-6)
    slope = (gained.measures(person("A")) - Rig().measures(person("A"))) / 1e-6
    behind = slope * rig.at(FREQUENCY).noise_factor(Rig().measures(person("A")))
    np.testing.assert_allclose(np.hypot(*common.T), 0.01 * np.abs(behind), rtol=1e-4)
