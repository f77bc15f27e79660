"""Effects whose size cannot be told from nothing keep no name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Experiment, entry, recovered, toy, with_mass

from bayes_impedance.diagnosis.selection import names_of_a_size as module
from bayes_impedance.diagnosis.selection.names_of_a_size import names_of_a_size, sizes_in_deviations
from bayes_impedance.diagnosis.selection.stepwise import Found


def of_either_sign(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A mass too many in half of the people, and one too few in the others."""
    mass = 2e-5 * np.where(np.arange(len(z)) % 2, 1.05, -0.95) * rng.uniform(0.8, 1.2, len(z))
    return z + s * mass[:, None, None], mass


def found_in(experiment: Experiment, name: str, pooling: str) -> Found:
    fit = recovered(experiment, entry(name), "port", pooling)
    step: Any = SimpleNamespace(chosen=None)
    return Found(experiment.fit(), fit, (step,))


@pytest.mark.parametrize(("name", "pooling"), [("body.mass", "varying"), ("rig.mass", "shared")])
def test_a_mass_that_is_there_keeps_its_name(name: str, pooling: str) -> None:
    experiment = toy(*TOY, seed=2, hidden=with_mass(0.3 if pooling == "varying" else 0.0))
    found = found_in(experiment, name, pooling)
    (size,) = sizes_in_deviations(found.final, 1)
    assert size > 3
    assert names_of_a_size(experiment.refitter, found, 1) is found


@pytest.mark.parametrize("pooling", ["varying", "shared"])
def test_a_mean_that_is_said_to_be_zero_is_believed_where_people_differ_in_sign(
    monkeypatch: pytest.MonkeyPatch, pooling: str
) -> None:
    """An approximation far from the fit says nothing of people who all have the effect."""
    experiment = toy(*TOY, seed=2, hidden=with_mass(0.3 if pooling == "varying" else 0.0))
    found = found_in(experiment, "body.mass", pooling)
    zero = SimpleNamespace(central=np.random.default_rng(1).normal(size=(500, 1)))
    monkeypatch.setattr(module, "coefficient_posterior", lambda *_: zero)
    kept = names_of_a_size(experiment.refitter, found, 1)
    assert (kept is found) == (pooling == "varying")


def test_a_mass_of_either_sign_describes_people_better_and_is_no_mass() -> None:
    experiment = toy(*TOY, seed=2, hidden=of_either_sign)
    found = found_in(experiment, "body.mass", "varying")
    assert found.final.evidence.sum() > found.base.evidence.sum() + 10
    kept = names_of_a_size(experiment.refitter, found, 1)
    assert kept.final is kept.base


def test_the_least_certain_goes_first_and_the_others_are_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without it another may be certain."""

    def of(*keys: str) -> Any:
        return SimpleNamespace(model=SimpleNamespace(additions=keys))

    sizes = {("a", "b", "c"): [2.0, -0.1, -0.4], ("a", "b"): [2.0, 0.5]}
    monkeypatch.setattr(module, "sizes_in_deviations", lambda fit, _: sizes[fit.model.additions])
    monkeypatch.setattr(
        module,
        "without",
        lambda _, found, gone: Found(found.base, of(*(k for k in found.final.model.additions if k not in gone)), ()),
    )
    kept: Any = names_of_a_size(None, Found(of(), of("a", "b", "c"), ()), 1)  # type: ignore[arg-type]
    assert kept.final.model.additions == ("a", "b")


def test_a_coefficient_that_may_have_either_sign_is_not_asked() -> None:
    found = found_in(toy(*TOY, seed=2, hidden=of_either_sign), "body.mass", "varying")
    (own,) = found.final.model.additions
    free = replace(own, effect=replace(own.effect, signed=True))
    fit = replace(found.final, model=replace(found.final.model, additions=(free,)))
    assert sizes_in_deviations(fit, 1) == [np.inf]
    assert sizes_in_deviations(found.base, 1) == []
