"""What no fit can use is refused in one sentence before any work: covariates, networks, impedances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from datasets import subject

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.fit import FitSettings
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.requirements import MOST_ELEMENTS, checked_model, network_of, require_usable
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings

AGE = np.array([21.0, 35.0, 28.0, 60.0, 44.0, 51.0, 33.0, 25.0])
FORCE = np.array([1.0, 0.9, 1.1, 1.05, 0.95, 1.02, 0.97, 1.0])


def people(**covariates: np.ndarray) -> Recordings:
    subjects = tuple(
        subject(f"S{i}", **{name: float(values[i]) for name, values in covariates.items()}) for i in range(AGE.size)
    )
    return Recordings(title="T", unit="N s/m", network="r1|m1", source="", licence="", subjects=subjects)


def test_good_covariates_are_standardised_whatever_their_unit() -> None:
    expected = (AGE - AGE.mean()) / AGE.std()
    for scale in (1.0, 1e300, 1e-300):
        design = standardised_covariates(people(age=scale * AGE, force=FORCE), ("age", "force"))
        np.testing.assert_allclose(design[:, 0], expected, rtol=1e-12)
    indicator = np.array([0.0, 0, 0, 0, 0, 0, 0, 1])
    assert standardised_covariates(people(age=indicator), ("age",)).std() == pytest.approx(1)
    rounded = np.array([0.3, 0.1 + 0.2, 1, 2, 3, 4, 5, 6])
    assert standardised_covariates(people(age=rounded), ("age",)).std() == pytest.approx(1)
    assert standardised_covariates(people(), ()).shape == (8, 0)


def _with(values: np.ndarray, index: int, value: float) -> np.ndarray:
    changed = values.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize(
    ("covariates", "names", "words"),
    [
        ({"age": AGE}, ("aeg",), ['"aeg" is not in the dataset', 'did you mean "age"']),
        ({}, ("age",), ["there are none"]),
        ({"age": AGE}, ("age", "age"), ["named twice"]),
        ({"age": _with(AGE, 2, np.nan)}, ("age",), ["missing for subject S2"]),
        ({"age": 0 * AGE}, ("age",), ["same for all"]),
        ({"age": 0 * AGE + 1e300}, ("age",), ["same for all"]),
        ({"age": 1 + 1e-17 * AGE}, ("age",), ["same for all"]),
        ({"age": _with(AGE, 3, 1e300)}, ("age",), ["1e+300 for subject S3", "correct it"]),
        ({"age": _with(AGE, 3, -1e38)}, ("age",), ["-1e+38 for subject S3"]),
        ({"age": AGE, "months": 12 * AGE}, ("age", "months"), ['"age", "months" are linearly dependent']),
        ({"age": AGE, "young": 80 - AGE, "force": FORCE}, ("force", "age", "young"), ['covariates "age", "young" are']),
        ({"age": AGE, "force": FORCE, "both": AGE + 9 * FORCE}, ("age", "force", "both"), ["are linearly dependent"]),
        ({"age": AGE, "near": AGE + 0.1 * FORCE}, ("age", "near"), ["are linearly dependent"]),
        (
            {f"x{i}": AGE ** (0.2 * i + 1) for i in range(9)},
            tuple(f"x{i}" for i in range(9)),
            ["9 covariates are too many"],
        ),
        (
            {f"x{i}": AGE ** (0.2 * i + 1) for i in range(6)},
            tuple(f"x{i}" for i in range(6)),
            ["are linearly dependent"],
        ),
    ],
)
def test_covariates_that_cannot_be_told_apart_are_refused(
    covariates: dict[str, np.ndarray], names: tuple[str, ...], words: list[str]
) -> None:
    with pytest.raises(InputError) as told:
        standardised_covariates(people(**covariates), names)
    for word in words:
        assert word in str(told.value)


def test_covariates_that_only_go_together_are_accepted() -> None:
    similar = AGE + np.array([1.0, -2, 2, -1, 1, 2, -2, 0])
    assert standardised_covariates(people(age=AGE, other=similar), ("age", "other")).shape == (8, 2)


def test_covariates_of_a_fit_are_names() -> None:
    with pytest.raises(InputError, match="tuple of names"):
        FitSettings(covariates="age")  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [0.0, np.nan, np.inf, 1e160, 1e300, 1e-300])
def test_impedances_that_no_load_can_be_are_refused(value: float) -> None:
    data = people()
    z = data.subjects[3].z.copy()
    z[1, 2] = value
    broken = replace(data, subjects=(*data.subjects[:3], replace(data.subjects[3], z=z), *data.subjects[4:]))
    kernel = Kernel(parse("r1|m1"))
    require_usable(data, kernel)
    with pytest.raises(InputError, match=r"subject S3, repetition 2: z is .* Hz, which is not a possible impedance"):
        require_usable(broken, kernel)
    with pytest.raises(InputError, match="at least one subject"):
        require_usable(replace(data, subjects=()), kernel)


@pytest.mark.parametrize("factor", [1e-20, 1e-7, 1e7, 1e20])
def test_a_person_of_another_order_of_magnitude_is_refused(factor: float) -> None:
    data = people()
    kernel = Kernel(parse("r1|m1"))
    far = replace(data.subjects[3], z=factor * data.subjects[3].z)
    with pytest.raises(InputError, match=r"subject S3: \|z\| is .* check its unit"):
        require_usable(replace(data, subjects=(*data.subjects[:3], far, *data.subjects[4:])), kernel)
    tenfold = replace(data.subjects[3], z=100 * data.subjects[3].z)
    require_usable(replace(data, subjects=(*data.subjects[:3], tenfold, *data.subjects[4:])), kernel)


def test_a_network_in_which_nobody_differs_is_refused() -> None:
    data = simulate_recordings(THREE_ELEMENTS, 4, 1, np.geomspace(5, 5000, 20), 1).recordings
    with pytest.raises(InputError, match="is the same for all"):
        checked_model(data, "m1*|r1*|n1*")
    assert checked_model(data, "m1*|r1*|n1").kernel.elements == ("m1", "r1", "n1")
    assert checked_model(data.select([data.names[0]]), "m1*|r1*|n1*").kernel.elements == ("m1", "r1", "n1")


def test_networks_of_more_elements_than_can_be_estimated_are_refused() -> None:
    data = people()
    most = "|".join(f"m{i}" for i in range(MOST_ELEMENTS))
    assert len(network_of(data, most).elements) == MOST_ELEMENTS
    with pytest.raises(InputError, match="has 60 elements"):
        network_of(data, "|".join(f"m{i}" for i in range(60)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"centre": np.array([np.nan])}, "centre"),
        ({"centre": np.zeros((2, 2))}, "centre"),
        ({"centre_sd": -3.0}, "centre_sd is -3.0"),
        ({"dispersion_sd": 0.0}, "dispersion_sd is 0.0"),
        ({"concentration": np.inf}, "concentration is inf"),
        ({"slope_sd": True}, "slope_sd is true"),
        ({"slope_sd": "1"}, "slope_sd is"),
    ],
)
def test_priors_that_are_none_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Prior(**({"centre": np.zeros(2)} | change))  # type: ignore[arg-type]
