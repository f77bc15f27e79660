r"""Virtual persons: simulated recordings with known true parameters.

A :class:`VirtualPopulation` is the distribution of the elements; :func:`simulate_recordings` draws persons from it and
simulates recordings as in the paper: several repetitions with the finger repositioned, contact force held within a
tolerance band, and noise that grows towards low frequencies, where the force of the shaker is small.

.. math::
    \ln x_{ij} = \mu + \tau\,C^{1/2}\,\xi_i + \rho\,\eta_{ij} + b \ln F_{ij}, \qquad
    z_{ijk} = Z_k(x_{ij}) + |Z_k|\,s_i\,\sigma_0\sqrt{1 + (f_c/f_k)^4}\;\epsilon_{ijk}

with standard normal eta, epsilon (real and imaginary part each) and xi, or xi of a multivariate t distribution
(:mod:`bayes_impedance.population.heavy_tails`) or of two groups (:mod:`bayes_impedance.population.two_components`),
log-normal s and F in newtons within the tolerance band around 1 N. The exponent b = 0.35 for stiffness and damping of
soft tissue is a published finding for fingertips under shear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from bayes_impedance.display import Brief
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.network.parameters import SIGNED
from bayes_impedance.population.heavy_tails import HEAVIEST, STUDENT_T, drawn_factors
from bayes_impedance.population.two_components import LEAST_SHARE, MIXTURE, Groups, drawn_people, groups_of
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime.user_table import hint, number_in, shown, text_in
from bayes_impedance.units import HIGHEST_HZ, LARGEST_ELEMENT, LARGEST_IMPEDANCE, LOWEST_HZ, SMALLEST_IMPEDANCE

if TYPE_CHECKING:
    import pandas as pd

_PERSON_FORCE = 0.07
"""Half width of the uniform relative contact-force error of a person. The division of the 10 % is by choice."""
_REPETITION_FORCE = 0.03
"""Half width of that of one repetition. With `_PERSON_FORCE` it adds up to the paper's 10 %."""

_SCALE_SPREAD = 0.15
"""Standard deviation of the logarithm of each person's noise scale. By choice: an assumption, not a measured value."""

MOST_NUMBERS = 20_000_000
"""Most impedances of one simulation. By choice: 200 times the paper's recordings; each takes some hundred bytes of
memory, with its noise and its text."""

LARGEST_DISPERSION = 10.0
"""Largest standard deviation of a log element. By choice: at ten, two people typically differ by a factor of a
million."""

_UNIT = "N s/m"


@dataclass(frozen=True, kw_only=True, repr=False)
class VirtualPopulation(Brief):
    """A population with known parameters.

    Attributes
    ----------
    network : str
        Notation.
    central : mapping of str to float
        Population median of each parameter in its unit, at a contact force of 1 N.
    between_persons, between_repetitions : mapping of str to float
        Standard deviations of the natural logarithms (of an exponent: of its logit), without the effect of the contact
        force. What is the same for everybody has none.
    correlation : mapping of (str, str) to float
        Between persons; pairs that are not named are zero.
    force_exponent : mapping of str to float
        d ln(element) / d ln(contact force).
    noise : float
        Relative noise of the real and of the imaginary part far above `noise_corner_hz`.
    noise_corner_hz : float
        Below this frequency the noise rises as 1/f^2.
    degrees_of_freedom : float
        Of the Student t distribution of people, whose scales are `between_persons`; more than two. Infinite for the
        normal distribution.
    second_group_share : float
        Share of people in the second of two groups, zero if there is one. Then `central` are geometric means of all
        people, `between_persons` and `correlation` those of all.
    group_difference : mapping of str to float
        Logarithm of the ratio of the groups' central values, second to first.
    """

    network: str
    central: Mapping[str, float]
    between_persons: Mapping[str, float]
    between_repetitions: Mapping[str, float] = field(default_factory=dict)
    correlation: Mapping[tuple[str, str], float] = field(default_factory=dict)
    force_exponent: Mapping[str, float] = field(default_factory=dict)
    noise: float = 0.01
    noise_corner_hz: float = 8.0
    degrees_of_freedom: float = np.inf
    second_group_share: float = 0.0
    group_difference: Mapping[str, float] = field(default_factory=dict)

    def vector(self, values: Mapping[str, float]) -> np.ndarray:
        """Values in the order of the network's elements, zero for an element that is not named, shape (P,)."""
        return np.array([values.get(e, 0.0) for e in parse(self.network).elements])

    def correlation_matrix(self) -> np.ndarray:
        """Correlations between persons, shape (P, P).

        Raises
        ------
        InputError
            If the named correlations contradict each other.
        """
        elements = parse(self.network).elements
        matrix = np.eye(len(elements))
        for (a, b), value in self.correlation.items():
            i, j = elements.index(a), elements.index(b)
            matrix[i, j] = matrix[j, i] = value
        if np.linalg.eigvalsh(matrix)[0] <= 0:
            raise InputError(
                "the correlations are inconsistent (their matrix is not positive definite): make them smaller"
            )
        return matrix


