"""Two-ports: chains against their parts, and the device as states against the device as a chain."""

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
from bayes_impedance.population.fingertip import FINGERTIP

S = 2j * np.pi * np.geomspace(1, 1000, 12)


@repeatable
@given(st.lists(st.tuples(st.sampled_from(("beside", "between", "lever")), st.floats(0.1, 10)), min_size=1, max_size=6))
def test_a_chain_is_its_parts_one_after_the_other(parts) -> None:
    chain = TwoPort(np.tile(np.eye(2, dtype=complex), (S.size, 1, 1)))
    load = seen = 3.0 + S / 50 + 20 / S
    for kind, size in parts:
        z = size + S * size / 100 + 100 / (S * size)
        chain @= two_port.lever(size, S.size) if kind == "lever" else getattr(two_port, kind)(z)
    for kind, size in reversed(parts):
        z = size + S * size / 100 + 100 / (S * size)
        seen = {"beside": seen + z, "between": 1 / (1 / seen + 1 / z), "lever": size**2 * seen}[kind]
    np.testing.assert_allclose(chain.seen(load), seen, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.det(chain.chain), 1, rtol=1e-6)  # reciprocal: no source, no gyrator


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
        ("m1 = 0.03", "m1 = -1", "m1 is -1, but must be a finite number at least"),
        ("m1 = 0.03, ", "", "positive value"),
        ('"m1|r1"', '"r1"', "positive value"),
        ('"lever"', '"gear"', "beside, between, lever"),
        ("period_s = 5e-4", "period_s = 0", "period_s is 0.0, but must be a finite number above 0"),
        ("network =", "net =", 'section 1: key "net" is not used; did you mean "network"'),
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
