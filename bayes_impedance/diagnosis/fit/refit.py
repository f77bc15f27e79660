"""Result of fitting a model with additions to all people, as :mod:`.fitter` returns it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.diagnosis.fit.normal_equations import (
    Equations,
    Population,
    owners,
    weights,
)
from bayes_impedance.person.likelihood import Likelihood


@dataclass(frozen=True, kw_only=True, eq=False)
class Refit:
    """A fitted model; two are equal only if they are the same object.

    Attributes
    ----------
    model : Model
    data : tuple of Likelihood
        One per person.
    u : ndarray, shape (M, P)
        Parameters of every recording, person by person.
    persons : ndarray, shape (N, V)
        v_i of each person.
    population : Population
    equations : Equations
        At u.
    evidence : ndarray, shape (N,)
    settled : bool
        Whether persons and population converged.
    mixed : int, optional
        Addition that only some people have, where the evidence is that of the mixture of people with and without it
        (:mod:`.of_members`).
    """

    model: Model
    data: tuple[Likelihood, ...]
    u: np.ndarray
    persons: np.ndarray
    population: Population
    equations: Equations
    evidence: np.ndarray
    settled: bool
    mixed: int | None = None

    @property
    def owner(self) -> np.ndarray:
        """Person of every recording, shape (M,)."""
        return owners(self.data)

    @property
    def shared_value(self) -> np.ndarray:
        """Shared parameters, shape (S,)."""
        return np.asarray(self.u[0, self.model.shared])

    @property
    def weight(self) -> np.ndarray:
        """1/scale^2 of each person's noise, shape (N,)."""
        return weights(self.data, self.equations.chi)
