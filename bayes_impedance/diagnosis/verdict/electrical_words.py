"""Words of the verdict on an electrical one-port, such as a cell: it has no tissue, no finger and no contactor.

The catalogue describes effects in the words of mechanics. The same operations on an impedance have names of their own
in electrochemistry: a springpot is a constant phase element, a squeeze film a relaxation, waves in a layer those of a
transmission line. Ids stay as they are, because they are keys of ``verdict.json``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from bayes_impedance.diagnosis.verdict_types import Alias, Detectable, Physics, Verdict

UNIT = "ohm"
"""Of the impedances that are meant."""


@dataclass(frozen=True)
class Words:
    """Name of an effect, what happens in it, and a measurement that would separate it from others."""

    name: str
    story: str
    separates: str


_RIG_SHORT = "the leads short-circuited at the cell"
_WIDER = "a wider band, by a decade or more"
_SLOW = "a sweep in the opposite direction, or in random order"
_WORDS = {
    "rig.mass": Words(
        "residual lead inductance",
        "The inductance of leads and holder was compensated incompletely, or in excess. It is the same for all.",
        _RIG_SHORT,
    ),
    "rig.damping": Words(
        "residual lead resistance",
        "The resistance of leads and contacts was compensated incompletely, or in excess. It is the same for all.",
        _RIG_SHORT,
    ),
    "rig.stiffness": Words(
        "residual series capacitance",
        "A capacitance in series with the cell was not fully removed. The error is largest at low frequencies.",
        "a known resistor in place of the cell, at low frequencies",
    ),
    "rig.delay": Words(
        "time skew between the channels",
        "The voltage is sampled slightly later than the current (or earlier). The phase error is proportional to "
        "frequency, and the magnitude does not change.",
        "a known resistor in place of the cell: its phase must be zero at every frequency",
    ),
    "rig.highpass": Words(
        "unequal high-pass corners",
        "The two channels are AC coupled with unequal corner frequencies. The phase is wrong at low frequencies.",
        "a known resistor measured down to the lowest frequency",
    ),
    "rig.lowpass": Words(
        "unequal anti-alias corners",
        "The two channels are low-pass filtered with unequal corner frequencies. The phase is wrong at the high end of "
        "the band, and close to the corner the magnitude too.",
        "a known resistor measured beyond the band: a filter lowers its magnitude, a delay does not",
    ),
    "rig.series_compliance": Words(
        "stray capacitance",
        "Leads and holder have a capacitance in parallel with the cell. It takes most of the current where the cell's "
        "impedance is large.",
        "the holder without a cell",
    ),
    "rig.resonance": Words(
        "resonance of the fixture",
        "Inductance and capacitance of the fixture resonate at one frequency, the same for all.",
        _RIG_SHORT,
    ),
    "rig.mains": Words(
        "hum of the mains",
        "The mains voltage couples into a channel. A few points near multiples of the mains frequency deviate strongly "
        "and at random.",
        "a higher excitation level: the answer grows, the hum does not",
    ),
    "body.mass": Words(
        "inductance of the cell",
        "The cell's windings and current collectors have an inductance, which differs between subjects.",
        "higher frequencies, where an inductance grows in proportion",
    ),
    "body.springpot": Words(
        "power law",
        "A constant phase element: it lies between a resistance and a capacitance, as rough or porous electrodes do. "
        "Its phase is constant over decades of frequency.",
        _WIDER,
    ),
    "body.hysteresis": Words(
        "rate-independent loss",
        "The same share of the energy is lost in every cycle at any frequency, as in a lossy dielectric.",
        "lower frequencies: the capacitance of a power law grows there, that of a lossy dielectric does not",
    ),
    "body.relaxation": Words(
        "further relaxation",
        "A resistance with a capacitance, a process with a time constant of its own, acts at the place. The impedance "
        "changes by a step around one frequency.",
        "finer frequencies around the step",
    ),
    "body.squeeze_film": Words(
        "relaxation with a power-law flank",
        "A process of diffusion kind acts at the place: below one frequency it is a resistance, above it a power law.",
        "finer frequencies around the step and a decade above it",
    ),
    "body.resonator": Words(
        "further resonance",
        "A further branch of inductance and capacitance resonates at a frequency that differs between subjects.",
        "finer frequencies around the resonance, at another state of charge",
    ),
    "body.line": Words(
        "waves on a transmission line",
        "Inductance and capacitance are distributed, so that waves run along them.",
        "a band that reaches beyond the first resonance of the line",
    ),
    "body.free_line": Words(
        "waves on an open transmission line",
        "What the network calls an inductance is distributed along a line whose far end is open.",
        "a band that reaches beyond the first resonance of the line",
    ),
    "body.diffusion": Words(
        "diffusion through a layer",
        "What the network calls a resistance is a layer through which ions diffuse (a Warburg element). Fast currents "
        "reach only its near side, so that the resistance falls and stores charge as it does.",
        "a wider band",
    ),
    "body.broad_relaxation": Words(
        "relaxation over a range of times",
        "A depressed arc (a ZARC element, or a constant phase element that ends in a capacitance) acts at the place. "
        "Many processes of one kind have time constants around a middle one.",
        "a wider band, by a decade to both sides of the arc",
    ),
    "body.bypass": Words(
        "second path for the current",
        "Something besides the cell connects the terminals. Its impedance adds to that of the cell.",
        "a recording with the second path removed",
    ),
    "body.reflex": Words(
        "delayed feedback",
        "Something answers the current after a delay, which makes the phase oscillate over frequency.",
        "recordings with the control of the cell switched off",
    ),
    "body.reflex_velocity": Words(
        "delayed feedback of the rate",
        "Something answers the rate of the charge after a delay and a lag of second order.",
        "lower frequencies: a response to the charge itself grows there, one to its rate does not",
    ),
    "body.amplitude": Words(
        "element that follows the amplitude",
        "An element depends on how large the current is, and so differs between drive levels, and between the ends of "
        "a band over which the current changes.",
        "a recording at another drive level, at which the step lies at another frequency",
    ),
    "body.covariate": Words(
        "an element follows a covariate",
        "Part of the difference between subjects has a known cause: an element follows a covariate that was recorded.",
        "the same subjects at several values of the covariate",
    ),
    "body.drift": Words(
        "cell that changes while it is measured",
        "An element changes while the frequencies, or the repetitions, are measured one after the other.",
        _SLOW,
    ),
    "body.subgroup": Words(
        "a group of subjects that differs",
        "Some subjects form a group that differs from the others. One centre with one dispersion describes neither.",
        "an examination of what the group has in common",
    ),
    "body.correlation": Words(
        "elements vary together",
        "Elements are correlated between subjects. Such a population needs a full covariance.",
        "nothing further: the recordings suffice",
    ),
}


def electrical(verdict: Verdict) -> Verdict:
    """A verdict in the words of its recordings: unchanged unless they are electrical."""
    if verdict.unit != UNIT:
        return verdict
    return replace(
        verdict,
        physics=tuple(_entry(entry) for entry in verdict.physics),
        detectable=tuple(_limit(limit) for limit in verdict.detectable),
    )


def _entry(entry: Physics) -> Physics:
    aliases = tuple(_alias(alias) for alias in entry.aliases)
    said = _WORDS.get(entry.id)
    if said is None:
        return replace(entry, aliases=aliases)
    # A trend or a correlation has a name that says which elements and covariates are meant.
    named = entry.kind == "effect"
    return replace(entry, name=said.name if named else entry.name, story=said.story, aliases=aliases)


def _alias(alias: Alias) -> Alias:
    said = _WORDS.get(alias.id)
    if said is None:
        return alias
    # Sentences on a computed measurement are about frequencies and repetitions, and end with the general remedy.
    computed, general, _ = alias.would_separate.rpartition("; in general: ")
    return replace(alias, name=said.name, would_separate=computed + general + said.separates)


def _limit(limit: Detectable) -> Detectable:
    said = _WORDS.get(limit.id)
    return limit if said is None or not limit.name else replace(limit, name=said.name)
