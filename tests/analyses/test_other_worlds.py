"""Other worlds: they follow from their seed, are what they say, and verdicts on them are scored strictly."""

import importlib
import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.diagnosis.catalogue.effect import registered
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.files import read_recordings

FOLDER = DATA.parent / "analyses" / "other_worlds"
sys.path.append(str(FOLDER))  # the scripts import each other by name, as when they are run
trees, left_out, worlds, drawing, visible, sealed, scoring, same, another = (
    importlib.import_module(name)
    for name in (
        "tree_networks",
        "left_out",
        "drawn_worlds",
        "drawing",
        "visible",
        "sealed_cases",
        "strict_scoring",
        "same_curve",
        "another_hand",
    )
)
specification = importlib.util.spec_from_file_location("other_worlds_run", FOLDER / "run.py")
assert specification is not None
assert specification.loader is not None
run = importlib.util.module_from_spec(specification)
specification.loader.exec_module(run)


def _stick(*effects: Any, **changed: Any) -> Any:
    """Ten people of one mass on a spring and a damper, resonance at 36 Hz."""
    world = worlds.World(
        family="stick",
        network=trees.FAMILIES["stick"],
        centre=np.log([0.02, 2.0, 1e-3]),
        spread=np.full(3, 0.2),
        correlation=np.eye(3),
        between_repetitions=np.zeros(3),
        frequency_hz=np.geomspace(2, 800, 61),
        n_people=10,
        n_repetitions=2,
        noise=worlds.Noise(level=0.01),
        effects=effects,
    )
    return replace(world, **changed)


def test_random_networks_have_the_impedance_that_the_package_reads_from_their_notation() -> None:
    rng = np.random.default_rng(2)
    s = 2j * np.pi * np.geomspace(1, 1000, 20)
    for node in [*trees.FAMILIES.values(), *(trees.random_tree(rng) for _ in range(30))]:
        network = parse(trees.notation(node))
        values = {name: np.exp(rng.normal(size=1)) for name in trees.elements(node)}
        expected = network.impedance(s, {name: float(v[0]) for name, v in values.items()})
        np.testing.assert_allclose(trees.impedance(node, s, values, {}), expected, rtol=1e-12)
        for place, _ in trees.places(node):
            assert network.place(place).name == place


def test_velocities_of_elements_account_for_the_power_at_the_port() -> None:
    """Re z |v|^2 is what the dampers lose: Tellegen's theorem."""
    node = trees.FAMILIES["finger"]
    s = 2j * np.pi * np.geomspace(5, 5000, 20)
    values = {name: np.array([another.CENTRES[name]]) for name in trees.elements(node)}
    z = trees.impedance(node, s, values, {})
    lost = sum(
        values[name] * np.abs(trees.velocity_of(node, name, s, values)) ** 2
        for name in trees.elements(node)
        if name[0] == "r"
    )
    np.testing.assert_allclose(lost, (1 / z).real, rtol=1e-10)


def test_a_case_follows_from_its_seed_and_index() -> None:
    first, again, other = drawing.draw(3, 4), drawing.draw(3, 4), drawing.draw(3, 5)
    assert worlds.described(first) == worlds.described(again)
    assert worlds.described(first) != worlds.described(other)
    np.testing.assert_array_equal(worlds.conduct(first).recorded, worlds.conduct(again).recorded)


def test_shares_of_cases_and_kinds() -> None:
    drawn = [worlds.described(drawing.draw(5, i)) for i in range(300)]
    groups = [scoring.group_of(d) for d in drawn]
    for group, share in drawing.SHARES.items():
        assert groups.count(group) / 300 == pytest.approx(share, abs=4 * np.sqrt(share * (1 - share) / 300))
    kinds = {effect["kind"] for d in drawn for effect in d["effects"]}
    assert len(kinds) > 0.8 * len({*left_out.KINDS, *left_out.ELSEWHERE})
    assert {d["family"] for d in drawn} == {*trees.FAMILIES, "tree"}


def test_effects_have_the_strength_that_was_drawn() -> None:
    checked = 0
    for i in range(60):
        world = drawing.draw(7, i)
        if len(world.effects) == 1 and world.effects[0].kind in left_out.KINDS:
            effect = world.effects[0]
            median = replace(world, spread=0 * world.spread, between_repetitions=0 * world.between_repetitions)
            alike = replace(effect, spreads={}, share=1.0)
            clean = worlds.conduct(replace(median, effects=(alike,), n_people=1, n_repetitions=1)).clean[0, 0]
            plain = worlds.curves(world.network, world.s, world.centre)
            assert np.abs(clean / plain - 1).max() == pytest.approx(effect.strength, rel=1e-3)
            checked += 1
    assert checked > 15


