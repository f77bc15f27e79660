"""Requirements on recordings and network, checked before any computation starts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import Network, parse
from bayes_impedance.network.redundancy import Combination, merged
from bayes_impedance.population.covariates import standardised_covariates
from bayes_impedance.population.natural_scales import NaturalScales, signed_scales, with_references
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.units import LARGEST_IMPEDANCE, SMALLEST_IMPEDANCE

MOST_ELEMENTS = 24
"""Most elements of a network that can be estimated. Measured with 40 people, few draws and two processors: 53 s for 14
elements, 255 s for 24, and for 60 not finished within 300 s. The paper's network has 8."""

FURTHEST_PERSON = 1e6
"""Largest ratio between the average magnitudes of one person and of the median person. People differ by factors of ten;
a factor of a million is two missing unit prefixes of a thousand. Measured: with a person at 1e-20 of the others the
chains contain not-a-number."""


@dataclass(frozen=True)
class CheckedModel:
    """The checked model that is fitted.

    Attributes
    ----------
    kernel : Kernel
        Of the network in which adjacent elements of one kind are replaced by one equivalent element.
    written : Network
        The network as given.
    combinations : tuple of Combination
        The elements that were replaced.
    covariates : ndarray, shape (N, Q)
        Standardised.
    """

    kernel: Kernel
    written: Network
    combinations: tuple[Combination, ...]
    covariates: np.ndarray


def checked_model(
    recordings: Recordings, network: Network | str | None, covariates: tuple[str, ...] = ()
) -> CheckedModel:
    """Check the model and prepare it for a fit.

    Raises
    ------
    InputError
        If network, covariates and recordings are not consistent.
    """
    written = network_of(recordings, network)
    fitted, combinations = merged(written)
    kernel = Kernel(fitted)
    standardised = standardised_covariates(recordings, covariates)
    require_usable(recordings, kernel)
    if len(recordings.subjects) > 1 and all(p.shared for p in kernel.parameters):
        raise InputError(
            f"every parameter of {fitted} is the same for all (*), so no subject differs from another: leave the * "
            "off at least one"
        )
    if not fitted.plain:
        scales = NaturalScales.of(recordings)
        fitted = with_references(fitted, scales.frequency_hz)
        kernel = Kernel(fitted, scales=signed_scales(fitted, scales))
    return CheckedModel(kernel, written, combinations, standardised)


def require_people_for_groups(n_persons: int, n_elements: int) -> None:
    """Refuse a population of two groups of so few people that no full covariance can be estimated.

    Raises
    ------
    InputError
    """
    if too_few_for_correlations(n_persons, n_elements):
        raise InputError(
            f"{n_persons} subjects are too few for two groups that differ in {n_elements} elements, which take "
            f"{n_elements + 2}: take another distribution, or a network with fewer elements"
        )


def too_few_for_correlations(n_persons: int, n_elements: int) -> bool:
    """Whether even a sample covariance of the elements would be singular.

    The posterior of a full covariance matrix then concentrates at singular matrices; only the prior limits it.
    """
    return n_persons < n_elements + 2


def network_of(recordings: Recordings, network: Network | str | None) -> Network:
    """The requested network, or the dataset's own.

    Raises
    ------
    InputError
        If there is none, it cannot be read, or it has more elements than can be estimated.
    """
    given = network if network is not None else recordings.network
    if given is None:
        raise InputError('no network: name one with --network, or write network = "..." into dataset.toml')
    try:
        tree = parse(given) if isinstance(given, str) else given
    except InputError as error:
        raise InputError(f"dataset.toml of {recordings.title}: {error}" if network is None else str(error)) from None
    if len(tree.elements) > MOST_ELEMENTS:
        raise InputError(
            f"the network has {len(tree.elements)} elements, but no recordings determine more than "
            f"{MOST_ELEMENTS}: use a smaller network"
        )
    return tree


def require_usable(recordings: Recordings, kernel: Kernel) -> None:
    """Refuse empty recordings, persons with fewer data than elements, and impedances of implausible size.

    Raises
    ------
    InputError
        Names the person and the place.
    """
    if not recordings.subjects:
        raise InputError("there are no recordings: give at least one subject")
    for subject in recordings.subjects:
        if 2 * subject.frequency_hz.size <= len(kernel.elements):
            raise InputError(
                f"subject {subject.name} has {subject.frequency_hz.size} frequencies, too few for "
                f"{len(kernel.elements)} elements: record more or use a smaller network"
            )
        size = np.hypot(subject.z.real, subject.z.imag)
        wrong = ~((size >= SMALLEST_IMPEDANCE) & (size <= LARGEST_IMPEDANCE))
        if wrong.any():
            j, i = (int(k) for k in np.argwhere(wrong)[0])
            raise InputError(
                f"subject {subject.name}, repetition {subject.repetitions[j]}: z is {subject.z[j, i]:g} at "
                f"{subject.frequency_hz[i]:g} Hz, which is not a possible impedance: leave the point out"
            )
    average = np.array([np.mean(np.log(np.hypot(s.z.real, s.z.imag))) for s in recordings.subjects])
    away = average - np.median(average)
    worst = int(np.argmax(np.abs(away)))
    if abs(away[worst]) > np.log(FURTHEST_PERSON):
        raise InputError(
            f"subject {recordings.subjects[worst].name}: |z| is {np.exp(away[worst]):.3g} times that of the median "
            "subject, far more than subjects differ: check its unit, or leave the subject out"
        )
