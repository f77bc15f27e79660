"""Two-ports: identities, a rival implementation, and the device seen from both ends."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import repeatable

from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.loop import two_port
from bayes_impedance.design.loop.device import PHANTOM, Device, Section, read_device
from bayes_impedance.design.loop.two_port import TwoPort
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.population.simulate import FINGERTIP

S = 2j * np.pi * np.geomspace(1, 1000, 12)


@st.composite
def chains(draw):
    """A few impedances beside and between, and levers, in any order."""
    result = TwoPort(np.tile(np.eye(2, dtype=complex), (S.size, 1, 1)))
    kinds = draw(st.lists(st.sampled_from("sbl"), min_size=2, max_size=5))
    for kind in [*kinds, "s", "b"]:
        m, r, n = (10 ** draw(st.floats(-1, 1)) for _ in range(3))
        z = (r + S * m / 100 + 100 / (S * n)) / 5
        part = {"s": two_port.beside(z), "b": two_port.between(z), "l": two_port.lever(r, S.size)}[kind]
        result = result @ part
    return result


@repeatable
@given(chains(), st.floats(0.1, 10))
def test_forms_convert_into_each_other(chain, load) -> None:
    np.testing.assert_allclose(TwoPort.from_impedance(chain.impedance()).chain, chain.chain, rtol=1e-7)
    np.testing.assert_allclose(TwoPort.from_hybrid(chain.hybrid()).chain, chain.chain, rtol=1e-7)
    for mechanical in (True, False):
        again = TwoPort.from_forward(chain.forward(first_mechanical=mechanical), first_mechanical=mechanical)
        np.testing.assert_allclose(again.chain, chain.chain, rtol=1e-6)
    np.testing.assert_allclose(chain.determinant, 1, rtol=1e-7)  # no source inside, no gyrator
    np.testing.assert_allclose(chain.reversed().reversed().chain, chain.chain, rtol=1e-9)
    z = chain.impedance()
    np.testing.assert_allclose(z[:, 0, 1], z[:, 1, 0], rtol=1e-6)
    by_definition = z[:, 0, 0] - z[:, 0, 1] * z[:, 1, 0] / (z[:, 1, 1] + load)
    np.testing.assert_allclose(chain.seen(load), by_definition, rtol=1e-6)


@repeatable
@given(chains())
def test_scikit_rf_agrees(chain) -> None:
    network = pytest.importorskip("skrf.network", reason="scikit-rf is an optional reference")
    np.testing.assert_allclose(network.a2z(chain.chain), chain.impedance(), rtol=1e-7)
    np.testing.assert_allclose(network.z2a(chain.impedance()), chain.chain, rtol=1e-6)
    np.testing.assert_allclose(network.z2h(chain.impedance()), chain.hybrid(), rtol=1e-6)
    np.testing.assert_allclose(network.h2z(chain.hybrid()), chain.impedance(), rtol=1e-6)
    a = network.Network(f=np.arange(1, S.size + 1), s=network.a2s(chain.chain), z0=50)
    other = two_port.beside(3.0 + S) @ two_port.between(2.0 + 0 * S)
    b = network.Network(f=np.arange(1, S.size + 1), s=network.a2s(other.chain), z0=50)
    np.testing.assert_allclose((a**b).a, (chain @ other).chain, rtol=1e-6)


def test_the_forms_mean_what_they_say() -> None:
    z1, z2 = 3.0 + S, 5.0 / S
    chain = two_port.beside(z1) @ two_port.between(z2)
    h = chain.hybrid()
    flow, effort = 2.0, 7.0  # of the first and second side
    first, into_second = (h @ np.array([flow, effort]))[:, 0], (h @ np.array([flow, effort]))[:, 1]
    both = chain.chain @ np.stack([np.full(S.size, effort), -into_second])[..., None].transpose(1, 0, 2)
    np.testing.assert_allclose(both[:, 0, 0], first)
    np.testing.assert_allclose(both[:, 1, 0], flow)
    forward = chain.forward() @ np.array([flow, 11.0])  # velocity, force
    back = chain.chain @ forward[:, ::-1, None]
    np.testing.assert_allclose(back[:, 0, 0], 11.0)
    np.testing.assert_allclose(back[:, 1, 0], flow)


def test_motor_of_equation_two() -> None:
    resistance, inductance, constant, rotor = 2.0, 1e-3, 0.05, 1e-5 * S + 1e-4
    motor = two_port.motor(S, resistance, inductance, constant, rotor)
    h = motor.forward(first_mechanical=False)
    # Textbook: u = (R + sL) i + k Omega, M = k i - z_rotor Omega.
    voltage, current = 12.0, 0.7
    omega = (voltage - (resistance + S * inductance) * current) / constant
    torque = constant * current - rotor * omega
    np.testing.assert_allclose(h @ np.array([voltage, current]), np.stack([omega, torque], axis=1))
    np.testing.assert_allclose(motor.determinant, -1)  # electrodynamic conversion is a gyrator in this analogy
    held = motor.seen(np.full(S.size, 1e12))
    np.testing.assert_allclose(held, resistance + S * inductance, rtol=1e-6)
    with pytest.raises(InputError, match="gyrator"):
        two_port.transducer(2.0).hybrid()
    with pytest.raises(InputError, match="move together"):
        two_port.lever(2.0).impedance()


@pytest.mark.parametrize(
    "device",
    [
        PHANTOM,
        Device(
            "geared",
            (
                Section("beside", "m1|r1", {"m1": 1e-4, "r1": 1e-3}),
                Section("lever", "", {"ratio": 0.2}),
                Section("between", "n1|r1", {"n1": 1e-4, "r1": 0.1}),
                Section("lever", "", {"ratio": 3.0}),
                Section("beside", "(m1|r1)-n1", {"m1": 0.01, "r1": 0.1, "n1": 1e-3}),
            ),
        ),
    ],
    ids=lambda d: d.name,
)
def test_a_device_is_the_same_as_states_and_as_a_chain(device: Device) -> None:
    user = parse(PAPER_NETWORK)
    z = user.impedance(S, FINGERTIP.central)
    np.testing.assert_allclose(
        device.with_load(realise(user, FINGERTIP.central))(S)[0], two_port.of_device(device, S).seen(z), rtol=1e-9
    )


def test_devices_are_read_and_bad_ones_refused(tmp_path) -> None:
    good = """
