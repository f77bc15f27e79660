"""What is odd about a dataset, before any model is fitted.

In come recordings; out come findings, each a sentence with the people and frequencies that it concerns.
Open :mod:`.checks` first; :mod:`.point_anomalies` looks at points of one curve, :mod:`.curve_anomalies` compares whole
curves.
"""

from bayes_impedance.quality.checks import check_recordings, describe

__all__ = ["check_recordings", "describe"]
