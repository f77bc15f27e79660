"""A haptic device in a user's hands: the sampled loop, its stability and its transparency.

In come a device and users; out come stability limits and what is felt against what was asked for.
Open :mod:`.device` first, then :mod:`.sampled_loop` (with :mod:`.hessenberg` for many gains), :mod:`.stability`,
:mod:`.transparency` and :mod:`.two_port`.
"""
