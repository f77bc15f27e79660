"""Results of a fit and the files that hold them: predictive bands, errors, ``result.nc``, ``summary.json``.

The input is a :class:`~bayes_impedance.population.PopulationFit`; the output is predictive bands and a :class:`Result`
that every picture, report and export reads. Open :mod:`.result` first, then :mod:`.predictive`; :mod:`.curve_errors`
holds eq. 5 and coverage.
"""

from bayes_impedance.results.predictive import Predictive, predict
from bayes_impedance.results.result import Result, load_result, make_result, save_result

__all__ = ["Predictive", "Result", "load_result", "make_result", "predict", "save_result"]
