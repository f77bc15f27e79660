r"""What moves a shape that everybody shares, beside the expansion of the likelihood.

The marginal likelihood of shared parameters and means (:mod:`.normal_equations`) has the term

.. math:: -\tfrac12\ln|1 + D_iT|

for every person, where D is the information of the person's coefficients c, and T their variance between people. The
expansion takes both as constant. Where a shape f and a coefficient change the curve nearly alike, neither is.

**Information.** An effect acts in proportion to its coefficient, so that the curve's derivative by the coefficient
itself changes with the shape as :math:`\partial_f\partial_c z = \partial_f z/c`, and

.. math:: \partial_f D_{cc'} = D_{fc'}/c, \qquad \partial_f D_{cc} = 2D_{fc}/c, \qquad
   F_f = -\sum_i (W_iD_{i,\cdot f})_c / c_i,

with :math:`W = T(1 + DT)^{-1}`. Along the ridge on which the curve does not change, D grows as :math:`c^{-2}`.

**Dispersion.** T is held in a step, and is a share of the mean (:mod:`.fitter`). If people's coefficients differ more
than that share says, smaller ones are nearer to the mean, T follows, and the fit walks down a ridge that leads nowhere:
N units of log likelihood per factor e. So the shape moves as if T followed already. With
:math:`\delta_i = W_i(h_i - D_ia)_c`, the deviations from the mean,

.. math:: F_f = \sum_i\left(\frac{\delta_i^2}{\tau^2} - (W_iD_{i,cc})_{cc}\right) \frac{d\ln\mu}{df},

where the mean follows the shape by the expansion. It is zero where T is what people show, and where coefficient and
shape have nothing to do with each other. The mean itself moves with T held, because it would be biased otherwise: a
ratio that is held would tell it (:mod:`.evidence_surface`).
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.model import Model

_ABSENT = 1e-9
"""Absolute value of a coefficient, or of a mean, that is as good as zero: it has no logarithm. By choice: far less than
can be told."""


def shape_force(
    model: Model,
    h: np.ndarray,
    d: np.ndarray,
    y: np.ndarray,
    tau: np.ndarray,
    a: np.ndarray,
    precision: np.ndarray,
) -> np.ndarray:
    """Derivative of the log likelihood by the additions' central values that their expansion leaves out, shape (A,).

    Parameters
    ----------
    model : Model
    h, d : ndarray, shapes (N, A) and (N, A, A)
        The expansion (:func:`.normal_equations.quadratic`).
    y : ndarray, shape (N, A)
        Each person's parameters.
    tau : ndarray, shape (A,)
        Standard deviations between people, zero of shared parameters.
    a : ndarray, shape (A,)
        Central values.
    precision : ndarray, shape (A, A)
        Theirs, by the expansion.
    """
    force = np.zeros(a.size)
    varying = np.flatnonzero(~model.shared[model.n_elements :])
    coefficient = np.array([p.is_coefficient for p in model.parameters], dtype=bool)
    shape = np.array([p.shared for p in model.parameters], dtype=bool) & ~coefficient
    addition = np.array([p.addition for p in model.parameters])
    if not (shape.any() and coefficient[varying].any()):
        return force
    variance = tau[varying] ** 2
    inside = d[:, varying][:, :, varying]
    w = variance[:, None] * np.linalg.inv(np.eye(varying.size) + inside * variance)
    deviation = np.einsum("nvw,nw->nv", w, (h - d @ a)[:, varying])
    wider = np.sum(deviation**2 / variance - np.einsum("nvw,nwv->nv", w, inside), axis=0)
    follows = -np.linalg.solve(precision[np.ix_(varying, varying)], precision[varying])
    for j, c in enumerate(varying):
        own = np.flatnonzero(shape & (addition == addition[c]))
        if not coefficient[c] or not own.size or abs(a[c]) < _ABSENT:
            continue
        present = np.abs(y[:, c]) > _ABSENT
        known = np.einsum("nv,nvf->nf", w[present, j], d[present][:, varying][:, :, own])
        force[own] += wider[j] * follows[j, own] / a[c] - np.sum(known / y[present, c, None], axis=0)
    return force
