"""A network with additions, fitted to all people at once.

Input: likelihoods and a model. Output: the elements of each person, the additions' parameters, evidence and whitened
residuals. Open :mod:`.baseline` first (the network alone), then :mod:`.fitter` and :mod:`.normal_equations` (the
iteration; :mod:`.cold_start` and :mod:`.majority` choose where it starts, :mod:`.refit` is what it returns),
:mod:`.model` and :mod:`.extend` (additions), :mod:`.person_residuals`, :mod:`.coefficient_posterior` (the additions'
parameters, from a quadratic expansion), :mod:`.evidence_surface` and :mod:`.evidence_posterior` (the same from the
evidence), :mod:`.spike_slab` with :mod:`.two_group_mixture` (whether only some people have them; :mod:`.of_members`).
"""
