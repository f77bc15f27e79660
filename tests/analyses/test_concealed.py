"""Concealed effects are what they claim to be: the generator against the package, closed forms and statistics."""

import importlib
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import DATA

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, parse
from bayes_impedance.recordings.files import read_recordings, write_recordings

FOLDER = DATA.parent / "analyses" / "concealed"
sys.path.insert(0, str(FOLDER))  # the scripts import each other by name, as when they are run
people, forms, cases, effects, visibility = (
    importlib.import_module(name) for name in ("people", "forms", "cases", "effects", "visibility")
)

SMALL = {"n_subjects": 10, "n_repetitions": 3, "n_points": 61}
CURVES = [(name, place) for name, effect in forms.EFFECTS.items() if effect.form for place in effect.places]


def test_the_network_by_hand_is_the_packages() -> None:
    case = cases.prepare("none", None, 0.0, 3, **SMALL)
    kernel = Kernel(parse(people.NETWORK))
    assert kernel.elements == people.ELEMENTS
    theta = np.ascontiguousarray(case.log_elements.reshape(-1, len(people.ELEMENTS)))
    expected = kernel.impedance(theta, case.frequency_hz).reshape(case.without.shape)
    assert np.abs(case.without / expected - 1).max() < 1e-12
    assert np.array_equal(case.concealed, case.without)


def test_numbers_are_those_of_the_shipped_population() -> None:
    truth = json.loads((DATA / "fingertip_71" / "truth.json").read_text(encoding="utf-8"))
    assert truth["network"] == people.NETWORK
    for name, element in truth["elements"].items():
        assert people.CENTRAL[name] == pytest.approx(element["central"], rel=1e-6)
        # The shipped dispersion includes a contact force, which adds 0.1 %.
        assert people.BETWEEN_PERSONS[name] == pytest.approx(element["dispersion_between_persons"], rel=2e-3)


def test_every_effect_of_the_catalogue_is_there_with_its_names() -> None:
    assert set(forms.PARAMETERS) == set(forms.EFFECTS)
    assert len(forms.EFFECTS) == 23


@pytest.mark.parametrize(("name", "place"), CURVES)
def test_the_mean_curve_moves_by_the_strength(name: str, place: str) -> None:
    asked = 0.25
    case = cases.prepare(name, place, asked, 5, **SMALL)
    without, concealed = cases.calibration_curves(case)
    assert without.shape == (400, 61)
    mean = without.mean(axis=0)
    between = np.sqrt(np.mean(np.abs(without - mean) ** 2, axis=0))
    assert np.max(np.abs(concealed.mean(axis=0) - mean) / between) == pytest.approx(asked, rel=0.01)


def test_strengths_that_are_not_of_the_mean_curve() -> None:
    slope = cases.prepare("body.covariate", "skin", 0.6, 2, n_subjects=4000, n_points=5)
    force = np.log(slope.people.covariates["contact_force_n"])
    for name, sign in (("n3", -1), ("r3", 1)):
        i = people.ELEMENTS.index(name)
        person = slope.log_elements.mean(axis=1)[:, i]
        # The total dispersion stays; one exponent for two dispersions (0.35, 0.30) explains 0.6 on average.
        assert person.std() == pytest.approx(people.BETWEEN_PERSONS[name], rel=4 / np.sqrt(2 * 4000))
        expected = sign * 0.6 * 0.325 / people.BETWEEN_PERSONS[name]
        assert np.corrcoef(force, person)[0, 1] == pytest.approx(expected, abs=4 * 0.8 / np.sqrt(4000))

    drift = cases.prepare("body.drift", "n3", 0.4, 2, **SMALL)
    base = cases.prepare("none", None, 0.0, 2, **SMALL)
    change = drift.log_elements - base.log_elements
    assert change[:, 2, 0] == pytest.approx(0.4 * 0.35)
    assert change[:, 0, 0] == pytest.approx(0.0)
    assert np.count_nonzero(np.abs(change) > 1e-12) == 2 * 10

    hum = cases.prepare("rig.mains", None, 0.3, 2)
    without, _ = cases.calibration_curves(hum)
    added = np.abs(hum.concealed - hum.without)
    touched = np.all(added > 1e-9, axis=(0, 1))
    harmonic = hum.frequency_hz[touched] / 50
    assert np.abs(harmonic / np.round(harmonic) - 1).max() < 0.01
    assert np.allclose(added[..., touched], hum.values["amplitude"])
    assert added[..., ~touched].max() < 1e-12
    between = cases.spread(without)[touched]
    assert np.max(hum.values["amplitude"] / between) == pytest.approx(0.3, rel=0.01)


