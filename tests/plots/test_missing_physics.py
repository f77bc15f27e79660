"""Pictures of a diagnosis: what they show, in which order, on which scale."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from diagnoses_by_hand import VARIANTS, holes, make_diagnosis

from bayes_impedance.errors import InputError
from bayes_impedance.plots import save_figure, style, write_diagnosis_pictures
from bayes_impedance.plots.missing_physics import (
    DIAGNOSIS_PICTURES,
    bands,
    improvement,
    one_ports,
    pattern_order,
    pooled,
    pooled_residual,
    residual_map,
)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Path]]:
    """PNG files of all variants, drawn once."""
    made = {name: make_diagnosis(**variant) for name, variant in VARIANTS.items() if name in ("two", "unknown")}
    made["holes"] = holes(make_diagnosis(subjects=4))
    return {n: write_diagnosis_pictures(d, tmp_path_factory.mktemp(n), ("png",)) for n, d in made.items()}


@pytest.mark.parametrize(
    ("variant", "absent"),
    [
        ("two", set()),
        ("unknown", {"diagnosis_residuals"}),
        ("holes", set()),
    ],
)
def test_pictures_apply_and_are_not_empty(drawn, variant: str, absent: set[str]) -> None:
    from matplotlib.image import imread

    assert set(drawn[variant]) == set(DIAGNOSIS_PICTURES) - absent
    for file in drawn[variant].values():
        pixels = imread(file)[..., :3]
        assert np.mean(np.any(pixels < 0.97, axis=-1)) > 0.01, file.name


def test_map_shows_the_residuals_in_one_order_and_on_one_scale() -> None:
    diagnosis = make_diagnosis("two", subjects=30)
    with style():
        figure = residual_map(diagnosis)
    assert figure is not None
    before, after = diagnosis.before, diagnosis.after
    order = pattern_order(np.hstack([before.residual_magnitude, before.residual_phase]))
    shown = (before.residual_magnitude, after.residual_magnitude, before.residual_phase, after.residual_phase)
    for axes, rows in zip(figure.axes, shown, strict=False):
        mesh = axes.collections[0]
        np.testing.assert_array_equal(mesh.get_array(), rows[order])
        assert mesh.get_clim() == (-4.0, 4.0)
    assert residual_map(make_diagnosis(subjects=1)) is None


def test_order_follows_the_first_principal_component() -> None:
    rng = np.random.default_rng(4)
    size = rng.permutation(np.arange(40.0))
    rows = np.outer(size, np.sin(np.arange(25))) + 0.01 * rng.normal(size=(40, 25))
    found = size[pattern_order(rows)]
    assert abs(np.corrcoef(found, np.arange(40))[0, 1]) > 0.9999
    assert list(pattern_order(np.full((3, 4), np.nan))) == [0, 1, 2]


def test_pooled_residual_is_the_mean_times_the_root_of_the_number() -> None:
    rows = np.array([[1.0, np.nan, np.nan], [2.0, 3.0, np.nan], [3.0, 5.0, np.nan], [6.0, 1.0, np.nan]])
    np.testing.assert_allclose(pooled(rows), [3.0 * 2, 3.0 * np.sqrt(3), np.nan])
    # Noise stays noise: unit variance whatever the number of people (chi-square with 400 degrees of freedom, 5 sd).
    noise = pooled(np.random.default_rng(0).normal(size=(50, 400)))
    assert abs(np.var(noise) - 1) < 5 * np.sqrt(2 / 400)


def test_pooled_picture_shades_the_bands_inside_of_the_grid() -> None:
    diagnosis = make_diagnosis(subjects=9)
    where = replace(diagnosis.verdict.where, bands_hz=((1.0, 8.0), (700.0, 9000.0), (2e4, 3e4)))
    with style():
        figure = pooled_residual(replace(diagnosis, verdict=replace(diagnosis.verdict, where=where)))
    for axes, rows in zip(
        figure.axes, (diagnosis.before.residual_magnitude, diagnosis.before.residual_phase), strict=True
    ):
        extents = [(p.get_x(), p.get_x() + p.get_width()) for p in axes.patches[:-1]]
        np.testing.assert_allclose(extents, [(5.0, 8.0), (700.0, 5000.0)])
        np.testing.assert_allclose(axes.lines[1].get_ydata(), pooled(rows))


def test_band_columns_are_before_and_after() -> None:
    diagnosis = make_diagnosis(subjects=5)
    with style():
        figure = bands(diagnosis)
        single = bands(make_diagnosis("nothing"))
    assert [axes.get_title(loc="left") for axes in figure.axes[:2]] == ["Before", "After"]
    assert len(figure.axes) == 6
    assert len(single.axes) == 3
    assert single.axes[0].get_title(loc="left") == ""
    np.testing.assert_allclose(figure.axes[1].lines[-1].get_ydata(), diagnosis.after.magnitude[1])


def test_one_ports_show_the_best_places_with_what_they_explain() -> None:
    diagnosis = make_diagnosis()
    with style():
        figure = one_ports(diagnosis)
        quiet = one_ports(make_diagnosis("nothing"))
    assert figure is not None
    assert quiet is not None
    assert len(figure.axes) == 8
    assert [a.get_title(loc="left") for a in figure.axes[:4:2]] == [
        "at port: explains 96 %",
        "at tissue: explains 48 %",
    ]
    assert quiet.axes[0].get_title(loc="left") == "at port"
    np.testing.assert_allclose(figure.axes[1].lines[-1].get_ydata(), diagnosis.one_ports[0].ratio.imag)
    assert figure.axes[-1].get_xlabel() == "frequency (Hz)"
    peak = diagnosis.one_ports[0].ratio.imag.max()
    assert figure.axes[1].get_ylim()[1] > peak
    assert one_ports(replace(diagnosis, one_ports=())) is None


def test_improvement_needs_an_after() -> None:
    with style():
        assert improvement(make_diagnosis("nothing")) is None
        assert len(improvement(make_diagnosis(subjects=4)).axes) == 4
        assert len(improvement(make_diagnosis(subjects=1)).axes) == 2


def test_formats_can_be_chosen(tmp_path: Path) -> None:
    with style():
        figure = pooled_residual(make_diagnosis(subjects=3, size=6))
    assert save_figure(figure, tmp_path, "a", ("png", "pdf")).name == "a.png"
    assert save_figure(figure, tmp_path, "b", ("pdf",)).name == "b.pdf"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.pdf", "a.png", "b.pdf"]
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    for wrong in (("jpeg",), ()):
        with pytest.raises(InputError, match="choose from png, svg and pdf"):
            save_figure(figure, tmp_path, "c", wrong)
