"""Entries of the catalogue that change no formula: structures of the population, and hum.

The order matters: of two entries that explain recordings equally well the earlier one is named first, the simpler
before the richer, and the rig before the body. Effects that concern how elements are distributed between people or
repetitions (``body.covariate``, ``body.subgroup``, ``body.drift`` over repetitions, ``body.amplitude`` over drive
levels, ``body.correlation``) change no formula. They stand at the end, and
:mod:`bayes_impedance.diagnosis.heterogeneity.person_likelihoods` is the basis of their tests.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["STRUCTURES", "Structure"]


@dataclass(frozen=True, kw_only=True)
class Structure:
    """An effect on the distribution of the elements, which changes no formula.

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
            id="rig.mains",
            name="hum of the mains",
            pooling="shared",
            formula="z + hum near 50 or 60 Hz and multiples",
            story="The mains voltage couples into the force channel. "
            "A few points near multiples of the mains frequency deviate strongly and at random.",
            look_for="scatter at single frequencies",
            separates="a higher excitation level: the finger's force grows, the hum does not",
            source="Ground loops",
            side="rig",
        ),
        Structure(
            id="body.covariate",
            name="an element follows a covariate",
            pooling="shared",
            formula="log element = mu + b x",
            story="Part of the difference between people has a known cause. "
            "An element follows a covariate that was recorded for everybody.",
            look_for="a trend of an element over the covariate",
            separates="the same people at several values of the covariate",
            source="Stiffness and damping grow with contact force as F^0.35",
        ),
        Structure(
            id="body.subgroup",
            name="a group of people that differs",
            pooling="some",
            formula="mixture of two groups",
            story="Some people form a group that differs from the others. "
            "One centre with one dispersion does not describe both groups.",
            look_for="two clusters",
            separates="an examination of what the group has in common",
            source="Calluses of manual workers",
        ),
        Structure(
            id="body.drift",
            name="tissue that changes while it is measured",
            pooling="shared",
            formula="log element = mu + b (repetition)",
            story="The tissue relaxes under the load while it is measured. "
            "An element changes from one repetition to the next, the same way in everybody.",
            look_for="a trend over repetitions",
            separates="repetitions in reverse order, or with pauses",
            source="Creep of about 0.5 % per second under load",
        ),
        Structure(
            id="body.amplitude",
            name="tissue that follows the amplitude",
            pooling="shared",
            formula="log element = mu + b ln(drive level)",
            story="The load is not linear. "
            "An element differs between the drive levels at which the same person was recorded.",
            look_for="a trend over the drive levels noted of the repetitions",
            separates="drive levels in random order, the contact force held constant",
            source="Fairley and Griffin 1989: a body softens with the magnitude of the vibration",
        ),
        Structure(
            id="body.correlation",
            name="elements vary together",
            pooling="shared",
            formula="full covariance in place of a diagonal one",
            story="Elements are correlated between people: for instance, a stiffer skin may also be more lossy. "
            "Such a population needs a full covariance.",
            look_for="correlated estimates",
            separates="nothing further: the recordings suffice",
            source="Hierarchical models",
        ),
    )
}

OF_AMPLITUDE = {
    ("n", True): "The spring is softer the further it moves.",
    ("n", False): "The spring is stiffer the further it moves.",
    ("r", True): "The damper resists more than in proportion to the velocity, as turbulent flow does.",
    ("r", False): "The damper resists less than in proportion to the velocity, as friction does.",
    ("m", True): "More mass moves along at larger amplitudes.",
    ("m", False): "Less mass moves along at larger amplitudes.",
}
"""What it means that an element grows (True) or falls with the amplitude, by the first letter of its name."""