@dataclass(frozen=True, repr=False)
class Simulation(Brief):
    """Virtual recordings and the true parameters.

    Attributes
    ----------
    recordings : Recordings
    log_elements : ndarray, shape (N, P)
        Each person's true parameters on the scale on which they are estimated, logarithms of elements
        (:mod:`bayes_impedance.network.parameters`), without the deviations of the repetitions.
    truth : dict
        Central values, dispersions (contact force included) and correlations, ready for JSON.
    """

    recordings: Recordings
    log_elements: np.ndarray
    truth: dict[str, Any]

    def to_dataframe(self) -> pd.DataFrame:
        """Everybody's true parameters.

        Returns
        -------
        DataFrame
            One row for each subject, whose name is the index; a column for each parameter, in its unit.
        """
        import pandas as pd

        network = parse(self.recordings.network or "")
        parameters = {p.name: p for p in network.parameters}
        own = {name: parameters[name].value(self.log_elements[:, k]) for k, name in enumerate(network.elements)}
        return pd.DataFrame(own, index=pd.Index(self.recordings.names, name="subject"))


def simulate_recordings(
    population: VirtualPopulation,
    n_subjects: int,
    n_repetitions: int,
    frequency_hz: np.ndarray,
    seed: int,
    title: str = "simulated recordings",
) -> Simulation:
    """Draw persons from a population and simulate their recordings.

    Parameters
    ----------
    population : VirtualPopulation
    n_subjects, n_repetitions : int
        At least one of each.
    frequency_hz : ndarray, shape (F,)
        Ascending.
    seed : int
        The same seed gives the same recordings.
    title : str

    Raises
    ------
    InputError
        If a central value is missing or impossible, something that is the same for everybody has a dispersion, or the
        number of subjects or repetitions is zero.
    """
    require_usable_population(population)
    if n_subjects < 1 or n_repetitions < 1:
        raise InputError("at least one subject and one repetition are needed")
    if n_subjects * n_repetitions * frequency_hz.size > MOST_NUMBERS:
        raise InputError(
            f"{n_subjects} subjects with {n_repetitions} repetitions at {frequency_hz.size} frequencies are more than "
            f"{MOST_NUMBERS} numbers; simulate fewer"
        )
    ascending = frequency_hz.size and np.all(np.diff(frequency_hz) > 0)
    if not ascending or not LOWEST_HZ <= frequency_hz[0] <= frequency_hz[-1] <= HIGHEST_HZ:
        raise InputError(f"the frequencies must ascend between {LOWEST_HZ:g} and {HIGHEST_HZ:g} Hz; give another band")
    kernel = Kernel(parse(population.network))
    central = np.array([float(p.u(population.central[p.name])) for p in kernel.parameters])
    rng = np.random.default_rng(seed)
    tau, rho = population.vector(population.between_persons), population.vector(population.between_repetitions)
    exponent = population.vector(population.force_exponent)
    factor = np.linalg.cholesky(population.correlation_matrix())
    p, f = len(kernel.elements), frequency_hz.size

    own = np.random.default_rng(np.random.SeedSequence(seed).spawn(1)[0])  # what follows is as of a normal population
    standard = rng.normal(size=(n_subjects, p))
    if population.second_group_share:
        standard = drawn_people(_groups(population, tau[:, None] * factor), standard[None], own)[0]
    standard = standard @ factor.T
    if np.isfinite(population.degrees_of_freedom):
        standard *= drawn_factors(np.array(1 / population.degrees_of_freedom), (n_subjects,), own)[:, None]
    person = central + tau * standard
    person_force = rng.uniform(-_PERSON_FORCE, _PERSON_FORCE, n_subjects)
    repetition_force = rng.uniform(-_REPETITION_FORCE, _REPETITION_FORCE, (n_subjects, n_repetitions))
    force = 1 + person_force[:, None] + repetition_force
    deviation = rho * rng.normal(size=(n_subjects, n_repetitions, p))
    theta = person[:, None] + deviation + exponent * np.log(force)[..., None]
    with np.errstate(all="ignore"):  # values that are not finite are refused below
        z = kernel.impedance(theta, frequency_hz)
    scale = np.exp(_SCALE_SPREAD * rng.normal(size=n_subjects))
    noise = population.noise * np.sqrt(1 + (population.noise_corner_hz / frequency_hz) ** 4)
    parts = rng.normal(size=(2, n_subjects, n_repetitions, f))
    with np.errstate(all="ignore"):
        z = z + np.abs(z) * scale[:, None, None] * noise * (parts[0] + 1j * parts[1])
        size = np.abs(z)
    if not np.all((size >= SMALLEST_IMPEDANCE) & (size <= LARGEST_IMPEDANCE)):
        raise InputError(
            f"the simulated impedances are not all between {SMALLEST_IMPEDANCE:g} and {LARGEST_IMPEDANCE:g} "
            f"{_UNIT}: take smaller dispersions, less noise or a narrower band"
        )

    width = len(str(n_subjects))
    subjects = tuple(
        Subject(
            name=f"V{i + 1:0{width}d}",
            frequency_hz=frequency_hz,
            z=z[i],
            repetitions=tuple(str(j + 1) for j in range(n_repetitions)),
            noise_sd=None,
            covariates={"contact_force_n": float(force[i].mean())},
        )
        for i in range(n_subjects)
    )
    recordings = Recordings(
        title=title,
        unit=_UNIT,
        network=population.network,
        source=f"simulated by bayes_impedance, seed {seed}: virtual subjects, not measured",
        licence="MIT",
        subjects=subjects,
        sha256="",
        warnings=(),
    )
    return Simulation(recordings, person + exponent * np.log1p(person_force)[:, None], _truth(population, seed))


