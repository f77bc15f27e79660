"""Names are kept only if they predict what was held out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from experiments import TOY, Experiment, entry, recovered, toy, with_mass

from bayes_impedance.diagnosis.selection import predictive_gain
from bayes_impedance.diagnosis.selection.predictive_gain import names_that_predict
from bayes_impedance.diagnosis.selection.stepwise import Found


class Named:
    """Stands for what a search found: some effects, in their order."""

    def __init__(self, *keys: str) -> None:
        additions = tuple(SimpleNamespace(key=(k, "", "port")) for k in keys)
        self.base = SimpleNamespace(model=SimpleNamespace(additions=()))
        self.final = SimpleNamespace(model=SimpleNamespace(additions=additions))

    @property
    def keys(self) -> list[str]:
        return [a.key[0] for a in self.final.model.additions]

    def step_of(self, addition: Any) -> Any:
        return SimpleNamespace(before=None, chosen=SimpleNamespace(fit=addition.key[0]))


def kept(monkeypatch: pytest.MonkeyPatch, n: int, gains: dict[str, Any]) -> list[str]:
    def without(_refitter: Any, found: Named, additions: Any) -> Named:
        return Named(*(a.key[0] for a in found.final.model.additions if a not in additions))

    def blocks(_refitter: Any, _base: Any, final: Any, _seed: int) -> Any:
        return SimpleNamespace(blocks=gains["".join(a.key[0] for a in final.model.additions)])

    monkeypatch.setattr(predictive_gain, "people_gain", lambda _r, _before, fit, _seed: gains[fit])
    monkeypatch.setattr(predictive_gain, "held_out", blocks)
    monkeypatch.setattr(predictive_gain, "without", without)
    start: Any = Named("a", "b") if "b" in gains or "ab" in gains else Named("a")
    found: Any = names_that_predict(SimpleNamespace(data=[None] * n), start, 1)[0]  # type: ignore[arg-type]
    return list(found.keys)


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ({"a": (0.5, 2.0)}, ["a"]),  # the first must gain
        ({"a": (-0.5, 2.0)}, []),
        ({"a": (50.0, 5.0), "b": (5.0, 2.0)}, ["a", "b"]),
        ({"a": (50.0, 5.0), "b": (3.0, 2.0)}, ["a"]),  # a further one by more than chance
        ({"a": (-1.0, 5.0), "b": (30.0, 2.0)}, ["b"]),
    ],
)
def test_by_held_out_people(
    monkeypatch: pytest.MonkeyPatch, gains: dict[str, tuple[float, float]], expected: list[str]
) -> None:
    assert kept(monkeypatch, 20, gains) == expected


@pytest.mark.parametrize(
    ("gains", "expected"),
    [({"a": 4.0}, ["a"]), ({"a": -0.9}, []), ({"ab": -0.1, "a": 2.0}, ["a"]), ({"ab": -0.1, "a": -3.0}, [])],
)
def test_by_held_out_frequencies_of_few_people(
    monkeypatch: pytest.MonkeyPatch, gains: dict[str, float], expected: list[str]
) -> None:
    assert kept(monkeypatch, 3, gains) == expected


def test_what_is_there_predicts() -> None:
    """A mass that is really there gains on held-out people, and the gain is reported."""
    experiment: Experiment = toy(*TOY, seed=2, hidden=with_mass(0.0))
    base = experiment.fit()
    fit = recovered(experiment, entry("rig.mass"), "port", "shared")
    step = SimpleNamespace(chosen=SimpleNamespace(fit=fit), before=base)
    found = Found(base, fit, (step,))  # type: ignore[arg-type]
    same, gains = names_that_predict(experiment.refitter, found, 1)
    assert same is found
    (gain, se), *_ = gains.values()
    assert se is not None
    assert gain > 5 * se
