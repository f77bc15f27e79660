"""What a user of Python hands over by mistake is refused in a sentence that names it, not by a traceback."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from hypothesis import given
from hypothesis import strategies as st
from strategies import repeatable

from bayes_impedance import (
    PHANTOM,
    FitSettings,
    InputError,
    check_recordings,
    design_answer,
    diagnose,
    fit_population,
    search_covariates,
)
from bayes_impedance.datasets import fingertip_population
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.runtime.user_table import whole_number_in

RECORDINGS = simulate_recordings(THREE_ELEMENTS, 3, 1, np.geomspace(5, 5000, 20), seed=1).recordings


def anything(value: object) -> Any:
    """A value of a wrong type, which a type checker would refuse."""
    return value


MISTAKES: dict[str, tuple[Callable[[], object], str]] = {
    "fit of a path": (lambda: fit_population(anything("mine")), 'recordings are "mine", .* read_recordings'),
    "fit of a Path": (lambda: fit_population(anything(Path("mine"))), "recordings are .*Path, .* read_recordings"),
    "diagnosis of a path": (lambda: diagnose(anything("mine")), "read_recordings"),
    "check of a path": (lambda: check_recordings(anything("mine")), "read_recordings"),
    "covariates of a path": (lambda: search_covariates(anything("mine")), "read_recordings"),
    "seed below zero": (lambda: fit_population(RECORDINGS, seed=-1), "^seed is -1, but must be a whole number from 0"),
    "half a seed": (lambda: diagnose(RECORDINGS, seed=anything(1.5)), "^seed is 1.5"),
    "no workers": (lambda: fit_population(RECORDINGS, workers=0), "^workers is 0"),
    "no draws": (lambda: FitSettings(draws=0), "^draws is 0"),
    "half a draw": (lambda: FitSettings(draws=anything(64.5)), "^draws is 64.5"),
    "prior as a path": (lambda: FitSettings(prior=anything("p.toml")), 'prior is "p.toml", .* read_prior'),
    "subject as a text": (lambda: RECORDINGS.select("nobody"), 'subject "nobody" is not among'),
    "frequency below zero": (lambda: fingertip_population().median_user().impedance([-1.0]), "a frequency is -1 Hz"),
    "frequency that is none": (lambda: fingertip_population().median_user().impedance(np.nan), "a frequency is nan"),
    "half a user": (lambda: fingertip_population().draw(anything(1.5), seed=1), "number of users is 1.5"),
    "damping below zero": (lambda: answer(damping=-1.0), "^damping is -1"),
    "more than everybody": (lambda: answer(share=2.0), "^share is 2"),
    "no gains": (lambda: answer(grid=0), "^grid is 0"),
}


def answer(**numbers: Any) -> object:
    population = fingertip_population()
    return design_answer(population, population.draw(2, seed=1), PHANTOM, **numbers)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_sentence(mistake: str) -> None:
    call, words = MISTAKES[mistake]
    with pytest.raises(InputError, match=words) as told:
        call()
    assert "\n" not in str(told.value)


def test_one_name_selects_one_subject() -> None:
    """The letters of a text are no names."""
    name = RECORDINGS.names[1]
    assert RECORDINGS.select(name).names == (name,)


def test_a_population_shows_itself_in_a_line() -> None:
    shown = repr(fingertip_population())
    assert "posterior draws" in shown
    assert len(shown) < 200


@repeatable
@given(st.one_of(st.integers(-5, 5), st.floats(-5, 5), st.booleans(), st.text(max_size=3)))
def test_whole_numbers(value: object) -> None:
    if type(value) is int and value >= 1:
        assert whole_number_in(value, "it", 1) == value
    else:
        with pytest.raises(InputError, match="whole number from 1 on"):
            whole_number_in(value, "it", 1)
