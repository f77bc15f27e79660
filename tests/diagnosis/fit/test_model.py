"""Networks with additions: order of elements and operations, pooling, priors, notation, typical sizes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from experiments import entry
from fingertip_effects import CENTRE, FOOT, FREQUENCY, NAIL, NETWORK, PAD, SCALES, S
from hypothesis import given
from strategies import network_impedance, networks_with_elements, repeatable

from bayes_impedance.diagnosis.catalogue.effect import Candidate, Effect
from bayes_impedance.diagnosis.fit.model import Addition, Model, build, inner_places, scales_of
from bayes_impedance.network.elements import kind_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, Parallel, Place, Series, parse
from bayes_impedance.recordings.files import Recordings, Subject


@repeatable
@given(networks_with_elements())
def test_a_model_without_additions_is_the_network(drawn: tuple[Network, np.ndarray]) -> None:
    network, theta = drawn
    model = build(network, (), SCALES, ())
    assert model.kernel.elements == network.elements
    assert model.n_elements == len(network.elements)
    assert (model.parameters, model.notation) == ((), str(network))
    z, dz = model.kernel.derivative(theta, FREQUENCY)
    expected, slope = Kernel(network).derivative(theta, FREQUENCY)
    np.testing.assert_allclose(z, expected, rtol=1e-11)
    np.testing.assert_allclose(dz, slope, rtol=1e-7, atol=1e-11 * np.abs(expected).max())


def test_the_networks_own_labels_are_respected() -> None:
    """Also one that looks like ours."""
    network = parse("place1:(n3|r3)-(m2|r1)")
    theta = np.log([1e-3, 2.0, 1e-4, 3.0])
    model = build(network, [Addition(effect=entry("body.mass"), place="place1", pooling="shared")], SCALES, [{}])
    z = model.kernel.impedance([*theta, 0.5], FREQUENCY)
    mass = 0.5 * SCALES.z_high / SCALES.high
    values = dict(zip(network.elements, np.exp(theta), strict=True))
    np.testing.assert_allclose(z, network_impedance(network, S, values, (0,), lambda z: z + S * mass), rtol=1e-10)


def test_the_networks_elements_come_first_wherever_branches_are() -> None:
    """Two branches in the middle: their elements come after the network's own, in every array."""
    additions = [
        Addition(effect=NAIL, place="n3", pooling="varying"),
        Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
    ]
    model = build(NETWORK, [*additions, Addition(effect=PAD, place="limb", pooling="shared")], SCALES, [{}, {}, {}])
    grown = NETWORK.beside("n3", parse("m3-(n4|r4)")).in_series("limb", parse("r5|m4"))
    assert model.kernel.elements[:8] == NETWORK.elements
    assert set(model.kernel.elements) == {*grown.elements, "rig.delay.delay.1"}
    assert grown.elements[:8] != NETWORK.elements  # so the order had to be changed
    extra = {"m3": 1e-4, "n4": 1e-3, "r4": 0.3, "r5": 20.0, "m4": 1e-2}
    values = dict(zip(NETWORK.elements, np.exp(CENTRE), strict=True)) | extra
    tau = 2e-6
    u = [np.log(values[name]) if name in values else tau * SCALES.high for name in model.kernel.elements]
    z, dz = model.kernel.derivative(u, FREQUENCY)
    theta = np.log([values[name] for name in grown.elements])
    expected, slope = Kernel(grown).derivative(theta, FREQUENCY)
    late = np.exp(-S * tau)
    np.testing.assert_allclose(z, expected * late, rtol=1e-10)
    for i, name in enumerate(model.kernel.elements):
        due = slope[grown.elements.index(name)] * late if name in values else -S / SCALES.high * z
        np.testing.assert_allclose(dz[i], due, rtol=1e-8, atol=1e-12 * np.abs(z).max())
    assert [p.name for p in model.parameters] == list(model.kernel.elements[8:])
    assert [[model.kernel.elements[c] for c in model.columns(i)] for i in range(3)] == [
        ["m3", "n4", "r4"],
        ["rig.delay.delay.1"],
        ["r5", "m4"],
    ]
    assert model.shared.tolist() == [False] * 11 + [True] * 3


