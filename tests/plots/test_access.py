"""What pictures and pages take from a result: draws of all chains, masked recordings, units, words for the subjects."""

from __future__ import annotations

import numpy as np
import pytest
from results_by_hand import CIRCUIT_VALUES, VALUES, make_result

from bayes_impedance.plots import access
from bayes_impedance.population.natural_scales import LOG_SD
from bayes_impedance.results.result import Result


def with_variable(result: Result, group: str, name: str, values: np.ndarray) -> Result:
    result.groups[group][name] = values
    return result


def test_a_variable_is_found_in_any_group() -> None:
    result = make_result()
    np.testing.assert_array_equal(access.variable(result, "observed_re"), result.groups["constant_data"]["observed_re"])
    assert access.variable(result, "nothing_of_the_kind") is None
    with pytest.raises(KeyError, match="nothing_of_the_kind"):
        access.needed(result, "nothing_of_the_kind")


def test_draws_of_all_ensembles_stand_in_one_row_one_ensemble_after_the_other() -> None:
    values = np.arange(2 * 3 * 4).reshape(2, 3, 4)
    rows = access.samples(with_variable(make_result(), "posterior", "own", values), "own")
    np.testing.assert_array_equal(rows, np.arange(24).reshape(6, 4))


def test_recordings_are_magnitude_and_phase_without_numbers_outside_of_their_band() -> None:
    result = make_result(gap=True, points=8)
    f, (magnitude, phase) = access.frequency(result), access.observed(result)
    assert magnitude.shape == phase.shape == (6, 8)
    assert np.isnan(magnitude[0, 4:]).all()
    assert np.isnan(phase[0, 4:]).all()
    assert np.isfinite(magnitude[1:]).all()
    data = result.groups["constant_data"]
    z = magnitude * np.exp(1j * np.deg2rad(phase))
    np.testing.assert_allclose(z[1], data["observed_re"][1] + 1j * data["observed_im"][1], rtol=1e-12)
    np.testing.assert_array_equal(f, np.geomspace(5.0, 5000.0, 8))
    assert access.subjects(result) == [f"P{i:02d}" for i in range(6)]


def test_elements_are_told_with_the_prefix_of_their_median() -> None:
    """6.8e-7 m/N are 0.68 um/N; an element without a number has no prefix."""
    result = make_result(unidentified=("n1",))
    assert VALUES["n3"] == 6.8e-7
    scale = access.element_scale(result, result.elements.index("n3"))
    assert (scale.factor, scale.unit) == (pytest.approx(1e6), "µm/N")
    unseen = access.element_scale(result, result.elements.index("n1"))
    assert (unseen.factor, unseen.unit) == (1.0, "m/N")
    assert access.identified(result).tolist() == [e != "n1" for e in result.elements]


def test_what_is_the_same_for_all_does_not_vary() -> None:
    result = make_result()
    assert access.varying(result).all()
    result.attributes["network"] = result.attributes["network"].replace("n3", "n3*")
    del result.__dict__["parameters"]  # made before the network was changed
    assert access.varying(result).tolist() == [e != "n3" for e in result.elements]


def test_prior_widths_of_an_earlier_version_are_the_default() -> None:
    result = make_result()
    for group in result.groups.values():
        group.pop("prior_centre_sd", None)
    np.testing.assert_array_equal(access.prior_sds(result), np.full(5, LOG_SD))
    known = with_variable(result, "constant_data", "prior_centre_sd", np.array([3, 1.5, 3, 0.01, 3]))
    assert access.prior_sds(known).tolist() == [3, 1.5, 3, 0.01, 3]


@pytest.mark.parametrize(("electrical", "one", "many"), [(False, "person", "people"), (True, "subject", "subjects")])
def test_circuits_are_not_people(electrical: bool, one: str, many: str) -> None:
    result = make_result(electrical=electrical)
    assert len(result.elements) == len(CIRCUIT_VALUES if electrical else VALUES)
    assert access.is_electrical(result) is electrical
    assert (access.who(result, 1), access.who(result, 2), access.who(result)) == (one, many, many)


@pytest.mark.parametrize(
    ("source", "title", "simulated"),
    [("measured", "ten", False), ("Simulated by hand", "ten", True), ("", "A simulation", True), (None, "ten", False)],
)
def test_a_simulation_says_that_it_is_one(source: str | None, title: str, simulated: bool) -> None:
    result = make_result()
    result.attributes.update(source=source or "", title=title)
    if source is None:
        del result.attributes["source"]
    assert access.is_simulated(result) is simulated
