"""Effects of the body: elements that change while they are measured, with time or with the amplitude of the motion."""

from __future__ import annotations

from dataclasses import replace

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.catalogue.effect import Effect, register

BODY_DRIFT = register(
    Effect(
        id="body.drift",
        name="tissue that changes during the sweep",
        side="body",
        pooling="varying",
        places=("springs", "dampers"),
        formula="z exp(x q(f)), q the elapsed fraction of the sweep's duration",
        story="The tissue relaxes under the load while the frequencies are measured one after the other. "
        "An element therefore has another value at the end of the sweep than at its beginning.",
        look_for="a slope of the magnitude over frequency without the corresponding phase",
        separates="a sweep in the opposite direction, or in random order",
        source="Creep of about 0.5 % per second under load",
        operation="sweep",
        coefficients=(Coefficient("change", ""), Coefficient("time_law", "", "log", (0.03, 1.0), 0.7)),
        signed=True,
        needs_repetitions=True,
    )
)

BODY_AMPLITUDE = register(
    Effect(
        id="body.amplitude",
        name="tissue that follows the amplitude",
        side="body",
        pooling="varying",
        places=("springs", "dampers"),
        formula="z exp(x h), h = a^2/(1 + a^2), a = (f_0/f)^q",
        story="The tissue is softer or stiffer the further it moves, and it moves less at higher frequencies. "
        "An element therefore has another value at the low end of the band than at its high end.",
        look_for="a slope of the magnitude over frequency without the corresponding phase",
        separates="a recording at another drive level, at which the step lies at another frequency",
        source="Fairley and Griffin 1989: a body softens with the magnitude of the vibration",
        operation="amplitude",
        coefficients=(
            Coefficient("change", ""),
            Coefficient("corner", "Hz", "log", 1.5, 0.7),
            Coefficient("steepness", "", "log", (1.0, 2.0), 0.5),
        ),
        signed=True,
        needs_repetitions=True,
    )
)

BODY_AMPLITUDE_OF_THE_ELEMENT = register(
    replace(
        BODY_AMPLITUDE,
        formula="z exp(x h), h = a^2/(1 + a^2), a = abs(v/F)/(w p), v the element's and F the port's",
        story="The tissue is softer or stiffer the further it moves. Under a force of constant amplitude an element "
        "moves most near the resonances, and has another value there.",
        look_for="a resonance that is bent towards lower or higher frequencies",
        separates="a recording at another drive level, at which the change is larger or smaller",
        operation="own_motion",
        coefficients=(Coefficient("change", ""), Coefficient("knee", "n", "log", 1.5, 0.7)),
        needs_repetitions=False,
    )
)