def test_entries_of_the_catalogue_stand_where_the_catalogue_has_them() -> None:
    assert any(entry.id == "body.springpot" for entry in registered())
    for i in range(120):
        world = drawing.draw(11, i)
        network = parse(trees.notation(world.network))
        for effect in (e for e in world.effects if e.kind in left_out.KINDS and not e.id.startswith("outside")):
            admitted = {place.name for entry in registered() if entry.id == effect.id for place in entry.sites(network)}
            assert effect.place in admitted, (effect.kind, effect.place, trees.notation(world.network))


def test_what_the_body_may_have_is_passive() -> None:
    rng = np.random.default_rng(1)
    f = np.geomspace(2, 2000, 40)
    s, at = 2j * np.pi * f, left_out.Setting(2.0, 2000.0, 3.0)
    place = {"spring": 1 / (s * 1e-3), "mass": 0.01 * s}
    for name, kind in left_out.KINDS.items():
        if kind.side == "body" and kind.id not in ("body.reflex", "body.drift"):
            z = place.get(kind.where, 1.0 + 0.01 * s + 1 / (s * 1e-3))
            own = {n: np.full(1, v) for n, v in kind.start(rng, at).items()}
            assert kind.form(s, z, own).real.min() > -1e-9, name


def test_limits_of_formulas_that_are_outside_of_the_catalogue() -> None:
    s = 2j * np.pi * np.array([1e-3])
    film, line = left_out.KINDS["outside.squeeze_film"], left_out.KINDS["outside.free_line"]
    own = {"damping": np.full(1, 3.0), "time_constant": np.full(1, 0.01)}
    np.testing.assert_allclose(film.form(s, 0 * s, own), 3.0, rtol=1e-4)  # slowly: a damper
    np.testing.assert_allclose(line.form(s, 0.01 * s, {"compliance": np.full(1, 1e-3)}), 0.01 * s, rtol=1e-8)


def test_noise_has_its_level_and_heavy_tails_have_the_same_variance() -> None:
    for tails in (np.inf, 5.0):
        world = _stick(n_people=70, noise=worlds.Noise(level=0.02, tails=tails))
        experiment = worlds.conduct(world)
        relative = (experiment.recorded - experiment.clean) / np.abs(experiment.clean)
        assert np.sqrt(np.mean(np.abs(relative) ** 2)) == pytest.approx(0.02, rel=0.05)
    rising = worlds.conduct(_stick(noise=worlds.Noise(level=0.02, rise=4.0, corner_hz=10.0)))
    share = (rising.sd / np.abs(rising.clean))[0, 0] * np.sqrt(2) / 0.02
    assert share[0] > 3.8
    assert share[-1] == pytest.approx(1.0, abs=1e-3)


def test_an_effect_that_elements_take_up_is_not_visible_and_a_delay_is() -> None:
    stiffness = worlds.Effect("rig.stiffness", "port", {"stiffness": 300.0}, {})
    delay = worlds.Effect("rig.delay", "port", {"delay": 1e-5}, {})
    for effect, low, high in ((stiffness, 0.0, 0.1), (delay, 6.0, 1e4)):
        world = _stick(effect)
        (found,) = visible.visibilities(world, worlds.conduct(world))
        assert low <= found <= high
    assert visible.visibilities(_stick(), worlds.conduct(_stick())) == []


def test_visibility_of_a_small_delay_is_that_of_the_projected_tangent() -> None:
    """To first order, what the elements leave is the effect's direction outside of the network's tangent space."""
    world = _stick(worlds.Effect("rig.delay", "port", {"delay": 1e-6}, {}), n_people=4, n_repetitions=1)
    experiment = worlds.conduct(world)
    total = 0.0
    for i in range(4):
        x, sd = experiment.log_elements[i, 0], experiment.sd[i, 0]
        z = worlds.curves(world.network, world.s, x)
        step = 1e-6 * np.eye(3)
        derivative = worlds.curves(world.network, world.s, x + step) - worlds.curves(world.network, world.s, x - step)
        tangent = derivative.T / 2e-6 / sd[:, None]
        a, d = np.r_[tangent.real, tangent.imag], -world.s * 1e-6 * z / sd
        d = np.r_[d.real, d.imag]
        total += float(np.sum((d - a @ np.linalg.lstsq(a, d, rcond=None)[0]) ** 2))
    assert visible.visibilities(world, experiment)[0] == pytest.approx(np.sqrt(total), rel=0.02)


def _entry(name: str, *undecided: str, place: str = "port", **more: Any) -> dict[str, Any]:
    aliases = [{"id": n, "place": place, "separated": False} for n in undecided]
    aliases.append({"id": "body.line", "place": place, "separated": True})
    return {"id": name, "place": place, "side": name.split(".")[0], "aliases": aliases, "parameters": {}, **more}


