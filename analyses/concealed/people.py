r"""Virtual fingertips written out by hand, so that they check the package and do not repeat it.

The paper's network ``skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))`` as one formula: with s = jw, impedances add in
parallel and mobilities add in series,

.. math::
    z_\text{skin} = \frac{1}{s n_3} + r_3, \quad
    \frac1{z_\text{limb}} = \frac1{s m_1} + \frac1{1/(s n_2) + r_2}, \quad
    z_\text{tissue} = s m_2 + r_1 + \frac1{s n_1} + z_\text{limb}, \quad
    \frac1z = \frac1{z_\text{skin}} + \frac1{z_\text{tissue}} .

A change can be applied at every place: a function of the impedance there that returns the changed impedance.

People are log-normal with a random, full correlation matrix. With three random factors, unit vectors l_e and a
communality h the correlation of two elements is h l_a . l_b, which is positive definite for 0 <= h < 1. Repetitions
scatter independently around their person. Noise is complex Gaussian and relative to |z|:

.. math:: \sigma(f) = \sigma_0\,s_i\left(1 + \frac{\rho - 1}{1 + (f/f_0)^6}\right)|z|
          \quad\text{for the real and for the imaginary part, } \ln s_i \sim N(0, \kappa^2) .

Only numpy is used: no network, element, kernel or simulation of the package.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

NETWORK = "skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))"
ELEMENTS = ("n3", "r3", "m2", "r1", "n1", "m1", "n2", "r2")

# The shipped population's (data/fingertip_71/truth.json), in m/N, N s/m and kg; sd of the natural logarithm.
CENTRAL = {
    "n3": 6.76e-7,
    "r3": 61.4,
    "m2": 7.90e-4,
    "r1": 1.52,
    "n1": 1.15e-3,
    "m1": 0.0517,
    "n2": 4.73e-3,
    "r2": 3.82,
}
BETWEEN_PERSONS = {"n3": 0.35, "r3": 0.30, "m2": 0.20, "r1": 0.40, "n1": 0.30, "m1": 0.35, "n2": 0.30, "r2": 0.30}

COVARIATES = {"contact_force_n": (1.0, 0.25), "temperature_c": (32.0, 0.06), "age_y": (38.0, 0.35)}
"""Median and sd of the natural logarithm. All are in every dataset; as a rule nothing follows them."""

Change = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Changed impedance at a place: (s (F,), z (..., F)) -> z (..., F)."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Complications of the recordings that are not missing physics.

    Attributes
    ----------
    noise : float
        Relative noise of each of real and imaginary part, at high frequencies.
    noise_rise : float
        Factor by which the noise is larger far below `rise_below_hz`.
    rise_below_hz : float
    noise_scale_sd : float
        Between persons, of the logarithm of their noise.
    gain_error : float
        Everything is recorded times 1 + gain_error.
    repositioning : (float, float)
        Each element's log sd between repetitions is drawn between these.
    communality : float
        h, from 0 (independent elements) to below 1; 0.5 gives correlations of about 0.3, 0.95 strong ones.
    centre_sd : float
        Log sd by which the population's centre differs from that of the shipped population.
    """

    noise: float = 0.01
    noise_rise: float = 3.0
    rise_below_hz: float = 12.0
    noise_scale_sd: float = 0.15
    gain_error: float = 0.0
    repositioning: tuple[float, float] = (0.05, 0.08)
    communality: float = 0.5
    centre_sd: float = 0.0

    def relative_noise(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Relative noise of an average person, shape (F,)."""
        rise = (self.noise_rise - 1) / (1 + (frequency_hz / self.rise_below_hz) ** 6)
        return np.asarray(self.noise * (1 + rise))


@dataclass(frozen=True)
class Population:
    """How elements are distributed; arrays in the order of :data:`ELEMENTS`.

    Attributes
    ----------
    log_centre, between_persons, between_repetitions : ndarray, shape (P,)
    correlation : ndarray, shape (P, P)
        Between persons.
    """

    log_centre: np.ndarray
    between_persons: np.ndarray
    between_repetitions: np.ndarray
    correlation: np.ndarray


@dataclass(frozen=True)
class People:
    """Some persons of a population.

    Attributes
    ----------
    deviation : ndarray, shape (N, P)
        Log elements of each person, less the population's centre.
    repositioning : ndarray, shape (N, J, P)
        Log elements of each recording, less the person's.
    coefficient : ndarray, shape (N, 4)
        Standard normal: how a person's own coefficients of an effect differ from the population's.
    order : ndarray of int, shape (N,)
        A random order: the first ones of it are the members of a subgroup.
    covariates : mapping of str to ndarray, shape (N,)
    """

    deviation: np.ndarray
    repositioning: np.ndarray
    coefficient: np.ndarray
    order: np.ndarray
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)


def draw_population(rng: np.random.Generator, conditions: Conditions) -> Population:
    """Draw a population: correlation, repositioning and, if requested, the centre."""
    p = len(ELEMENTS)
    loading = rng.normal(size=(p, 3))
    loading /= np.linalg.norm(loading, axis=1, keepdims=True)
    h = conditions.communality
    return Population(
        log_centre=np.log([CENTRAL[e] for e in ELEMENTS]) + conditions.centre_sd * rng.normal(size=p),
        between_persons=np.array([BETWEEN_PERSONS[e] for e in ELEMENTS]),
        between_repetitions=rng.uniform(*conditions.repositioning, size=p),
        correlation=h * loading @ loading.T + (1 - h) * np.eye(p),
    )


def draw_people(population: Population, rng: np.random.Generator, n_subjects: int, n_repetitions: int) -> People:
    """Draw persons and put their fingers down."""
    p = len(ELEMENTS)
    factor = np.linalg.cholesky(population.correlation)
    return People(
        deviation=population.between_persons * (rng.normal(size=(n_subjects, p)) @ factor.T),
        repositioning=population.between_repetitions * rng.normal(size=(n_subjects, n_repetitions, p)),
        coefficient=rng.normal(size=(n_subjects, 4)),
        order=rng.permutation(n_subjects),
        covariates={
            name: median * np.exp(sd * rng.normal(size=n_subjects)) for name, (median, sd) in COVARIATES.items()
        },
    )


def impedance(
    log_elements: np.ndarray, frequency_hz: np.ndarray, changes: Mapping[str, Change] | None = None
) -> np.ndarray:
    """Impedance of the fingertip, by the formula of the module's docstring.

    Parameters
    ----------
    log_elements : ndarray, shape (..., P)
        Natural logarithms in the order of :data:`ELEMENTS`.
    frequency_hz : ndarray, shape (F,)
    changes : mapping of str to Change, optional
        Name of a place (``port``, ``skin``, ``tissue``, ``limb``, ``n2|r2`` or an element) to what happens there.

    Returns
    -------
    ndarray, complex, shape (..., F)
        z in N s/m.
    """
    changes = changes or {}
    unknown = set(changes) - {"port", "skin", "tissue", "limb", "n2|r2", *ELEMENTS}
    if unknown:
        raise ValueError(f"no place is called {sorted(unknown)[0]!r} in {NETWORK}")
    s = 2j * np.pi * frequency_hz
    x = {name: np.exp(log_elements[..., i, None]) for i, name in enumerate(ELEMENTS)}

    def at(place: str, z: np.ndarray) -> np.ndarray:
        return changes[place](s, z) if place in changes else z

    skin = at("skin", at("n3", 1 / (s * x["n3"])) + at("r3", x["r3"] + 0 * s))
    holder = at("n2|r2", at("n2", 1 / (s * x["n2"])) + at("r2", x["r2"] + 0 * s))
    limb = at("limb", 1 / (1 / at("m1", s * x["m1"]) + 1 / holder))
    tissue = at("tissue", at("m2", s * x["m2"]) + at("r1", x["r1"] + 0 * s) + at("n1", 1 / (s * x["n1"])) + limb)
    return at("port", 1 / (1 / skin + 1 / tissue))


def record(
    z: np.ndarray, frequency_hz: np.ndarray, conditions: Conditions, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Add noise and gain error to clean curves (N, J, F).

    Returns
    -------
    recorded : ndarray, complex, shape (N, J, F)
    sd : ndarray, shape (N, J, F)
        Of real and imaginary part each, before the gain error.
    """
    scale = np.exp(conditions.noise_scale_sd * rng.normal(size=z.shape[0]))
    sd = scale[:, None, None] * conditions.relative_noise(frequency_hz) * np.abs(z)
    parts = rng.normal(size=(2, *z.shape))
    return (1 + conditions.gain_error) * (z + sd * (parts[0] + 1j * parts[1])), sd
