"""Hum that was only imagined: what looked like it is gone beside what was found."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bayes_impedance.diagnosis import first_fit
from bayes_impedance.diagnosis.first_fit import FirstFit

HUM: Any = SimpleNamespace(frequency_hz=50.0)
NOBODY: Any = None
FINAL: Any = SimpleNamespace(model="with a resonance", u="there", population="of all")


class Everything:
    """The fit to all points, which remembers what was fitted to them."""

    def __init__(self) -> None:
        self.recordings = SimpleNamespace(names=("S1", "S2"))
        self.refitter = self
        self.asked: list[tuple[Any, ...]] = []

    def fit(self, *arguments: Any) -> str:
        self.asked.append(arguments[:3])
        return "beside the resonance"


def first_of(hum: Any) -> tuple[FirstFit, Everything]:
    every: Any = Everything()
    clean: Any = SimpleNamespace(names=("S1", "S2"))
    return FirstFit(clean=clean, fitted=NOBODY, hum=hum, spoilt=NOBODY, to_everything=every), every


@pytest.mark.parametrize("left", [None, HUM])
def test_it_is_looked_for_again_in_all_points_beside_what_was_found(left: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_fit, "person_residuals", lambda fit, names, _: (fit, names))
    seen: list[Any] = []

    def hum_in(residuals: Any) -> Any:
        seen.append(residuals)
        return left

    monkeypatch.setattr(first_fit, "_hum_in", hum_in)
    first, every = first_of(HUM)
    assert first.imagined(FINAL, NOBODY) is (left is None)
    assert every.asked == [("with a resonance", "there", "of all")]
    assert seen == [("beside the resonance", ("S1", "S2"))]


def test_without_hum_nothing_is_fitted() -> None:
    first, every = first_of(None)
    assert first.imagined(FINAL, NOBODY) is False
    assert every.asked == []


def test_then_all_points_take_part() -> None:
    first, every = first_of(HUM)
    again = first.of_everything()
    assert again.hum is None
    assert again.spoilt is None
    assert again.clean is every.recordings
    assert again.fitted is every
