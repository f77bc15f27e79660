"""The population: centres and dispersions of the elements, from everybody's likelihood.

In come recordings and a network; out comes :class:`PopulationFit`: chains of the population's parameters, draws of
everybody. Open :mod:`.fit` first: it calls, in order, :mod:`.starting_fits`, :mod:`.em` (with :mod:`.e_step`),
:mod:`.sharded_likelihood` (on :mod:`.importance_likelihood`), :mod:`.posterior` and :mod:`.diagnostics`.
:mod:`.simulate` makes virtual people.
"""

from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population

__all__ = ["FitSettings", "PopulationFit", "fit_population"]
