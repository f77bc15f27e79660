"""A network with additions, fitted to all people at once.

Input: likelihoods and a model. Output: the elements of each person, the additions' parameters, evidence and whitened
residuals. Open :mod:`.baseline` first (the network alone), then :mod:`.fitter` and :mod:`.normal_equations` (the
iteration), :mod:`.model` and :mod:`.extend` (additions), :mod:`.coefficient_posterior`, :mod:`.profile_posterior` and
:mod:`.spike_slab` with :mod:`.two_group_mixture` (posterior of their parameters, and whether only some people have
them).
"""
