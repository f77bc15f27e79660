"""What single formats have of their own: records, groups, sheets, segments, ports."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from kinds_of_files import lvm
from known_impedance import FREQUENCY, impedance, imported, table

from bayes_impedance.commands.cli import main
from bayes_impedance.recordings import read_recordings

F, Z = FREQUENCY, impedance()
S = 2j * np.pi * F


def refused(capsys: pytest.CaptureFixture[str], file: Path, *options: str) -> str:
    assert main(["import", str(file), "-o", str(file.parent / "out"), *options]) == 2
    assert not (file.parent / "out").exists()
    return capsys.readouterr().err


def responses(file: Path, places: list[tuple[int, int, int, int]], kind: int = 11, label: str = "") -> None:
    """Mobilities at places (response node and direction, reference node and direction)."""
    pyuff = pytest.importorskip("pyuff")
    for k, (node, direction, other, toward) in enumerate(places):
        data = pyuff.prepare_58(
            binary=0, func_type=4, rsp_node=node, rsp_dir=direction, ref_node=other, ref_dir=toward, rsp_ent_name="A",
            ref_ent_name="A", abscissa_spacing=0, abscissa_spec_data_type=18, ordinate_spec_data_type=kind,
            orddenom_spec_data_type=13, ordinate_axis_units_lab=label, data=(1 + k) / Z, x=np.round(F), id1="a test",
        )  # fmt: skip
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            pyuff.UFF(str(file)).write_sets(data, "add")


def test_transfer_functions_are_no_impedances(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "a.uff"
    responses(file, [(2, 3, 1, 3), (1, 2, 1, 3)])
    assert "none of its 2 frequency responses is a driving point (the first is 2+3/1+3)" in refused(capsys, file)
    assert "there are 2+3/1+3, 1+2/1+3" in refused(capsys, file, "--record", "3+3/1+3")
    np.testing.assert_allclose(imported(tmp_path, file, "--record", "2+3/1+3").z[0], Z, rtol=1e-5)
    np.testing.assert_allclose(imported(tmp_path, file, "--record", "2").z[0], Z / 2, rtol=1e-5)


def test_several_driving_points_are_repetitions_and_labels_are_units(tmp_path: Path) -> None:
    file = tmp_path / "a.uff"
    responses(file, [(1, 3, 1, 3), (2, 3, 1, 3), (1, 3, 1, 3)], label="mm/s")
    subject = imported(tmp_path, file)
    assert subject.repetitions == ("1", "2")
    np.testing.assert_allclose(subject.z, [1e3 * Z, 1e3 * Z / 3], rtol=1e-5)


def test_touchstone_is_read_as_by_scikit_rf(tmp_path: Path) -> None:
    skrf = pytest.importorskip("skrf")
    network = skrf.Network(f=F * 1e3, f_unit="Hz", z=(50 * Z)[:, None, None], z0=75)
    for form in ("ri", "ma", "db"):
        network.write_touchstone("a", dir=tmp_path, form=form)
        subject = imported(tmp_path, tmp_path / "a.s1p")
        np.testing.assert_allclose(subject.frequency_hz, F * 1e3, rtol=1e-12)
        np.testing.assert_allclose(subject.z[0], 50 * Z, rtol=1e-9)


@pytest.mark.parametrize(
    ("lines", "value"),
    [("# Hz Z RI R 10", Z / 10), ("# Hz Y RI R 10", 10 / Z), ("#", None)],
)
def test_parameters_of_touchstone(lines: str, value: np.ndarray | None, tmp_path: Path) -> None:
    if value is None:  # the defaults: GHz, S, MA, 50 ohm
        s = (Z - 50) / (Z + 50)
        rows = [f"{f * 1e-9!r} {abs(a)!r} {np.angle(a, deg=True)!r} ! x" for f, a in zip(F.tolist(), s, strict=True)]
        rows = [row.replace("np.float64(", "").replace(")", "") for row in rows]
    else:
        rows = [f"{f!r} {a.real!r} {a.imag!r}" for f, a in zip(F.tolist(), value.tolist(), strict=True)]
    (tmp_path / "a.s1p").write_text("\n".join([lines, *rows]), encoding="utf-8")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.s1p").z[0], Z, rtol=1e-9)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("# Hz S RI R 50\n1 0 0 0 0 0 0 0 0\n", "a one-port has 3"),
        ("# Hz H RI R 50\n1 0 0\n", "option"),
        ("# Hz S RI R x\n1 0 0\n", "not a number"),
        ("# Hz S RI R 50\n1 0 zero\n", "no row of numbers"),
        ("[Version] 2.0\n# Hz S RI R 50\n", "version 2"),
        ("! nothing\n", "no rows of numbers"),
    ],
)
def test_touchstone_that_cannot_be_used(
    content: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.s1p").write_text(content, encoding="utf-8")
    assert sentence in refused(capsys, tmp_path / "a.s1p")


def test_sheets_of_a_workbook(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "notes"
    book.active.append(["measured", "on Monday"])
    sheet = book.create_sheet("data")
    for row in [["made by a test"], [], ["f (Hz)", "z_re", "z_im", "remark"]]:
        sheet.append(row)
    for k, (f, z) in enumerate(zip(F.tolist(), Z.tolist(), strict=True)):
        sheet.append([f, z.real, z.imag, "first" if k == 0 else None])
    book.save(tmp_path / "a.xlsx")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.xlsx", "--record", "data").z[0], Z)
    assert 'did you mean "data"?' in refused(capsys, tmp_path / "a.xlsx", "--record", "date")
    assert "no rows of numbers" in refused(capsys, tmp_path / "a.xlsx")


def test_a_second_sheet_with_numbers_is_not_left_out_silently(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It may be another person; words and a few numbers are none."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.title = "S01"
    remarks = book.create_sheet("remarks")
    remarks.append(["gain", 2.0, 3.0, 4.0])
    remarks.append(["measured", "on Monday"])
    for sheet in (book["S01"], book.create_sheet("S02")):
        sheet.append(["f (Hz)", "z_re", "z_im"])
        for f, z in zip(F.tolist(), Z.tolist(), strict=True):
            sheet.append([f, z.real, z.imag])
    book.save(tmp_path / "a.xlsx")
    said = refused(capsys, tmp_path / "a.xlsx")
    assert '2 sheets ("S01", "S02")' in said
    assert "--record" in said
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.xlsx", "--record", "S02").z[0], Z)
    del book["S02"]
    book.save(tmp_path / "a.xlsx")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.xlsx").z[0], Z)


def test_groups_of_tdms_are_realisations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nptdms = pytest.importorskip("nptdms")
    from simulated_signals import Multisine

    sines = Multisine()
    with nptdms.TdmsWriter(tmp_path / "a.tdms") as writer:
        for k in range(3):
            force, x = (signal.ravel() for signal in sines.periods(4, k, noise=1e-3))
            for name, values, unit in (("F", force, "N"), ("x", x, "m")):
                properties = {"wf_increment": 1 / sines.rate_hz, "unit_string": unit}
                writer.write_segment([nptdms.ChannelObject(f"run {k}", name, values, properties=properties)])
    assert imported(tmp_path, tmp_path / "a.tdms").z.shape == (1, 48)
    assert "3 realisations scatter" in capsys.readouterr().out
    one = imported(tmp_path, tmp_path / "a.tdms", "--record", "run 1")
    np.testing.assert_allclose(one.z[0], sines.impedance(), rtol=0.02)
    assert "there is no group" in refused(capsys, tmp_path / "a.tdms", "--record", "run 7")


def test_segments_of_labview_are_realisations(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lvm(tmp_path / "a.lvm")
    lines = (tmp_path / "a.lvm").read_text(encoding="utf-8").splitlines()
    again = lines.index("Channels\t2\t\t")
    (tmp_path / "a.lvm").write_text("\n".join([*lines, "", *lines[again:]]) + "\n", encoding="utf-8")
    assert imported(tmp_path, tmp_path / "a.lvm").z.shape == (1, 48)
    assert "2 realisations" in capsys.readouterr().out


def test_seventy_one_files_are_seventy_one_persons(tmp_path: Path) -> None:
    for k in range(71):
        text = table({"f": F, "z_re": Z.real + k, "z_im": Z.imag})
        (tmp_path / f"person {k:02}.csv").write_text(text, encoding="utf-8")
    (tmp_path / ".hidden").write_text("not a recording", encoding="utf-8")
    assert main(["import", str(tmp_path), "-o", str(tmp_path.parent / "seventy_one")]) == 0
    recordings = read_recordings(tmp_path.parent / "seventy_one")
    assert len(recordings) == 71
    assert recordings.names[7] == "person 07"
    np.testing.assert_allclose(recordings.subjects[7].z[0].real, Z.real + 7)


def test_structures_and_matrices_of_matlab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from scipy.io import savemat

    both = np.stack([F, (1 / Z).real, (1 / Z).imag], axis=1)
    savemat(tmp_path / "a.mat", {"result": {"M": both, "by": "somebody"}, "other": {"M": 1.0}})
    columns = ("--columns", "frequency=result.M 1", "real=result.M 2", "imaginary=result.M 3", "--unit", "m/(N s)")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.mat", *columns).z[0], Z)
    assert "no arrays of numbers" in refused(capsys, tmp_path / "a.mat", "--record", "other")


def test_complex_arrays_are_named_first_where_none_is_clear(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = {f"channel_{i}": F for i in range(20)}
    np.savez(tmp_path / "a.npz", f=F, **other, answer=Z)
    said = refused(capsys, tmp_path / "a.npz")
    assert "(columns: answer, f, channel_0" in said
    assert "and 10 more)" in said
    assert "or complex=NAME" in said
    columns = ("--columns", "frequency=f", "complex=answer", "--unit", "N s/m")
    np.testing.assert_allclose(imported(tmp_path, tmp_path / "a.npz", *columns).z[0], Z)
