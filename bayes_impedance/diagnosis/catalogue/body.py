"""Effects of the body: tissue and joints that the network describes in a simpler form or lacks."""

from __future__ import annotations

from dataclasses import replace

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Effect, register
from bayes_impedance.diagnosis.catalogue.rig import RESONATOR

_SIMPLER = ("body.springpot", "body.relaxation", "body.squeeze_film", "body.diffusion")
"""What relaxes with one parameter less: where none of these leaves structure, the recordings ask for no richer law."""

_FRACTIONAL = "Fractional Kelvin-Voigt and Zener models of soft tissue; constant phase elements in electrochemistry"

_ANYWHERE = ("port", "groups", "elements")
"""Beside a mass is between it and the ground: a limb's mass is also held by what is behind it."""

BODY_MASS = register(
    Effect(
        id="body.mass",
        name="tissue moving with the contactor",
        side="body",
        pooling="varying",
        places=("port", "groups"),
        formula="z + s m",
        story="Part of the tissue moves rigidly with the contactor and adds its mass. The mass differs from person to "
        "person.",
        look_for="a change of Im z that grows with frequency and differs between people",
        separates="a smaller contactor, under which less tissue moves",
        source="Fingertip models under shear: 0.11 to 0.23 g",
        operation="add",
        coefficients=(Coefficient("mass", "m"),),
        branch="m",
    )
)

BODY_SPRINGPOT_ELEMENT = register(
    Effect(
        id="body.springpot",
        name="power-law tissue",
        side="body",
        pooling="varying",
        places=("springs",),
        formula="1/(s n) becomes c s^(a-1)",
        story="The material lies between a spring and a damper (springpot): it creeps and relaxes by a power law of "
        "time. Its phase is constant over decades of frequency.",
        look_for="depressed arcs in the complex plane; phase and slope that change together over decades",
        separates="a wider band, by a decade or more",
        source=_FRACTIONAL,
        operation="power",
        coefficients=(Coefficient("exponent", ""),),
    )
)

BODY_SPRINGPOT = register(
    Effect(
        id="body.springpot",
        name="power-law tissue",
        side="body",
        pooling="varying",
        places=_ANYWHERE,
        formula="z + c s^(a-1)",
        story="A power-law material (springpot) acts in parallel with the place: it creeps and relaxes without a time "
        "constant. Its phase is constant over decades of frequency.",
        look_for="phase and slope that change together over decades; an exponent a near 0.5 indicates diffusion",
        separates="a wider band, by a decade or more",
        source=_FRACTIONAL,
        operation="beside_power",
        coefficients=(
            Coefficient("coefficient", "c"),
            Coefficient("exponent", "", "logit", (0.15, 0.3, 0.5, 0.7, 0.85)),
        ),
    )
)

BODY_HYSTERESIS = register(
    Effect(
        id="body.hysteresis",
        name="rate-independent loss",
        side="body",
        pooling="varying",
        places=("springs",),
        formula="k(1 + j eta)/s",
        story="The tissue loses the same share of energy in every cycle at any frequency, as friction between fibres "
        "does. A damper would lose less at lower frequencies.",
        look_for="a loss angle that does not depend on frequency",
        separates="lower frequencies: the stiffness of a power law falls there, that of a hysteretic spring does not",
        source="Structural damping",
        operation="hysteresis",
        coefficients=(Coefficient("loss_factor", ""),),
    )
)

BODY_RELAXATION = register(
    Effect(
        id="body.relaxation",
        name="relaxing tissue",
        side="body",
        pooling="varying",
        places=_ANYWHERE,
        formula="z + 1/(1/r + s n)",
        story="A spring in series with a damper (Maxwell branch) resists fast loads and relaxes under slow ones. "
        "The stiffness rises by a step around one frequency, where the loss has its maximum.",
        look_for="a step of stiffness with a peak of loss, a decade wide",
        separates="finer frequencies around the step",
        source="Standard linear solid",
        operation="relaxation",
        coefficients=(Coefficient("damping", "r"), Coefficient("time_constant", "s", "log", 3.0)),
        branch="r-n",
    )
)