def coefficients(model: Model, values: Sequence[Sequence[float]]) -> np.ndarray:
    """Parameters with every addition's own values in their units: log values of the elements of a branch."""
    u = np.append(CENTRE, np.zeros(len(model.parameters)))
    for i, (addition, own) in enumerate(zip(model.additions, values, strict=True)):
        effect = addition.effect
        if effect.operation:
            u[model.columns(i)] = [c.unbounded(v, SCALES) for c, v in zip(effect.coefficients, own, strict=True)]
        else:
            u[model.columns(i)] = np.log(own)
    return u


ELEMENTS = dict(zip(NETWORK.elements, np.exp(CENTRE), strict=True))


def with_additions(*items: tuple[Effect, str, Sequence[float]]) -> tuple[Model, np.ndarray]:
    """A model, and the impedance of the average fingertip with these additions."""
    additions = [Addition(effect=effect, place=place, pooling="shared") for effect, place, _ in items]
    starts = [{c.name: v for c, v in zip(e.coefficients, own, strict=False)} for e, _, own in items]
    model = build(NETWORK, additions, SCALES, starts)
    return model, model.kernel.impedance(coefficients(model, [own for *_, own in items]), FREQUENCY)


def at(place: str, form: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    return network_impedance(NETWORK, S, ELEMENTS, NETWORK.place(place).path, form)


def branch(r: float, n: float) -> np.ndarray:
    """A damper and a spring in series."""
    return r / (1 + S * r * n)


def test_two_effects_at_one_place() -> None:
    m, r, t = 2e-4, 2.0, 3e-3
    relaxation, mass = (entry("body.relaxation"), "tissue", [r, t]), (entry("body.mass"), "tissue", [m])
    expected = at("tissue", lambda z: z + S * m + branch(r, t / r))
    for items in ((relaxation, mass), (mass, relaxation)):
        np.testing.assert_allclose(with_additions(*items)[1], expected, rtol=1e-10)
    # Those that do not commute are applied in their order: the loss of the spring, then the waves in it.
    loss, waves = (entry("body.hysteresis"), "n1", [0.3]), (entry("body.line"), "n1", [1e-3])

    def line(z: np.ndarray) -> np.ndarray:
        x = np.sqrt(S * 1e-3 / z)
        return z * x / np.tanh(x)

    first, then = with_additions(loss, waves)[1], with_additions(waves, loss)[1]
    np.testing.assert_allclose(first, at("n1", lambda z: line(z * (1 + 0.3j))), rtol=1e-10)
    np.testing.assert_allclose(then, at("n1", lambda z: line(z) * (1 + 0.3j)), rtol=1e-10)
    assert np.abs(first / then - 1).max() > 1e-4
    # A branch and an operation at the same place.
    nail, values = (NAIL, "skin", [1e-4, 1e-3, 0.3]), {"m": 1e-4, "n": 1e-3, "r": 0.3}
    beside = parse(NAIL.branch).impedance(S, values)
    found = with_additions(nail, (entry("body.mass"), "skin", [m]))[1]
    np.testing.assert_allclose(found, at("skin", lambda z: z + S * m + beside), rtol=1e-10)


def test_rig_effects_are_outermost() -> None:
    m, tau, n = 2e-4, 3e-6, 1e-8
    delay, mount = (entry("rig.delay"), "port", [tau]), (entry("rig.series_compliance"), "port", [n])
    tissue, layer = (entry("body.mass"), "port", [m]), (entry("body.subgroup"), "port", [1e-6, 1e-3])
    inside = 1 / (1 / (at("port", lambda z: z) + S * m) + S * 1e-6 / (1 + S * 1e-3))
    expected = 1 / (1 / inside + S * n) * np.exp(-S * tau)
    for items in (
        (tissue, layer, delay, mount),
        (delay, tissue, layer, mount),
        (delay, mount, tissue, layer),
        (delay, tissue, mount, layer),
        (tissue, mount, layer, delay),
    ):  # a channel delays what the rig's mechanics does, whichever was found first
        np.testing.assert_allclose(with_additions(*items)[1], expected, rtol=1e-10)
    # Those of one kind keep their order: a damper of the rig behind its compliance, or before it.
    damper = entry("rig.damping"), "port", [2.0]
    outer, inner = 1 / (1 / inside + S * n) + 2.0, 1 / (1 / (inside + 2.0) + S * n)
    np.testing.assert_allclose(with_additions(tissue, layer, mount, damper)[1], outer, rtol=1e-10)
    np.testing.assert_allclose(with_additions(tissue, layer, damper, mount)[1], inner, rtol=1e-10)
    assert np.abs(outer / inner - 1).max() > 1e-6
    # A branch of the rig is outside of a branch of the body, whichever came first.
    foot, nail = (FOOT, "port", [1e-8, 50.0]), (NAIL, "port", [1e-4, 1e-3, 0.3])
    beside = parse(NAIL.branch).impedance(S, {"m": 1e-4, "n": 1e-3, "r": 0.3})
    z = 1 / (1 / at("port", lambda z: z + beside) + 1 / (50.0 + 1 / (S * 1e-8)))
    np.testing.assert_allclose(with_additions(foot, nail)[1], z, rtol=1e-10)
    np.testing.assert_allclose(with_additions(nail, foot)[1], z, rtol=1e-10)


def test_pooling_says_what_is_shared() -> None:
    shape = {"frequency": 900.0, "damping_ratio": 0.2, "ratio": 100.0}
    for pooling, expected in (("shared", [True] * 3), ("varying", [False, True, True]), ("free", [False] * 3)):
        model = build(
            NETWORK,
            [Addition(effect=entry("body.resonator"), place="skin", pooling=pooling, dispersion=0.5)],
            SCALES,
            [shape],
        )
        assert model.shared[8:].tolist() == expected
        assert [p.is_coefficient for p in model.parameters] == [True, False, False]
        assert model.parameters[0].dispersion == 0.5
    both = build(NETWORK, [Addition(effect=entry("body.bypass"), place="port", pooling="varying")], SCALES, [shape])
    assert both.shared[8:].tolist() == [False, False]  # two coefficients, no shape
    own = build(NETWORK, [Addition(effect=NAIL, place="port", pooling="varying")], SCALES, [{}])
    assert own.shared[8:].tolist() == [False] * 3
    assert not any(p.is_coefficient for p in own.parameters)


def test_shapes_are_centred_where_they_were_found() -> None:
    shape = {"frequency": 900.0, "damping_ratio": 0.2}
    model = build(NETWORK, [Addition(effect=entry("body.resonator"), place="skin", pooling="varying")], SCALES, [shape])
    mass, frequency, ratio = model.parameters
    assert (mass.centre, mass.prior_sd) == (0.0, 30.0)
    assert (frequency.centre, ratio.centre) == pytest.approx((np.log(900), np.log(0.2)))
    assert (frequency.prior_sd, ratio.prior_sd) == (0.3, 1.0)
    # The prior of a branch's elements is that of any element: its impedance meets the data's in the middle of the band.
    m, n, r = build(NETWORK, [Addition(effect=NAIL, place="port", pooling="shared")], SCALES, [{"m": 1e-4}]).parameters
    for p in (m, n, r):
        size = kind_of(p.name).impedance(1j * SCALES.middle, np.exp(p.centre))
        assert abs(size) == pytest.approx(SCALES.z_middle)
        assert p.prior_sd == 3.0
    assert (m.start, n.start) == (pytest.approx(np.log(1e-4)), n.centre)


def structural(model: Model, values: Mapping[str, float]) -> np.ndarray:
    network = parse(model.notation)
    return Kernel(network).impedance(np.log([values[name] for name in network.elements]), FREQUENCY)


def test_notation_is_the_network_with_the_additions() -> None:
    m, r, t, n = 2e-4, 2.0, 3e-3, 1e-8
    model, z = with_additions((entry("body.relaxation"), "tissue", [r, t]), (entry("body.mass"), "n3", [m]))
    assert set(parse(model.notation).elements) == {*ELEMENTS, "r4", "n4", "m3"}
    extra = {"r4": r, "n4": t / r, "m3": m}
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)
    # What is not made of elements is left out.
    model, _ = with_additions((entry("rig.delay"), "port", [1e-6]), (entry("body.hysteresis"), "n1", [0.1]))
    assert model.notation == str(NETWORK)
    model, z = with_additions((entry("rig.series_compliance"), "port", [n]))
    np.testing.assert_allclose(structural(model, ELEMENTS | {"n4": n}), z, rtol=1e-10)
    model, z = with_additions((NAIL, "limb", [1e-4, 1e-3, 0.3]), (entry("body.bypass"), "port", [0.5, 300.0]))
    extra = {"m3": 1e-4, "n4": 1e-3, "r4": 0.3, "r5": 0.5, "n5": 1 / 300}
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)


