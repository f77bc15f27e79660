"""The paper's pictures: what is given is what is drawn, nothing missing breaks them, and files repeat byte by byte."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.plots import all_curves, bode, error_bars, new_figure, save_figure, style

FREQUENCY = np.geomspace(5, 5000, 40)
MAGNITUDE_FIT, TABLE, OWN = "fitted to magnitudes", "look-up table", "this package"
LABELS = ["fit, mean", "fit, median", "table, mean", "table, median", "centre", "no end"]
FAMILIES = [MAGNITUDE_FIT, MAGNITUDE_FIT, TABLE, TABLE, OWN, OWN]
MEAN = [812.0, 2.4, 1.91, 1.83, 1.9, math.nan]
SD = [1430.0, 30.0, 1.2, 2.5, math.nan, math.nan]


@pytest.fixture(autouse=True)
def common_style():
    with style():
        yield


@pytest.fixture
def axes():
    return new_figure(8, 4).subplots()


def people(n=12, missing=True):
    rng = np.random.default_rng(0)
    s = 2j * np.pi * FREQUENCY
    mass, damping, compliance = np.exp(0.2 * rng.normal(size=(3, n, 1))) * np.array([8e-4, 5.0, 1e-3])[:, None, None]
    z = s * mass + damping + 1 / (s * compliance)
    if missing:
        z[3, :7] = np.nan
        z[:, 20] = np.nan
        z[5] = np.nan
    return z


def texts(axes):
    return [text.get_text() for text in axes.texts]


# ---------------------------------------------------------------- everybody's curves


@pytest.mark.parametrize("part", ["magnitude", "phase"])
def test_all_curves_are_those_given(axes, part: str) -> None:
    z = people()
    z[0, 30] = np.inf
    assert all_curves(axes, FREQUENCY, z, "N s/m", part) is axes
    axes.figure.draw_without_rendering()
    segments = axes.collections[0].get_segments()
    expected = np.abs(z) if part == "magnitude" else np.degrees(np.arctan2(z.imag, z.real))
    expected[~np.isfinite(z)] = np.nan
    drawn = [segment for segment in segments if len(segment)]
    present = [row for row in expected if np.isfinite(row).any()]
    assert len(drawn) == len(present) == 11
    for segment, row in zip(drawn, present, strict=True):
        np.testing.assert_allclose(segment[:, 1], row[np.isfinite(row)], rtol=1e-12)
        np.testing.assert_allclose(segment[:, 0], FREQUENCY[np.isfinite(row)], rtol=1e-12)
    assert axes.get_ylabel() == ("|z| (N s/m)" if part == "magnitude" else "phase (°)")
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log" if part == "magnitude" else "linear")
    low, high = axes.get_ylim()
    assert low < np.nanmin(expected) < np.nanmax(expected) < high


def test_all_curves_in_a_readable_unit(axes) -> None:
    all_curves(axes, FREQUENCY, people() / 1e3, "ohm", "magnitude")
    assert axes.get_ylabel() == "|z| (mΩ)"
    low, high = axes.get_ylim()
    assert low < np.nanmin(np.abs(people())) < np.nanmax(np.abs(people())) < high


# ---------------------------------------------------------------- models over the data


def models():
    z = people(missing=False)
    gap = z[1].copy()
    gap[:5] = np.nan
    return {"system identification": z[0], "vector fitting": gap, "far away": 1e6 * z[2]}


@pytest.mark.parametrize("part", ["magnitude", "phase"])
def test_bode_shows_models_over_the_data(axes, part: str) -> None:
    z, curves = people(), models()
    assert bode(axes, FREQUENCY, curves, z, "N s/m", part) is axes
    axes.figure.draw_without_rendering()
    value = np.abs if part == "magnitude" else lambda x: np.degrees(np.arctan2(x.imag, x.real))
    lines = {line.get_label(): line.get_ydata() for line in axes.lines}
    assert list(lines) == ["data, median", *curves]
    some = np.arange(FREQUENCY.size) != 20
    np.testing.assert_allclose(lines["data, median"][some], np.nanmedian(value(z[:, some]), axis=0), rtol=1e-12)
    assert np.isnan(lines["data, median"][20])
    for label, curve in curves.items():
        np.testing.assert_allclose(lines[label], value(curve), rtol=1e-9)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["data, 5–95 %", "data, median", *curves]
    assert len({line.get_color() for line in axes.lines}) == len(lines)
    assert len({str(line._dash_pattern) for line in axes.lines[1:]}) == len(curves)


def test_the_shade_holds_nine_of_ten_people(axes) -> None:
    z = (1 + np.arange(101)[:, None]) * np.ones(FREQUENCY.size) + 0j
    bode(axes, FREQUENCY, {}, z, "N s/m", "magnitude")
    heights = axes.collections[0].get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((6, 96))


def test_a_model_far_away_leaves_the_data_readable(axes) -> None:
    bode(axes, FREQUENCY, models(), people(), "N s/m", "magnitude")
    low, high = axes.get_ylim()
    assert low < np.nanmin(np.abs(people()))
    assert np.nanmax(np.abs(people())) < high < 30 * np.nanmax(np.abs(people()))


def test_phases_of_models_do_not_jump(axes) -> None:
    """Data around 90 degrees; what falls from 290 to 150 stays in one piece, and on the side of the data."""
    turning = np.exp(1j * np.radians(np.linspace(290, 150, FREQUENCY.size)))
    bode(axes, FREQUENCY, {"turning": turning}, 1j * people(), "N s/m", "phase")
    np.testing.assert_allclose(axes.lines[-1].get_ydata(), np.linspace(290, 150, FREQUENCY.size), rtol=1e-9)


def test_an_unknown_part_is_refused(axes) -> None:
    for draw in (
        lambda: all_curves(axes, FREQUENCY, people(), "ohm", "angle"),
        lambda: bode(axes, FREQUENCY, {}, people(), "ohm", "angle"),
    ):
        with pytest.raises(InputError, match="no part 'angle': choose 'magnitude' or 'phase'"):
            draw()


def test_only_the_lowest_panel_names_the_frequencies() -> None:
    upper, lower = new_figure(8, 6).subplots(2, 1, sharex=True)
    for axes, part in ((upper, "magnitude"), (lower, "phase")):
        bode(axes, FREQUENCY, models(), people(), "N s/m", part, legend=False)
        assert axes.get_legend() is None
    assert (upper.get_xlabel(), lower.get_xlabel()) == ("", "frequency (Hz)")


def test_nobody_measured_is_drawn_empty() -> None:
    """No curve, no value on any line, and axes that can still be read."""
    nobody = np.full((3, FREQUENCY.size), np.nan + 0j)
    for part in ("magnitude", "phase"):
        figure = new_figure(8, 6)
        left, right = figure.subplots(1, 2)
        all_curves(left, FREQUENCY, nobody, "N s/m", part)
        bode(right, FREQUENCY, {"none": nobody[0]}, nobody, "N s/m", part)
        figure.draw_without_rendering()
        assert not [segment for curves in left.collections for segment in curves.get_segments() if len(segment)]
        assert [line.get_label() for line in right.lines] == ["data, median", "none"]
        assert all(np.isnan(line.get_ydata()).all() for line in right.lines)
        for axes in (left, right):
            assert axes.get_ylabel() == ("|z| (N s/m)" if part == "magnitude" else "phase (°)")
            low, high = axes.get_ylim()
            assert np.isfinite([low, high]).all()
            assert low < high


# ---------------------------------------------------------------- errors


def test_bars_are_as_long_as_the_errors(axes) -> None:
    assert error_bars(axes, LABELS, MEAN, SD, families=FAMILIES) is axes
    axes.figure.draw_without_rendering()
    assert [label.get_text() for label in axes.get_yticklabels()] == LABELS
    right = axes.get_xlim()[1]
    bars = {round(bar.get_y() + bar.get_height() / 2): bar for bar in axes.patches}
    assert [bars[i].get_width() for i in range(6)] == pytest.approx([right, 2.4, 1.91, 1.83, 1.9, 0.0])
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # the first is on top
    assert 3.11 < right < 10  # the longest bar would hide all others
    assert [text.get_text() for text in axes.get_legend().get_texts()] == list(dict.fromkeys(FAMILIES))
    colours = [bars[i].get_facecolor() for i in range(6)]
    assert all((colours[i] == colours[j]) == (FAMILIES[i] == FAMILIES[j]) for i in range(6) for j in range(6))


def test_numbers_are_written_beside_the_bars(axes) -> None:
    error_bars(axes, LABELS, MEAN, SD)
    assert texts(axes) == ["812 ± 1430", "2.40 ± 30.00", "1.91 ± 1.20", "1.83 ± 2.50", "1.90", "no value"]
    assert axes.get_legend() is None


@pytest.mark.parametrize(
    ("value", "deviation", "text"),
    [(3.2e7, 5e8, "3.2×10⁷ ± 5.0×10⁸"), (31.04, 0.2, "31.0 ± 0.2"), (0.0, 0.0, "0 ± 0"), (0.5, math.inf, "0.500")],
)
def test_numbers_of_any_size(axes, value: float, deviation: float, text: str) -> None:
    error_bars(axes, ["one"], [value], [deviation], unit="°")
    assert texts(axes) == [text]
    axes.figure.draw_without_rendering()


def test_deviations_stay_above_zero_and_inside(axes) -> None:
    error_bars(axes, LABELS, MEAN, SD)
    right = axes.get_xlim()[1]
    marks_of = {
        m: [x for x in axes.lines if x.get_marker() == m and x.get_color() != "white"] for m in ("None", "|", ">")
    }
    rows = [int(line.get_ydata()[0]) for line in marks_of["None"]]
    assert rows == [1, 2, 3]  # neither the bar that is cut nor those without a deviation
    for row, line in zip(rows, marks_of["None"], strict=True):
        assert line.get_xdata() == pytest.approx([max(MEAN[row] - SD[row], 0), min(MEAN[row] + SD[row], right)])
    assert [len(line.get_xdata()) for line in marks_of["|"]] == [0, 2, 1]  # no cap at zero and none outside
    assert [list(line.get_ydata()) for line in marks_of[">"]] == [[1]]
    marks = [line for line in axes.lines if line.get_color() == "white"]
    assert [round(float(np.mean(line.get_ydata()))) for line in marks] == [0, 0]


def test_comparable_errors_are_not_cut(axes) -> None:
    error_bars(axes, ["a", "b", "c"], [1.0, 2.0, 4.5], [0.2, 0.3, 0.4])
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([1.0, 2.0, 4.5])
    assert axes.get_xlim()[1] == pytest.approx(1.1 * 4.9)
    assert not [line for line in axes.lines if line.get_color() == "white"]


@pytest.mark.parametrize("mean", [[math.nan, math.nan], [0.0, 0.0], [0.0, math.inf]])
def test_errors_without_a_size_are_drawn(axes, mean) -> None:
    error_bars(axes, ["a", "b"], mean, [0.0, math.nan])
    axes.figure.draw_without_rendering()
    assert texts(axes).count("no value") == sum(not math.isfinite(x) for x in mean)


@pytest.mark.parametrize(
    ("unit", "factor", "label"),
    [
        ("N s/m", 1, "magnitude error (N s/m)"),
        ("ohm", 1e-3, "magnitude error (mΩ)"),
        ("°", 1, "phase error (°)"),
        ("deg", 1e-3, "phase error (°)"),
    ],
)
def test_errors_have_units(axes, unit: str, factor: float, label: str) -> None:
    error_bars(axes, ["a", "b"], np.array([2.0, 3.0]) * factor, np.array([1.0, 1.0]) * factor, unit=unit)
    assert axes.get_xlabel() == label
    in_unit = 1.0 if unit in ("N s/m", "ohm") else factor
    assert [bar.get_width() for bar in axes.patches] == pytest.approx([2 * in_unit, 3 * in_unit])
    assert texts(axes)[1] == ("3.00 ± 1.00" if in_unit == 1 else "0.00300 ± 0.00100")


def test_what_does_not_belong_together_is_refused(axes) -> None:
    with pytest.raises(InputError, match="2 labels, 1 means, 2 deviations and 2 families"):
        error_bars(axes, ["a", "b"], [1.0], [1.0, 2.0])
    with pytest.raises(InputError, match="1 families"):
        error_bars(axes, ["a", "b"], [1.0, 1.0], [1.0, 2.0], families=["x"])
    with pytest.raises(InputError, match="negative"):
        error_bars(axes, ["a", "b"], [1.0, -1.0], [1.0, 2.0])


def test_two_axes_share_their_labels_and_one_legend() -> None:
    figure = new_figure(8.2, 3.5)
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, unit in ((left, "N s/m"), (right, "°")):
        error_bars(axes, LABELS, MEAN, SD, families=FAMILIES, unit=unit, legend=False)
    figure.legend(*left.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    figure.draw_without_rendering()
    assert left.get_ylim() == right.get_ylim() == (5.6, -0.6)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == list(dict.fromkeys(FAMILIES))
    edge = figure.bbox.x1
    assert all(text.get_window_extent().x1 <= edge for text in right.texts)
    assert max(text.get_window_extent().x1 for text in left.texts) < right.get_window_extent().x0


# ---------------------------------------------------------------- files


def drawn():
    figure = new_figure(8, 6)
    axes = figure.subplots(3, 1)
    all_curves(axes[0], FREQUENCY, people(), "N s/m", "magnitude")
    bode(axes[1], FREQUENCY, models(), people(), "N s/m", "phase")
    error_bars(axes[2], LABELS, MEAN, SD, families=FAMILIES)
    return figure


def test_figures_are_saved_twice_with_the_same_bytes(tmp_path: Path) -> None:
    first = save_figure(drawn(), tmp_path / "new" / "folder", "paper")
    figure = drawn()
    second = save_figure(figure, tmp_path, "again")
    third = save_figure(figure, tmp_path, "same")
    assert first == tmp_path / "new" / "folder" / "paper.png"
    assert sorted(file.name for file in first.parent.iterdir()) == ["paper.png", "paper.svg"]
    assert first.read_bytes().startswith(b"\x89PNG")
    for suffix in (".png", ".svg"):
        written = first.with_suffix(suffix).read_bytes()
        assert written == second.with_suffix(suffix).read_bytes() == third.with_suffix(suffix).read_bytes()


def test_saving_outside_of_the_style_gives_the_same_bytes(tmp_path: Path) -> None:
    import matplotlib

    inside = save_figure(drawn(), tmp_path, "inside")
    figure = drawn()
    with matplotlib.rc_context({"svg.hashsalt": None, "savefig.facecolor": "red"}):
        outside = save_figure(figure, tmp_path, "outside")
        assert matplotlib.rcParams["savefig.facecolor"] == "red"
    for suffix in (".png", ".svg"):
        assert inside.with_suffix(suffix).read_bytes() == outside.with_suffix(suffix).read_bytes()