def require_usable_population(population: VirtualPopulation) -> None:
    """Refuse a population from which no persons can be drawn; the message names the element."""
    network = parse(text_in(population.network, "a population's network"))
    elements, parameters = network.elements, {p.name: p for p in network.parameters}
    for what, values, bounds in (
        ("central value", population.central, {}),
        ("dispersion between subjects", population.between_persons, _DISPERSION),
        ("dispersion between repetitions", population.between_repetitions, _DISPERSION),
        ("force exponent", population.force_exponent, _EITHER_SIGN),
        ("difference of groups", population.group_difference, _EITHER_SIGN),
    ):
        for name, value in values.items():
            if name not in elements:
                raise InputError(
                    f"{what} of {shown(name)}: the network {population.network} has no such element; "
                    f"{hint(str(name), elements)}"
                )
            least = -LARGEST_ELEMENT if parameters[name].link == SIGNED else 1 / LARGEST_ELEMENT
            own = bounds or {"at_least": least, "at_most": LARGEST_ELEMENT}
            number_in(value, f"{what} of '{name}'", **own)
            if not bounds:
                parameters[name].u(value)
            elif parameters[name].shared and value != 0:
                raise InputError(
                    f"{what} of '{name}' is {value:g}, but it is the same for all (*): leave it out, or remove * "
                    "from the network"
                )
    missing = [name for name in elements if name not in population.central]
    if missing:
        raise InputError(f"element '{missing[0]}' has no central value: give one for each of {elements}")
    for pair, value in population.correlation.items():
        if len(set(pair)) != 2 or not set(pair) <= set(elements):
            raise InputError(f"a correlation is between {' and '.join(map(shown, pair))}: name two different elements")
        number_in(value, f"correlation of {pair[0]} and {pair[1]}", at_least=-1, at_most=1)
    number_in(population.noise, "relative noise", at_least=0)
    number_in(population.noise_corner_hz, "noise_corner_hz", at_least=0, at_most=HIGHEST_HZ)
    if population.degrees_of_freedom != np.inf:
        number_in(population.degrees_of_freedom, "degrees_of_freedom", above=_LEAST_FREEDOM)
    number_in(population.second_group_share, "second_group_share", at_least=0, at_most=1 - LEAST_SHARE)
    if population.second_group_share and population.degrees_of_freedom != np.inf:
        raise InputError("a population has degrees of freedom or two groups, not both: leave one out")
    if population.second_group_share:
        tau = population.vector(population.between_persons)
        alike = [e for e, sd in zip(elements, tau, strict=True) if sd == 0 and population.group_difference.get(e)]
        if alike:
            raise InputError(
                f"groups differ in '{alike[0]}', which does not differ between subjects: give both or none"
            )
        _groups(population, tau[:, None] * np.linalg.cholesky(population.correlation_matrix()))


