"""Networks in state space, as coefficients, and as objects of python-control."""

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import SMALL
from hypothesis import given
from hypothesis import strategies as st
from strategies import networks, networks_with_elements, repeatable

from bayes_impedance.design.circuits.passivity_check import passive_coefficients, passive_states
from bayes_impedance.design.circuits.state_space import realise, zeros_and_poles
from bayes_impedance.design.circuits.transfer_functions import (
    described,
    matrices,
    read_control,
    to_control,
    transfer_function,
)
from bayes_impedance.design.users import Users
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.population.fingertip import FINGERTIP

S = 2j * np.pi * np.geomspace(1e-2, 1e2, 15)


@repeatable
@given(networks_with_elements(12))
def test_realisation_is_the_network_and_has_no_state_too_many(drawn) -> None:
    network, theta = drawn
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    realisation = realise(network, values)
    z = network.impedance(S, values)
    np.testing.assert_allclose(realisation(S)[0], z, rtol=1e-11)
    np.testing.assert_allclose(realisation.reciprocal()(S)[0], 1 / z, rtol=1e-11)
    function = network.transfer_function(values)
    degrees = [max(i for i, c in enumerate(p) if c != 0) for p in function.ascending]
    assert realisation.order == max(degrees)
    assert realisation.high == degrees[0] - degrees[1]
    lowest = [min(i for i, c in enumerate(p) if c != 0) for p in function.ascending]
    assert realisation.low == lowest[0] - lowest[1]


@repeatable
@given(networks_with_elements(12))
def test_zeros_poles_and_gain_make_the_impedance(drawn) -> None:
    network, theta = drawn
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    zeros, poles, gain = (x[0] for x in zeros_and_poles(realise(network, values)))
    z = gain * np.prod(S[:, None] - zeros, axis=1) / np.prod(S[:, None] - poles, axis=1)
    np.testing.assert_allclose(z, network.impedance(S, values), rtol=1e-8)
    assert np.all(poles.real <= 1e-9 * np.abs(poles))
    assert np.all(zeros.real <= 1e-9 * np.abs(zeros))


@repeatable
@given(networks_with_elements(10))
def test_states_store_energy_and_never_make_any(drawn) -> None:
    network, theta = drawn
    values = {e: np.array([x]) for e, x in zip(network.elements, np.exp(theta), strict=True)}
    assert passive_states(network, values).all()


def test_a_system_that_delivers_energy_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from bayes_impedance.design.circuits import passivity_check

    network = parse(SMALL.network)
    values = {e: np.array([v, v]) for e, v in SMALL.central.items()}
    assert passive_states(network, values).all()

    def spoiled(realisation):
        a, b, c, d = matrices(realisation)
        a = a.copy()
        a[1] += 2 * np.abs(a[1]).max() * np.eye(a.shape[-1])
        return a, b, c, d

    monkeypatch.setattr(passivity_check, "matrices", spoiled)
    assert passive_states(network, values).tolist() == [True, False]
    assert not passive_coefficients([1.0, -0.5, 1.0], [1.0, 1.0])


@repeatable
@given(networks(8), st.integers(0, 2**32 - 1))
def test_many_users_at_once_are_the_users_one_by_one(network, seed) -> None:
    values = np.exp(np.random.default_rng(seed).normal(size=(3, len(network.elements))))
    together = realise(network, dict(zip(network.elements, values.T, strict=True))).reciprocal()
    for i in range(3):
        alone = realise(network, dict(zip(network.elements, values[i], strict=True))).reciprocal()
        np.testing.assert_allclose(together(S)[i], alone(S)[0], rtol=1e-12)


def test_coefficients_are_those_of_the_appendix() -> None:
    z = transfer_function(parse(PAPER_NETWORK), FINGERTIP.central)
    assert (z.numerator.size, z.denominator.size) == (6, 6)
    assert z.denominator[0] == 1
    assert z.denominator[-1] == 0  # the pole at s = 0 that the paper's system identification found
    omega = 2j * np.pi * np.geomspace(5, 5000, 20)
    np.testing.assert_allclose(z(omega), parse(PAPER_NETWORK).impedance(omega, FINGERTIP.central), rtol=1e-10)


@pytest.mark.parametrize("form", ["transfer", "zeros_poles", "state_space"])
@pytest.mark.parametrize("mobility", [True, False])
def test_python_control_has_the_same_frequency_response(form: str, mobility: bool) -> None:
    pytest.importorskip("control", reason="python-control is an optional dependency")
    network = parse(PAPER_NETWORK)
    system = to_control(network, FINGERTIP.central, form, mobility=mobility)
    omega = 2 * np.pi * np.geomspace(5, 5000, 30)
    z = network.impedance(1j * omega, FINGERTIP.central)
    np.testing.assert_allclose(system(1j * omega), 1 / z if mobility else z, rtol=1e-10)


def test_python_control_is_refused_what_grows_without_bound() -> None:
    pytest.importorskip("control", reason="python-control is an optional dependency")
    with pytest.raises(InputError, match="ask for its reciprocal"):
        to_control(parse("m1|r1"), {"m1": 1.0, "r1": 1.0}, mobility=False)
    with pytest.raises(InputError, match="form is "):
        to_control(parse("m1|r1"), {"m1": 1.0, "r1": 1.0}, "matrix")


def test_exported_transfer_functions_load_in_python_control(tmp_path: Path) -> None:
    control = pytest.importorskip("control", reason="python-control is an optional dependency")
    network = parse(PAPER_NETWORK)
    centre = np.log([FINGERTIP.central[e] for e in network.elements])
    users = Users(network, "N s/m", ("a", "b"), np.stack([centre, centre + 0.3]))
    file = tmp_path / "transfer.json"
    file.write_text(json.dumps(described(users)), encoding="utf-8")
    systems = read_control(file)
    assert list(systems) == ["a", "b"]
    frequency = np.geomspace(5, 5000, 20)
    for name, z in zip("ab", users.impedance(frequency), strict=True):
        assert isinstance(systems[name], control.StateSpace)
        np.testing.assert_allclose(1 / systems[name](2j * np.pi * frequency), z, rtol=1e-11)
    with pytest.raises(InputError, match=r"transfer\.json"):
        read_control(tmp_path / "nothing.json")
