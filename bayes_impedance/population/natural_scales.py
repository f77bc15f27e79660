r"""The recordings' own scales: where default priors are centred, and what a signed parameter is measured in.

With the size :math:`Z_0` of the impedance and the angular frequency :math:`\omega_0`, both in the middle of the
recordings on logarithmic scales, every quantity has a value at which it matters: a mass of :math:`Z_0/\omega_0`, a
delay of :math:`1/\omega_0`, a corner at :math:`\omega_0/2\pi`. The default prior of a logarithm is centred there with a
standard deviation of 3, a factor of twenty either way; that of a signed parameter is centred at zero and as wide in
units of that value; an exponent's is nearly uniform. No unit, body part or device need be known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bayes_impedance.network.elements import KINDS, band_scale
from bayes_impedance.network.extensions import PowerLaw
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import LOG, LOGIT, SIGNED, Parameter
from bayes_impedance.network.tree import Network, Place
from bayes_impedance.population.prior import Prior
from bayes_impedance.recordings.files import Recordings

LOG_SD = 3.0
"""Prior standard deviation of the logarithm of an element around its natural value, and of a signed parameter around
zero in units of it: a factor of twenty either way. By choice."""
LOGIT_SD = 1.5
"""Prior standard deviation of the logit of an exponent. By choice: the density of the exponent itself is then flat
within a factor of 1.3 from 0.1 to 0.9."""
LOSS_FACTOR, _GAIN = 0.2, 1.0
"""Natural loss factor and gain, which have no scale in the recordings. By choice: rubber and soft tissue lose 0.1 to
0.4 (a fifth is in the middle); a gain's natural value is one."""

_POWERS: dict[str, tuple[int, int]] = {
    "d": (0, -1),
    "t": (0, -1),
    "f": (0, 1),
    "k": (1, 1),
    "m": (1, -1),
    "r": (1, 0),
    "p": (1, 0),
}
"""Powers of the impedance and of the angular frequency in each quantity's natural value (in the formulas' units)."""


@dataclass(frozen=True)
class NaturalScales:
    """Middle of the recordings.

    Attributes
    ----------
    log_magnitude : float
        Logarithm of the size of the impedance.
    log_frequency : float
        Logarithm of the frequency in Hz.
    """

    log_magnitude: float
    log_frequency: float

    @classmethod
    def of(cls, recordings: Recordings) -> NaturalScales:
        """Medians over persons of their means over frequencies."""
        magnitude = np.median([np.mean(np.log(np.abs(s.mean))) for s in recordings.subjects])
        frequency = np.median([np.mean(np.log(s.frequency_hz)) for s in recordings.subjects])
        return cls(float(magnitude), float(frequency))

    @property
    def frequency_hz(self) -> float:
        """Frequency in the middle of the recordings."""
        return float(np.exp(self.log_frequency))

    def centre(self, parameter: Parameter) -> tuple[float, float]:
        """Prior centre and standard deviation of a parameter's unbounded u; a signed one's are others."""
        return (0.0, LOGIT_SD) if parameter.link == LOGIT else (self.log_value(parameter), LOG_SD)

    def log_value(self, parameter: Parameter) -> float:
        """Logarithm of a parameter's natural value as it stands in the formulas."""
        letter = parameter.letter
        if letter in KINDS:
            return band_scale(parameter.name, float(np.exp(self.log_magnitude)), float(np.exp(self.log_frequency)))
        if letter in "eg":
            return float(np.log(LOSS_FACTOR if letter == "e" else _GAIN))
        of_magnitude, of_omega = _POWERS[letter]
        return of_magnitude * self.log_magnitude + of_omega * (self.log_frequency + float(np.log(2 * np.pi)))


def signed_scales(network: Network, scales: NaturalScales) -> dict[str, float]:
    """Natural value, in its unit, of each signed parameter."""
    return {
        p.name: float(np.exp(scales.log_value(p)) / p.quantity.factor) for p in network.parameters if p.link == SIGNED
    }


def with_references(network: Network, frequency_hz: float) -> Network:
    """The network with a reference frequency for every power law that has none.

    Far from the recordings' band a power law's size and its exponent go together; in its middle they are nearly
    independent.
    """
    rounded = float(f"{frequency_hz:.3g}")
    result = network
    for path, node in network.walk():
        if isinstance(node, PowerLaw) and node.reference_hz is None:
            result = result.replaced(Place(path, ""), replace(node, reference_hz=rounded))
    return result


def default_prior(kernel: Kernel, recordings: Recordings) -> Prior:
    """The scale-free prior of every parameter: derived above."""
    scales = NaturalScales.of(recordings)
    parameters = kernel.parameters
    centres = np.array([scales.log_value(p) if p.link == LOG else 0.0 for p in parameters])
    if all(p.link != LOGIT for p in parameters):
        return Prior(centre=centres)
    sds = np.array([LOGIT_SD if p.link == LOGIT else LOG_SD for p in parameters])
    return Prior(centre=centres, centre_sd=sds)