BODY_SQUEEZE_FILM = register(
    Effect(
        id="body.squeeze_film",
        name="film of fluid",
        side="body",
        pooling="varying",
        places=_ANYWHERE,
        formula="z + r S(s t), S the sum over odd k of (96/(pi k)^4)/(1 + 4 s t/(pi k)^2)",
        story="Fluid between two surfaces is pressed out and drawn in again. "
        "Slow motion meets a damper, and in fast motion the fluid has no time to leave and acts as a spring.",
        look_for="a step of stiffness with a peak of loss, wider towards high frequencies than that of one relaxation",
        separates="finer frequencies around the step and a decade above it",
        source="Langlois 1962; Griffin, Richardson and Yamanami 1966: squeeze films",
        operation="squeeze_film",
        coefficients=(Coefficient("damping", "r"), Coefficient("time_constant", "s", "log", 2.0)),
    )
)

BODY_RESONATOR = register(
    Effect(
        id="body.resonator",
        name="further joint or bone",
        side="body",
        pooling="varying",
        places=_ANYWHERE,
        formula="z + 1/(1/(s m) + 1/(r + k/s))",
        story="A further joint or bone vibrates on the tissue around it. "
        "It causes a resonance whose frequency differs between people.",
        look_for="a resonance at a different frequency in each person",
        separates="another posture or grip force, which shifts the resonance",
        source="Hand-arm models with several segments",
        operation="resonator",
        coefficients=RESONATOR,
        branch="m-(r|n)",
    )
)

BODY_LINE = register(
    Effect(
        id="body.line",
        name="shear waves in the pulp",
        side="body",
        pooling="varying",
        places=("groups", "springs"),
        formula="z x coth x, x^2 = s M/z",
        story="The tissue's mass is distributed over its thickness, so that shear waves run through it. "
        "Above the first resonance it no longer moves as one mass.",
        look_for="several resonances at odd multiples of the first, towards the high end of the band",
        separates="a band that reaches beyond the first resonance of the layer",
        source="Shear beam on a rigid base: transmission line",
        operation="line",
        coefficients=(Coefficient("mass", "m"),),
    )
)

BODY_FREE_LINE = register(
    Effect(
        id="body.free_line",
        name="waves behind a free surface",
        side="body",
        pooling="varying",
        places=("masses",),
        formula="s m tanh(x)/x, x^2 = s^2 m n",
        story="What the network calls a mass is a layer with a compliance of its own, and its far side is free. "
        "Waves run through it, and above the first resonance it no longer moves as one mass.",
        look_for="a mass that grows with frequency towards a resonance",
        separates="a band that reaches beyond the first resonance of the layer",
        source="Shear beam with a free end: transmission line",
        operation="free_line",
        coefficients=(Coefficient("compliance", "n"),),
    )
)

BODY_DIFFUSION = register(
    Effect(
        id="body.diffusion",
        name="diffusion through a layer",
        side="body",
        pooling="varying",
        places=("dampers",),
        formula="r tanh(x)/x, x^2 = s r n",
        story="What the network calls a damper is a layer through which something diffuses, such as fluid in tissue. "
        "Fast motion reaches only its near side, so that the resistance falls and stores energy as it does.",
        look_for="a phase of -45 degrees over a decade, above which the resistance falls as 1/sqrt(frequency)",
        separates="a wider band towards high frequencies",
        source="Warburg 1899; poroelastic layers",
        operation="free_line",
        coefficients=(Coefficient("compliance", "n"),),
    )
)

# A layer beside the place has an impedance of its own. The law of a damper of the network that diffuses has only one
# parameter more, and is tried first.
BODY_DIFFUSION_BESIDE = register(
    replace(
        BODY_DIFFUSION,
        places=_ANYWHERE,
        formula="z + r tanh(x)/x, x^2 = s r n",
        story="Beside the place is a layer through which something diffuses, such as fluid in tissue. "
        "Fast motion reaches only its near side, so that its resistance falls and stores energy as it does.",
        operation="",
        coefficients=(),
        branch="line_fixed[r1](n1)",
        refines=_SIMPLER,
    )
)

BODY_BROAD_RELAXATION = register(
    Effect(
        id="body.broad_relaxation",
        name="tissue that relaxes over a range of times",
        side="body",
        pooling="varying",
        places=_ANYWHERE,
        formula="z + 1/(s^(1-a)/c + s n)",
        story="A power-law material (springpot) in series with a spring relaxes with many time constants around one. "
        "It is a power law below the middle one, and a spring above it.",
        look_for="a step of stiffness with a peak of loss, wider than a decade",
        separates="a wider band, by a decade to both sides of the step",
        source="Cole and Cole 1941; Koeller 1984: fractional Maxwell and Zener models",
        branch="p1^a1-n1",
        refines=_SIMPLER,
    )
)

