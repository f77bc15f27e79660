"""From a finished fit to its result: what is examined, which findings are kept, what the helper does, which files."""

from __future__ import annotations

from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from diagnoses_by_hand import DELAY, make_diagnosis, verdict_of

from bayes_impedance import plots, report
from bayes_impedance.commands import finished_fit
from bayes_impedance.commands.finished_fit import examined_result, write_extended, write_pages
from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.result_folders import FIT_FILES, PICTURE_FOLDER
from bayes_impedance.diagnosis import examine as examining
from bayes_impedance.quality.findings import Finding
from bayes_impedance.results import model_before, predictive
from bayes_impedance.results import result as results
from bayes_impedance.runtime.clock import Clock

FIT: Any = SimpleNamespace(seconds={"modes": 1.0})
FINDINGS = tuple(
    Finding(id="jump", severity=severity, subject=None, repetition=None, frequency_hz=None, message=message)
    for severity, message in (("warning", "a jump"), ("note", "one repetition"), ("warning", "an outlier"))
)


class Helper(Executor):
    """Keeps what it was asked to do."""

    def __init__(self) -> None:
        self.asked: list[Any] = []

    def submit(self, fn: Any, /, *_: Any, **__: Any) -> Future[Any]:
        self.asked.append(fn)
        return Future()


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """What was done, in order, with what; nothing is computed."""
    done: list[tuple[str, Any]] = []

    def step(module: Any, name: str, answer: Any) -> None:
        def function(*arguments: Any, **options: Any) -> Any:
            done.append((name, (arguments, options)))
            return answer

        monkeypatch.setattr(module, name, function)

    step(examining, "examine", "adequacy")
    step(predictive, "predict", "predictive")
    step(results, "make_result", "result")
    step(model_before, "with_model_before", "result with both")
    step(results, "save_result", None)
    step(plots, "write_pictures", {"errors": Path("errors.png")})
    step(report, "write_report", None)
    return done


def test_warnings_are_findings_and_notes_are_not(steps: list[tuple[str, Any]]) -> None:
    clock, options = Clock(), FitOptions(seed=5, subjects=("A",), plain="m1")
    assert examined_result(FIT, options, clock, Helper(), lambda *_: None, FINDINGS) == "result"
    assert [name for name, _ in steps] == ["examine", "predict", "make_result"]
    assert steps[1][1] == ((FIT,), {"seed": 5})
    told = ["a jump", "an outlier"]
    made = steps[2][1][0]
    assert made[:2] == (FIT, "predictive")
    assert made[3:] == (("A",), "adequacy", told, None)
    assert set(clock.seconds) == {"modes", "examine", "predictive"}
    assert clock.seconds["modes"] == 1.0


def test_the_helper_prepares_for_the_pictures(steps: list[tuple[str, Any]]) -> None:
    helper = Helper()
    examined_result(FIT, FitOptions(), Clock(), Helper(), lambda *_: None, (), helper)
    assert helper.asked == [plots.prepare]
    assert len(steps) == 3


def test_the_report_shows_the_pictures_that_were_drawn(steps: list[tuple[str, Any]], tmp_path: Path) -> None:
    result, helper = SimpleNamespace(), Helper()
    write_pages(result, tmp_path, FINDINGS, lambda *_: None, helper)  # type: ignore[arg-type]
    assert steps == [
        ("write_pictures", ((result, tmp_path / PICTURE_FOLDER, helper), {})),
        ("write_report", ((result, tmp_path, FINDINGS, {"errors": Path("errors.png")}), {})),
    ]


def test_the_extended_network_is_an_ordinary_result_that_knows_what_was_before(
    steps: list[tuple[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diagnosis = make_diagnosis()
    verdict = verdict_of((DELAY,), "m1|r1", None, extended_network="delay[d1*](m1|r1)")
    diagnosis = replace(diagnosis, verdict=verdict, fit=FIT)
    removed: list[str] = []
    monkeypatch.setattr(finished_fit, "remove", lambda _, names: removed.extend(names))
    helper = Helper()
    write_extended(diagnosis, tmp_path, FitOptions(seed=3), Helper(), lambda *_: None, helper)  # type: ignore[arg-type]
    assert helper.asked == [plots.prepare]
    assert [name for name, _ in steps] == [
        "examine",
        "predict",
        "make_result",
        "with_model_before",
        "save_result",
        "write_pictures",
        "write_report",
    ]
    assert steps[3][1][0][0] == "result"
    assert steps[3][1][0][1].described is diagnosis.before
    assert steps[4][1][0][0] == steps[6][1][0][0] == "result with both"
    assert steps[5][1][0][-1] is helper
    before = steps[2][1][0][-1]
    assert before["network"] == "m1|r1"
    assert before["delta_phase_deg"] == pytest.approx(diagnosis.before.delta_phase_deg.mean())
    assert set(FIT_FILES) < set(removed)  # no old file contradicts the new result
    assert "report.html" in removed
