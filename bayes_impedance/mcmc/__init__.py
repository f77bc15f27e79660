"""Sampling a density with emcee, and the files of chains.

Input: a log-density of a few dozen coordinates. Output: chains of several independent ensembles with diagnostics.
Open :mod:`.ensemble` first; :mod:`.laplace` finds starting values, :mod:`.autocorrelation` estimates the correlation
time, :mod:`.chain_file` saves chains so that a killed run can be resumed, :mod:`.arviz_file` is the only module that
uses ArviZ.
"""

from bayes_impedance.mcmc.ensemble import Chains, sample

__all__ = ["Chains", "sample"]