def _answer(*ids: str, **more: Any) -> dict[str, Any]:
    effects = [
        {"kind": i, "id": i, "side": i.split(".")[0], "place": "port", "values": {}, "spreads": {}, "strength": 0.1}
        for i in ids
    ]
    fixed = {"case": "x", "network": "m1|r1|n1", "people": 9, "repetitions": 1, "points": 51, "noise": {"tails": None}}
    return fixed | {"effects": effects, "visible": [20.0 for _ in ids]} | more


@pytest.mark.parametrize(
    ("truth", "said", "right"),
    [
        ([], [], True),
        ([], [_entry("rig.mass")], False),
        (["rig.mass"], [], False),
        (["rig.mass"], [_entry("rig.mass")], True),
        (["rig.mass"], [_entry("rig.mass"), _entry("unknown")], False),
        (["rig.mass"], [_entry("rig.delay", "rig.mass", "rig.lowpass")], True),
        (["rig.mass"], [_entry("rig.delay", "rig.mass", "rig.lowpass", "body.mass")], False),
        (["rig.mass"], [_entry("body.line")], False),
        (["rig.mass", "body.hysteresis"], [_entry("body.hysteresis"), _entry("rig.delay", "rig.mass")], True),
        (["rig.mass", "body.hysteresis"], [_entry("body.hysteresis", "rig.mass")], False),
        (["rig.mass", "body.hysteresis"], [_entry("rig.mass"), _entry("rig.mass")], False),
        (["outside.echo"], [_entry("unknown")], True),
        (["outside.echo"], [_entry("rig.delay"), _entry("unknown")], False),
        (["outside.squeeze_film"], [_entry("body.squeeze_film")], True),
        (["outside.squeeze_film"], [_entry("body.squeeze_film", place="n1")], False),
    ],
)
def test_strictly_right_is_the_right_set_of_names_and_nothing_else(
    truth: list[str], said: list[dict[str, Any]], right: bool
) -> None:
    assert scoring.right(_answer(*truth), said, same_curve=False) is right


def test_a_change_during_the_only_sweep_counts_as_outside_of_the_catalogue() -> None:
    once, again = _answer("body.drift"), _answer("body.drift", repetitions=2)
    for said, right_once, right_again in (
        ([_entry("unknown")], True, False),
        ([_entry("body.drift")], False, True),
        ([_entry("body.resonator"), _entry("unknown")], False, False),
    ):
        assert scoring.right(once, said, same_curve=False) is right_once
        assert scoring.right(again, said, same_curve=False) is right_again


def test_what_has_a_name_keeps_it_beside_what_one_sweep_cannot_show() -> None:
    both = _answer("rig.mass", "body.drift")
    for said, right in (
        ([_entry("unknown")], True),
        ([_entry("rig.mass"), _entry("unknown")], True),
        ([_entry("unknown"), _entry("rig.delay", "rig.mass")], True),
        ([_entry("rig.delay"), _entry("unknown")], False),
        ([_entry("rig.mass")], False),
        ([_entry("rig.mass"), _entry("body.drift")], False),
        ([_entry("rig.mass"), _entry("unknown"), _entry("unknown")], False),
    ):
        assert scoring.right(both, said, same_curve=False) is right
    again = _answer("rig.mass", "body.drift", repetitions=2)
    assert not scoring.right(again, [_entry("rig.mass"), _entry("unknown")], same_curve=False)


def test_one_name_of_the_same_curve_is_right_for_physics_outside_and_two_are_not() -> None:
    answer, names = _answer("outside.echo"), [_entry("body.relaxation"), _entry("rig.lowpass")]
    assert scoring.right(answer, names[:1], same_curve=True)
    assert not scoring.right(answer, names, same_curve=True)


def test_rows_count_intervals_sides_crashes_and_what_is_not_reliable() -> None:
    answer = _answer("rig.mass")
    answer["effects"][0]["values"] = {"mass": 2.0}
    entry = _entry("rig.mass", parameters={"mass": {"unit": "kg", "q05": 1.0, "median": 2.0, "q95": 3.0}})
    record = {"verdict": {"physics": [entry], "reliable": False}, "seconds": 3.0, "exit": 1, "crash": None}
    row = scoring.score(answer, record)
    assert (row["right"], row["covered"], row["intervals"], row["side"], row["reliable"]) == (True, 1, 1, True, False)
    entry["side"], entry["parameters"]["mass"]["q05"] = "body", 2.5
    wrong = scoring.score(answer, record)
    assert (wrong["covered"], wrong["side"]) == (0, False)
    crash = scoring.score(answer, {"verdict": None, "seconds": 1.0, "exit": 1, "crash": "Traceback ..."})
    assert crash["crashed"]
    assert not crash["right"]
    rates = dict(scoring.rates([row, crash]))
    assert rates["strictly right, of visible"].startswith("1/2")
    assert rates["crashes and no verdict"].startswith("1/2")
    assert rates["must not be relied on"].startswith("1/1")


