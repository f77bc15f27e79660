"""Diagnosis of a network: where recordings and model differ, which physics is missing, and the gain from adding it.

Input: recordings and a network. Output: a :class:`Diagnosis` with its verdict. Open :mod:`.diagnose` first: it fits the
network (``fit``), searches (``selection``) the ``catalogue`` for effects that explain the remaining structure
(``residuals``, ``hum``), tests the population's distribution (``heterogeneity``), proposes measurements that would
separate rivals (``next_experiment``) and makes the ``verdict``; :mod:`.extended_network` writes the network with what
was found, for the population's posterior, which begins at :mod:`.extended_start`. :mod:`.types` defines the output,
with the verdict of :mod:`.verdict_types`, which :mod:`.verdict_file` writes and reads as ``verdict.json``.
:mod:`.examine` is the beginning of it, for every fit; :mod:`.covariate_search` asks only which elements follow a
covariate.
"""

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Effect, register, registered, unregister
from bayes_impedance.diagnosis.covariate_search import CovariateSearch, search_covariates
from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.diagnosis.types import Diagnosis

__all__ = [
    "Coefficient",
    "CovariateSearch",
    "Diagnosis",
    "Effect",
    "diagnose",
    "register",
    "registered",
    "search_covariates",
    "unregister",
]
