"""Sampling a density with emcee, and the files of chains.

In comes a log-density of a few dozen coordinates; out come chains of several independent ensembles with diagnostics.
Open :mod:`.ensemble` first; :mod:`.laplace` finds where to begin, :mod:`.chain_file` keeps chains of a run that may be
killed, :mod:`.arviz_file` is the only module that knows ArviZ.
"""

from bayes_impedance.mcmc.ensemble import Chains, sample

__all__ = ["Chains", "sample"]
