r"""A virtual experiment before noise, with an effect of a known strength in it.

The **strength** of an effect on the curve is the largest change of the population's mean curve, in units of the spread
between persons at that frequency,

.. math:: S = \max_f \frac{\left|\overline{z'}(f) - \overline z(f)\right|}
                          {\sqrt{\overline{|z(f) - \overline z(f)|^2}}},

with means over 400 persons of the same population, without noise and without repositioning, on the recordings' own
frequencies; z' is with the effect, z without. The size of the effect that has the strength is found by bisection. With
S = 0.3 a curve moves by about a tenth of its magnitude at the worst frequency: ten times the noise of one recording
there, and a third of the standard deviation between persons.

Some effects do not change the mean curve, or change the curves of some people only. Their strength is:

- ``rig.mains`` has a random phase. S is its amplitude over the spread between persons, at the harmonic where that is
  largest.
- ``body.subgroup``: S as above, of the people who have the layer (as if all 400 had it).
- ``body.covariate``: S is the part of the standard deviation between persons of the log element that the covariate
  explains, on average over the elements that follow it; their total dispersion is unchanged.
- ``body.drift``: S is the change of the log element from the first to the last repetition over its standard deviation
  between persons.
- ``none`` and ``body.correlation`` conceal nothing; their strength is ignored.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from forms import EFFECTS, FRACTION, HARMONICS_HZ, NOTHING, Effect, Values
from people import (
    BETWEEN_PERSONS,
    COVARIATES,
    ELEMENTS,
    Change,
    Conditions,
    People,
    Population,
    draw_people,
    draw_population,
    impedance,
)

CALIBRATION_PEOPLE = 400
"""Persons over whom a strength is averaged: a standard deviation is known to 1/sqrt(2 * 400) = 3.5 %."""

COVARIATE = "contact_force_n"
STRONG_COMMUNALITY = 0.95
"""Just below 1, where the correlation matrix would be singular."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A virtual experiment before noise.

    Attributes
    ----------
    id, place : str
    strength : float
    seed : int
    conditions : Conditions
    frequency_hz : ndarray, shape (F,)
    population : Population
    people : People
    values : dict of str to float
        The effect's parameters for an average person, by the names that ``forms.py`` uses.
    members : ndarray of bool, shape (N,)
        Persons who have the effect.
    log_elements : ndarray, shape (N, J, P)
        Elements of each recording, including the change by a drift or a covariate.
    without, concealed : ndarray, complex, shape (N, J, F)
        Curves of the network without and with the effect.
    """

    id: str
    place: str
    strength: float
    seed: int
    conditions: Conditions
    frequency_hz: np.ndarray
    population: Population
    people: People
    values: Values
    members: np.ndarray
    log_elements: np.ndarray
    without: np.ndarray
    concealed: np.ndarray


def prepare(
    effect_id: str,
    place: str | None,
    strength: float,
    seed: int,
    n_subjects: int = 40,
    n_repetitions: int = 3,
    n_points: int = 201,
    band: tuple[float, float] = (5.0, 5000.0),
    conditions: Conditions | None = None,
) -> Case:
    """Make the case of ``effects.concealed`` before noise is added; the arguments are the same."""
    if effect_id not in EFFECTS:
        raise ValueError(f"no effect is called {effect_id!r}: there are {', '.join(EFFECTS)}")
    if effect_id not in NOTHING and not strength > 0:
        raise ValueError(f"strength must be above zero, not {strength}; the effect 'none' conceals nothing")
    effect = EFFECTS[effect_id]
    place = effect.places[seed % len(effect.places)] if place is None else place
    conditions = conditions or Conditions()
    if effect_id == "body.correlation":
        conditions = replace(conditions, communality=max(conditions.communality, STRONG_COMMUNALITY))
    frequency_hz = np.geomspace(*band, n_points)
    population = draw_population(stream(seed, "population"), conditions)
    people = draw_people(population, stream(seed, "people"), n_subjects, n_repetitions)
    members = np.ones(n_subjects, dtype=bool)
    if effect_id == "body.subgroup":
        members = np.isin(np.arange(n_subjects), people.order[: max(1, round(FRACTION * n_subjects))])
    values = _solve(effect_id, place, strength, seed, population, frequency_hz, n_repetitions)
    if effect_id == "body.subgroup":
        values["fraction"] = float(members.mean())

    before, after = _log_elements(effect_id, place, values, population, people)
    without = impedance(before, frequency_hz)
    if effect_id == "rig.mains":
        angle = stream(seed, "effect").uniform(0, 2 * np.pi, size=without.shape)
        changed = without + values["amplitude"] * np.exp(1j * angle) * hums(frequency_hz)
    else:
        changed = impedance(after, frequency_hz, _changes(effect, place, values, people, members))
    return Case(
        id=effect_id,
        place=place,
        strength=strength,
        seed=seed,
        conditions=conditions,
        frequency_hz=frequency_hz,
        population=population,
        people=people,
        values=values,
        members=members,
        log_elements=after,
        without=without,
        concealed=changed,
    )


def calibration_curves(case: Case, values: Mapping[str, float] | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Curves (400, F) of the calibration people, who define the strength, without and with the effect."""
    people = _calibration_people(case.population, case.seed)
    everybody = np.ones(CALIBRATION_PEOPLE, dtype=bool)
    changes = _changes(EFFECTS[case.id], case.place, values or case.values, people, everybody)
    log_elements = (case.population.log_centre + people.deviation)[:, None]
    return (
        impedance(log_elements, case.frequency_hz)[:, 0],
        impedance(log_elements, case.frequency_hz, changes)[:, 0],
    )


