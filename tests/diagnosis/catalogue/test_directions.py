"""The derivative of the impedance by an effect's coefficient at zero, against finite differences of the model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from experiments import entry
from fingertip_effects import BEFORE, BRANCHES, FREQUENCY, NETWORK, OMEGA, SCALES, THETA, S, assert_slope, own_name

from bayes_impedance.diagnosis.catalogue.effect import (
    Candidate,
    Effect,
    direction,
    registered,
    shape_grid,
)
from bayes_impedance.diagnosis.fit.model import Addition, Model, build, inner_places
from bayes_impedance.diagnosis.residuals.sensitivity import local_impedances, motion_at, spot_of
from bayes_impedance.network.notation import parse
from bayes_impedance.network.operations import line_compliance, line_mass

SECANT = ("line", "free_line")
"""Operations that are screened by a secant."""


def assert_direction(effect: Effect, place: str, shape: dict[str, float], before: Sequence[Addition] = ()) -> None:
    starts = [{"time_constant": 0.01, "frequency": 900.0, "damping_ratio": 0.2} for _ in before]
    small = build(NETWORK, before, SCALES, starts)
    u = np.column_stack([THETA, *(np.full(3, p.start + 0.1 * p.is_coefficient) for p in small.parameters)])
    local = local_impedances(small, u, OMEGA)[spot_of(Candidate(effect, place, shape))]
    motion = motion_at(small, u, OMEGA, inner_places(small)[place]) if effect.follows_motion else None
    change = direction(effect, shape, SCALES, OMEGA, local.z, motion)
    model = build(NETWORK, [*before, Addition(effect=effect, place=place, pooling="shared")], SCALES, [*starts, shape])
    columns = model.columns(len(before))
    own = np.column_stack([THETA, *(np.full(3, p.start + 0.1 * p.is_coefficient) for p in model.parameters)])
    units = [c.scale(SCALES) for c in effect.coefficients]

    def curve(x: float) -> np.ndarray:
        """x in the operation's unit."""
        u = own.copy()
        u[:, columns[0]] = x / units[0]
        if effect.operation == "bypass":
            u[:, columns[1]] = x * shape["ratio"] / units[1]
        return model.kernel.impedance(u, FREQUENCY)

    np.testing.assert_allclose(curve(0.0), small.kernel.impedance(u, FREQUENCY), rtol=1e-12)
    assert_slope(curve, change * local.adjoint, np.abs(change / local.z) + np.abs(change * local.adjoint / curve(0.0)))


@pytest.mark.parametrize("effect", [e for e in registered() if e.operation and e.operation not in SECANT], ids=own_name)
def test_directions_are_the_derivatives_of_the_model(effect: Effect) -> None:
    """At every place and with every shape, by differences of the impedance of the model with the effect in it."""
    sites = effect.sites(NETWORK)
    assert sites
    for place in sites:
        for shape in shape_grid(effect, SCALES):
            assert_direction(effect, place.name, shape)


@pytest.mark.parametrize("effect", [e for e in registered() if e.operation and e.operation not in SECANT], ids=own_name)
def test_directions_behind_other_additions(effect: Effect) -> None:
    for place in effect.sites(NETWORK):
        if effect.side == "body" and place.name == "port":
            continue  # see the next test
        if (effect.id, place.name) in [(a.effect.id, a.place) for a in BEFORE]:
            continue
        shapes = list(shape_grid(effect, SCALES))
        for shape in shapes[:: max(1, len(shapes) // 3)]:
            assert_direction(effect, place.name, shape, BEFORE)


def test_a_body_effect_at_the_port_is_behind_the_rig() -> None:
    assert_direction(entry("body.mass"), "port", {}, BEFORE)


def test_a_line_is_screened_by_its_secant() -> None:
    """From zero to the level; to first order in a small mass that is a third of it beside the place."""
    local = local_impedances(build(NETWORK, (), SCALES, ()), THETA, OMEGA)["tissue"]
    for level in (0.3, 3.0):
        mass = level * line_mass(OMEGA, local.z)
        w = S * mass[:, None] / local.z
        expected = (local.z * np.sqrt(w) / np.tanh(np.sqrt(w)) - local.z) / mass[:, None]
        found = direction(entry("body.line"), {"level": level}, SCALES, OMEGA, local.z)
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    tiny = direction(entry("body.line"), {"level": 1e-6}, SCALES, OMEGA, local.z)
    np.testing.assert_allclose(tiny, np.broadcast_to(S / 3, tiny.shape), rtol=1e-5)
    assert line_mass(OMEGA, local.z) == pytest.approx(np.abs(local.z[:, -1]) / OMEGA[-1])


@pytest.mark.parametrize(("name", "place"), [("body.free_line", "m1"), ("body.diffusion", "r1")])
def test_a_free_line_is_screened_by_its_secant(name: str, place: str) -> None:
    """Its mobility is that of the element, and to first order a third of the compliance in series."""
    local = local_impedances(build(NETWORK, (), SCALES, ()), THETA, OMEGA)[place]
    for level in (0.3, 3.0):
        n = level * line_compliance(OMEGA, local.z)
        w = S * n[:, None] * local.z
        expected = (local.z * np.tanh(np.sqrt(w)) / np.sqrt(w) - local.z) / n[:, None]
        found = direction(entry(name), {"level": level}, SCALES, OMEGA, local.z)
        np.testing.assert_allclose(found, expected, rtol=1e-7)  # differences of a thin line
    tiny = direction(entry(name), {"level": 1e-4}, SCALES, OMEGA, local.z)
    np.testing.assert_allclose(tiny, -(local.z**2) * S / 3, rtol=1e-4)


@pytest.mark.parametrize("effect", BRANCHES, ids=own_name)
def test_directions_of_branches(effect: Effect) -> None:
    """A branch as a whole made weak: impedances times x beside, mobilities times x in series."""
    plain = build(NETWORK, (), SCALES, ())
    local = local_impedances(plain, THETA, OMEGA)
    for place in effect.sites(NETWORK):
        for shape in list(shape_grid(effect, SCALES))[::5]:
            model = build(NETWORK, [Addition(effect=effect, place=place.name, pooling="shared")], SCALES, [shape])
            names = model.kernel.elements[8:]
            assert [name[0] for name in names] == [e[0] for e in parse(effect.branch).elements]

            def curve(x: float, model: Model = model, shape: dict[str, float] = shape) -> np.ndarray:
                weak = x if effect.connection == "beside" else 1 / x
                power = {"n": -1, "e": 0, "a": 0}
                values = [v * weak ** power.get(e[0], 1) for e, v in shape.items()]
                by_name = {p.name: p for p in model.kernel.network.parameters}
                own = [by_name[name].u(v) for name, v in zip(model.kernel.elements[8:], values, strict=True)]
                return model.kernel.impedance(np.column_stack([THETA, np.tile(own, (3, 1))]), FREQUENCY)

            here = local[place.name]
            change = direction(effect, shape, SCALES, OMEGA, here.z)
            plainly = plain.kernel.impedance(THETA, FREQUENCY)
            size = np.abs(change / here.z) + np.abs(change * here.adjoint / plainly)
            assert_slope(lambda x: curve(x) if x else plainly, change * here.adjoint, size)  # noqa: B023
