r"""Corrections of p-values for the number of tests that were made.

Both control the family-wise error rate, the probability of one false alarm or more among m true null hypotheses,
whatever the dependence between the tests. By the union bound the smallest of m p-values is below
:math:`\alpha/m` with a probability of at most :math:`\alpha` (**Bonferroni**). **Holm** (Scandinavian Journal of
Statistics 6, 65-70, 1979) corrects all of them: the k-th smallest is multiplied by the number m - k + 1 of hypotheses
that have not been rejected yet, and a corrected p-value is never smaller than one before it,

.. math:: \tilde p_{(k)} = \max_{l \le k} \min\bigl(1, (m - l + 1)\,p_{(l)}\bigr) .
"""

from __future__ import annotations

import numpy as np

STRUCTURE_ALPHA = 1e-3
"""P-value below which residuals have structure, and are not noise alone. By choice."""


def bonferroni(p_value: float, tests: int) -> float:
    """The smallest p-value of a number of tests, corrected for that number."""
    return min(p_value * tests, 1.0)


def holm(p_values: np.ndarray) -> np.ndarray:
    """P-values (M,) corrected for all M tests, in the order given."""
    order = np.argsort(p_values)
    steps = p_values[order] * np.arange(p_values.size, 0, -1)
    corrected = np.empty_like(p_values)
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected
