"""What the terminal says of a result and of a verdict that must not be relied on."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import pytest
from diagnoses_by_hand import PAPER_NETWORK, make_diagnosis, verdict_of
from results_by_hand import make_result

from bayes_impedance.commands.cli import DONE, FAILED, _finish, _tell_verdict

COPIES = "11 of 12 subjects are copies of others"


def test_effects_of_a_verdict_that_is_not_reliable_are_not_listed(capsys: pytest.CaptureFixture[str]) -> None:
    verdict = make_diagnosis().verdict
    _tell_verdict(verdict)
    ids = {entry.id for entry in verdict.physics}
    assert all(f"{id} at " in capsys.readouterr().out for id in sorted(ids)[:1])
    refused = replace(verdict, reliable=False, shortcomings=(COPIES,), remarks=(COPIES, "Something else."))
    _tell_verdict(refused)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"NOT RELIABLE: {COPIES}"
    assert lines[1] == "note: Something else."
    assert not [line for line in lines if line.startswith(tuple(ids)) or line.startswith("    ")]


def test_people_whom_a_reliable_verdict_leaves_out_stay_a_note(capsys: pytest.CaptureFixture[str]) -> None:
    _tell_verdict(verdict_of((), PAPER_NETWORK, None, shortcomings=("One is far off.",), remarks=("One is far off.",)))
    assert capsys.readouterr().out.startswith("note: One is far off.\n")


def test_a_mark_belongs_to_a_number(capsys: pytest.CaptureFixture[str]) -> None:
    result = make_result()
    summary = deepcopy(result.summary)
    first, second = list(summary["elements"])[:2]
    summary["elements"][first]["marked"] = summary["elements"][second]["marked"] = True
    nothing = {"median": None, "q05": None, "q95": None}
    summary["elements"][second]["central"] = nothing
    assert _finish(replace(result, summary=summary), "end") == DONE
    said = capsys.readouterr().out
    assert f"\n{first}* " in said
    assert f"\n{second}* " not in said
    assert "because of the misfit" in said
    summary["elements"][first]["central"] = nothing
    summary["problems"] = ["no number holds"]
    assert _finish(replace(result, summary=summary), "end") == FAILED
    assert "*" not in capsys.readouterr().out


def test_the_network_of_electrical_recordings_is_told_in_both_spellings(capsys: pytest.CaptureFixture[str]) -> None:
    _finish(make_result(electrical=True), "end")
    assert "network r0|(r1-n1) = R0-p(R1,C1)\n" in capsys.readouterr().out
    verdict = make_diagnosis(electrical=True).verdict
    _tell_verdict(replace(verdict, unit="ohm", extended_network="r0|(r1-p1^a1@10)"))
    said = capsys.readouterr().out
    assert "\nnetwork r0|(r1-n1)|(r2-n2) = R0-p(R1,C1)-p(R2,C2)\n" in said
    assert "\nwith what was found: r0|(r1-p1^a1@10) = R0-p(R1,CPE1)\n" in said
    _tell_verdict(verdict_of((), PAPER_NETWORK, None))
    said = capsys.readouterr().out
    assert f"\nnetwork {PAPER_NETWORK}\n" in said
    assert "with what was found" not in said