def _edited(name: str, place: str, own: Mapping[str, float]) -> tuple[Network, dict[str, float]]:
    """The package's network with the effect as lumped elements, and their values."""
    network = parse(people.NETWORK)
    mass, spring, damper = Element("m9"), Element("n9"), Element("r9")
    if name == "rig.resonance":
        w0 = 2 * np.pi * own["frequency"]
        own = {
            "mass": own["mass"],
            "damping": 2 * own["ratio"] * w0 * own["mass"],
            "compliance": 1 / own["mass"] / w0**2,
        }
    values = {"m9": own.get("mass"), "r9": own.get("damping"), "n9": own.get("compliance")}
    if name == "rig.stiffness":
        values["n9"] = 1 / own["stiffness"]
    addition = {
        "rig.mass": mass,
        "body.mass": mass,
        "rig.damping": damper,
        "rig.stiffness": spring,
        "rig.resonance": mass - (damper | spring),
        "body.resonator": mass - (damper | spring),
        "body.relaxation": damper - spring,
        "body.bypass": damper | spring,
        "rig.series_compliance": spring,
        "body.subgroup": damper | spring,
    }[name]
    series = name in ("rig.series_compliance", "body.subgroup")
    return (network.in_series if series else network.beside)(place, addition), values


LUMPED = ("rig.mass", "body.mass", "rig.damping", "rig.stiffness", "rig.resonance", "body.resonator")
LUMPED += ("body.relaxation", "body.bypass", "rig.series_compliance", "body.subgroup")


@pytest.mark.parametrize(("name", "place"), [c for c in CURVES if c[0] in LUMPED])
def test_lumped_effects_equal_the_packages_network_with_more_elements(name: str, place: str) -> None:
    case = cases.prepare(name, place, 0.5, 4, **SMALL)
    s = 2j * np.pi * case.frequency_hz
    person = int(np.flatnonzero(case.members)[0])
    spread = forms.EFFECTS[name].spread
    own = {
        key: value * np.exp(spread.get(key, 0.0) * case.people.coefficient[person, k])
        for k, (key, value) in enumerate(case.values.items())
    }
    network, values = _edited(name, place, own)
    values |= dict(zip(people.ELEMENTS, np.exp(case.log_elements[person, 1]), strict=True))
    assert np.abs(case.concealed[person, 1] / network.impedance(s, values) - 1).max() < 1e-12
    assert np.abs(case.concealed[person, 1] / case.without[person, 1] - 1).max() > 1e-3


def test_distributed_and_fractional_forms_in_their_limits() -> None:
    s = 2j * np.pi * np.geomspace(1, 100, 7)
    spring = 1 / (s * 1e-3)
    line = forms.EFFECTS["body.line"].form(s, spring, {"mass": np.float64(1e-6)})
    # A spring with a little mass of its own carries a third of it at its end.
    assert np.abs((line - spring) / (s * 1e-6 / 3) - 1).max() < 1e-3
    # x coth x has its poles where sin |x| = 0: first standing wave of a fixed bar, w = pi / sqrt(M n).
    w = np.pi / np.sqrt(1e-2 * 1e-3)
    near = np.array([0.999999j * w])
    assert np.abs(forms.EFFECTS["body.line"].form(near, 1 / (near * 1e-3), {"mass": 1e-2}))[0] > 1e5
    springpot = forms.EFFECTS["body.springpot"].form
    assert springpot(s, 0 * s, {"coefficient": 2.0, "exponent": 1.0}) == pytest.approx(2.0)
    assert springpot(s, 0 * s, {"coefficient": 2.0, "exponent": 0.0}) == pytest.approx(2.0 / s)
    lossy = forms.EFFECTS["body.hysteresis"].form(s, spring, {"loss": 0.2})
    assert lossy.real == pytest.approx(0.2 * np.abs(spring))
    assert lossy.imag == pytest.approx(spring.imag)
    reflex = forms.EFFECTS["body.reflex"].form(s, 0 * s, {"stiffness": 100.0, "latency": 0.029})
    lag = 1 / (1 + s / (2 * np.pi * 8))
    assert reflex == pytest.approx(100 / s * lag * np.exp(-s * 0.029))
    for name, expected in (("rig.highpass", s / (s + 20 * np.pi)), ("rig.lowpass", 1 / (1 + s / (20 * np.pi)))):
        assert forms.EFFECTS[name].form(s, np.ones_like(s), {"corner": 10.0}) == pytest.approx(expected)
    assert np.angle(forms.EFFECTS["rig.delay"].form(s, np.ones_like(s), {"delay": 1e-3})) == pytest.approx(
        -1e-3 * s.imag
    )


