r"""How much a difference of evidence is worth when both explanations are wrong.

The difference of log likelihood of a rival B to the chosen explanation A, whose curves differ by
:math:`\Delta = Z_B - Z_A`, over the noise, at residuals r of the final model, is

.. math:: \ln L_A - \ln L_B = \sum_k \left(\tfrac12|\Delta_k|^2 - \operatorname{Re}(\bar r_k\,\Delta_k)\right) .

If r is white noise, the second term has the variance :math:`\sum_k c_k^2` with
:math:`c_k = \operatorname{Re}(\bar r_k \Delta_k)`. If physics is still missing, r goes up and down with frequency, and
alike in all people: the sum over a block of frequencies and all people is much larger than that, with a sign that is an
accident of what is missing. The ratio

.. math:: \kappa = \frac{\sum_b \left(\sum_{k\in b} c_k\right)^2}{\sum_k c_k^2}

of the variance over blocks to that of independent points says how many points count as one. As in composite
likelihoods (Varin, Reid and Firth 2011), a log likelihood that treats dependent points as independent is divided by it.

Residuals and differences are taken outside of what the elements of each recording can absorb
(:mod:`bayes_impedance.diagnosis.fit.person_residuals`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, real_and_imaginary
from bayes_impedance.diagnosis.fit.refit import Refit

BLOCKS = 8
"""Blocks of frequency, each with the same share of what the two explanations differ by. By choice, as for held-out
frequencies: with more of them, a block becomes narrower than the structure that remains."""

_BY_CHANCE = float(chdtri(BLOCKS, 0.025)) / BLOCKS
"""Ratio that white noise exceeds in 2.5 % of all comparisons (2.19, chi-square over its degrees of freedom)."""


def dependence(chosen: Refit, rival: Refit, remaining: Sequence[PersonResiduals]) -> float:
    """Number of points that count as one in a comparison of two explanations; 1 if the residuals look white.

    Parameters
    ----------
    chosen, rival : Refit
        Of the same recordings.
    remaining : sequence of PersonResiduals
        Residuals of the final model, in the order of the people.
    """
    frequency, product, difference = [], [], []
    start = 0
    for person in remaining:
        rows = slice(start, start + len(person.white))
        start = rows.stop
        pair = [f.model.kernel.impedance(f.u[rows], person.frequency_hz) for f in (rival, chosen)]
        delta = person.outside(real_and_imaginary((pair[0] - pair[1]) / person.sd))
        left = person.outside(person.white)
        frequency.append(np.tile(person.frequency_hz, 2 * len(delta)))
        product.append((left * delta).ravel())
        difference.append((delta**2).ravel())
    f, c, weight = (np.concatenate(parts) for parts in (frequency, product, difference))
    independent = float(np.sum(c**2))
    if not independent > 0:
        return 1.0
    order = np.argsort(f, kind="stable")
    share = np.cumsum(weight[order]) / weight.sum()
    # Points at one frequency, of all people, belong to one block.
    last = np.append(np.diff(f[order]) > 0, True)
    level = np.repeat(share[last], np.diff(np.append(0, np.flatnonzero(last) + 1)))
    block = np.minimum((BLOCKS * (level - 1e-12)).astype(int), BLOCKS - 1)
    sums = np.bincount(block, c[order], minlength=BLOCKS)
    ratio = float(np.sum(sums**2)) / independent
    return ratio if ratio > _BY_CHANCE else 1.0
