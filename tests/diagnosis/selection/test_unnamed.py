"""Small networks that stand in for physics outside of the catalogue: passive, as good as the truth, none for noise."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from experiments import TOY, entry, toy

from bayes_impedance.diagnosis.catalogue.effect import Candidate, shape_grid
from bayes_impedance.diagnosis.fit.extend import extended
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.multiple_testing import STRUCTURE_ALPHA
from bayes_impedance.diagnosis.residuals.missing_impedance import missing_one_ports
from bayes_impedance.diagnosis.selection import unnamed as unnamed_module
from bayes_impedance.diagnosis.selection.compare import Comparison
from bayes_impedance.diagnosis.selection.score_scan import Screening
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.stepwise import Found
from bayes_impedance.diagnosis.selection.trial import Trial
from bayes_impedance.diagnosis.selection.unnamed import (
    BRANCHES,
    Realised,
    along_the_sweep,
    branch_effects,
    stand_in_network,
    structure_remains,
)
from bayes_impedance.diagnosis.verdict.entries import unknown_entry
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.notation import parse

FREQUENCY = np.geomspace(2, 2000, 25)
EFFECTS = branch_effects()

# The branches


def test_every_branch_is_tried_beside_and_in_series_with_a_place() -> None:
    beside, in_series = ([e.branch for e in EFFECTS if e.connection == c] for c in ("beside", "series"))
    assert beside == in_series
    assert len(set(beside)) == len(beside) == len(BRANCHES)
    assert len({effect.form for effect in EFFECTS}) == len(EFFECTS)
    assert {effect.id for effect in EFFECTS} == {"unknown"}


@pytest.mark.parametrize("effect", EFFECTS, ids=[effect.form for effect in EFFECTS])
def test_a_branch_is_made_of_masses_springs_and_dampers_with_names_of_their_own(effect) -> None:  # type: ignore[no-untyped-def]
    elements = parse(effect.branch).elements
    assert len(set(elements)) == len(elements) == sum(character in "mnr" for character in effect.branch)
    assert {kind_of(e).letter for e in elements} <= set("mnr")
    assert not effect.operation


@pytest.mark.parametrize("effect", EFFECTS, ids=[effect.form for effect in EFFECTS])
def test_the_network_stays_passive_whatever_the_branch(effect) -> None:  # type: ignore[no-untyped-def]
    """Re z >= 0 with elements over many orders of magnitude, alone and inside the network."""
    rng = np.random.default_rng(3)
    branch = parse(effect.branch)
    values = {e: np.exp(rng.normal(0, 3, (200, 1))) for e in branch.elements}
    omega = np.geomspace(1e-3, 1e3, 60)
    z = branch.impedance(1j * omega, values)
    assert np.all(z.real >= -1e-9 * np.abs(z))
    model = toy(*TOY, seed=1, n=2).model
    shape = next(iter(shape_grid(effect, model.scales)))
    grown = extended(model, Candidate(effect, "port", shape), "varying", 1.0)
    assert len(grown.parameters) == len(branch.elements)
    assert len(set(grown.kernel.elements)) == 2 + len(branch.elements)
    u = rng.normal(0, 3, (200, len(grown.kernel.elements)))
    z = grown.kernel.impedance(u, omega / (2 * np.pi))
    assert np.all(z.real >= -1e-9 * np.abs(z))


# Whether structure remains


@pytest.mark.parametrize(
    ("in_residuals", "in_scores", "ended_by_choice"), list(product((True, False), (True, False), (True, False)))
)
def test_structure_remains_in_residuals_or_in_candidates_that_were_refused(
    in_residuals: bool, in_scores: bool, ended_by_choice: bool
) -> None:
    """A search that ended with a choice has not looked for what is left."""
    fit = toy(*TOY, seed=1, n=2).fit()
    score = 9.0 if in_scores else 1.0
    candidate = Candidate(entry("rig.mass"), "port", {})
    screening = Screening(
        candidates=(candidate,),
        score=np.zeros((2, 1)),
        information=np.ones((2, 1)),
        z=np.array([score]),
        size=np.ones(1),
        spread=np.zeros(1),
        log_p_spread=np.zeros(1),
        cosine=np.eye(1),
        visible=np.ones(1),
        effective=1.0,
    )
    trial = Trial(candidate=candidate, pooling="shared", fit=fit, gain=5.0, physical=True) if ended_by_choice else None
    named = Trial(candidate=candidate, pooling="shared", fit=fit, gain=5.0, physical=True)
    first = Step(before=fit, residuals=(), screening=replace(screening, z=np.array([20.0])), chosen=named)
    last = Step(before=fit, residuals=(), screening=screening, chosen=trial)
    found = Found(fit, fit, (first, last))
    p_value = 0.1 * STRUCTURE_ALPHA if in_residuals else 10 * STRUCTURE_ALPHA
    assert structure_remains(found, p_value) == (in_residuals or (in_scores and not ended_by_choice))
    predicts_nobody = Found(fit, fit, (first, replace(last, chosen=None, unpredictive=True)))
    assert structure_remains(predicts_nobody, p_value) == in_residuals


# What stands in


def layer(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A spring and a damper in series, the same for all."""
    return z + 1 / (1 / 1.0 + s * 2e-3), np.zeros(len(z))


