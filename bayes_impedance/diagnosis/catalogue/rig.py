"""Effects of the measurement chain: contactor, suspension, channels, mount, fixture."""

from __future__ import annotations

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Effect, register

_PAPER = "Paper, section 3: the unloaded contactor is measured and subtracted"

RESONATOR = (
    Coefficient("mass", "m"),
    Coefficient("frequency", "Hz", "log", 6.0, 0.3),
    Coefficient("damping_ratio", "", "log", (0.03, 0.12, 0.5)),
)

RIG_MASS = register(
    Effect(
        id="rig.mass",
        name="residual contactor mass",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z + s m",
        story="The moving mass between sensor and finger was subtracted incompletely, or in excess. "
        "It is the same for everybody because it belongs to the device.",
        look_for="a change of Im z that grows with frequency, the same for everybody",
        separates="the unloaded device, or a second contactor of another known mass",
        source=_PAPER,
        operation="add",
        coefficients=(Coefficient("mass", "m"),),
        signed=True,
    )
)

RIG_DAMPING = register(
    Effect(
        id="rig.damping",
        name="residual suspension damping",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z + r",
        story="The contactor's suspension loses energy, and this loss was not fully subtracted. "
        "It adds the same resistance at every frequency and for everybody.",
        look_for="a constant offset of Re z, largest where |z| is smallest",
        separates="the unloaded device",
        source=_PAPER,
        operation="add",
        coefficients=(Coefficient("damping", "r"),),
        signed=True,
    )
)

RIG_STIFFNESS = register(
    Effect(
        id="rig.stiffness",
        name="residual suspension stiffness",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z + k/s",
        story="The contactor is suspended on a spring whose force was not fully subtracted. "
        "The error is largest at the low end of the band and the same for everybody.",
        look_for="a change of Im z that falls with frequency, the same for everybody",
        separates="the unloaded device at low frequencies",
        source=_PAPER,
        operation="add",
        coefficients=(Coefficient("stiffness", "k"),),
        signed=True,
    )
)

RIG_DELAY = register(
    Effect(
        id="rig.delay",
        name="time skew between the channels",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z exp(-s tau)",
        story="The force channel is sampled slightly later than the acceleration channel (or earlier). "
        "The phase error is proportional to frequency, and the magnitude does not change.",
        look_for="a phase error proportional to frequency, no magnitude error",
        separates="a known pure mass in place of the finger: its phase must be 90 degrees at every frequency",
        source="Multiplexed or filtered acquisition channels",
        operation="delay",
        coefficients=(Coefficient("delay", "s"),),
        signed=True,
    )
)

RIG_HIGHPASS = register(
    Effect(
        id="rig.highpass",
        name="unequal high-pass corners",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z s/(s + wc)",
        story="The two channels are high-pass filtered (AC coupled) with unequal corner frequencies, as by charge "
        "amplifiers. The phase is wrong at the low end of the band, by the same angle for everybody.",
        look_for="a phase error proportional to 1/frequency",
        separates="a known spring or mass measured down to the lowest frequency",
        source="Charge amplifiers and AC coupling",
        operation="highpass",
        coefficients=(Coefficient("corner", "Hz"),),
        signed=True,
    )
)

RIG_LOWPASS = register(
    Effect(
        id="rig.lowpass",
        name="unequal anti-alias corners",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z/(1 + s/wc)",
        story="The two channels are low-pass filtered with unequal corner frequencies. "
        "The phase is wrong at the high end of the band, and close to the corner the magnitude too.",
        look_for="a phase error proportional to frequency, with a fall of magnitude near the corner",
        separates="a known pure mass measured beyond the band: a filter lowers its magnitude, a delay does not",
        source="Anti-alias filters",
        operation="lowpass",
        coefficients=(Coefficient("time_constant", "s"),),
        signed=True,
    )
)

RIG_SERIES_COMPLIANCE = register(
    Effect(
        id="rig.series_compliance",
        name="compliant mount",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="1/(1/z + s n)",
        story="The adhesive or the mount between sensor and finger is compliant. "
        "The sensor then moves more than the finger, most of all where the finger's impedance is large.",
        look_for="a change proportional to s z^2, the same compliance for everybody",
        separates="a heavier known mass: its apparent mass grows towards high frequencies",
        source="Adhesive mounts of impedance heads",
        operation="series_compliance",
        coefficients=(Coefficient("compliance", "n"),),
        branch="n",
        connection="series",
    )
)

RIG_RESONANCE = register(
    Effect(
        id="rig.resonance",
        name="mode of the fixture",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z + 1/(1/(s m) + 1/(r + k/s))",
        story="Part of the fixture vibrates on a spring of its own. "
        "It causes a resonance at one frequency, the same for everybody.",
        look_for="a resonance at the same frequency in everybody",
        separates="the unloaded device, or a tap on the fixture",
        source="Modal tests of fixtures",
        operation="resonator",
        coefficients=RESONATOR,
        branch="m-(r|n)",
    )
)

RIG_SEMI_INDUCTANCE = register(
    Effect(
        id="rig.semi_inductance",
        name="semi-inductance of a coil",
        side="rig",
        pooling="shared",
        places=("port",),
        formula="z + c s^a, 0 < a < 1",
        story="Eddy currents behind a coil, or in the iron around it, keep part of the field out. "
        "The coil then acts between a resistance and an inductance, and its phase is constant over decades.",
        look_for="Re z and Im z that grow together as a power of frequency, towards the high end of the band",
        separates="the coil alone, blocked or without the magnet",
        source="Vanderkooy 1989: loudspeakers with eddy currents",
        operation="semi_inductance",
        coefficients=(Coefficient("coefficient", "l"), Coefficient("exponent", "", "logit", (0.3, 0.5, 0.7))),
    )
)
