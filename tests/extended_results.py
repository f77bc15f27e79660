"""Finished runs of networks with more than masses, springs and dampers, made from a plain run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.network.notation import parse
from bayes_impedance.results.result import DIMS, Result


def extended(result: Result, text: str, u: dict[str, float]) -> Result:
    """The plain result with more parameters: those in `u` at about these values of u, the others from the result.

    What is shared has a spread of its mean of a tenth, and none between people.
    """
    network, rng = parse(text), np.random.default_rng(5)
    posterior = result.groups["posterior"]
    lead, old, p = posterior["mu"].shape[:2], result.elements, len(network.elements)
    mu = np.empty((*lead, p))
    dispersions = {name: np.zeros((*lead, p)) for name in posterior if name.startswith("dispersion")}
    correlation = np.zeros((*lead, p, p)) + np.eye(p)
    shared = {q.name for q in network.parameters if q.shared}
    for i, name in enumerate(network.elements):
        if name in u:
            mu[..., i] = u[name] + 0.1 * rng.normal(size=lead)
            for values in dispersions.values():
                values[..., i] = 0.0 if name in shared else 0.2
        else:
            mu[..., i] = posterior["mu"][..., old.index(name)]
            for key, values in dispersions.items():
                values[..., i] = posterior[key][..., old.index(name)]
    kept = [i for i, name in enumerate(network.elements) if name not in u]
    rows = [old.index(network.elements[i]) for i in kept]
    for i, row in zip(kept, rows, strict=True):
        correlation[..., i, kept] = posterior["correlation"][..., row, rows]
    groups = {
        group: {name: values for name, values in table.items() if "element" not in DIMS.get(name, ())}
        for group, table in result.groups.items()
    }
    groups["constant_data"] |= {"identified": np.ones(p, dtype=bool)}
    groups["posterior"] |= {"mu": mu, "correlation": correlation} | dispersions
    return replace(
        result,
        groups=groups,
        summary=result.summary | {"network": text},
        coords=result.coords | {"element": list(network.elements), "element_2": list(network.elements)},
        attributes=result.attributes | {"network": text},
    )
