"""Rational functions whose passivity is tested: the fingertip with further terms, and models at random."""

from __future__ import annotations

import numpy as np
from experiments import PAPER

from bayes_impedance.classical.pole_residue import PoleResidue, partial_fractions
from bayes_impedance.network.rational import TransferFunction

BAND = np.geomspace(5, 5000, 201)
S = 2j * np.pi * BAND
FINGER = {"m1": 3e-3, "n1": 2e-3, "r1": 0.9, "m2": 1e-4, "n2": 3e-4, "r2": 2.5, "n3": 1.5e-5, "r3": 4.0}
ratio = TransferFunction.from_coefficients


def finger() -> PoleResidue:
    return partial_fractions(PAPER.transfer_function({name: FINGER[name] for name in PAPER.elements}))


def with_terms(model, poles, residues, constant=0.0, linear=0.0) -> PoleResidue:
    return PoleResidue(
        np.concatenate([model.poles, poles]),
        np.concatenate([model.residues, residues]),
        model.constant + constant,
        model.linear + linear,
    )


def random_model(rng) -> PoleResidue:
    """Poles over six decades, damping ratios down to 1e-3; residues as they come, so that some are passive."""
    poles, residues = [], []
    for size in 10 ** rng.uniform(0, 6, rng.integers(1, 6)):
        if rng.random() < 0.5:
            poles.append(-size)
            residues.append(size * rng.normal())
        else:
            damping = 10 ** rng.uniform(-3, 0)
            pole = size * (-damping + 1j * np.sqrt(1 - damping**2))
            residue = size * np.sqrt(damping) * (rng.normal() + 0.7j * rng.normal())
            poles += [pole, pole.conjugate()]
            residues += [residue, residue.conjugate()]
    if rng.random() < 0.5:
        poles.append(0)
        residues.append(10 ** rng.uniform(0, 3))
    return PoleResidue(poles, residues, rng.choice([0.0, 1.0, 10.0]) * rng.random(), rng.choice([0, 1e-4]))


def sampled_relative(model, omega):
    """Re z / |z| by adding up the lossy terms as they stand."""
    real = np.full(omega.size, model.constant)
    for pole, residue in zip(model.poles, model.residues, strict=True):
        if pole.real != 0:
            real = real + (-residue * pole / ((pole - 1j * omega) * (pole + 1j * omega))).real
    return real / np.abs(model(1j * omega))


def only(violations):
    assert len(violations) == 1
    return violations[0]


def above_the_band():
    pole, residue = 2 * np.pi * 5e4 * (-0.005 + 1j), -2e4 + 0j
    return with_terms(finger(), [pole, pole.conjugate()], [residue, residue.conjugate()])


def below_the_band():
    return with_terms(finger(), [-2 * np.pi * 0.05], [-2 * np.pi * 0.05 * 5])
