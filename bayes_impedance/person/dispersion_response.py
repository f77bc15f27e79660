r"""How the likelihood of each of a person's draws changes with the dispersions between repetitions.

A draw's log likelihood (:mod:`bayes_impedance.person.marginal_likelihood`) has the deviations of the repetitions
integrated out at one dispersion :math:`\rho_0`. The curvature of the impedance, and what the repetitions differ by,
depend on where the draw lies, so another dispersion raises some draws and lowers others: what a person's repetitions
say of rho and where the person's mean lies are not independent.

Near its mode at a draw the log likelihood of the contrasts d between repetitions is quadratic, with curvature H and
slope b at zero deviation; with :math:`R = \operatorname{diag}\rho^2`, :math:`K = (H + R_0^{-1})^{-1}` and
:math:`y = K b`

.. math:: \ln p(\rho) = -\tfrac12\ln|R| - \tfrac12\ln|H + R^{-1}| + \tfrac12\, b^T (H + R^{-1})^{-1} b .

If the dispersion of one element p changes, :math:`R^{-1}` changes by :math:`\Delta = \rho_p^{-2} - \rho_{0p}^{-2}` in
that element's contrasts alone, and by the determinant lemma, with the block :math:`K_p` of these contrasts and
:math:`S = I + \Delta K_p`,

.. math:: \ln p(\rho) - \ln p(\rho_0) = -\tfrac12\ln|S| - \tfrac12\,\Delta\, y_p^T S^{-1} y_p
          - \tfrac12\left(\ln|R| - \ln|R_0|\right) .

One inverse for each draw thus gives as many other dispersions as are wanted. The last term, which is the same for all
draws, is left out.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel, compiled, workspace
from bayes_impedance.network.program import Program
from bayes_impedance.person.likelihood import SCALE_SHAPE, Likelihood, equations_apart
from bayes_impedance.person.marginal_likelihood import Ridge, begun, settled
from bayes_impedance.person.noise import contrasts
from bayes_impedance.person.small_matrices import inverted


def responses(kernel: Kernel, likelihood: Likelihood, ridge: Ridge, theta: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Change of each draw's log likelihood when one dispersion between repetitions changes.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        Of at least two repetitions, with the deviations at their mode.
    ridge : Ridge
        Its rho is that from which the dispersions change.
    theta : ndarray, shape (K, P)
        The draws' log elements.
    nodes : ndarray, shape (P, M)
        Other dispersions of each element, above zero.

    Returns
    -------
    ndarray, shape (K, P, M)
        Without what is the same for all draws; not finite where the network's impedance is not.
    """
    d = likelihood
    return np.asarray(
        _responses(
            kernel.program,
            np.ascontiguousarray(theta),
            ridge.theta,
            ridge.slope,
            ridge.rho,
            d.deviations,
            d.omega,
            d.z,
            d.weight,
            SCALE_SHAPE + d.values,
            d.beta,
            contrasts(len(d.z)),
            np.ascontiguousarray(nodes),
        )
    )


def response_of(information: np.ndarray, gradient: np.ndarray, rho: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """The same, (P, M), from the curvature (C P, C P) and slope (C P,) of the contrasts' log likelihood at zero."""
    own, slope = np.ascontiguousarray(information), np.ascontiguousarray(gradient)
    result = np.empty(nodes.shape)
    _one_at_a_time(own, slope, rho, np.ascontiguousarray(nodes), result)
    return result


@compiled
def _one_at_a_time(
    information: np.ndarray, gradient: np.ndarray, rho: np.ndarray, nodes: np.ndarray, result: np.ndarray
) -> None:
    size, n_elements = gradient.size, rho.size
    n_contrasts = size // n_elements
    inverse = information.copy()
    for a in range(size):
        inverse[a, a] += rho[a % n_elements] ** -2.0
    inverted(inverse)
    at = inverse @ gradient
    factor, solved = np.empty((n_contrasts, n_contrasts)), np.empty(n_contrasts)
    for p in range(n_elements):
        for m in range(nodes.shape[1]):
            change = nodes[p, m] ** -2.0 - rho[p] ** -2.0
            total = 0.0
            for c in range(n_contrasts):  # Cholesky factor of S, and y solved against it, row by row
                for d in range(c + 1):
                    entry = change * inverse[c * n_elements + p, d * n_elements + p]
                    if c == d:
                        entry += 1.0
                    for k in range(d):
                        entry -= factor[c, k] * factor[d, k]
                    factor[c, d] = np.sqrt(entry) if c == d else entry / factor[d, d]
                solved[c] = at[c * n_elements + p]
                for k in range(c):
                    solved[c] -= factor[c, k] * solved[k]
                solved[c] /= factor[c, c]
                total -= np.log(factor[c, c]) + 0.5 * change * solved[c] * solved[c]
            result[p, m] = total


@compiled
def _responses(
    program: Program,
    theta: np.ndarray,
    centre: np.ndarray,
    slope: np.ndarray,
    rho: np.ndarray,
    deviations: np.ndarray,
    omega: np.ndarray,
    z: np.ndarray,
    weight: np.ndarray,
    exponent: float,
    beta: float,
    rows: np.ndarray,
    nodes: np.ndarray,
) -> np.ndarray:
    n_repetitions, n_elements = deviations.shape
    n_contrasts = n_repetitions - 1
    result = np.empty((theta.shape[0], *nodes.shape))
    information = np.empty((n_contrasts * n_elements, n_contrasts * n_elements))
    gradient = np.empty(n_contrasts * n_elements)
    sums, outputs = workspace(program, omega)
    inverses = np.empty((n_repetitions, n_elements, n_elements))
    steps, moved = np.empty((n_repetitions, n_elements)), np.empty((n_repetitions, n_elements))
    for i in range(theta.shape[0]):
        information[:], gradient[:] = 0.0, 0.0
        chi = 0.0
        begun(program, theta[i], centre, slope, deviations, rho, omega, z, weight, exponent, beta, sums, outputs, moved)
        settled(program, theta[i], moved, rho, omega, z, weight, exponent, beta, inverses, steps)
        for j in range(n_repetitions):
            own = moved[j]
            c, g, h = equations_apart(program, theta[i] + own, omega, z[j], weight[j])
            pull = h @ own - g
            chi += c
            for a in range(n_contrasts * n_elements):
                p, row = a % n_elements, rows[a // n_elements, j]
                gradient[a] += row * pull[p]
                for b in range(n_contrasts * n_elements):
                    information[a, b] += row * rows[b // n_elements, j] * h[p, b % n_elements]
        w = exponent / (beta + 0.5 * chi)
        if np.isfinite(w):
            _one_at_a_time(w * information, w * gradient, rho, nodes, result[i])
        else:
            result[i] = np.nan
    return result
