"""The diagnosis from recordings to verdict: found, nothing, one recording, a claimed simulation, unknown physics."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.commands.cli import main
from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.diagnosis.claimed_simulation import Claim
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.diagnosis.types import Diagnosis
from bayes_impedance.diagnosis.verdict_file import from_json, to_json
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import Recordings, Subject, read_recordings, write_recordings

FREQUENCY = np.geomspace(5, 5000, 81)
SCHEMA = {
    "schema", "mismatch", "summary", "where", "physics", "improvement", "network", "unexplained", "detectable",
    "not_identifiable", "elements_not_identified", "seed", "data_sha256",
}  # fmt: skip


def people(n: int, seed: int, repetitions: int = 2) -> Recordings:
    return simulate_recordings(FINGERTIP, n, repetitions, FREQUENCY, seed).recordings


def changed(recordings: Recordings, change) -> Recordings:
    """Recordings with their impedance changed by a function of s and z."""

    def one(subject: Subject) -> Subject:
        return replace(subject, z=change(2j * np.pi * subject.frequency_hz, subject.z))

    return replace(recordings, subjects=tuple(one(s) for s in recordings.subjects))


DELAY = 8e-6


@pytest.fixture(scope="module")
def delayed() -> Diagnosis:
    return diagnose(changed(people(16, 3), lambda s, z: z * np.exp(-s * DELAY)), seed=1, quick=True)


@pytest.fixture(scope="module")
def clean() -> Diagnosis:
    return diagnose(people(16, 3), seed=1)


def test_a_skew_between_the_channels_is_found_named_measured_and_placed(delayed: Diagnosis) -> None:
    verdict = delayed.verdict
    assert set(to_json(verdict)) >= SCHEMA
    assert verdict.mismatch is True
    first = verdict.physics[0]
    assert (first.id, first.place, first.side, first.pooling) == ("rig.delay", "port", "rig", "shared")
    delay = first.parameters["delay"]
    assert delay.unit == "s"
    assert delay.dispersion == 0.0
    sd = (delay.q95 - delay.q05) / 3.29
    assert abs(delay.median - DELAY) < 3.5 * sd
    assert sd < 0.1 * DELAY
    assert verdict.where.part == "phase"
    assert verdict.where.side == "rig"
    assert any(high > 2000 for _, high in verdict.where.bands_hz)
    gain = verdict.improvement
    assert gain.elpd_gain > 3 * gain.elpd_gain_se > 0
    assert gain.subject_rms_relative[1] < gain.subject_rms_relative[0]
    assert first.evidence.p_value < 1e-6
    aliases = {a.id: a for a in first.aliases}
    assert aliases["rig.lowpass"].elpd_behind > -1
    assert aliases["rig.lowpass"].would_separate
    assert delayed.after is not None
    assert "skew between the channels" in verdict.summary


def test_the_pooled_residual_is_flat_after_the_explanation(delayed: Diagnosis) -> None:
    assert delayed.after is not None

    def pooled(phase: np.ndarray) -> float:
        return float(np.mean(phase.mean(axis=0) ** 2) * len(phase))

    assert pooled(delayed.before.residual_phase) > 2
    assert pooled(delayed.after.residual_phase) < 1.5


def test_where_nothing_is_missing_it_says_so_with_limits(clean: Diagnosis) -> None:
    verdict = clean.verdict
    assert verdict.mismatch is False
    assert verdict.physics == ()
    assert clean.after is None
    assert verdict.summary.startswith("Nothing is missing")
    limits = {(row.id, row.place): row for row in verdict.detectable}
    assert limits["rig.delay", "port"].unit == "s"
    assert 0 < limits["rig.delay", "port"].above < DELAY  # what was found in the other test is above the limit
    assert "gain" in verdict.not_identifiable
    assert from_json(json.loads(json.dumps(to_json(verdict), allow_nan=False))) == verdict


@pytest.mark.long
def test_the_limit_is_where_effects_begin_to_be_found(clean: Diagnosis) -> None:
    limit = next(r for r in clean.verdict.detectable if (r.id, r.place) == ("rig.delay", "port")).above
    weak, strong = (
        diagnose(changed(people(16, 3), lambda s, z, f=f: z * np.exp(-s * f * limit)), seed=1, quick=True)
        for f in (0.2, 1.6)
    )
    assert not weak.verdict.mismatch
    assert strong.verdict.mismatch


def test_the_order_of_people_and_the_number_of_workers_change_nothing(clean: Diagnosis) -> None:
    again = diagnose(people(16, 3), seed=1, workers=1)
    assert again.verdict == clean.verdict
    for a, b in zip(again.ranking, clean.ranking, strict=True):
        assert a == b


def test_a_gain_error_is_never_claimed() -> None:
    assert not diagnose(changed(people(16, 5), lambda s, z: 1.05 * z), seed=1, quick=True).verdict.mismatch


@pytest.mark.long
def test_one_recording_is_diagnosed_and_its_limits_are_told() -> None:
    one = changed(people(1, 4, repetitions=1), lambda s, z: z * np.exp(-s * 3e-5))
    verdict = diagnose(one, seed=1).verdict
    assert verdict.mismatch
    assert verdict.where.side is None
    assert any("rig" in remark and "body" in remark for remark in verdict.remarks)
    first = verdict.physics[0]
    assert first.side is None
    named = {first.id, *(a.id for a in first.aliases if not a.separated)}
    assert "rig.delay" in named


def test_a_claimed_simulation_is_compared_by_parameters_before_structure() -> None:
    centres = dict(FINGERTIP.central)
    other = replace(FINGERTIP, central={**centres, "r3": 1.6 * centres["r3"]})
    recorded = simulate_recordings(other, 24, 2, FREQUENCY, 8).recordings
    diagnosis = diagnose(recorded, simulation=people(24, 9), seed=1, quick=True)
    assert not diagnosis.verdict.mismatch
    surest = diagnosis.differences[0]
    assert (surest.element, surest.what) == ("r3", "central")
    assert surest.q05 < 1.6 < surest.q95
    assert surest.p_value < 0.01
    assert {d.element for d in diagnosis.verdict.parameters_differ} == {"r3"}


@pytest.mark.long
def test_physics_that_the_simulation_has_already_is_not_called_missing() -> None:
    both = [changed(people(16, seed), lambda s, z: z * np.exp(-s * DELAY)) for seed in (10, 11)]
    diagnosis = diagnose(both[0], simulation=both[1], seed=1, quick=True)
    assert "rig.delay" not in [entry.id for entry in diagnosis.verdict.physics]


def rippled(recordings: Recordings) -> Recordings:
    """With structure of which neither network nor catalogue know anything: a ripple of magnitude without phase."""
    return changed(recordings, lambda s, z: z * (1 + 0.05 * np.sin(2.5 * np.log(np.abs(s)))))


@pytest.mark.long
@pytest.mark.parametrize("same_people", [True, pytest.param(False, marks=[pytest.mark.slow, pytest.mark.ci])])
def test_what_the_simulation_leaves_of_itself_is_no_difference(same_people: bool) -> None:
    """Both have the same ripple; the recordings have a skew as well, and that is all there is to say."""
    recorded = changed(rippled(people(14, 10)), lambda s, z: z * np.exp(-s * DELAY))
    diagnosis = diagnose(recorded, simulation=rippled(people(14, 10 if same_people else 11)), seed=1, quick=True)
    verdict = diagnosis.verdict
    first = verdict.physics[0]
    assert first.id == "rig.delay"
    # What is left of other people is not quite what is left of these.
    assert first.parameters["delay"].median == pytest.approx(DELAY, rel=0.1 if same_people else 0.3)
    assert any("subtracted" in remark for remark in verdict.remarks)
    if same_people:
        assert [entry.id for entry in verdict.physics] == ["rig.delay"]


def test_people_are_the_same_if_their_curves_are_and_not_only_their_names() -> None:
    found = Found.__new__(Found)  # not looked at
    one, other = people(8, 10), people(8, 11)
    claim = Claim(one, found, ())
    assert claim.is_of(one)
    assert claim.is_of(changed(one, lambda s, z: z + s * 2e-5))
    assert not claim.is_of(other)
    assert not claim.is_of(one.select(one.names[:5]))
    assert not claim.is_of(replace(one, subjects=tuple(replace(s, name=f"X{s.name}") for s in one.subjects)))


@pytest.mark.long
def test_physics_outside_of_the_candidates_is_unknown_and_realised_by_a_passive_network() -> None:
    def layer(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        return z + 1 / (1 / 20.0 + s * 2e-5)  # a relaxation at 400 Hz, which the candidates below do not have

    from bayes_impedance.diagnosis.catalogue.rig import RIG_STIFFNESS

    diagnosis = diagnose(changed(people(12, 12), layer), effects=[RIG_STIFFNESS], seed=1, quick=True)
    verdict = diagnosis.verdict
    assert verdict.mismatch
    assert "unknown" in [entry.id for entry in verdict.physics]
    assert verdict.unexplained.id == "unknown"
    assert verdict.network[1] != verdict.network[0]
    assert verdict.improvement.elpd_gain > 2 * verdict.improvement.elpd_gain_se


@pytest.mark.slow
@pytest.mark.ci
def test_names_that_only_together_come_near_are_no_names() -> None:
    def diffusion(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        root = np.sqrt(s * 0.02)
        return z + 60.0 * np.tanh(root) / root  # no relaxation, but a sum of them comes near

    candidates = [effect for effect in registered() if effect.id == "body.relaxation"]
    verdict = diagnose(changed(people(16, 12), diffusion), effects=candidates, seed=1, quick=True).verdict
    assert [entry.id for entry in verdict.physics] == ["unknown"]
    assert verdict.physics[0].formula.startswith(("a sum of", "the network"))
    assert verdict.unexplained == verdict.physics[0]
    assert verdict.physics[0].evidence.elpd_gain > 0
    assert verdict.improvement.elpd_gain > 2 * verdict.improvement.elpd_gain_se


# -------------------------------------------------------------------- the command


@pytest.mark.long
def test_the_command_writes_verdict_report_and_says_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    dataset, out = tmp_path / "data", tmp_path / "out"
    write_recordings(changed(people(12, 3), lambda s, z: z * np.exp(-s * DELAY)), dataset)
    assert main(["diagnose", str(dataset), "-o", str(out), "--quick"]) == 0
    printed = capsys.readouterr().out
    verdict = json.loads((out / "verdict.json").read_text(encoding="utf-8"))
    assert verdict["summary"] in printed
    assert verdict["physics"][0]["id"] == "rig.delay"
    assert verdict["data_sha256"] == read_recordings(dataset).sha256
    page = (out / "diagnosis.html").read_text(encoding="utf-8")
    assert "skew between the channels" in page
    assert not list(out.glob("*.tmp"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["nowhere"], "there is no such file or folder"),
        (["data", "--network", "(m1|"], "ends too early"),
        (["data", "--simulation", "nowhere"], "there is no such file or folder"),
        (["data", "--subject", "nobody"], "nobody"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    expected: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    write_recordings(people(2, 1), Path("data"))
    assert main(["diagnose", *arguments, "-o", "out"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ")
    assert expected in said
    assert said.count("\n") == 1
    assert not Path("out").exists()


# -------------------------------------------------------------------- real recordings


@pytest.mark.slow
@pytest.mark.ci
def test_the_battery_has_depressed_arcs_and_diffuses(real_data: Path) -> None:
    battery = read_recordings(real_data / "battery_130")
    some = battery.select(battery.names[::5])
    diagnosis = diagnose(some, seed=1, quick=True)
    found = [entry.id for entry in diagnosis.verdict.physics]
    assert found.count("body.springpot") >= 2
    before, after = diagnosis.verdict.improvement.subject_rms_relative
    assert before > 0.10
    assert after < 0.02
    exponents = [e.parameters["exponent"].median for e in diagnosis.verdict.physics if e.id == "body.springpot"]
    assert any(0.3 < a < 0.7 for a in exponents)  # diffusion
    assert all(math.isfinite(a) for a in exponents)
