"""Units, prefixes and digits of all texts."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import repeatable

from bayes_impedance.units import (
    Scale,
    hertz,
    number_with_unit,
    rounded,
    scale_for,
    signed,
    significant,
    typeset,
    unit_of,
    with_interval,
)


@pytest.mark.parametrize(
    ("unit", "impedance", "expected"),
    [
        ("m", "N s/m", "kg"),
        ("n", "N s/m", "m/N"),
        ("r", "ohm", "ohm"),
        ("k", "N s/m", "N/m"),
        ("k", "ohm", "1/F"),
        ("k", "Pa s/m", "Pa s/m/s"),
        ("c", "N s/m", "N s/m s^(a-1)"),
        ("Hz", "N s/m", "Hz"),
        ("", "N s/m", ""),
    ],
)
def test_units_of_parameters(unit: str, impedance: str, expected: str) -> None:
    assert unit_of(unit, impedance) == expected


@pytest.mark.parametrize(
    ("value", "unit", "factor", "text"),
    [
        (6.8e-7, "m/N", 1e6, "µm/N"),
        (4.48e-3, "m/N", 1e3, "mm/N"),
        (0.052, "kg", 1e3, "g"),
        (7.8e-4, "kg", 1e3, "g"),
        (3e-6, "kg", 1e6, "mg"),
        (2.5, "kg", 1.0, "kg"),
        (61.4, "N s/m", 1.0, "N s/m"),
        (0.017, "ohm", 1e3, "mΩ"),
        (0.2, "ohm", 1.0, "Ω"),
        (904.0, "F", 1.0, "F"),
        (2e4, "N s/m", 1e-3, "kN s/m"),
        (3e-5, "kg m^2", 1e6, "mg m²"),
        (2e-9, "m^3/Pa", 1e9, "10⁻⁹ m³/Pa"),
        (0.0, "kg", 1.0, "kg"),
        (float("nan"), "m/N", 1.0, "m/N"),
    ],
)
def test_prefixes(value: float, unit: str, factor: float, text: str) -> None:
    scale = scale_for(value, unit)
    assert scale.unit == text
    assert scale.factor == pytest.approx(factor)


@repeatable
@given(
    st.floats(1e-14, 1e14), st.sampled_from(["kg", "m/N", "N s/m", "ohm", "F", "m^3/Pa", "kg m^2", "rad/(N m)", "foo"])
)
def test_scaled_values_are_easy_to_read(value: float, unit: str) -> None:
    assert 0.099 <= value * scale_for(value, unit).factor < 1000.1


def test_axis_labels() -> None:
    assert Scale(1.0, "").label("share") == "share"
    assert Scale(1e6, "µm/N").label("n3") == "n3 (µm/N)"
    assert typeset("ohm m^-2") == "Ω m⁻²"


def test_digits_follow_the_interval() -> None:
    assert with_interval(0.68234, 0.64702, 0.72338) == ("0.682", "0.647 to 0.723")
    assert with_interval(904.1, 674.06, 1182.7) == ("904", "674 to 1183")
    assert with_interval(2.0, 2.0, 2.0) == ("2.00", "2.00 to 2.00")


def test_significant_digits() -> None:
    assert significant(0.0) == "0"
    assert significant(0.053549) == "0.0535"
    assert significant(1234.5, 2) == "1234"
    assert significant(3.2e-7) == "3.20×10⁻⁷"
    assert significant(float("nan")) == "–"


def test_signs() -> None:
    assert signed(0.4) == "+0.40"
    assert signed(-0.4) == "−0.40"
    assert signed(-0.001) == "0.00"


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (1.53e-6, "s", "1.53 µs"),
        (1.5e-4, "s", "0.15 ms"),
        (2.1e-6, "kg", "2.1 mg"),
        (1.7, "kg", "1.7 kg"),
        (0.25, "N s/m", "0.25 N s/m"),
        (-0.012, "N s/m", "-12 mN s/m"),
        (0.012345, "", "0.0123"),
        (0.5, "1", "0.5"),
        (0.02, "per °C", "0.02 per °C"),
        (49.97, "Hz", "50 Hz"),
        (0.05, "Hz", "0.05 Hz"),
        (999.7, "Hz", "1000 Hz"),
        (41234.0, "Hz", "41.2 kHz"),
        (2e6, "Hz", "2000 kHz"),
        (0.0, "N/m", "0 N/m"),
        (math.inf, "N/m", "an unknown amount"),
    ],
)
def test_numbers_of_sentences(value: float, unit: str, text: str) -> None:
    assert number_with_unit(value, unit) == text


def test_frequencies_of_sentences() -> None:
    assert hertz(5.0) == "5 Hz"
    assert hertz(5160.0) == "5.16 kHz"
    assert hertz(5160.0, digits=2) == "5.2 kHz"
    assert hertz(math.inf) == "infinity"


def test_rounded_numbers_have_no_zeros_at_the_end() -> None:
    assert rounded(1234.5) == "1230"
    assert rounded(1.0) == "1"
    assert rounded(0.12, 2) == "0.12"
    assert rounded(0.996, 2) == "1"
