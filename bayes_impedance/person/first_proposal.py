r"""The first proposal for a person's importance draws: a t along the surface of conditional modes.

Around its mode a person's posterior is approximately normal, with Laplace's covariance. Where that is thin and bent, a
normal distribution covers it only near the mode: of its draws a few count, and a proposal that is fitted to these is no
better (:mod:`bayes_impedance.person.bent_proposal`). But how it is bent can be seen without draws. In the coordinates v
of that module, in which Laplace's covariance is the identity, the least determined directions are held at some place,
and the mode of the others there is looked for, :math:`\hat v_j(v_1, v_2, \dots)`. Its second differences are the
coefficients of the surface,

.. math:: \beta_{jaa} = \frac{\hat v_j(r e_a) + \hat v_j(-r e_a)}{2 r^2}, \qquad
          \beta_{jab} = \frac{\hat v_j(r e_a + r e_b) + \hat v_j(-r e_a - r e_b)
                              - \hat v_j(r e_a - r e_b) - \hat v_j(r e_b - r e_a)}{4 r^2},

and the surface passes through the mode, where all v are zero.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.person.bent_proposal import BentT, axes_of, long_directions
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import find_mode

_AWAY = 1.5
"""Distance r, in standard deviations. By choice: the surface is to hold for most of the posterior."""
_HOLD = 1e4
"""Prior precision with which directions are held, in one over their variance. By choice: to a hundredth of their
standard deviation."""


def along_conditional_modes(
    kernel: Kernel,
    likelihood: Likelihood,
    theta: np.ndarray,
    mean: np.ndarray,
    covariance: np.ndarray,
    laplace: np.ndarray,
) -> BentT:
    """The t along the surface.

    Parameters
    ----------
    kernel : Kernel
    likelihood : Likelihood
        With the deviations at their mode.
    theta : ndarray, shape (P,)
        The mode.
    mean, covariance : ndarray, shape (P,) and (P, P)
        Of the reference population.
    laplace : ndarray, shape (P, P)
        Covariance of the person's posterior by Laplace's method.
    """
    axes, into = axes_of(laplace, covariance)
    long = long_directions(theta.size)
    held, precision = into[:long], np.linalg.inv(covariance)
    whole = precision + _HOLD * held.T @ held

    def others(*away: np.ndarray) -> np.ndarray:
        """Sum over places v (long,) of the conditional modes there, less the mode: coordinates (P,)."""
        total = np.zeros(theta.size)
        for v in away:
            start = theta + axes[:, :long] @ v
            centre = np.linalg.solve(whole, precision @ mean + _HOLD * held.T @ (held @ start))
            total += into @ (find_mode(kernel, likelihood, start[None], centre, whole).theta - theta)
        return total

    step, bend, middle = _AWAY * np.eye(long), [], np.zeros(theta.size)
    for a, b in zip(*np.tril_indices(long), strict=True):
        if a == b:
            bend.append(others(step[a], -step[a]) / (2 * _AWAY**2))
            middle += bend[-1]  # products of a direction with itself are -1 at the mode
        else:
            same, opposite = others(step[a] + step[b], -step[a] - step[b]), others(step[a] - step[b], step[b] - step[a])
            bend.append((same - opposite) / (4 * _AWAY**2))
    surface = np.array(bend).reshape(-1, theta.size)
    surface[:, :long], middle[:long] = 0.0, 0.0
    return BentT(centre=theta, axes=axes, into=into, bend=surface, middle=middle, factor=np.eye(theta.size))
