"""A haptic device held by a user: the sampled loop, its stability and its transparency.

Input: a device and users. Output: stability limits, and the transmitted against the desired impedance.
Open :mod:`.device` first, then :mod:`.sampled_loop` (with :mod:`.hessenberg` for many gains), :mod:`.stability`,
:mod:`.population_limit` (the limit of a share of the population), :mod:`.transparency` and :mod:`.two_port`.
"""
