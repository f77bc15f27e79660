r"""A further effect in the recordings of few people, from whom no standard error over people can be taken.

An effect of the body has a mean, a dispersion and often a shape, and these can be estimated only from several people.
An effect of the measurement chain is one number for everybody, and one recording of enough frequencies can determine
two of them: a low-pass and a lag. The question is then how many of the residuals are independent. Where the better
model leaves structure, neighbouring residuals are correlated, and so are those of all repetitions, but a difference of
log evidence counts them as independent. With the whitened residuals :math:`w_{jf}` of J repetitions, their mean
:math:`\bar w_f` and its autocorrelation :math:`\rho_k` k points apart,

.. math:: \kappa = \Bigl(1 + 2 \sum_{k < K} \rho_k\Bigr)
          \max\Bigl(1, \frac{J \sum_f |\bar w_f|^2}{\frac1J \sum_{jf} |w_{jf}|^2}\Bigr)

residuals count as one: kappa is 1 for noise, J for a structure that all repetitions share. (K is the first k with
:math:`\rho_k \le 0`.) A further effect counts if it predicts blocks of frequencies that were held out better than the
model without it does, and if its difference of log evidence, divided by the kappa of the better model, exceeds that of
three standard errors after a choice among n effects,

.. math:: \Delta / \kappa > \tfrac12\, 3^2 + \ln n .

An effect of the body counts only if it leaves no structure as well. It has many ways to resemble what is left, and
no others to show that it does not: in one motor's recordings elements that follow the motion's amplitude would stand
beside the low-pass, and leave as much. What a low-pass, a lag or a delay leaves behind is no reason against them.

In a motor's recordings a lag of 0.1 ms gained 76 to 3000 nats, which division by kappa reduces to 43 to 81. A high-pass
that the motor does not have then gained 55 nats, which it reduces to 2.6, and a stiffness 6 to 111, reduced to 1.2 to
5.4; with the stiffness the corner of the low-pass was 5 % from what the motor's encoder shows, without it 0.1 %.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayes_impedance.diagnosis.catalogue.effect import Effect
from bayes_impedance.diagnosis.fit.fitter import Refitter
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.chain_first import of_the_chain
from bayes_impedance.diagnosis.selection.compare import FEWEST_PEOPLE, log_evidence
from bayes_impedance.diagnosis.selection.cross_validation import held_out
from bayes_impedance.diagnosis.selection.what_remains import leaves_structure

_STANDARD_ERRORS = 3.0
"""By how many a further effect must stand out, where there is no scatter between people that would show how much of a
gain is a whim of the recordings. By choice: one more than over people (:data:`~.compare.SCATTERS`)."""


_PEOPLE_PER_ADDITION = 8
"""People required per addition of the body, which has a mean, a dispersion and often a shape to be estimated. By
choice; one may be named of any number of people. Effects of the measurement chain are one number for everybody, and
take nobody's place: where a drift and a damping of the rig stood beside a resonator of 23 people, nothing but effects
of the rig was tried in the resonator's place, and it stood for a mass."""


def may_follow(found: Sequence[Effect], effects: Sequence[Effect], people: int) -> tuple[Sequence[Effect], bool]:
    """Effects that may be added to those that were found, and whether :func:`holds_beside` judges them.

    Which of two effects is found first does not matter: so few people may have one of the body, before or after one of
    the chain. It judges effects of the chain where nothing else may follow, and everything where people are too few for
    a standard error over them.
    """
    of_the_body = len(found) - len(of_the_chain(found))
    only_chain = bool(found) and of_the_body >= max(people // _PEOPLE_PER_ADDITION, 1)
    return of_the_chain(effects) if only_chain else effects, only_chain or people < FEWEST_PEOPLE


def holds_beside(refitter: Refitter, fit: Refit, grown: Refit, seed: int, effects: Sequence[Effect]) -> bool:
    """Whether a further effect is in the recordings.

    Parameters
    ----------
    refitter : Refitter
    fit, grown : Refit
        Without it and with it.
    seed : int
        Of the division into folds, if there are people enough.
    effects : sequence of Effect
        From which it was chosen, n of them.
    """
    gain = (log_evidence(grown) - log_evidence(fit)) / residuals_that_say_one_thing(grown)
    if gain <= 0.5 * _STANDARD_ERRORS**2 + np.log(len(effects)):
        return False
    foretold = held_out(refitter, fit, grown, seed).blocks
    if foretold is None or foretold <= 0:
        return False
    if of_the_chain([grown.model.additions[-1].effect]):
        return True
    numbers = [str(i + 1) for i in range(len(fit.data))]
    return not leaves_structure(grown, numbers, effects, seed, refitter.executor)


def residuals_that_say_one_thing(fit: Refit) -> float:
    """Kappa of the module's docstring, people together; at least 1."""
    products, shared, own, row = np.zeros(max(d.omega.size for d in fit.data)), 0.0, 0.0, 0
    for d in fit.data:
        rows = slice(row, row + d.z.shape[0])
        row = rows.stop
        model = fit.model.kernel.impedance(np.ascontiguousarray(fit.u[rows]), d.omega / (2 * np.pi))
        white = (d.z[:, 0] + 1j * d.z[:, 1] - model) * np.sqrt(d.weight)
        mean = white.mean(axis=0)
        spectrum = np.abs(np.fft.fft(mean, 2 * mean.size)) ** 2
        products[: mean.size] += np.fft.ifft(spectrum).real[: mean.size]
        shared += len(white) * float(np.sum(np.abs(mean) ** 2))
        own += float(np.sum(np.abs(white) ** 2)) / len(white)
    if products[0] <= 0:
        return 1.0
    rho = products[1:] / products[0]
    ends = np.flatnonzero(rho <= 0)
    neighbours = 1.0 + 2.0 * float(rho[: ends[0] if ends.size else rho.size].sum())
    return neighbours * max(1.0, shared / own)
