"""The population: centres and dispersions of the elements, from the likelihoods of all persons.

The input is recordings and a network; the output is :class:`PopulationFit`: chains of the population's parameters, and
draws of each person's elements. Open :mod:`.fit` first: it calls, in order, :mod:`.starting_fits`, :mod:`.em` (with
:mod:`.e_step`), :mod:`.sharded_likelihood` (on :mod:`.importance_likelihood`), :mod:`.posterior` and
:mod:`.diagnostics`. :mod:`.simulate` simulates virtual persons.
"""

from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population

__all__ = ["FitSettings", "PopulationFit", "fit_population"]
