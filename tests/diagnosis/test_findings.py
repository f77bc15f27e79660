"""What a search has found is continued until it is at rest."""

from __future__ import annotations

from dataclasses import replace

import pytest
from experiments import TOY, toy

from bayes_impedance.diagnosis.findings import at_rest
from bayes_impedance.diagnosis.fit.refit import Refit


def test_a_fit_that_was_left_on_its_way_comes_to_rest() -> None:
    """A far start and a few rounds: where it goes on it is better, and what is at rest stays."""
    experiment = toy(*TOY, seed=7, n=12)
    refitter = experiment.refitter
    begun = refitter.fit(experiment.model, experiment.u + 1.0, experiment.population, 3)
    assert not begun.settled
    rest = at_rest(refitter, begun)
    assert rest.settled
    assert rest.evidence.sum() > begun.evidence.sum()
    assert at_rest(refitter, rest) is rest


@pytest.mark.parametrize("worse", [0.2, 0.5])
def test_a_rest_with_less_evidence_is_none(worse: float) -> None:
    """Additions were moved to where the evidence is largest, and rounds may lead away from there again."""
    experiment = toy(*TOY, seed=7, n=12)
    fit = experiment.fit()
    assert fit.settled
    elsewhere = replace(fit, evidence=fit.evidence - worse / fit.evidence.size)

    class Continued:
        def fit(self, *_: object) -> Refit:
            return elsewhere

    left = replace(fit, settled=False)
    found = at_rest(Continued(), left)  # type: ignore[arg-type]
    assert found is (elsewhere if worse < 0.3 else left)
