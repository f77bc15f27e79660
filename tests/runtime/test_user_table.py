"""One check of every table that a user writes."""

from __future__ import annotations

import datetime

import numpy as np
import pytest

from bayes_impedance.errors import InputError
from bayes_impedance.runtime.user_table import UserTable, choice_in, number_in, shown, text_in


def test_keys_that_are_not_known_are_refused_or_told() -> None:
    with pytest.raises(InputError, match='here: key "delay" is not used; did you mean "delay_s"'):
        UserTable({"delay": 1}, "here", ("delay_s", "period_s"))
    with pytest.raises(InputError, match='key "zzz" is not used; known are delay_s, period_s'):
        UserTable({"zzz": 1}, "here", ("delay_s", "period_s"))
    table = UserTable({"zzz": 1, "a": 2.0}, lambda key: f"line of {key}", ("a",), tolerant=True)
    assert table.unknown == ("zzz",)
    assert table.about_unknown("zzz").startswith("line of zzz")
    assert table.number("a") == 2.0
    with pytest.raises(InputError, match='key "b" is missing'):
        table.number("b")
    assert table.number("b", 3.0) == 3.0
    with pytest.raises(InputError, match="is a list, but must be a table"):
        UserTable([1], "here", ("a",))


@pytest.mark.parametrize(
    "value", [True, False, np.True_, "1", None, [1], {}, float("nan"), float("inf"), 1 << 2000, 1j]
)
def test_what_is_no_number(value: object) -> None:
    with pytest.raises(InputError, match=r"x is .*, but must be a finite number"):
        number_in(value, "x")


def test_ranges() -> None:
    assert number_in(np.float32(2), "x", above=1, at_most=2) == 2.0
    assert number_in(1, "x", at_least=1, below=2) == 1.0
    for value, bounds in ((1, {"above": 1}), (2, {"below": 2}), (0, {"at_least": 1}), (3, {"at_most": 2})):
        with pytest.raises(InputError, match="must be a finite number"):
            number_in(value, "x", **{k: float(v) for k, v in bounds.items()})


def test_words_and_text() -> None:
    assert choice_in("rig", "x", ("rig", "body")) == "rig"
    with pytest.raises(InputError, match=r'x is "rgi" .did you mean "rig".., but must be one of rig, body'):
        choice_in("rgi", "x", ("rig", "body"))
    for value in (3, ["rig"], None):
        with pytest.raises(InputError, match="must be one of"):
            choice_in(value, "x", ("rig", "body"))
        with pytest.raises(InputError, match="must be text"):
            text_in(value, "x")


def test_any_value_is_shown_in_one_short_line() -> None:
    # Not as parameters: pytest would write the numbers of thousands of digits into its names.
    date = datetime.date(2020, 1, 1)
    for value in (
        "x" * 10_000,
        "a\nb\x1b[31m",
        1 << 20_000,
        -(1 << 20_000),
        [[1] * 10_000],
        {"a": 1},
        date,
        object(),
        b"x",
    ):
        assert len(shown(value)) < 100
        assert shown(value).isprintable()
