"""Models with other additions, from the fit of one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from experiments import entry
from fingertip_effects import FREQUENCY, NAIL, NETWORK, SCALES, THETA

from bayes_impedance.diagnosis.fit.extend import with_last
from bayes_impedance.diagnosis.fit.model import Addition, build
from bayes_impedance.diagnosis.fit.normal_equations import Population


@pytest.mark.parametrize("addition", [0, 1, 2, 3])
def test_an_addition_in_the_last_place_changes_nothing_but_the_order(addition: int) -> None:
    """They act at different places, or have an order of their own."""
    additions = [
        Addition(effect=entry("body.relaxation"), place="tissue", pooling="varying"),
        Addition(effect=NAIL, place="n1", pooling="varying"),
        Addition(effect=entry("body.hysteresis"), place="r3", pooling="shared"),
        Addition(effect=entry("rig.delay"), place="port", pooling="shared"),
    ]
    starts = [{"time_constant": 0.01}, {"m": 1e-4, "n": 1e-3, "r": 0.3}, {}, {}]
    model = build(NETWORK, additions, SCALES, starts)
    rng = np.random.default_rng(1)
    own = [np.full(3, p.start) + (0.1 if p.is_coefficient else 0.3) * rng.normal(size=3) for p in model.parameters]
    u = np.column_stack([THETA, *own])
    size = int((~model.shared).sum())
    mu, factor = rng.normal(size=size), rng.normal(size=(size, size))
    population = Population(mu, factor @ factor.T, rng.uniform(size=size))
    refitter = cast(Any, SimpleNamespace(fit=lambda model, u, population: SimpleNamespace(**locals())))
    found: Any = with_last(refitter, cast(Any, SimpleNamespace(model=model, u=u, population=population)), addition)
    assert found.model.additions[-1] == additions[addition]
    assert {a.key for a in found.model.additions} == {a.key for a in additions}
    np.testing.assert_allclose(found.model.kernel.impedance(found.u, FREQUENCY), model.kernel.impedance(u, FREQUENCY))

    def varying(values: Any, of: Any) -> Any:
        """By addition and position in it; elements first."""
        columns = np.flatnonzero(~of.shared)
        at = {int(c): k for k, c in enumerate(columns)}
        by_key = {a.key: [at[c] for c in of.columns(i) if c in at] for i, a in enumerate(of.additions)}
        order = [*range(of.n_elements), *(k for key in sorted(by_key) for k in by_key[key])]
        return values[np.ix_(order, order)] if values.ndim == 2 else values[order]

    for name in ("mu", "rho", "covariance"):
        after, before = getattr(found.population, name), getattr(population, name)
        np.testing.assert_array_equal(varying(after, found.model), varying(before, model))
