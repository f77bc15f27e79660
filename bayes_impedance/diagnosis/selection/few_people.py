r"""A further effect in the recordings of few people, from whom no standard error over people can be taken.

An effect of the body has a mean, a dispersion and often a shape, which take people to be estimated. One of the
measurement chain is one number for everybody, and one recording of enough frequencies can hold two of them: a low-pass
and a lag. What is in doubt is then not the number of people but that of independent frequencies. Where the better model
leaves structure, neighbouring residuals err together, and differences of log evidence count each of them as a fact of
its own. With the autocorrelation :math:`\rho_k` of the whitened residuals k points apart,

.. math:: \kappa = 1 + 2 \sum_{k < K} \rho_k ,

up to the first K with :math:`\rho_K \le 0`, points say one thing (1 for noise). A further effect counts if its
difference of log evidence, divided by that of the better model, exceeds
:data:`~bayes_impedance.diagnosis.selection.compare.LEAST_GAIN`, and if it predicts blocks of frequencies that were held
out better than the model without it does.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.compare import LEAST_GAIN, log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import held_out


def holds_beside(refitter: Refitter, fit: Refit, grown: Refit, seed: int) -> bool:
    """Whether a further effect is in the recordings.

    Parameters
    ----------
    refitter : Refitter
    fit, grown : Refit
        Without it and with it.
    seed : int
        Of the division into folds, if there are people enough.
    """
    if (log_evidence(grown) - log_evidence(fit)) / points_that_err_together(grown) <= LEAST_GAIN:
        return False
    gain = held_out(refitter, fit, grown, seed).blocks
    return gain is not None and gain > 0


def points_that_err_together(fit: Refit) -> float:
    """Number of neighbouring points whose residuals say one thing: kappa of the module's docstring, at least 1."""
    products, row = np.zeros(max(d.omega.size for d in fit.data)), 0
    for d in fit.data:
        rows = slice(row, row + d.z.shape[0])
        row = rows.stop
        model = fit.model.kernel.impedance(np.ascontiguousarray(fit.u[rows]), d.omega / (2 * np.pi))
        # What all repetitions share is structure; their scatter is not, and repetitions are not independent of it.
        white = np.mean((d.z[:, 0] + 1j * d.z[:, 1] - model) * np.sqrt(d.weight), axis=0)
        spectrum = np.abs(np.fft.fft(white, 2 * white.size)) ** 2
        products[: white.size] += np.fft.ifft(spectrum).real[: white.size]
    if products[0] <= 0:
        return 1.0
    rho = products[1:] / products[0]
    ends = np.flatnonzero(rho <= 0)
    return 1.0 + 2.0 * float(rho[: ends[0] if ends.size else rho.size].sum())
