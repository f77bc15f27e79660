"""The population: centres and dispersions of the elements, from the likelihoods of all persons.

Input: recordings and a network. Output: :class:`PopulationFit`: chains of the population's parameters, and draws of
each person's elements. Open :mod:`.fit` first: it calls, in order, :mod:`.requirements`, :mod:`.starting_fits`,
:mod:`.recording_noise`, :mod:`.em` (with :mod:`.e_step` and :mod:`.alignment`), :mod:`.sampling` (of :mod:`.posterior`,
whose likelihood is :mod:`.sharded_likelihood` on :mod:`.importance_likelihood`, from everybody's :mod:`.person_draws`;
:mod:`.draw_error` decides whether to draw anew), :mod:`.dependence` (elements that are determined only together with
another) and :mod:`.diagnostics`. The population's parameters are :mod:`.parameters`, and :mod:`.shared` what is the
same for everybody. :mod:`.person_densities` and :mod:`.held_out_person` serve the comparison of networks;
:mod:`.simulate` simulates virtual persons.
"""

from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population

__all__ = ["FitSettings", "PopulationFit", "fit_population"]
