"""Seconds of named steps, with a clock that is not the wall's."""

import pytest

from bayes_impedance.runtime import clock as module
from bayes_impedance.runtime.clock import Clock


def test_seconds_of_steps_are_added(monkeypatch: pytest.MonkeyPatch) -> None:
    times = iter([0.0, 2.0, 10.0, 13.0, 20.0, 24.0])
    monkeypatch.setattr(module.time, "perf_counter", lambda: next(times))
    clock = Clock()
    for name in ("fit", "search", "fit"):
        with clock.measure(name):
            pass
    assert clock.seconds == {"fit": 6.0, "search": 3.0}
    assert list(clock.seconds) == ["fit", "search"]


def test_a_step_that_fails_is_not_counted() -> None:
    clock = Clock()

    def failing() -> None:
        with clock.measure("fit"):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    assert clock.seconds == {}
