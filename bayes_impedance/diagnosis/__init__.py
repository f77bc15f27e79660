"""What the network leaves out: where recordings and model differ, which physics is missing, and how much it helps.

In come recordings and a network; out comes a :class:`Diagnosis` with its verdict. Open :mod:`.diagnose` first: it fits
the network (``fit``), searches (``selection``) for what of the ``catalogue`` explains what is left (``residuals``,
``hum``), tests the population's shape (``heterogeneity``), says which measurement would separate rivals
(``next_experiment``) and puts it all in a ``verdict``; :mod:`.types` is what comes
out, with the verdict of :mod:`.verdict_types`, which :mod:`.verdict_file` writes and reads as ``verdict.json``.
"""

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Effect, register, registered, unregister
from bayes_impedance.diagnosis.diagnose import diagnose
from bayes_impedance.diagnosis.types import Diagnosis

__all__ = ["Coefficient", "Diagnosis", "Effect", "diagnose", "register", "registered", "unregister"]
