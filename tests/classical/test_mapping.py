"""Mapping a rational impedance onto the network: exact, nearest, and elements that are not identified."""

from __future__ import annotations

import json

import numpy as np
import pytest
from conftest import published

from bayes_impedance.classical.elementwise import Curve
from bayes_impedance.classical.mapping import map_to_network
from bayes_impedance.classical.system_identification import identify
from bayes_impedance.classical.vector_fitting import vector_fit
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.network.rational import TransferFunction

PAPER = parse(PAPER_NETWORK)
SIMPLE = parse("(n3|r3)-(m2|r1|n1)")
TYPICAL = {"n3": 6.7e-7, "r3": 60.0, "m2": 7.6e-4, "r1": 1.5, "n1": 1.2e-3, "m1": 0.05, "n2": 4.9e-3, "r2": 3.7}
FREQUENCY_HZ = np.geomspace(5, 5000, 201)


@pytest.fixture(scope="module")
def sit():
    return map_to_network(published("sit"), PAPER, np.geomspace(5, 5000, 401))


def test_an_exact_function_gives_its_elements_back():
    transfer = PAPER.transfer_function(TYPICAL)
    mapping = map_to_network(transfer, PAPER, FREQUENCY_HZ)
    assert (mapping.n_coefficients, mapping.n_elements) == (10, 8)
    assert mapping.obstacles == ()
    assert [s.positive for s in mapping.exact] == [True]
    assert mapping.distance < 1e-9
    for name, element in mapping.elements.items():
        assert element.value == pytest.approx(TYPICAL[name], rel=1e-6)
        assert element.q05 <= element.value <= element.q95
        assert mapping.exact[0].values[name] == pytest.approx(TYPICAL[name], rel=1e-6)
    assert mapping.elements["m2"].unit == "kg"
    assert max(abs(r - 1) for r in mapping.coefficient_ratios.values()) < 1e-6


def test_vector_fitting_with_its_pole_kept_at_0_can_be_mapped():
    """The paper's could not, because of its constant term in the denominator."""
    transfer = PAPER.transfer_function(TYPICAL)
    fitted = vector_fit(FREQUENCY_HZ, transfer(2j * np.pi * FREQUENCY_HZ), 5, pole_at_zero=True)
    mapping = map_to_network(fitted.model.transfer_function(), PAPER, FREQUENCY_HZ)
    assert mapping.obstacles == ()
    for name, element in mapping.elements.items():
        assert element.value == pytest.approx(TYPICAL[name], rel=1e-6)


def test_the_first_published_curve(sit):
    assert sit.obstacles == ()
    assert sit.exact == ()  # no elements at all, not even negative ones, meet all coefficients
    assert sit.distance == pytest.approx(0.043, abs=0.0005)
    assert [n for n, e in sit.elements.items() if e.value is None] == ["r1"]
    assert sit.elements["r1"].amplification > 100
    assert sit.elements["r3"].amplification < 3
    for element in sit.elements.values():
        assert (element.value is None) == (element.q05 is None) == (element.q95 is None)
        if element.value is not None:
            assert element.q05 < element.value < element.q95


def test_the_second_published_curve_has_no_pole_at_0():
    transfer = published("vf_median")
    mapping = map_to_network(transfer, PAPER, np.geomspace(5, 5000, 401))
    assert mapping.obstacles == (f"a0 = {transfer.denominator[-1]:.4g}",)
    assert mapping.exact == ()
    assert mapping.distance == pytest.approx(0.048, abs=0.0005)
    assert [n for n, e in mapping.elements.items() if e.value is None] == ["n3"]


def test_the_summary_is_json_without_infinities(sit):
    text = json.dumps(sit.summary(), allow_nan=False)
    assert json.loads(text)["elements"]["r1"]["value"] is None


def test_elasticities_say_what_an_element_becomes():
    """At an exact network, moving the coefficients along one element's own change moves just that element."""
    mapping = map_to_network(PAPER.transfer_function(TYPICAL), PAPER, FREQUENCY_HZ)
    held_by = dict(mapping.elements["r3"].held_by)
    assert set(held_by) & {"b5", "a5"} == {"b5", "a5"}  # at high frequency z is r3 alone: b5/a5
    assert mapping.elements["r1"].amplification > 5 * mapping.elements["r3"].amplification


def test_mapping_of_a_noisy_fit_is_the_direct_fit_with_the_same_intervals():
    """Least squares through the larger set first is least squares on the recordings."""
    values = {e: TYPICAL[e] for e in SIMPLE.elements}
    kernel, truth = Kernel(SIMPLE), np.log([values[e] for e in SIMPLE.elements])
    clean = kernel.impedance(truth, FREQUENCY_HZ)
    sd = 0.02 * np.abs(clean)
    scores = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        z = clean + sd * (rng.normal(size=sd.size) + 1j * rng.normal(size=sd.size))
        direct, _ = Curve(kernel, FREQUENCY_HZ, z, "complex", 1 / sd, truth).best(truth[None])
        fitted = identify(FREQUENCY_HZ, z, 3, 3, noise_sd=sd)
        mapping = map_to_network(fitted.transfer, SIMPLE, FREQUENCY_HZ, noise_sd=sd, seed=seed)
        assert mapping.whitened_distance < 0.5
        error = np.array([mapping.elements[e].standard_error for e in SIMPLE.elements])
        np.testing.assert_allclose((mapping.log_elements - direct) / error, 0, atol=0.25)
        scores.append((mapping.log_elements - truth) / error)
    assert 0.6 < np.std(scores) < 1.5


def test_an_element_that_the_band_does_not_show_gets_no_number():
    values = {**TYPICAL, "n3": 1e-10}  # stiff far beyond the band
    mapping = map_to_network(
        PAPER.transfer_function(values), PAPER, FREQUENCY_HZ, noise_sd=np.full(FREQUENCY_HZ.size, 0.05)
    )
    assert mapping.elements["n3"].value is None
    assert mapping.elements["m2"].value == pytest.approx(TYPICAL["m2"], rel=1e-3)


def test_refuses_functions_that_are_no_impedance():
    entry = published("sit")
    turned = TransferFunction.from_coefficients([-c for c in entry.numerator], entry.denominator.tolist())
    with pytest.raises(InputError, match="reverse the sign"):
        map_to_network(turned, PAPER, FREQUENCY_HZ)
    complex_one = TransferFunction.from_coefficients([1.0, 2.0 + 1j], [1.0, 0.0])
    with pytest.raises(InputError, match="coefficients are complex"):
        map_to_network(complex_one, PAPER, FREQUENCY_HZ)
    with pytest.raises(InputError, match="too few for 8 elements"):
        map_to_network(entry, PAPER, FREQUENCY_HZ[:3])