_LEAST_FREEDOM = 1 / HEAVIEST
"""Of a Student t distribution, whose variance is infinite there."""
_EITHER_SIGN = {"at_least": -LARGEST_DISPERSION, "at_most": LARGEST_DISPERSION}
_DISPERSION = {"at_least": 0.0, "at_most": LARGEST_DISPERSION}
"""Limits of every dispersion: a standard deviation is not negative; for the upper limit see `LARGEST_DISPERSION`."""


def _truth(population: VirtualPopulation, seed: int) -> dict[str, Any]:
    """True parameters that a fit without covariates should find: dispersions include the effect of contact force."""
    elements = parse(population.network).elements
    tau, rho = population.vector(population.between_persons), population.vector(population.between_repetitions)
    exponent = population.vector(population.force_exponent)
    shift_person, shift_repetition = _PERSON_FORCE / np.sqrt(3), _REPETITION_FORCE / np.sqrt(3)
    covariance = np.outer(tau, tau) * population.correlation_matrix() + np.outer(exponent, exponent) * shift_person**2
    total = np.sqrt(np.diag(covariance))
    alike = np.where(total > 0, total, 1.0)  # elements without dispersion have no correlation
    correlation = covariance / np.outer(alike, alike)
    return {
        "seed": seed,
        "network": population.network,
        "elements": {
            e: {
                "central": population.central[e],
                "dispersion_between_persons": float(total[i]),
                "dispersion_between_repetitions": float(np.hypot(rho[i], exponent[i] * shift_repetition)),
                "contact_force_exponent": float(exponent[i]),
            }
            for i, e in enumerate(elements)
        },
        "correlation": [[a, elements[j], float(correlation[i, j])] for i, a in enumerate(elements) for j in range(i)],
        "noise": {"relative_sd": population.noise, "corner_hz": population.noise_corner_hz},
        **_distribution(population),
    }


def _distribution(population: VirtualPopulation) -> dict[str, Any]:
    said: dict[str, Any] = {}
    if np.isfinite(population.degrees_of_freedom):
        said = {"name": STUDENT_T, "degrees_of_freedom": population.degrees_of_freedom}
    if population.second_group_share:
        said = {"name": MIXTURE, "second_group_share": population.second_group_share}
        said["difference"] = dict(population.group_difference)
    return {"distribution": said} if said else {}


def _groups(population: VirtualPopulation, factor: np.ndarray) -> Groups:
    """The two groups of a population whose covariance has a factor (P, P)."""
    difference = population.vector(population.group_difference)[None]
    try:
        return groups_of(difference, np.array([population.second_group_share]), factor[None])
    except ValueError as error:
        raise InputError(f"{error}: give larger dispersions, which are those of both groups together") from None
