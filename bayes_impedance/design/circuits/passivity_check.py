r"""Passivity of exported users.

A network of positive elements is passive by construction. Every exported form is checked with its values as rounded in
the file:

* **elements**: all positive and finite;
* **coefficients**: rounded to the digits in the file, :func:`bayes_impedance.classical.check_passivity` looks at the
  whole frequency axis;
* **state space**: in energy coordinates a passive system without direct term satisfies :math:`A + A^T \le 0` and
  :math:`C = B^T`; with one, the matrix :math:`\begin{pmatrix} -A - A^T & C^T - B \\ C - B^T & 2D \end{pmatrix}` has
  no negative eigenvalue (the lemma of Kalman, Yakubovich and Popov with the stored energy as its certificate);
* **ladders**: their elements, as above.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bayes_impedance.classical import check_passivity
from bayes_impedance.design.circuits.state_space import realise
from bayes_impedance.design.circuits.transfer_functions import matrices
from bayes_impedance.design.users import Users, free_parameters, values_of
from bayes_impedance.network.notation import Network
from bayes_impedance.network.rational import TransferFunction

_ROUNDING = 1e-9
"""Negative eigenvalues up to this size, relative to the largest entry and per state, are taken as rounding errors. By
choice: some 1e7 times double precision, because rates of states differ by orders of magnitude."""


def positive_elements(users: Users) -> np.ndarray:
    """Whether each user's elements are all positive and finite, shape (N,); exponents off their lower bound."""
    values = values_of(users.network, users.u) - [p.quantity.low for p in free_parameters(users.network)]
    return np.asarray(np.all(np.isfinite(values) & (values > 0), axis=1))


def passive_states(network: Network, values: Mapping[str, np.ndarray]) -> np.ndarray:
    """Whether the state space of each user is passive, with the stored energy as storage function, shape (U,)."""
    impedance = realise(network, values)
    a, b, c, d = matrices(impedance.reciprocal() if impedance.high >= 0 else impedance)
    upper = np.concatenate([-a - np.swapaxes(a, 1, 2), (np.swapaxes(c[:, None], 1, 2) - b[..., None])], axis=2)
    lower = np.concatenate([c[:, None] - b[:, None], 2 * d[:, None, None]], axis=2)
    whole = np.concatenate([upper, lower], axis=1)
    # States are scaled so that the loss of each (its diagonal entry) is one.
    scale = np.sqrt(np.maximum(np.abs(np.einsum("uii->ui", whole)), 1e-300))
    scale = np.maximum(scale, np.sqrt(np.max(np.abs(whole), axis=(1, 2)) * _ROUNDING)[:, None])
    lowest = np.linalg.eigvalsh(whole / scale[:, :, None] / scale[:, None, :])[:, 0]
    return np.asarray(lowest >= -_ROUNDING * whole.shape[1])


def passive_coefficients(numerator: list[float], denominator: list[float]) -> bool:
    """Whether coefficients, as written to the file, are those of a passive impedance."""
    return check_passivity(TransferFunction.from_coefficients(numerator, denominator)).positive_real