def test_notation_with_two_additions_at_an_unlabelled_group() -> None:
    m, r, t = 2e-4, 2.0, 3e-3
    model, z = with_additions((entry("body.mass"), "n2|r2", [m]), (entry("body.relaxation"), "n2|r2", [r, t]))
    names = parse(model.notation).elements
    extra = dict(zip(["m3", "r4", "n4"], [m, r, t / r], strict=True))
    if set(names) != {*ELEMENTS, *extra}:
        raise KeyError(model.notation)
    np.testing.assert_allclose(structural(model, ELEMENTS | extra), z, rtol=1e-10)


def test_notation_with_the_rig_outermost() -> None:
    m, n = 2e-4, 1e-8
    model, z = with_additions((entry("rig.series_compliance"), "port", [n]), (entry("body.mass"), "port", [m]))
    np.testing.assert_allclose(structural(model, ELEMENTS | {"n4": n, "m3": m}), z, rtol=1e-10)


def test_places_are_found_again_in_a_grown_network() -> None:
    additions = [
        Addition(effect=NAIL, place="n3", pooling="shared"),
        Addition(effect=PAD, place="limb", pooling="shared"),
        Addition(effect=NAIL, place="port", pooling="shared"),
    ]
    model = build(NETWORK, additions, SCALES, [{}, {}, {}])
    paths, grown = inner_places(model), model.kernel.network
    assert set(paths) == {place.name for place in NETWORK.places()}
    assert paths["port"] == ()
    for name, path in paths.items():
        if name != "port":
            node, own = grown.at(Place(path, name)), NETWORK.at(name)
            assert type(node) is type(own)
            assert set(own.elements) <= set(node.elements)
            if isinstance(node, Parallel | Series):
                assert len(node.elements) < len(grown.elements)


