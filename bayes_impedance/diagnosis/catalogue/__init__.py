"""The catalogue: what a rig or a network of masses, springs and dampers most often leaves out.

In comes nothing; out come effects, each a formula at a place with units, priors, sign rule, story and source.
Open :mod:`.effect` first (what an entry is), then :mod:`.rig` and :mod:`.body` (the entries) and
:mod:`.population_structure` (entries that change no formula). Of two entries that explain recordings equally well the
one registered first is named first: the simpler before the richer, and the rig before the body.
"""

from bayes_impedance.diagnosis.catalogue import body, rig  # they register their effects

__all__ = ["body", "rig"]
