"""Where an effect may act in a network: no place twice, no place lost."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from fingertip_effects import BRANCHES, CABLE, NAIL, NETWORK, PAD, own_name
from hypothesis import given
from hypothesis import strategies as st
from strategies import networks, repeatable

from bayes_impedance.diagnosis.catalogue.effect import (
    Effect,
    registered,
)
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Element, Network, Place, parse
from bayes_impedance.network.operations import ADDING, Operation


def adding() -> list[Effect]:
    return [e for e in registered() if e.operation in ADDING] + [NAIL, CABLE]


def kinds_of_place(effect: Effect, network: Network) -> list[Place]:
    """Places of the kinds that an effect names, without looking for what is the same."""
    result = []
    for place in network.places():
        node = network.at(place)
        if not place.path:
            kind = {"port"}
        elif isinstance(node, Element):
            kind = {"elements", {"n": "springs", "r": "dampers", "m": "masses"}[node.name[0]]}
        else:
            kind = {"groups"}
        if kind & set(effect.places):
            result.append(place)
    return result


def changes(network: Network, theta: np.ndarray, places: Sequence[Place], beside: bool) -> list[np.ndarray]:
    """What a damper beside (or in series with) each place does to the port's impedance."""
    frequency = np.geomspace(0.02, 5, 15)
    name = "add" if beside else "series_layer"  # a layer with a time constant of zero is a spring
    u, letters = ([0.7], ("x",)) if beside else ([0.7, -60.0], ("x", "y"))
    plain = Kernel(network).impedance(theta, frequency)
    kernels = (Kernel(network, [Operation(name, place.path, letters, (1.0, 0.0))]) for place in places)
    return [kernel.impedance([*theta, *u], frequency) - plain for kernel in kernels]


def same(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.abs(a - b).max() < 1e-7 * max(np.abs(a).max(), np.abs(b).max()))


@pytest.mark.parametrize("effect", [*registered(), *BRANCHES], ids=own_name)
def test_sites_of_the_fingertip(effect: Effect) -> None:
    sites = effect.sites(NETWORK)
    assert len({place.path for place in sites}) == len(sites)
    assert len({place.name for place in sites}) == len(sites)
    assert set(sites) <= set(kinds_of_place(effect, NETWORK))
    expected = {
        "body.relaxation": ["port", "skin", "tissue", "m1", "n2|r2"],  # beside the limb is beside the tissue
        "body.hysteresis": ["n3", "n1", "n2"],
        "body.line": ["skin", "n3", "tissue", "n1", "limb", "n2|r2", "n2"],
        "rig.delay": ["port"],
        "body.nail": ["port", "skin", "tissue", "m1", "n2|r2"],
        "body.pad": ["port", "n3", "r3", "m2", "r1", "n1", "limb", "n2", "r2"],
    }
    if effect.id in expected:
        assert [place.name for place in sites] == expected[effect.id]


def some_elements(network: Network) -> np.ndarray:
    """No two of them alike, so that places are only alike by the network."""
    return np.random.default_rng(5).uniform(-1, 1, len(network.elements))


@repeatable
@given(networks(), st.sampled_from(adding()))
def test_no_two_sites_are_the_same_and_none_is_lost(network: Network, effect: Effect) -> None:
    theta = some_elements(network)
    sites = effect.sites(network)
    assert len({place.path for place in sites}) == len(sites)
    kept = changes(network, theta, sites, True)
    for a, b in combinations(kept, 2):
        assert not same(a, b)
    others = [p for p in kinds_of_place(effect, network) if p not in sites]
    for change in changes(network, theta, others, True):
        assert any(same(change, k) for k in kept)


@repeatable
@given(networks())
def test_no_two_sites_in_series_are_the_same_and_none_is_lost(network: Network) -> None:
    theta = some_elements(network)
    kept = changes(network, theta, PAD.sites(network), False)
    for a, b in combinations(kept, 2):
        assert not same(a, b)
    others = [p for p in kinds_of_place(PAD, network) if p not in PAD.sites(network)]
    for change in changes(network, theta, others, False):
        assert any(same(change, k) for k in kept)


def test_places_are_not_lost_to_a_group_that_is_not_asked_for() -> None:
    only = replace(NAIL, places=("springs",))
    assert {place.name for place in only.sites(NETWORK)} & {"n3", "skin"}
    assert [place.name for place in only.sites(parse("n1|r1"))]
