"""A claimed network that lacks elements is grown into one that describes the recordings, and no further."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from experiments import Experiment, toy

from bayes_impedance.diagnosis.fit.model import build
from bayes_impedance.diagnosis.fit.normal_equations import Population
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.grown_network import grown_network, without_element
from bayes_impedance.network.notation import parse

TRUE = ("(n2|r2)-(m1|r1|n1)", {"n2": 1e-4, "r2": 20.0, "m1": 2e-3, "r1": 1.5, "n1": 1e-3})


@pytest.mark.parametrize(
    ("notation", "element", "expected"),
    [
        ("m1|r1", "r1", "m1"),
        ("m1-n1", "m1", "n1"),
        ("m1|r1|(m2-(n2|r2))", "n2", "m1|r1|(m2-r2)"),
        ("m1|r1|(m2-n2)", "m2", "m1|r1|n2"),
        ("(n1|r1)-m1", "m1", "n1|r1"),
        ("delay[d1](m1|r1)", "m1", "delay[d1](r1)"),
    ],
)
def test_an_element_is_taken_out(notation: str, element: str, expected: str) -> None:
    assert str(without_element(parse(notation), element)) == expected


def test_nothing_is_left_of_a_single_element() -> None:
    assert without_element(parse("m1"), "m1") is None


@pytest.mark.parametrize("element", ["n2", "r2", "m1", "r1", "n1"])
def test_what_is_left_is_the_limit_of_the_whole(element: str) -> None:
    """In parallel an element vanishes with its impedance, in series with its mobility."""
    notation, values = TRUE
    s = 2j * np.pi * np.geomspace(5, 5000, 20)
    for network in (parse(notation), parse("m1-r1-n1-(n2|r2)")):
        rest = without_element(network, element)
        assert rest is not None
        limits = [network.impedance(s, values | {element: values[element] * factor}) for factor in (1e-12, 1e12)]
        wanted = rest.impedance(s, values)
        assert min(np.abs(z / wanted - 1).max() for z in limits) < 1e-6


def claimed(experiment: Experiment, notation: str) -> Refit:
    """Fit of another network to an experiment's recordings."""
    network = parse(notation)
    columns = [experiment.model.network.elements.index(e) for e in network.elements]
    model = build(network, (), experiment.model.scales, ())
    p = experiment.population
    start = Population(p.mu[columns], p.covariance[np.ix_(columns, columns)], p.rho[columns])
    refitter = experiment.refitter
    return refitter.settle(refitter.fit(model, experiment.u[:, columns], start, 80), 1)


def grown(experiment: Experiment, base: Refit) -> Refit | None:
    names = [str(i) for i in range(len(experiment.data))]
    with ThreadPoolExecutor(1) as executor:
        return grown_network(experiment.refitter, base, names, 1, executor)


@pytest.mark.parametrize("notation", ["m1|r1|n1", "n2-(m1|r1|n1)"])
def test_missing_elements_are_found(notation: str) -> None:
    """As many elements as the truth has, and curves like the true ones."""
    experiment = toy(*TRUE, seed=4, n=16)
    base = claimed(experiment, notation)
    found = grown(experiment, base)
    assert found is not None
    assert len(found.model.network.elements) == 5
    frequency = np.geomspace(2, 2000, 41)
    true = experiment.model.kernel.impedance(experiment.u, frequency)
    error = np.abs(found.model.kernel.impedance(found.u, frequency) / true - 1)
    before = np.abs(base.model.kernel.impedance(base.u, frequency) / true - 1)
    assert np.sqrt(np.mean(error**2)) < 0.01
    assert np.sqrt(np.mean(before**2)) > 0.1


def test_a_right_network_stays_as_it_is() -> None:
    experiment = toy(*TRUE, seed=5, n=16)
    assert grown(experiment, experiment.fit()) is None