@pytest.mark.parametrize("name", list(forms.EFFECTS))
def test_truth_is_complete_and_recordings_say_nothing(name: str) -> None:
    recordings, truth = effects.concealed(name, None, 0.3, 6, **SMALL | {"n_points": 101})
    assert json.loads(json.dumps(truth)) == truth
    assert len(recordings) == 10
    assert recordings.repetitions_max == 3
    assert recordings.network == people.NETWORK
    told = " ".join([recordings.title, recordings.source, *recordings.subjects[0].covariates])
    assert name == "none" or name.split(".")[1] not in told
    missing = name not in ("none", "body.correlation")
    assert truth["mismatch"] is missing
    assert set(truth["parameters"]) == {reported for reported, _ in forms.PARAMETERS[name].values()}
    numbers = [*truth["parameters"].values(), *truth["also"].values()]
    assert all(np.isfinite(number["value"]) and number["unit"] for number in numbers)
    assert (truth["subjects"] != "all") == (name == "body.subgroup")
    if not missing:
        assert truth["place"] is None
        assert truth["bands_hz"] == []
        assert truth["side"] is None
        return
    assert truth["side"] == name.split(".")[0]
    assert truth["place"] == truth["places"][0]
    known = {place.name for place in parse(people.NETWORK).places()}
    assert set(truth["places"]) <= known
    assert all(5.0 <= low < high <= 5000.0 for low, high in truth["bands_hz"])
    assert truth["bands_hz"]
    varies = any(p["dispersion"] > 0 for p in truth["parameters"].values())
    assert varies == (truth["pooling"] in ("varying", "some"))


def test_a_subgroup_is_thirty_percent_and_the_others_are_untouched() -> None:
    case = cases.prepare("body.subgroup", None, 0.3, 8, n_subjects=20, n_points=21)
    _, truth = effects.concealed("body.subgroup", None, 0.3, 8, n_subjects=20, n_points=21)
    assert truth["parameters"]["fraction"]["value"] == 0.3
    assert len(truth["subjects"]) == 6
    moved = np.abs(case.concealed / case.without - 1).max(axis=(1, 2)) > 1e-9
    assert [f"V{i + 1:02d}" for i in np.flatnonzero(moved)] == truth["subjects"]


def test_concealing_changes_neither_the_people_nor_the_noise() -> None:
    plain, _ = effects.concealed("none", None, 0.0, 9, **SMALL)
    delayed, truth = effects.concealed("rig.delay", None, 0.3, 9, **SMALL)
    for a, b in zip(plain.subjects, delayed.subjects, strict=True):
        s = 2j * np.pi * a.frequency_hz
        # A delay keeps |z| and so the noise: only the noise's own phase differs, by the 9 % of the effect.
        expected = a.z * np.exp(-s * truth["parameters"]["delay"]["value"])
        assert np.abs(b.z / expected - 1).max() < 0.02
        assert dict(a.covariates) == dict(b.covariates)
    again, _ = effects.concealed("rig.delay", None, 0.3, 9, **SMALL)
    assert all(np.array_equal(a.z, b.z) for a, b in zip(delayed.subjects, again.subjects, strict=True))


def test_noise_and_gain_are_as_conditions_say() -> None:
    conditions = people.Conditions(noise_scale_sd=0.0)
    z = np.full((20000, 1, 2), 3 + 4j)
    frequency_hz = np.array([3.0, 1000.0])
    recorded, sd = people.record(z, frequency_hz, conditions, np.random.default_rng(1))
    assert sd[0, 0] == pytest.approx([5 * 0.03, 5 * 0.01], rel=1e-3)
    for part in (recorded - z).real, (recorded - z).imag:
        assert part[:, 0].std(axis=0) == pytest.approx(sd[0, 0], rel=4 / np.sqrt(2 * 20000))
    high, _ = people.record(z, frequency_hz, replace(conditions, gain_error=0.03), np.random.default_rng(1))
    assert high == pytest.approx(1.03 * recorded)


def test_correlations_are_full_and_strong_where_they_are_the_effect() -> None:
    off = ~np.eye(8, dtype=bool)
    sizes = {}
    for name in ("none", "body.correlation"):
        matrices = [cases.prepare(name, None, 0.0, seed, 2, 1, 3).population.correlation for seed in range(40)]
        assert all(np.linalg.eigvalsh(m)[0] > 0.01 and np.all(m[off] != 0) for m in matrices)
        assert all(np.diag(m) == pytest.approx(1) for m in matrices)
        sizes[name] = np.sqrt(np.mean([np.mean(m[off] ** 2) for m in matrices]))
    # Directions in three dimensions: a root mean square cosine of 1/sqrt(3), times the communality.
    assert sizes["none"] == pytest.approx(0.5 / np.sqrt(3), rel=0.1)
    assert sizes["body.correlation"] == pytest.approx(0.95 / np.sqrt(3), rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("rig.mess", None, 0.3), "no effect is called"),
        (("rig.mass", None, 0.0), "above zero"),
        (("rig.mass", "elbow", 0.3), "no place"),
        (("body.covariate", "skin", 0.9), "cannot explain"),
        (("body.covariate", "limb", 0.3), "needs the skin or an element"),
        (("rig.lowpass", None, 50.0), "cannot reach"),
    ],
)
def test_what_cannot_be_concealed_is_refused(arguments: tuple[str, str | None, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cases.prepare(*arguments, 1, **SMALL)


def test_recordings_survive_being_written_for_the_command(tmp_path: Path) -> None:
    recordings, _ = effects.concealed("body.subgroup", None, 0.3, 2, 4, 2, 21)
    write_recordings(recordings, tmp_path / "d", significant_digits=8)
    again = read_recordings(tmp_path / "d")
    assert again.network == people.NETWORK
    assert not again.warnings
    for a, b in zip(recordings.subjects, again.subjects, strict=True):
        assert b.z == pytest.approx(a.z, rel=1e-6)
        assert set(b.covariates) == set(people.COVARIATES)


def _white(case: Any, sd: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curves z (N, J, F) over the noise, and a basis of the tangent space by the package's derivative."""
    tangent = np.swapaxes(Kernel(parse(people.NETWORK)).derivative(case.log_elements, case.frequency_hz)[1], -1, -2)
    tangent = tangent / sd[..., None]
    basis, _ = np.linalg.qr(np.concatenate([tangent.real, tangent.imag], axis=-2))
    return np.concatenate([z.real / sd, z.imag / sd], axis=-1), basis


def test_what_elements_can_imitate_is_invisible() -> None:
    case = cases.prepare("rig.delay", None, 0.3, 3, **SMALL)
    sd = 0.01 * np.abs(case.without)
    total, outside = visibility.visibility(case, sd)
    assert total > 5
    assert np.sum(outside**2) == pytest.approx(total**2 / 30)
    for gain in (1.0001, 1.3):  # a gain error scales all elements, however large it is
        imitated = replace(case, concealed=gain * case.without)
        everything = (gain - 1) / 0.01 * np.sqrt(30 * 61)
        assert visibility.visibility(imitated, sd)[0] < 1e-3 * everything


def test_visibility_is_the_mean_of_the_best_test() -> None:
    case = cases.prepare("rig.delay", None, 0.02, 3, **SMALL)  # so little that curves are straight
    sd = 1e-3 * np.abs(case.without)
    total, _ = visibility.visibility(case, sd)
    change, basis = _white(case, sd, case.concealed - case.without)
    free = change - np.einsum("ijfp,ijgp,ijg->ijf", basis, basis, change)
    assert np.sqrt(np.sum(free**2)) == pytest.approx(total, rel=0.03)
    # The score, sum g.r / sqrt(sum g.g), in 500 experiments.
    rng = np.random.default_rng(1)
    recorded = (change + rng.normal(size=change.shape) for _ in range(500))
    score = np.array([np.sum(free * r) for r in recorded]) / np.sqrt(np.sum(free**2))
    assert score.mean() == pytest.approx(total, abs=4 / np.sqrt(500) + 0.03 * total)
    assert score.std() == pytest.approx(1, abs=4 / np.sqrt(2 * 500))


def test_hum_stands_out_by_its_power() -> None:
    stated, found = [], []
    for seed in range(40):
        case = cases.prepare("rig.mains", None, 0.004, seed, 20, 3, 61)
        sd = 1e-3 * np.abs(case.without)
        stated.append(visibility.visibility(case, sd)[0])
        change, basis = _white(case, sd, case.concealed - case.without)
        recorded = change + np.random.default_rng(seed).normal(size=change.shape)
        free = recorded - np.einsum("ijfp,ijgp,ijg->ijf", basis, basis, recorded)
        hum = np.tile(cases.hums(case.frequency_hz), 2)
        degrees = np.sum(1 - np.sum(basis**2, axis=-1)[..., hum])
        found.append((np.sum(free[..., hum] ** 2) - degrees) / np.sqrt(2 * 60 * hum.sum()))
    difference = np.array(found) - stated
    assert np.mean(stated) > 5
    assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(40)


def test_drift_and_covariate_stand_out_of_the_elements_scatter() -> None:
    """The statistics that their closed forms speak of, from simulated experiments without noise."""
    n, n_seeds = 30, 150
    drifts, covariates = np.zeros((n_seeds, 2)), np.zeros((n_seeds, 2))
    for seed in range(n_seeds):
        case = cases.prepare("body.drift", "n1", 0.2, seed, n, 3, 7)
        i = people.ELEMENTS.index("n1")
        slope = np.mean(case.log_elements[:, 2, i] - case.log_elements[:, 0, i]) / 2
        drifts[seed] = slope / (case.population.between_repetitions[i] / np.sqrt(2 * n)), _stated(case)
        case = cases.prepare("body.covariate", "r3", 0.5, seed, n, 3, 7)
        person = case.log_elements[..., people.ELEMENTS.index("r3")].mean(axis=1)
        force = np.log(case.people.covariates["contact_force_n"])
        slope, constant = np.polyfit(force, person, 1)
        covariates[seed] = slope * 0.25 * np.sqrt(n) / np.std(person - slope * force - constant), _stated(case)
    # One over a standard deviation estimated with n - 2 degrees of freedom is too large by this on average.
    bias = np.sqrt(n / 2) * math.gamma((n - 3) / 2) / math.gamma((n - 2) / 2)
    for values, factor in ((drifts, 1.0), (covariates, bias)):
        difference = values[:, 0] / factor - values[:, 1]
        assert values[:, 1].mean() > 2
        assert abs(difference.mean()) < 4 * difference.std() / np.sqrt(n_seeds)


def _stated(case: Any) -> float:
    return float(visibility.visibility(case, 1e-6 * np.abs(case.without))[0])


@pytest.mark.parametrize("name", ["body.relaxation", "body.resonator", "rig.resonance", "body.subgroup", "rig.lowpass"])
def test_equivalent_numbers_give_the_same_curve(name: str) -> None:
    values = forms.EFFECTS[name].start(np.random.default_rng(3), "tissue")
    also = {key: value for key, (value, _) in forms.equivalents(name, values).items()}
    s = 2j * np.pi * np.geomspace(5, 5000, 9)
    z = np.full_like(s, 10.0)
    expected = forms.EFFECTS[name].form(s, z, values)
    if name == "rig.lowpass":
        again = z / (1 + s * also["time_constant"])
    elif name == "rig.resonance":
        fixture = {"mass": values["mass"], **also}
        again = forms.EFFECTS["body.resonator"].form(s, z, fixture)
    elif name == "body.resonator":
        fixture = {"mass": values["mass"], "frequency": also["frequency_hz"], "ratio": also["damping_ratio"]}
        again = forms.EFFECTS["rig.resonance"].form(s, z, fixture)
    else:
        swapped = {"damping": values["damping"], "compliance": also["time_constant"] / values["damping"]}
        again = forms.EFFECTS[name].form(s, z, swapped)
    assert again == pytest.approx(expected, rel=1e-12)
