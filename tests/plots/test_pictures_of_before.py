"""Pictures show what the network described before something was added to it, if the result holds it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure
from results_by_hand import described_worse, make_result

from bayes_impedance.plots import bands, coverage, errors, new_figure, style
from bayes_impedance.plots.fit_charts import BEFORE
from bayes_impedance.results.model_before import ModelBefore, with_model_before
from bayes_impedance.results.result import Result


def dotted(draw: Callable[[Figure, Result], Figure], result: Result) -> list[list[np.ndarray]]:
    """Ordinates of the dotted lines of each panel."""
    with style():
        figure = draw(new_figure(8, 8), result)
    return [[line.get_ydata() for line in axes.lines if line.get_linestyle() == ":"] for axes in figure.axes]


@pytest.mark.parametrize("draw", [bands, errors, coverage])
def test_without_it_nothing_is_dotted(draw: Callable[[Figure, Result], Figure]) -> None:
    assert not any(dotted(draw, make_result()))


def test_each_picture_has_it_in_every_panel() -> None:
    plain = make_result()
    earlier = described_worse(plain)
    result = with_model_before(plain, ModelBefore("m1", earlier))
    kept = plain.groups["constant_data"]
    magnitude, divided, phase = dotted(bands, result)
    for low_and_high, of in ((magnitude, earlier.magnitude), (phase, earlier.phase_deg)):
        for drawn, row in zip(low_and_high, (of[0], of[2]), strict=True):
            assert np.ptp(drawn / row) == pytest.approx(0, abs=1e-6 * abs(drawn[0] / row[0]))  # in another unit
    for drawn, row in zip(divided, earlier.magnitude[[0, 2]], strict=True):
        np.testing.assert_allclose(drawn, row / kept["band_centre"][0, 2])
    (size,), (angle,) = dotted(errors, result)
    assert np.ptp(size / earlier.delta_magnitude) == pytest.approx(0, abs=1e-6 * size[0] / earlier.delta_magnitude[0])
    np.testing.assert_allclose(angle, earlier.delta_phase_deg)
    for (share,), own in zip(dotted(coverage, result), earlier.coverage90, strict=True):
        np.testing.assert_allclose(share, 100 * own)


def test_legends_name_it() -> None:
    plain = make_result()
    result = with_model_before(plain, ModelBefore("m1", described_worse(plain)))
    for draw in (bands, errors, coverage):
        with style():
            figure = draw(new_figure(8, 8), result)
        texts = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
        assert sum(BEFORE in text for text in texts) == 1