def nail(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A mass on a spring and a damper, of another size in everybody, with its resonance at 150 Hz."""
    mass = 2e-4 * np.exp(0.3 * rng.normal(size=(len(z), 1, 1)))
    stiffness = mass * (2 * np.pi * 150) ** 2
    damping = 0.4 * np.sqrt(mass * stiffness)
    return z + 1 / (1 / (s * mass) + 1 / (damping + stiffness / s)), np.zeros(len(z))


def layer_of_one(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The same layer, and only the first person has it."""
    first = (np.arange(len(z)) == 0)[:, None, None]
    return np.where(first, layer(s, z, rng)[0], z), np.zeros(len(z))


HIDDEN = {"layer": layer, "nail": nail, "layer of one": layer_of_one, "nothing": None}


def stand_in(hidden: str, n: int, seed: int = 1, frequency_hz: np.ndarray = FREQUENCY) -> tuple[Refit, Realised | None]:
    experiment = toy(*TOY, seed=seed, n=n, hidden=HIDDEN[hidden], frequency_hz=frequency_hz)
    fit = experiment.fit()
    residuals = residuals_of(fit)
    ports = missing_one_ports(fit, residuals)
    with ThreadPoolExecutor(1) as executor:
        return fit, stand_in_network(experiment.refitter, fit, residuals, ports, 1, executor)


def residuals_of(fit: Refit) -> list[PersonResiduals]:
    return person_residuals(fit, [str(i) for i in range(len(fit.data))])


def mean_square(fit: Refit) -> tuple[float, float]:
    """Of the whitened residuals outside of the elements, and its standard error if they are noise."""
    people = residuals_of(fit)
    freedom = sum(p.white.size - p.basis.shape[0] * p.basis.shape[2] for p in people)
    return sum(float(np.sum(p.outside(p.white) ** 2)) for p in people) / freedom, float(np.sqrt(2 / freedom))


@pytest.mark.parametrize(("hidden", "n"), [("layer", 20), ("nail", 20), ("layer", 6), ("nail", 6)])
def test_a_branch_outside_of_the_catalogue_is_stood_in_for(hidden: str, n: int) -> None:
    """Of few people frequencies are held out in place of people."""
    fit, realised = stand_in(hidden, n)
    before, error = mean_square(fit)
    assert before > 1 + 20 * error
    assert realised is not None
    assert realised.trial.effect.id == "unknown"
    assert realised.gain_se is not None
    assert realised.gain > 3 * realised.gain_se > 0
    grown = realised.trial.fit
    assert grown.model.additions[-1].effect in EFFECTS
    # The gap is closed: what is left is noise.
    after, error = mean_square(grown)
    assert after == pytest.approx(1, abs=4 * error)
    assert set(parse(grown.model.notation).elements) == set(grown.model.kernel.elements)


@pytest.mark.parametrize(("n", "seed"), [(20, 1), (6, 1), (6, 2)])
def test_nothing_stands_in_for_noise(n: int, seed: int) -> None:
    assert stand_in("nothing", n, seed)[1] is None


def test_a_branch_has_to_be_better_by_the_criterion_of_all_explanations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Predicting others better is not enough: the best of several that are tried does so by chance."""
    monkeypatch.setattr(unnamed_module, "compare", lambda *_: Comparison(3.3, 5.3))
    assert stand_in("layer", 20)[1] is None


def test_what_a_single_person_has_is_not_stood_in_for() -> None:
    """The gain of one among twenty is no surer than that one person: it is that person's, not the population's."""
    fit, realised = stand_in("layer of one", 20)
    assert mean_square(fit)[0] > 1.5
    assert realised is None


def test_nothing_stands_in_for_noise_of_few_people_by_chance() -> None:
    assert stand_in("nothing", 6, 3, np.geomspace(2, 2000, 41))[1] is None


# A law in the place of a network


@pytest.mark.parametrize("swept_once", [False, True])
def test_a_law_without_its_name_is_described_as_one(swept_once: bool) -> None:
    """And not as a network of no elements; a change along the sweep has a story, and its name nowhere."""
    experiment = toy(*TOY, seed=2)
    effect = entry("body.drift" if swept_once else "body.hysteresis")
    shape = next(iter(shape_grid(effect, experiment.model.scales)))
    candidate = Candidate(effect, "n1", shape)
    fit = replace(experiment.fit(), model=extended(experiment.model, candidate, "varying", 0.1))
    trial = Trial(candidate=candidate, pooling="varying", fit=fit, gain=9.0, physical=True)
    described = unknown_entry(Realised(along_the_sweep(trial) if swept_once else trial, 8.0, 2.0), 0)
    assert (described.id, described.place, described.network) == ("unknown", "n1", "")
    assert "small network" not in described.formula
    if swept_once:
        assert (described.formula, described.name) == (
            "a value that changes along the sweep",
            "element that changes along the sweep",
        )
        assert "both directions" in described.story
        assert fit.model.additions[0].effect is effect  # the trial itself keeps it
    else:
        assert described.formula == f"a law of the form {effect.formula}"
