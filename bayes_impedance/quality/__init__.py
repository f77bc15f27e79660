"""Checks of a dataset before any model is fitted.

Input: recordings. Output: findings, each a sentence with the subjects and frequencies that it concerns.
Open :mod:`.checks` first; :mod:`.point_anomalies` looks at points of one curve, :mod:`.curve_anomalies` compares whole
curves, :mod:`.kramers_kronig` asks whether real and imaginary part belong together, :mod:`.negative_real_part` says
what makes Re z negative, :mod:`.marks` finds codes for missing data. :mod:`.copies` refuses copies.
"""

from bayes_impedance.quality.checks import check_recordings, describe

__all__ = ["check_recordings", "describe"]
