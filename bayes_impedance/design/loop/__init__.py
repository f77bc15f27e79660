"""A haptic device held by a user: the sampled loop, its stability and its transparency.

The input is a device and users; the output is stability limits, and the transmitted against the desired impedance.
Open :mod:`.device` first, then :mod:`.sampled_loop` (with :mod:`.hessenberg` for many gains), :mod:`.stability`,
:mod:`.transparency` and :mod:`.two_port`.
"""
