"""Forms and units: closed forms, and both meanings of g."""

import numpy as np
import pytest
from known_impedance import FREQUENCY, impedance

from bayes_impedance.errors import InputError
from bayes_impedance.intake.quantities import (
    FORMS,
    Response,
    channel_of,
    form_named,
    hertz_factor,
    is_response_unit,
    radian_factor,
    response_of,
    si_response,
)

S = 2j * np.pi * FREQUENCY
Z = impedance()
MEASURED = {
    "dynamic stiffness": S * Z,
    "impedance": Z,
    "apparent mass": Z / S,
    "receptance": 1 / (S * Z),
    "mobility": 1 / Z,
    "accelerance": S / Z,
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_impedance(form: str) -> None:
    response = si_response(form)
    np.testing.assert_allclose(response.impedance(FREQUENCY, MEASURED[form]), Z, rtol=1e-13)


@pytest.mark.parametrize("form", FORMS)
def test_noise_is_carried_over_to_first_order(form: str) -> None:
    rng, h = np.random.default_rng(1), MEASURED[form]
    sd = 1e-4 * np.abs(h)
    noisy = h + sd * (rng.normal(size=(4000, h.size)) + 1j * rng.normal(size=(4000, h.size)))
    z = si_response(form).impedance(FREQUENCY, noisy)
    predicted = si_response(form).noise(Z, h, sd)
    # 4000 draws know a standard deviation to 1.1 %; the largest of 50 is within five times that.
    for part in (z.real, z.imag):
        np.testing.assert_allclose(part.std(axis=0), predicted, rtol=0.06)


@pytest.mark.parametrize(
    ("unit", "form", "factor", "kept"),
    [
        ("m/s^2/N", "accelerance", 1.0, "N s/m"),
        ("(m/s²)/N", "accelerance", 1.0, "N s/m"),
        ("m s-2 N-1", "accelerance", 1.0, "N s/m"),
        ("1/kg", "accelerance", 1.0, "N s/m"),
        ("g/N", "accelerance", 9.80665, "N s/m"),
        ("g/lbf", "accelerance", 9.80665 / 4.4482216152605, "N s/m"),
        ("mm/s/N", "mobility", 1e-3, "N s/m"),
        ("µm/N", "receptance", 1e-6, "N s/m"),
        ("in/lbf", "receptance", 0.0254 / 4.4482216152605, "N s/m"),
        ("N/mm", "dynamic stiffness", 1e3, "N s/m"),
        ("N/g", "apparent mass", 1 / 9.80665, "N s/m"),
        ("g", "apparent mass", 1e-3, "N s/m"),
        ("kg", "apparent mass", 1.0, "N s/m"),
        ("Ns/m", "impedance", 1.0, "N s/m"),
        ("N·s·m⁻¹", "impedance", 1.0, "N s/m"),
        ("mNs/mm", "impedance", 1.0, "N s/m"),
        ("lbf s/in", "impedance", 4.4482216152605 / 0.0254, "N s/m"),
        ("N m/deg", "dynamic stiffness", 180 / np.pi, "N m s/rad"),
        ("Nms/rad", "impedance", 1.0, "N m s/rad"),
        ("kg m^2", "apparent mass", 1.0, "N m s/rad"),
        ("deg/(N m)", "receptance", np.pi / 180, "N m s/rad"),
        ("rad/s/(N m)", "mobility", 1.0, "N m s/rad"),
        ("kΩ", "impedance", 1e3, "ohm"),
        ("mS", "mobility", 1e-3, "ohm"),
    ],
)
def test_units_say_form_and_factor(unit: str, form: str, factor: float, kept: str) -> None:
    found = response_of(unit, "here")
    assert (found.form, found.unit) == (form, kept)
    assert found.factor == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("unit", ["", "dB", "furlong", "m/s^2", "N", "N//m", "m/(N", "kg^99", "N" * 200, "1", "/N"])
def test_what_is_no_unit_of_a_driving_point_is_refused(unit: str) -> None:
    assert not is_response_unit(unit)
    with pytest.raises(InputError, match="none of a driving point"):
        response_of(unit, "here")


def test_unit_and_form_must_agree() -> None:
    with pytest.raises(InputError, match="is that of mobility, not of receptance"):
        response_of("m/(N s)", "here", "receptance")


def test_channels_and_frequencies() -> None:
    assert channel_of("g") == ("acceleration", "translation", 9.80665)
    assert channel_of("mm") == ("displacement", "translation", 1e-3)
    assert channel_of("N m") == ("force", "rotation", 1.0)
    assert channel_of("kg/s") is None
    assert hertz_factor("kHz") == 1e3
    assert hertz_factor("rad/s") == pytest.approx(1 / (2 * np.pi))
    assert hertz_factor("m") is None
    assert radian_factor("deg") == pytest.approx(np.pi / 180)
    assert radian_factor("") is None


def test_forms_by_other_names() -> None:
    assert form_named("Inertance", "x") == "accelerance"
    assert form_named("dynamic-mass", "x") == "apparent mass"
    with pytest.raises(InputError, match="unknown"):
        form_named("flexibilty", "x")
    assert Response(form="mobility", factor=2.0, unit="N s/m").impedance(FREQUENCY, 0.5 / Z) == pytest.approx(Z)