def test_physics_outside_is_right_if_the_claim_is_the_same_curve() -> None:
    """A relaxation is itself, with values that are off by a half, and no residual mass."""
    values = {"damping": 1.0, "time_constant": 2e-3}
    effect = worlds.Effect("body.relaxation", "port", values, {"damping": 0.2, "time_constant": 0.2})
    world = _stick(effect)

    def verdict(name: str, values: dict[str, float]) -> dict[str, Any]:
        parameters = {n: {"median": 1.5 * v} for n, v in values.items()}
        return {"physics": [{"id": name, "place": "port", "pooling": "varying", "parameters": parameters}]}

    assert same.same_curve(world, verdict("body.relaxation", values))
    assert not same.same_curve(world, verdict("rig.delay", {"delay": 1e-6}))
    assert not same.same_curve(world, {"physics": [{"id": "unknown", "place": "port", "parameters": {}}]})


def test_a_seed_is_used_once_and_its_answers_cannot_be_changed(tmp_path: Path) -> None:
    out = tmp_path / "seed_6"
    assert sealed.may_run(out, 2, again=False)
    seal = sealed.prepare(6, 2, out, small=True)
    answers = sealed.answers_of(out)
    assert seal == sealed.prepare(6, 2, tmp_path / "other", small=True)
    for answer in answers:
        folder = out / "datasets" / answer["case"]
        assert read_recordings(folder).sha256 == answer["data_sha256"] == sealed.digest_of(folder)
    assert not sealed.may_run(out, 2, again=False)  # interrupted before any verdict: it goes on
    with pytest.raises(sealed.SeedUsedError, match="2 cases, not 3"):
        sealed.may_run(out, 3, again=False)
    lines = [json.dumps({"data_sha256": a["data_sha256"], "verdict": None}) for a in answers]
    (out / sealed.VERDICTS).write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(sealed.SeedUsedError, match="all its verdicts are on file"):
        sealed.may_run(out, 2, again=False)
    (out / sealed.VERDICTS).write_text(lines[0] + "\n", encoding="utf-8")
    (out / sealed.USED).write_text("other sources\n", encoding="utf-8")
    with pytest.raises(sealed.SeedUsedError, match="other sources"):
        sealed.may_run(out, 2, again=False)
    assert sealed.may_run(out, 2, again=True)
    assert (out / sealed.AGAIN).is_file()
    content = (out / sealed.SEALED).read_text(encoding="utf-8")
    (out / sealed.SEALED).write_text(content.replace('"people": 8', '"people": 9', 1), encoding="utf-8")
    with pytest.raises(ValueError, match="not what was sealed"):
        sealed.answers_of(out)


def test_the_population_of_another_hand_has_what_it_says() -> None:
    for name in another.EFFECTS:
        world = another.population(name, 8, 41)
        found = visible.visibilities(world, worlds.conduct(world))
        assert all(v > 3 for v in found), name  # 8 people and 41 points: 71 and 401 show nine times as much
        assert len(found) == (name != "nothing")


@pytest.mark.slow
@pytest.mark.ci
def test_a_trial_runs_from_drawing_to_the_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["--cases", "2", "--seed", "3", "--small", "-o", str(tmp_path)]
    assert run.main(arguments) == 0
    rows = run.rows_of(tmp_path / "seed_3")
    assert len(rows) == 2
    assert not any(row["crashed"] for row in rows)
    assert (tmp_path / "table.csv").read_text(encoding="utf-8").count("\n") == 3
    capsys.readouterr()
    assert run.main(arguments) == 2
    assert "take another seed" in capsys.readouterr().out


def test_what_was_drawn_is_the_same_to_within_rounding() -> None:
    one = {"band": [1.0, 2.0], "effects": [{"id": "x", "values": {"mass": 1e-3}, "share": 1.0}], "people": 9}
    rounded = {
        "band": [1.0, 2.0 * (1 + 1e-15)],
        "effects": [{"id": "x", "values": {"mass": 1e-3}, "share": 1.0}],
        "people": 9,
    }
    assert run._equal(one, rounded)
    for changed in ({"people": 8}, {"band": [1.0, 2.00001]}, {"band": [1.0]}, {"effects": [{"id": "y"}]}):
        assert not run._equal(one, one | changed)
