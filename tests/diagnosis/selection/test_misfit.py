"""How much a difference of evidence is worth where physics is still missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from experiments import Experiment, concealing, entry

from bayes_impedance.diagnosis.catalogue.effect import Candidate
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals, real_and_imaginary
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import Comparison, compare
from bayes_impedance.diagnosis.selection.misfit import dependence
from bayes_impedance.diagnosis.selection.trial import try_candidate

FITS = tuple[Experiment, Refit, Refit]


@pytest.fixture(scope="module")
def fits() -> FITS:
    """A population with a residual mass, explained by a mass and by a delay."""
    experiment = concealing("rig.mass", "port", 1.0, seed=3, n=12)
    base = experiment.fit()
    right, wrong = (
        try_candidate(experiment.refitter, base, Candidate(entry(name), "port", {}), size, ("shared",))[0].fit
        for name, size in (("rig.mass", 1e-4), ("rig.delay", 1e-6))
    )
    return experiment, right, wrong


def residuals(fits: FITS) -> list[PersonResiduals]:
    return person_residuals(fits[1], [str(i) for i in range(len(fits[1].data))])


def with_noise(some: list[PersonResiduals], seed: int, common: np.ndarray | None = None) -> list[PersonResiduals]:
    """The same people with white residuals, and a curve (F,) over the noise that is the same in all."""
    rng = np.random.default_rng(seed)
    result = []
    for person in some:
        white = rng.normal(size=person.white.shape)
        if common is not None:
            white = white + real_and_imaginary(common)
        result.append(replace(person, white=white))
    return result


def test_points_with_white_residuals_count_one_by_one(fits: FITS) -> None:
    some = residuals(fits)
    beyond = sum(dependence(fits[1], fits[2], with_noise(some, seed)) > 1 for seed in range(200))
    assert beyond <= 13  # 2.5 % are expected; more than 13 of 200 would have a probability of 1e-3


def test_it_is_the_variance_over_blocks_of_what_remains(fits: FITS) -> None:
    """A remaining curve that is the same in everybody, with one sign in a block: N people count nearly as one."""
    some = residuals(fits)
    phase = np.linspace(0, 3 * np.pi, some[0].frequency_hz.size)
    weak, strong = (dependence(fits[1], fits[2], with_noise(some, 1, size * np.exp(1j * phase))) for size in (1.0, 4.0))
    assert weak > 3
    assert strong > weak


def test_a_difference_that_is_worth_little_decides_nothing(fits: FITS) -> None:
    plain = compare(fits[1], fits[2])
    assert plain.decided
    assert compare(fits[1], fits[2], 0.9 * plain.difference / 3).decided
    assert not compare(fits[1], fits[2], 1.1 * plain.difference / 3).decided
    assert Comparison(10.0, 1.0).decided
    assert not Comparison(10.0, 1.0, 4.0).decided


def test_the_residuals_of_the_right_explanation_are_white(fits: FITS) -> None:
    assert dependence(fits[1], fits[2], residuals(fits)) == 1.0
