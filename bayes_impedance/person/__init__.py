"""One person: noise, likelihood, mode, exact posterior draws.

Input: one person's recordings and a kernel. Output: log-likelihoods over log elements, and draws from the posterior.
Open :mod:`.likelihood` first, then :mod:`.noise` (its size), :mod:`.mode` (the maximum of the posterior),
:mod:`.marginal_likelihood` (repetitions integrated out; :mod:`.absolute_density` has the constants) and
:mod:`.importance_draws` (draws with weights; :mod:`.valley` draws along a curved posterior).
"""

from bayes_impedance.person.importance_draws import draw
from bayes_impedance.person.likelihood import Likelihood
from bayes_impedance.person.mode import find_mode

__all__ = ["Likelihood", "draw", "find_mode"]
