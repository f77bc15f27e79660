"""The catalogue of effects: stories, units, registration, values and shapes; an effect of one's own."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, Serial, entry, toy
from fingertip_effects import BRANCHES, CABLE, FOOT, NAIL, OMEGA, SCALES, own_name

from bayes_impedance.diagnosis.catalogue.effect import (
    Coefficient,
    Effect,
    register,
    registered,
    shape_grid,
    unregister,
)
from bayes_impedance.diagnosis.catalogue.population_structure import STRUCTURES
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.selection.finalists import finalists
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import try_shortlist
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.units import unit_of

IDS = (
    "rig.mass",
    "rig.damping",
    "rig.stiffness",
    "rig.delay",
    "rig.highpass",
    "rig.lowpass",
    "rig.series_compliance",
    "rig.resonance",
    "rig.mains",
    "body.springpot",
    "body.hysteresis",
    "body.relaxation",
    "body.resonator",
    "body.mass",
    "body.line",
    "body.bypass",
    "body.reflex",
    "body.covariate",
    "body.subgroup",
    "body.drift",
    "body.correlation",
    "body.squeeze_film",
    "body.free_line",
    "body.diffusion",
    "body.broad_relaxation",
    "body.reflex_velocity",
    "body.amplitude",
    "rig.semi_inductance",
)
"""What a diagnosis may name; these ids are stable."""


@pytest.fixture
def added() -> Iterator[Callable[[Effect], Effect]]:
    """Registers effects for the time of a test."""
    effects: list[Effect] = []

    def add(effect: Effect) -> Effect:
        effects.append(effect)
        return register(effect)

    yield add
    for effect in effects:
        unregister(effect)


def entries() -> list[object]:
    return [*registered(), *STRUCTURES.values()]


# The catalogue


def test_every_row_of_the_table_has_an_entry() -> None:
    assert {effect.id for effect in registered()} | set(STRUCTURES) == set(IDS)
    assert len(IDS) == 28
    assert all(key == entry.id for key, entry in STRUCTURES.items())


@pytest.mark.parametrize("entry", entries(), ids=own_name)
def test_every_entry_tells_its_story(entry: Effect) -> None:
    for text in (entry.name, entry.formula, entry.look_for, entry.separates, entry.source):
        assert text.strip() == text
        assert len(text) > 2
    sentences = re.findall(r"[A-Z][^.!?]*(?:\.\d[^.!?]*)*[.!?](?=\s|$)", entry.story)
    assert len(sentences) == 2, entry.story
    assert " ".join(sentences) == entry.story
    assert entry.side == entry.id.split(".")[0]
    assert entry.pooling in ("shared", "varying", "some")


@pytest.mark.parametrize("effect", registered(), ids=own_name)
def test_every_coefficient_has_a_unit(effect: Effect) -> None:
    dimensionless = {"exponent", "loss_factor", "damping_ratio", "change", "time_law", "steepness"}
    for coefficient in effect.coefficients:
        assert (unit_of(coefficient.unit, "N s/m") == "") == (coefficient.name in dimensionless)
    names = [coefficient.name for coefficient in effect.coefficients]
    assert len(set(names)) == len(names)
    if effect.branch:  # the same thing as elements
        assert Kernel(parse(effect.branch)).elements


def test_rig_effects_are_shared_at_the_port() -> None:
    for effect in registered():
        if effect.side == "rig":
            assert effect.places == ("port",)
            assert effect.pooling == "shared"
        else:
            assert effect.pooling != "shared"


def test_registering_and_taking_out(added: Callable[[Effect], Effect]) -> None:
    before = registered()
    assert added(NAIL) is NAIL
    assert registered() == (*before, NAIL)
    renamed = added(replace(NAIL, name="finger nail"))
    assert registered() == (*before, renamed)  # the same id and form: replaced
    other = added(replace(NAIL, connection="series"))
    assert registered() == (*before, renamed, other)  # another form under the same id
    unregister(renamed)
    unregister(renamed)
    assert registered() == (*before, other)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": ""}, "no id"),
        ({"id": 3}, "must be text"),
        ({"story": None}, "story is None"),
        ({"side": "bod"}, 'side is "bod" .did you mean "body"'),
        ({"side": ["body"]}, "side is a list"),
        ({"pooling": "sometimes"}, "pooling is"),
        ({"connection": "across"}, "connection is"),
        ({"places": ("elbow",)}, 'a place is "elbow"'),
        ({"places": ["port"]}, "places is a list, but must be a tuple"),
        ({"places": "port"}, "must be a tuple"),
        ({"places": ()}, "must be a tuple"),
        ({"signed": 1}, "signed is 1"),
        ({"branch": ""}, "give an operation or a branch"),
        ({"coefficients": (Coefficient("x", "m"),)}, "the coefficients of a branch are its elements"),
        ({"branch": "", "operation": "wobble", "coefficients": (Coefficient("x", "m"),)}, "must be one of add, "),
        ({"branch": "", "operation": "delai"}, 'did you mean "delay"'),
        ({"branch": "", "operation": "add"}, "the coefficients of 'add' are coefficient .linear."),
        ({"branch": "", "operation": "add", "coefficients": [Coefficient("x", "m")]}, "must be a tuple of Coefficient"),
        ({"branch": "", "operation": "add", "coefficients": (3,)}, "must be a tuple of Coefficient"),
        ({"branch": "", "operation": "delay", "coefficients": (Coefficient("x", "m"),)}, "unit of coefficient 'x'"),
        ({"branch": "", "operation": "relaxation", "coefficients": (Coefficient("x", "r"),)}, "time_constant"),
        (
            {
                "branch": "",
                "operation": "relaxation",
                "coefficients": (Coefficient("x", "r"), Coefficient("t", "s", "log")),
            },
            "'t' has no grid",
        ),
        (
            {
                "branch": "",
                "operation": "relaxation",
                "coefficients": (Coefficient("x", "r"), Coefficient("x", "s", "log", 3.0)),
            },
            "the same name",
        ),
        ({"branch": "m-"}, "ends too early"),
        ({"branch": "k1"}, "no known kind"),
        ({"branch": "r1-p1*^a1"}, "marks p1. as the same for everybody"),
        ({"branch": "m1=0.001-n1=0.1"}, "holds all its parameters"),
    ],
)
def test_effects_that_make_no_sense_are_refused(change: Mapping[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        replace(NAIL, **change)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        (("", "m"), "no name"),
        ((3, "m"), "must be text"),
        (("x", "kg"), 'unit is "kg"'),
        (("x", "m", "exp"), "link is"),
        (("x", "m", "lin"), 'did you mean "linear"'),
        (("x", "m", "linear", (1.0, float("nan"))), "a value of the grid is nan"),
        (("x", "m", "linear", float("nan")), "grid .* is nan"),
        (("x", "m", "linear", [1.0, 2.0]), "grid .* is a list"),
        (("x", "m", "linear", 0), "grid .* is 0"),
        (("x", "s", "log", (0.0, 1.0)), "a value of the grid is 0.0, but must be a finite number above 0"),
        (("x", "", "logit", (0.5, 1.0)), "below 1"),
        (("x", "m", "linear", (), -1.0), "prior_sd is -1.0"),
        (("x", "m", "linear", (), True), "prior_sd is true"),
        (("x", "m", "linear", (), float("inf")), "prior_sd is inf"),
    ],
)
def test_coefficients_that_make_no_sense_are_refused(fields: tuple[object, ...], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        Coefficient(*fields)  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_only_effects_are_registered() -> None:
    before = registered()
    with pytest.raises(InputError, match="must be an Effect"):
        register({"id": "body.nail"})  # type: ignore[arg-type]
    assert registered() == before


# Coefficients and shapes


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_share_that_a_fit_has_driven_to_its_end_can_be_begun_from(share: float) -> None:
    exponent = Coefficient("exponent", "", "logit", (0.5,))
    assert exponent.value(exponent.unbounded(share, SCALES), SCALES) == pytest.approx(share, abs=1e-8)


@pytest.mark.parametrize("effect", registered(), ids=own_name)
def test_values_and_unbounded_parameters_are_inverse(effect: Effect) -> None:
    for coefficient in effect.coefficients:
        for value in (0.03, 0.4, 0.9):
            u = coefficient.unbounded(value, SCALES)
            assert float(coefficient.value(u, SCALES)) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("unit", ["m", "r", "c", "k", "n", "s", "Hz", ""])
def test_a_linear_coefficient_of_one_changes_the_impedance_by_itself(unit: str) -> None:
    """Where it acts most, the change is as large as what is there."""
    x = float(Coefficient("x", unit).value(1.0, SCALES))
    change = {
        "m": OMEGA[-1] * x / SCALES.z_high,
        "r": x / SCALES.z_middle,
        "c": x / SCALES.z_middle,
        "k": x / OMEGA[0] / SCALES.z_low,
        "n": SCALES.z_high * OMEGA[-1] * x,
        "s": OMEGA[-1] * x,
        "Hz": x / OMEGA[0],
        "": x,
    }
    assert change[unit] == pytest.approx(1.0)


@pytest.mark.parametrize("effect", [*registered(), *BRANCHES], ids=own_name)
def test_shapes_cover_the_band(effect: Effect) -> None:
    shapes = list(shape_grid(effect, SCALES))
    assert shapes
    assert len({tuple(shape.items()) for shape in shapes}) == len(shapes)
    for coefficient in effect.coefficients[1:] if effect.operation not in ("", "bypass") else ():
        values = sorted({shape[coefficient.name] for shape in shapes})
        assert set(coefficient.values(SCALES)) == set(values)
        if isinstance(coefficient.grid, tuple):
            factor = 2 * np.pi if coefficient.unit == "Hz" else 1.0
            assert values == pytest.approx(sorted(factor * g for g in coefficient.grid))
            continue
        if coefficient.unit == "n":
            motions = sorted((1 / (SCALES.z_low * SCALES.low), 1 / (SCALES.z_high * SCALES.high)))
            assert values[0] <= motions[0] * 1.001
            assert motions[1] <= values[-1] * 1.001
            assert np.diff(np.log10(values)).max() <= 1.2 / coefficient.grid
            continue
        angular = sorted(1 / v for v in values) if coefficient.unit == "s" else values
        assert (angular[0], angular[-1]) == pytest.approx((SCALES.low, SCALES.high))
        assert np.diff(np.log10(angular)).max() <= 1.2 / coefficient.grid  # as many per decade as it says
    if not effect.operation:
        meeting = []
        for shape in shapes:
            assert set(shape) == set(parse(effect.branch).elements)
            # Impedances of masses and springs have magnitude one at a common frequency.
            found = [1 / v for e, v in shape.items() if e[0] in "mn"]
            if found:
                np.testing.assert_allclose(found, found[0], rtol=1e-9)
                meeting.append(found[0])
        if meeting and len(parse(effect.branch).elements) > 1:
            assert (min(meeting), max(meeting)) == pytest.approx((SCALES.low, SCALES.high))


# An effect of one's own, from a few lines to an estimate


def hide(effect: Effect, values: Mapping[str, float]) -> Experiment:
    """Twenty people with a branch in series with, or beside, all that they are."""

    def hidden(s: np.ndarray, z: np.ndarray, _: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        own = parse(effect.branch).impedance(s, values)
        return (z + own if effect.connection == "beside" else 1 / (1 / z + 1 / own)), np.ones(len(z))

    return toy("n1|r1", {"n1": 1e-3, "r1": 2.0}, seed=21, n=20, hidden=hidden)


OWN = (
    (replace(CABLE, id="rig.own", branch="m-r"), {"m": 3e-3, "r": 0.4}),
    (replace(FOOT, id="rig.own", branch="m|r"), {"m": 3.0, "r": 600.0}),
    (replace(NAIL, id="body.own", branch="m-r", places=("port",)), {"m": 3e-3, "r": 0.4}),
    (replace(NAIL, id="body.own", branch="m1-p1^a1@100", places=("port",)), {"m1": 3e-3, "p1": 1.5, "a1": 0.4}),
)


@pytest.mark.parametrize(("effect", "values"), OWN, ids=["rig beside", "rig in series", "body beside", "power law"])
def test_an_effect_of_ones_own_is_screened_and_refitted(
    added: Callable[[Effect], Effect], effect: Effect, values: dict[str, float]
) -> None:
    added(effect)
    experiment = hide(effect, values)
    refitter, fit = experiment.refitter, experiment.fit()
    residuals = person_residuals(fit, [str(i) for i in range(20)])
    screening = screen(fit, residuals, registered(), 1, Serial())
    mine = [k for k, c in enumerate(screening.candidates) if c.effect is effect]
    assert len(mine) > 3
    strength = np.abs(np.nan_to_num(screening.z))
    assert strength[mine].max() > 0.9 * strength.max()
    assert screening.log_p(strength[mine].max()) < np.log(1e-9)
    only = screen(fit, residuals, [effect], 1, Serial())
    trials = try_shortlist(refitter, fit, only)
    best = finalists(refitter, fit, trials, registered(), 1)[0]
    assert best.effect is effect
    assert best.gain > 10
    grown = max((t.fit for t in trials), key=lambda f: float(f.evidence.sum()))
    assert grown.model.kernel.elements[:2] == ("n1", "r1")
    # The elements of the branch are those that were hidden.
    columns = grown.model.columns(0)
    found, sd = grown.u[:, columns].mean(axis=0), coefficient_posterior(grown, 1).central.std(axis=0)
    true = [float(p.u(values[p.name])) for p in parse(effect.branch).parameters]
    assert [grown.model.kernel.elements[c][0] for c in columns] == [e[0] for e in parse(effect.branch).elements]
    assert np.all(np.abs(found - true) < 3.5 * sd)
    assert np.all(sd < 0.15)
    again = person_residuals(grown, [str(i) for i in range(20)])
    after = screen(grown, again, [effect, entry("rig.delay"), entry("rig.mass")], 1, Serial())
    assert effect not in [c.effect for c in after.candidates]
    assert np.nanmax(np.abs(after.z)) < 5 < strength.max()