def spread(z: np.ndarray) -> np.ndarray:
    """Standard deviation between persons of curves (N, F), complex: shape (F,)."""
    return np.asarray(np.sqrt(np.mean(np.abs(z - z.mean(axis=0)) ** 2, axis=0)))


def followers(place: str) -> dict[str, int]:
    """Elements at a place that may follow a covariate, with sign: force stiffens and damps, so compliance falls."""
    names = {"skin": ("n3", "r3")}.get(place, (place,))
    if not set(names) <= set(ELEMENTS):
        raise ValueError(f"body.covariate needs the skin or an element, not {place!r}")
    return {name: -1 if name[0] == "n" else 1 for name in names}


def stream(seed: int, what: str) -> np.random.Generator:
    """Independent generators, so that concealing something does not change the people or the noise."""
    names = ("population", "people", "noise", "effect", "calibration", "shape")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(names.index(what),)))


def _calibration_people(population: Population, seed: int) -> People:
    return draw_people(population, stream(seed, "calibration"), CALIBRATION_PEOPLE, 1)


def hums(frequency_hz: np.ndarray) -> np.ndarray:
    """Whether a frequency lies within 1 % of a harmonic, shape (F,)."""
    return np.asarray(np.any(np.abs(frequency_hz[:, None] / HARMONICS_HZ - 1) <= 0.01, axis=1))


def _log_elements(
    effect_id: str, place: str, values: Mapping[str, float], population: Population, people: People
) -> tuple[np.ndarray, np.ndarray]:
    """Log elements (N, J, P) without and with the change by a drift or covariate; equal for other effects."""
    person, added = people.deviation, np.zeros_like(people.repositioning)
    if effect_id == "body.covariate":
        median, sd = COVARIATES[COVARIATE]
        x = np.log(people.covariates[COVARIATE] / median)
        rest = np.ones(len(ELEMENTS))
        for name, sign in followers(place).items():
            i = ELEMENTS.index(name)
            added[:, :, i] = sign * values["slope"] * x[:, None]
            # The unexplained part is reduced, so that the total dispersion is unchanged.
            rest[i] = np.sqrt(1 - (values["slope"] * sd / population.between_persons[i]) ** 2)
        person = person * rest
    elif effect_id == "body.drift":
        added[:, :, ELEMENTS.index(place)] = values["trend"] * np.arange(added.shape[1])
    before = population.log_centre + person[:, None] + people.repositioning
    return before, before + added


def _changes(
    effect: Effect, place: str, values: Mapping[str, float], people: People, members: np.ndarray
) -> dict[str, Change]:
    """The change of the impedance at a place: the effect's formula with each person's own parameters."""
    form = effect.form
    if form is None:
        return {}
    own = {
        name: value * np.exp(effect.spread.get(name, 0.0) * people.coefficient[:, k, None, None])
        for k, (name, value) in enumerate(values.items())
    }

    def change(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.where(members[:, None, None], form(s, z, own), z)

    return {place: change}


def _solve(
    effect_id: str,
    place: str,
    strength: float,
    seed: int,
    population: Population,
    frequency_hz: np.ndarray,
    n_repetitions: int,
) -> Values:
    """Parameters at which the effect has its strength."""
    effect = EFFECTS[effect_id]
    if effect_id in NOTHING:
        return {}
    if effect_id == "body.covariate":
        tau = float(np.mean([BETWEEN_PERSONS[name] for name in followers(place)]))
        if strength >= 0.85:
            raise ValueError(f"a covariate cannot explain {strength} of the sd of two elements; stay below 0.85")
        return {"slope": strength * tau / COVARIATES[COVARIATE][1]}
    if effect_id == "body.drift":
        if n_repetitions < 2:
            raise ValueError("body.drift needs at least two repetitions")
        return {"trend": strength * BETWEEN_PERSONS[place] / (n_repetitions - 1)}

    people = _calibration_people(population, seed)
    log_elements = (population.log_centre + people.deviation)[:, None]
    base = impedance(log_elements, frequency_hz)
    between = spread(base[:, 0])
    if effect_id == "rig.mains":
        hum = hums(frequency_hz)
        if not hum.any():
            raise ValueError("no frequency is within 1 % of a harmonic of the mains: take more points")
        return {"amplitude": strength * float(between[hum].min())}

    start = effect.start(stream(seed, "shape"), place)
    everybody = np.ones(CALIBRATION_PEOPLE, dtype=bool)

    def reached(size: float) -> float:
        changes = _changes(effect, place, effect.values(start, size), people, everybody)
        change = np.mean(impedance(log_elements, frequency_hz, changes) - base, axis=0)[0]
        return float(np.max(np.abs(change) / between))

    return effect.values(start, _bisect(reached, strength, f"{effect_id} at {place}"))


def _bisect(reached: Callable[[float], float], strength: float, what: str) -> float:
    """Size > 0 at which an increasing function equals the strength, to 1e-4."""
    low = strength / reached(1.0)  # exact where the effect is linear
    high = low
    for _ in range(40):
        if reached(low) <= strength:
            break
        high, low = low, low / 1.3
    for _ in range(40):
        if reached(high) >= strength:
            break
        low, high = high, high * 1.3
    while high / low > 1 + 1e-4:
        middle = np.sqrt(low * high)
        low, high = (middle, high) if reached(middle) < strength else (low, middle)
    size = float(np.sqrt(low * high))
    if abs(reached(size) / strength - 1) > 0.005:
        raise ValueError(f"{what} cannot reach the strength {strength}: ask for less")
    return size
