"""What elements can absorb has no value in a verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from diagnoses_by_hand import DELAY
from experiments import entry, toy

from bayes_impedance.diagnosis.extended_network import extended_network
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior, reported
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.verdict.absorbed import without_absorbed, without_change
from bayes_impedance.diagnosis.verdict.entries import parameters_of
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse

LAYERED = "r1-(m1|n1|r2)"
CENTRE = {"r1": 3.0, "m1": 5e-3, "n1": 2e-4, "r2": 1.5}


def with_bypass(network: str) -> Refit:
    """A network of which a second path of 0.8 N s/m and 300 N/m is missing, fitted with it."""
    centre = {name: value for name, value in CENTRE.items() if name in network}
    experiment = toy(network, centre, 3, 6, hidden=lambda s, z, _: (z + 0.8 + 300 / s, np.full(len(z), 0.8)))
    path = Addition(effect=entry("body.bypass", "bypass"), place="port", pooling="free")
    model = build(experiment.model.network, (path,), experiment.model.scales, ({"stiffness": 300.0},))
    unit = path.effect.coefficients[0].scale(model.scales)
    own = np.tile([0.8 / unit, model.parameters[-1].start], (len(experiment.u), 1))
    u = np.column_stack([experiment.u, own])
    mu = np.append(experiment.population.mu, u[0, -2:])
    population = replace(
        experiment.population,
        mu=mu,
        covariance=0.04 * np.eye(mu.size),
        rho=np.append(experiment.population.rho, [0.0, 0.0]),
    )
    return experiment.refitter.fit(model, u, population, 60)


@pytest.mark.parametrize(("network", "lost"), [(LAYERED, {"damping"}), ("m1|(n1-r1)", set())])
def test_a_damper_that_the_network_takes_up_has_no_value(network: str, lost: set[str]) -> None:
    """Beside a damper before a mass, spring and damper it makes another network of the same form; a spring does not."""
    fit = with_bypass(network)
    posterior = coefficient_posterior(fit, 1)
    rows = reported(fit.model, 0, posterior, fit.u[:, : fit.model.n_elements].mean(axis=0))
    said = replace(DELAY, id="body.bypass", name="second path", place="port", parameters=parameters_of(rows))
    (shown,), remarks = without_absorbed((said,), fit, 0, posterior, extended_network(fit.model))
    assert set(said.parameters) - set(shown.parameters) == lost
    assert {name: shown.parameters[name] for name in shown.parameters} == {
        name: said.parameters[name] for name in said.parameters if name not in lost
    }
    assert len(remarks) == len(lost)
    if lost:
        assert "damping" in remarks[0]
        assert "stiffness" not in remarks[0]


def test_the_other_network_has_the_same_curve() -> None:
    """The module's equation, and the combination that is found is its direction."""
    f = np.geomspace(1, 1000, 30)
    r, a = 0.8, (CENTRE["r1"] + 0.8) / CENTRE["r1"]
    one = Kernel(parse(f"({LAYERED})|r9"))
    other = Kernel(parse(LAYERED))
    before = np.log([{**CENTRE, "r9": r}[e] for e in one.elements])
    taken = {"r1": CENTRE["r1"] + r, "m1": CENTRE["m1"] * a**2, "n1": CENTRE["n1"] / a**2}
    taken["r2"] = CENTRE["r2"] * a**2 + r + r**2 / CENTRE["r1"]
    after = np.log([taken[e] for e in other.elements])
    np.testing.assert_allclose(one.impedance(before, f), other.impedance(after, f), rtol=1e-12)
    fit = with_bypass(LAYERED)
    u = fit.u.mean(axis=0)
    (vector,) = without_change(fit.model, u)
    assert abs(vector[-1]) < 1e-8 < abs(vector[-2])
    z = fit.model.kernel.impedance(u + 1e-5 * vector, f)
    np.testing.assert_allclose(z, fit.model.kernel.impedance(u, f), rtol=1e-9)
