"""The catalogue: effects that a network of masses, springs and dampers or a description of the rig often lacks.

Input: none. Output: effects, each a formula at a place with units, priors, sign rule, story and source.
Open :mod:`.effect` first (definition of an entry), then :mod:`.rig`, :mod:`.body` and :mod:`.changing_elements` (the
entries) and :mod:`.population_structure` (entries that change no formula). Of two entries that explain recordings
equally well the one registered first is named first: the simpler before the richer, and the rig before the body.
"""

from bayes_impedance.diagnosis.catalogue import body, changing_elements, rig  # they register their effects

__all__ = ["body", "changing_elements", "rig"]