# Typical sizes


def test_scales_are_those_of_the_recordings() -> None:
    """Three people whose curves are 1, 2 and 30 dampers; the median has two."""
    frequency = np.geomspace(2, 200, 21)
    subjects = tuple(
        Subject(
            name=str(r),
            frequency_hz=frequency,
            z=np.full((2, 21), r + 0j),
            repetitions=("1", "2"),
            noise_sd=None,
            covariates={},
        )
        for r in (1.0, 2.0, 30.0)
    )
    scales = scales_of(
        Recordings(
            title="t", unit="ohm", network="r1", source="s", licence="l", subjects=subjects, sha256="", warnings=()
        )
    )
    assert (scales.low, scales.middle, scales.high) == pytest.approx(2 * np.pi * np.array([2, 20, 200]))
    assert (scales.z_low, scales.z_middle, scales.z_high, scales.unit) == (2.0, 2.0, 2.0, "ohm")


@pytest.mark.parametrize(
    ("effect", "pooling", "dispersion"),
    [
        (entry("body.subgroup"), "varying", 1.343968),  # 40 % have it: sqrt((1 + 0.35^2) / 0.4 - 1)
        (entry("rig.delay"), "varying", 1.343968),
        (entry("rig.delay"), "shared", 0.35),
        (entry("body.relaxation"), "varying", 0.35),
        (replace(NAIL, pooling="some"), "varying", 0.35),  # a branch: its elements are logarithms, which are not zero
    ],
)
def test_what_some_people_lack_differs_more_between_all_of_them(
    effect: Effect, pooling: str, dispersion: float
) -> None:
    assert Addition.of(Candidate(effect, "port", {}), pooling).dispersion == pytest.approx(dispersion)