name = "coil"
period_s = 5e-4
delay_s = 1e-4
[[section]]
arrangement = "beside"
network = "m1|r1"
values = {m1 = 0.03, r1 = 0.2}
[[section]]
arrangement = "lever"
values = {ratio = 2.0}
"""
    file = tmp_path / "device.toml"
    file.write_text(good, encoding="utf-8")
    device = read_device(file)
    assert (device.name, device.period_s, device.delay_s, device.damping) == ("coil", 5e-4, 1e-4, 0.2)
    assert device.classical_stiffness(0.05) == pytest.approx(2 * 0.15 / 5e-4)
    assert device.classical_stiffness(0.3) == 0
    for old, new, message in (
        ("m1 = 0.03", "m1 = -1", "positive value"),
        ("m1 = 0.03, ", "", "positive value"),
        ('"m1|r1"', '"r1"', "positive value"),
        ('"lever"', '"gear"', "beside, between, lever"),
        ("period_s = 5e-4", "period_s = 0", "period must be positive"),
        ("network =", "net =", "."),
        ('name = "coil"', "name = ", "TOML"),
    ):
        file.write_text(good.replace(old, new), encoding="utf-8")
        with pytest.raises(InputError, match=message) as told:
            read_device(file)
        assert "device.toml" in str(told.value)
    with pytest.raises(InputError, match="there is no such file"):
        read_device(tmp_path / "none.toml")
    with pytest.raises(InputError, match="beside the actuator"):
        Device("massless", (Section("beside", "r1", {"r1": 1.0}),))
