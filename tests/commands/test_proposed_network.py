"""The network that a verdict proposes: with all effects, else the one after; refused where an effect is no network."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from diagnoses_by_hand import DELAY, RESONATOR, UNKNOWN, verdict_of

from bayes_impedance.commands.fit_options import FitOptions
from bayes_impedance.commands.proposed_network import plain_in, plain_network, proposed_network, start_in
from bayes_impedance.diagnosis.verdict_file import to_json
from bayes_impedance.diagnosis.verdict_types import Verdict
from bayes_impedance.errors import InputError
from bayes_impedance.recordings.files import Recordings

PLAIN, MORE, ALL = "m1|r1", "m1|r1|n1", "delay[d1*](m1|r1)"


def written(folder: Path, verdict: Verdict) -> Path:
    file = folder / "verdict.json"
    file.write_text(json.dumps(to_json(verdict)), encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("verdict", "network"),
    [
        (verdict_of((DELAY,), PLAIN, None, extended_network=ALL), ALL),
        (verdict_of((RESONATOR,), PLAIN, MORE, extended_network=ALL), ALL),
        (verdict_of((RESONATOR,), PLAIN, MORE), MORE),
        (verdict_of((UNKNOWN,), PLAIN, MORE), MORE),
        (verdict_of((), PLAIN, None), PLAIN),
        (
            verdict_of((replace(UNKNOWN, kind="correlation"),), PLAIN, None),
            PLAIN,
        ),  # a structure: there is nothing to add
    ],
)
def test_the_network_with_all_effects_or_the_one_after(tmp_path: Path, verdict: Verdict, network: str) -> None:
    assert proposed_network(written(tmp_path, verdict)) == network
    assert proposed_network(tmp_path) == network  # the folder that has it


def test_effects_that_are_no_network_are_named(tmp_path: Path) -> None:
    file = written(tmp_path, verdict_of((RESONATOR, DELAY, UNKNOWN), PLAIN, None))
    with pytest.raises(InputError, match=r"\(body\.resonator, rig\.delay\) cannot be written as a network; fit m1\|r1"):
        proposed_network(file)


def test_what_was_before_is_known_where_something_was_added(tmp_path: Path) -> None:
    assert plain_in(written(tmp_path, verdict_of((DELAY,), PLAIN, None, extended_network=ALL))) == PLAIN
    assert plain_in(written(tmp_path, verdict_of((RESONATOR,), PLAIN, MORE))) == PLAIN
    assert plain_in(written(tmp_path, verdict_of((), PLAIN, None))) is None


def test_a_fit_begins_near_what_the_verdict_found(tmp_path: Path) -> None:
    near = {"m1": 2e-3, "r1": 1.5, "d1": 1e-4}
    file = written(tmp_path, verdict_of((DELAY,), PLAIN, None, extended_network=ALL, start=near))
    assert start_in(file) == near
    assert start_in(written(tmp_path, verdict_of((DELAY,), PLAIN, None, extended_network=ALL))) is None


@pytest.mark.parametrize(
    ("own", "options", "plain"),
    [
        (PLAIN, FitOptions(network=ALL), PLAIN),
        (PLAIN, FitOptions(network=ALL, plain="r1"), "r1"),  # the verdict's goes before the dataset's
        (None, FitOptions(network=ALL, plain=PLAIN), PLAIN),
        (PLAIN, FitOptions(network=ALL, plain="r1", with_before=False), None),
        (PLAIN, FitOptions(network=ALL, with_before=False), None),
        (PLAIN, FitOptions(network=PLAIN), None),
        (PLAIN, FitOptions(network="m1-(r1|n1)"), None),
        (PLAIN, FitOptions(), None),
        (None, FitOptions(network=ALL), None),
        ("m1|", FitOptions(network=ALL), None),
    ],
)
def test_the_network_before_is_that_of_the_verdict_or_the_dataset_s(
    own: str | None, options: FitOptions, plain: str | None
) -> None:
    recordings = Recordings(title="t", unit="N s/m", network=own, source=None, licence=None, subjects=())
    assert plain_network(recordings, options) == plain


@pytest.mark.parametrize("content", ["{}", '{"schema": 1}', '{"network": ["m1", "m1|r1"]}', '{"schema": 2}'])
def test_what_is_no_verdict_is_refused_with_its_name(tmp_path: Path, content: str) -> None:
    (tmp_path / "verdict.json").write_text(content, encoding="utf-8")
    for read in (proposed_network, plain_in):
        with pytest.raises(InputError, match=r"verdict\.json: this is not a verdict of schema 1"):
            read(tmp_path)


def test_a_folder_without_a_verdict_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        proposed_network(tmp_path)