BODY_BROAD_RELAXATION_OF_A_DAMPER = register(
    replace(
        BODY_BROAD_RELAXATION,
        formula="z + 1/(1/r + s^(1-a)/c)",
        story="A damper in series with a power-law material (springpot) relaxes with many time constants around one. "
        "It is a damper below the middle one, and a power law above it.",
        look_for="a depressed arc in the complex plane",
        branch="r1-p1^a1",
    )
)

BODY_BYPASS = register(
    Effect(
        id="body.bypass",
        name="second path to ground",
        side="body",
        pooling="varying",
        places=("port",),
        formula="z + r + k/s",
        story="Something besides the finger connects the contactor to ground, such as a neighbouring finger or a "
        "sleeve. Its stiffness and damping add to those of the finger and differ between people.",
        look_for="a constant offset of Re z, and one of Im z that falls as 1/frequency; both differ between people",
        separates="a recording with the second path removed",
        source="Contact with neighbouring fingers or surrounds",
        operation="bypass",
        coefficients=(Coefficient("damping", "r"), Coefficient("stiffness", "k")),
        branch="n|r",
    )
)

# Beside a damper or a spring of the network at the port, one of the two is part of it, and of the second path only the
# other one can be seen: with both, a coefficient that the recordings do not determine decides about its sign.
BODY_BYPASS_STIFFNESS = register(
    replace(
        BODY_BYPASS,
        formula="z + k/s",
        look_for="a change of Im z that falls as 1/frequency and differs between people",
        operation="add",
        coefficients=(Coefficient("stiffness", "k"),),
        branch="n",
    )
)

BODY_BYPASS_DAMPING = register(
    replace(
        BODY_BYPASS,
        formula="z + r",
        look_for="a constant offset of Re z that differs between people",
        operation="add",
        coefficients=(Coefficient("damping", "r"),),
        branch="r",
    )
)

BODY_REFLEX = register(
    Effect(
        id="body.reflex",
        name="reflex feedback",
        side="body",
        pooling="varying",
        places=("port", "groups"),
        formula="z + k exp(-s T)/(s (1 + s/wc))",
        story="Muscles respond to a stretch with the latency of the reflex, about 29 ms (short) or 51 ms (long). "
        "The delayed stiffness makes the phase oscillate over frequency at the low end of the band.",
        look_for="ripples over linear frequency with a period of 1/T, below 50 Hz",
        separates="recordings with a relaxed and with a tensed hand; anaesthesia",
        source="Short- and long-latency stretch reflexes",
        operation="reflex",
        coefficients=(
            Coefficient("stiffness", "k"),
            Coefficient("latency", "s", "log", (0.023, 0.029, 0.036, 0.051), 0.3),
            Coefficient("corner", "Hz", "log", (4.0, 12.0), 0.7),
        ),
    )
)

BODY_REFLEX_VELOCITY = register(
    Effect(
        id="body.reflex_velocity",
        name="reflex that follows velocity",
        side="body",
        pooling="varying",
        places=("port", "groups"),
        formula="z + r exp(-s T)/(1 + s/wc)^2",
        story="Muscle spindles respond to the velocity of a stretch, after the latency of the reflex. "
        "The muscle takes up their signal with a lag of second order, which is taken as critically damped.",
        look_for="ripples over linear frequency with a period of 1/T, below 50 Hz, that vanish at zero frequency",
        separates="lower frequencies: a response to the stretch itself grows there, one to its velocity does not",
        source="Mirbagheri, Barbeau and Kearney 2000",
        operation="reflex",
        coefficients=(
            Coefficient("damping", "r"),
            Coefficient("latency", "s", "log", (0.023, 0.029, 0.036, 0.051), 0.3),
            Coefficient("corner", "Hz", "log", (4.0, 12.0), 0.7),
        ),
    )
)

BODY_SUBGROUP = register(
    Effect(
        id="body.subgroup",
        name="further layer in some people",
        side="body",
        pooling="some",
        places=("port",),
        formula="1/(1/z + 1/(r + 1/(s n))) in some people",
        story="Some people have a further layer in series with the finger, such as a callus. The others have none.",
        look_for="people in two groups",
        separates="an examination of the skin",
        source="Calluses of manual workers",
        operation="series_layer",
        coefficients=(Coefficient("compliance", "n"), Coefficient("time_constant", "s", "log", 3.0)),
        branch="n|r",
        connection="series",
    )
)
