"""A population from which a fit begins besides its own searches."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from datasets import recordings as recordings_of
from datasets import subject

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.fit import fit_population
from bayes_impedance.population.given_start import unbounded_start
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.requirements import checked_model
from bayes_impedance.population.starting_fits import first_fits

NETWORK = "offset[m1*](r1|n1)"
START = {"m1": -2e-3, "r1": 1.5, "n1": np.array([1e-3, 2e-3, 3e-3])}


def test_values_become_unbounded_parameters_on_the_scales_of_the_fit() -> None:
    kernel = checked_model(recordings_of(*(subject(f"S{i}") for i in range(3))), NETWORK).kernel
    prior = Prior(centre=np.arange(3.0))
    u = unbounded_start(START, kernel, 3, prior)
    column = {name: k for k, name in enumerate(kernel.elements)}
    np.testing.assert_allclose(np.exp(u[:, column["r1"]]), 1.5)
    np.testing.assert_allclose(np.exp(u[:, column["n1"]]), START["n1"])
    assert kernel.scales["m1"] != 1.0
    np.testing.assert_allclose(u[:, column["m1"]] * kernel.scales["m1"], -2e-3)
    without = {name: value for name, value in START.items() if name != "m1"}
    u = unbounded_start(without, kernel, 3, prior, rig=("m1",))
    np.testing.assert_array_equal(u[:, column["m1"]], prior.centre[column["m1"]])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"r1": None}, "has no value of r1"),
        ({"r2": 1.0}, "names r2"),
        ({"r1": np.ones(2)}, "2 values of r1"),
        ({"r1": -1.0}, "r1"),
        ({"m1": np.nan}, "m1"),
    ],
)
def test_an_impossible_start_is_told(change: dict[str, object], said: str) -> None:
    given = {name: value for name, value in (START | change).items() if value is not None}
    with pytest.raises(InputError, match=said):
        unbounded_start(given, Kernel(parse(NETWORK)), 3, Prior(centre=np.zeros(3)))  # type: ignore[arg-type]


def test_a_start_is_checked_before_anything_is_fitted() -> None:
    with pytest.raises(InputError, match="has no value of n1"):
        fit_population(recordings_of(*(subject(f"S{i}") for i in range(12))), "r1|n1", start={"r1": 1.0})


def test_a_start_is_one_more_common_solution() -> None:
    recordings = recordings_of(*(subject(f"S{i}") for i in range(12)))
    kernel = checked_model(recordings, "r1|n1").kernel
    start = np.random.default_rng(1).normal(size=(12, 2))
    with ThreadPoolExecutor(1) as executor:
        prior, seed = default_prior(kernel, recordings), np.random.SeedSequence(1)
        without, beside = (
            first_fits(kernel, recordings, prior, seed, executor, lambda *_: None, start=begin)
            for begin in (None, start)
        )
    np.testing.assert_array_equal(beside.common[-1], start)
    np.testing.assert_allclose(beside.common[: len(without.common)], without.common, rtol=1e-6)
