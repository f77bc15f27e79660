"""The population of virtual fingertips: central values from published curves, dispersions by choice."""

from __future__ import annotations

from bayes_impedance.network.notation import PAPER_NETWORK
from bayes_impedance.population.simulate import VirtualPopulation

FINGERTIP = VirtualPopulation(
    network=PAPER_NETWORK,
    central={
        "n3": 6.76e-7,
        "r3": 61.4,
        "m2": 7.90e-4,
        "r1": 1.52,
        "n1": 1.15e-3,
        "m1": 0.0517,
        "n2": 4.73e-3,
        "r2": 3.82,
    },
    between_persons={
        "n3": 0.35,
        "r3": 0.30,
        "m2": 0.20,
        "r1": 0.40,
        "n1": 0.30,
        "m1": 0.35,
        "n2": 0.30,
        "r2": 0.30,
    },
    between_repetitions={
        "n3": 0.06,
        "r3": 0.05,
        "m2": 0.03,
        "r1": 0.08,
        "n1": 0.04,
        "m1": 0.05,
        "n2": 0.05,
        "r2": 0.05,
    },
    correlation={
        ("n3", "r3"): -0.5,
        ("n1", "r1"): -0.4,
        ("m2", "m1"): 0.5,
        ("n1", "n2"): 0.4,
        ("r1", "r2"): 0.3,
        ("n2", "r2"): -0.4,
        ("m2", "n3"): 0.3,
    },
    force_exponent={"n3": -0.35, "r3": 0.35, "n1": -0.35, "r1": 0.35},
)
"""A virtual fingertip population. Its central values come from both published curves (the paper's appendix A): the
geometric mean of the two fits of the corrected eq. 4 if both curves determine an element, otherwise the fit of the one
curve that determines it (``analyses/fingertip_71/centre.py`` computes them)."""
