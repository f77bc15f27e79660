"""What a fit says, and the files that hold it: predictive bands, errors, ``result.nc``, ``summary.json``.

In comes a :class:`~bayes_impedance.population.PopulationFit`; out come predictive bands and a :class:`Result` that
every picture, report and export reads. Open :mod:`.result` first, then :mod:`.predictive`; :mod:`.curve_errors` holds
eq. 5 and coverage.
"""

from bayes_impedance.results.predictive import Predictive, predict
from bayes_impedance.results.result import Result, load_result, make_result, save_result

__all__ = ["Predictive", "Result", "load_result", "make_result", "predict", "save_result"]
