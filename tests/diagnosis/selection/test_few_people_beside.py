"""Of few people an effect of the body counts beside others only if it leaves no structure."""

from types import SimpleNamespace
from typing import Any

import pytest

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.selection import few_people

EFFECTS = {effect.id: effect for effect in registered()}
DELAY, HYSTERESIS = EFFECTS["rig.delay"], EFFECTS["body.hysteresis"]


@pytest.mark.parametrize(
    ("last", "structured", "expected"),
    [
        (DELAY, True, True),  # a chain may have more than one thing in it
        (DELAY, False, True),
        (HYSTERESIS, True, False),  # it stands for what is left in many ways
        (HYSTERESIS, False, True),
    ],
)
def test_an_effect_of_the_body_has_to_leave_nothing(
    monkeypatch: pytest.MonkeyPatch, last: Any, structured: bool, expected: bool
) -> None:
    fit, grown = (SimpleNamespace(evidence=e, data=(), model=None) for e in (0.0, 500.0))
    grown.model = SimpleNamespace(additions=[SimpleNamespace(effect=last)])
    monkeypatch.setattr(few_people, "log_evidence", lambda fit: fit.evidence)
    monkeypatch.setattr(few_people, "residuals_that_say_one_thing", lambda _: 10.0)
    monkeypatch.setattr(few_people, "held_out", lambda *_: SimpleNamespace(blocks=3.0))
    monkeypatch.setattr(few_people, "leaves_structure", lambda *_: structured)
    refitter: Any = SimpleNamespace(executor=None)
    assert few_people.holds_beside(refitter, fit, grown, 1, list(EFFECTS.values())) == expected  # type: ignore[arg-type]
