"""The catalogue: what a rig or a network of masses, springs and dampers most often leaves out.

Order matters a little: of two entries that explain recordings equally well the earlier one is named first, the simpler
before the richer, and the rig before the body. Effects that concern how elements are distributed between people or
repetitions (``body.covariate``, ``body.subgroup``, ``body.drift`` over repetitions, ``body.correlation``) change no
formula; they stand at the end, and :mod:`bayes_impedance.diagnosis.heterogeneity.person_likelihoods` looks for them.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["STRUCTURES", "Structure"]


@dataclass(frozen=True)
class Structure:
    """An effect on how elements are distributed, which changes no formula.

    Attributes
    ----------
    id, name, pooling, formula, story, look_for, separates, source : str
        As in :class:`~bayes_impedance.diagnosis.catalogue.effect.Effect`; the side is always the body, except for the
        mains.
    side : str
    """

    id: str
    name: str
    pooling: str
    formula: str
    story: str
    look_for: str
    separates: str
    source: str
    side: str = "body"


STRUCTURES = {
    entry.id: entry
    for entry in (
        Structure(
            "rig.mains",
            "hum of the mains",
            "shared",
            "z + hum near 50 or 60 Hz and multiples",
            "The mains couple into the force channel. A few points next to its multiples are far off, at random.",
            "scatter at single frequencies",
            "another excitation level: hum stays, the finger's force grows",
            "Ground loops",
            "rig",
        ),
        Structure(
            "body.covariate",
            "an element follows a covariate",
            "shared",
            "log element = mu + b x",
            "People differ partly for a known reason. An element follows a quantity that was noted for everybody.",
            "a trend of an element over the covariate",
            "the same people at several values of the covariate",
            "Stiffness and damping grow with contact force as F^0.35",
        ),
        Structure(
            "body.subgroup",
            "a group of people that differs",
            "some",
            "mixture of two groups",
            "Some people differ from the others as a group. One centre with one dispersion does not describe both.",
            "two clusters",
            "an examination of what the group has in common",
            "Calluses of manual workers",
        ),
        Structure(
            "body.drift",
            "tissue that changes while it is measured",
            "shared",
            "log element = mu + b (repetition)",
            "The tissue relaxes under the load while it is measured. "
            "An element changes from one repetition to the next, the same way in everybody.",
            "a trend over repetitions",
            "repetitions in reverse order, or with pauses",
            "Creep of about 0.5 % per second under load",
        ),
        Structure(
            "body.correlation",
            "elements vary together",
            "shared",
            "full covariance in place of a diagonal one",
            "Who has a stiff skin has a lossy one too. Elements that vary together need a full covariance.",
            "correlated estimates",
            "nothing further: the recordings suffice",
            "Hierarchical models",
        ),
    )
}
