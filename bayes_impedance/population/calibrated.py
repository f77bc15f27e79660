"""What a calibration leaves uncertain, in a fit: a rig around the network, the same for everybody, with its prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.network.redundancy import inseparable
from bayes_impedance.population.natural_scales import default_prior
from bayes_impedance.population.prior import Prior
from bayes_impedance.population.requirements import network_of
from bayes_impedance.recordings.files import Recordings


def within_rig(recordings: Recordings, network: Network | str | None) -> Network | str | None:
    """The network within the rig that the recordings' calibration describes.

    It is as it is given if there is no calibration, or if it has the parameters of its rig already, as the network of
    an earlier fit.

    Raises
    ------
    InputError
        If the rig cannot be read, or the network has other parameters of the same name.
    """
    error = recordings.calibration
    if error is None:
        return network
    inside = network_of(recordings, network)
    rig = parse(error.around("m1"))
    wrong = set(error.parameters) - {p.name for p in rig.parameters if p.shared}
    if wrong:
        raise InputError(
            f"[calibration]: {sorted(wrong)[0]} is no parameter of the rig that is the same for all (*); import "
            "the recordings again"
        )
    if set(error.parameters) <= {p.name for p in inside.parameters if p.shared}:
        return inside
    taken = set(error.parameters) & set(inside.elements)
    if taken:
        raise InputError(
            f"the network has a parameter {sorted(taken)[0]}, but so has the rig of the recordings' calibration "
            "([calibration] in dataset.toml), which is added by itself: rename or remove it"
        )
    return parse(error.around(str(inside)))


def prior_of(kernel: Kernel, recordings: Recordings) -> Prior:
    """The default prior of every parameter, and what a calibration says of those of the rig.

    Parameters
    ----------
    kernel : Kernel
        Of the network within the rig.
    recordings : Recordings
    """
    prior, error = default_prior(kernel, recordings), recordings.calibration
    if error is None:
        return prior
    rows = [kernel.elements.index(name) for name in error.parameters]
    centre, sd = prior.centre.copy(), prior.centre_sds.copy()
    correlation, informed = np.eye(centre.size), np.zeros(centre.size, dtype=bool)
    for row, mean, spread in zip(rows, error.mean.tolist(), error.sd.tolist(), strict=True):
        parameter = kernel.parameters[row]
        scale = kernel.scales.get(parameter.name, 1.0) if parameter.link == SIGNED else 1.0
        centre[row], sd[row] = float(parameter.u(mean)) / scale, spread / scale
    correlation[np.ix_(rows, rows)] = error.correlation
    informed[rows] = True
    return replace(prior, centre=centre, centre_sd=sd, correlation=correlation, informed=informed)


def inseparable_given(kernel: Kernel, prior: Prior) -> tuple[str, ...]:
    """Parameters that no recordings determine, even with what is known from others.

    What is known takes no part: a gain that is known to a per cent leaves the sizes of elements to be told, although
    none of them can be told from a gain of which nothing is known.
    """
    informed = zip(kernel.parameters, prior.known, strict=True)
    known = {p.name: float(p.value(np.array(0.5))) for p, of in informed if of}
    return inseparable(kernel.network.holding(known))


def known_of(recordings: Recordings) -> tuple[str, ...]:
    """What a fit takes from the calibration, for comparison with another fit; nothing if there is none."""
    lumped, each = recordings.calibration, recordings.calibration_map
    return (
        *(() if lumped is None else (lumped.toml(),)),
        *(() if each is None else (each.csv().decode(),)),
    )
