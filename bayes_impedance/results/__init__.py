"""Results of a fit and the files that hold them: predictive bands, errors, ``result.nc``, ``summary.json``.

Input: a :class:`~bayes_impedance.population.PopulationFit`. Output: predictive bands and a :class:`Result` that every
picture, report and export reads. Open :mod:`.result` first, then :mod:`.predictive` and :mod:`.summary`;
:mod:`.curve_errors` holds eq. 5 and coverage, :mod:`.adequacy` and :mod:`.misfit` what a network leaves out,
:mod:`.leave_one_out` and :mod:`.network_comparison` the comparison of networks, :mod:`.tables` the DataFrames.
"""

from bayes_impedance.results.predictive import Predictive, predict
from bayes_impedance.results.result import Result, load_result, make_result, save_result

__all__ = ["Predictive", "Result", "load_result", "make_result", "predict", "save_result"]
