r"""An experiment in the virtual world: people, their fingers, the effects, the rig's recordings, and the truth.

The strength of an effect is that of ``cases.py``, by the rig's own noise-free readings of :data:`CALIBRATION_PEOPLE`:

.. math:: S = \max_f |\overline{z'}(f) - \overline z(f)| \Big/ \sqrt{\overline{|z(f) - \overline z(f)|^2}} .

Hum has a random phase: its rms counts. A covariate: the part of the standard deviation of log skin elements that it
explains on average. Creep over the session: the change of the log element from the first to the last sweep over its
standard deviation between persons. Sizes of gain and centre are drawn at random.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from people import (
    BETWEEN_PERSONS,
    ELEMENTS,
    Change,
    Conditions,
    Population,
    draw_people,
    draw_population,
    impedance,
    record,
)

from world.friction import sliding
from world.kind import Kind, Own, Values
from world.kinds import KINDS
from world.rig import Rig, measured_at, sweep_seconds
from world.tissue import hertz_exponents, logarithmic_creep

CALIBRATION_PEOPLE = 200
"""Persons who define a strength: their standard deviation is known to 5 %."""
FRICTION_PEOPLE = 40
"""The same with friction, whose curves are found by iteration and take much longer."""
FORCE_N, FORCE_SD, FORCE_WANDER = 1.0, 0.25, 0.05
"""Requested contact force; log sd of the held force between persons, and between repetitions of a person."""

MEMBERS = 0.3
CREEP_ONSET_S, CREEP_TIME_S = 2.0, 200.0
STRONG_COMMUNALITY = 0.95
_TRANSVERSE = {"n3": 0.4, "r3": 1.6, "m2": 1.0, "r1": 2.0, "n1": 0.3, "m1": 0.7, "n2": 0.3, "r2": 2.0}


@dataclass(frozen=True, kw_only=True)
class Plan:
    """Design of an experiment.

    Attributes
    ----------
    kinds : tuple of str
        Names in ``kinds.KINDS``; one, or two that work together.
    strengths : tuple of float
    seed : int
    n_subjects, n_repetitions, n_points : int
    band : (float, float)
        Hz; frequencies are spaced logarithmically and measured from low to high.
    conditions : Conditions
    rig : Rig
    """

    kinds: tuple[str, ...]
    strengths: tuple[float, ...]
    seed: int
    n_subjects: int = 40
    n_repetitions: int = 3
    n_points: int = 201
    band: tuple[float, float] = (5.0, 5000.0)
    conditions: Conditions = field(default_factory=Conditions)
    rig: Rig = field(default_factory=Rig)

    @property
    def frequency_hz(self) -> np.ndarray:
        """Shape (F,)."""
        return np.geomspace(*self.band, self.n_points)


@dataclass(frozen=True)
class Fingers:
    """Some people's fingers, put down some times.

    Attributes
    ----------
    log_elements : ndarray, shape (N, J, P)
    force_n : ndarray, shape (N, J)
        Contact force that was actually held.
    coefficients : ndarray, shape (K, N, 8)
        Standard normal: own values of each of K effects.
    members : ndarray of bool, shape (N,)
    """

    log_elements: np.ndarray
    force_n: np.ndarray
    coefficients: np.ndarray
    members: np.ndarray


@dataclass(frozen=True)
class Experiment:
    """An experiment with its complete truth.

    Attributes
    ----------
    plan : Plan
    population : Population
    fingers : Fingers
        Before a covariate or creep acts on the elements.
    values : tuple of dict
        Of each effect, for an average person.
    without, alone, clean : ndarray, complex, (N, J, F), (K, N, J, F), (N, J, F)
        Readings without noise: without effects, with each effect alone, and with all of them.
    recorded : ndarray, complex, shape (N, J, F)
    sd : ndarray, shape (N, J, F)
        Noise of real and imaginary part each.
    covariates : dict of str to ndarray (N,)
    """

    plan: Plan
    population: Population
    fingers: Fingers
    values: tuple[Values, ...]
    without: np.ndarray
    alone: np.ndarray
    clean: np.ndarray
    recorded: np.ndarray
    sd: np.ndarray
    covariates: Mapping[str, np.ndarray]


def conduct(plan: Plan) -> Experiment:
    """Draw people, solve for the sizes, record; the same plan gives the same numbers."""
    kinds = tuple(KINDS[name] for name in plan.kinds)
    specials = [kind.special for kind in kinds]
    conditions = plan.conditions
    if "correlation" in specials:
        conditions = replace(conditions, communality=STRONG_COMMUNALITY)
    population = draw_population(_stream(plan.seed, 0), conditions)
    if "centre" in specials:
        shift = KINDS["trap.centre"].start(_stream(plan.seed, 8))["shift"] * _stream(plan.seed, 9).normal(size=8)
        population = replace(population, log_centre=population.log_centre + shift)
    if any(kind.name == "trap.gain" for kind in kinds):
        conditions = replace(conditions, gain_error=KINDS["trap.gain"].start(_stream(plan.seed, 8))["gain"])
    values = tuple(
        _solve(plan, population, kind, strength, k)
        for k, (kind, strength) in enumerate(zip(kinds, plan.strengths, strict=True))
    )
    force_sd = next((v["force_sd"] for v in values if "force_sd" in v), FORCE_SD)
    fingers = _fingers(population, _stream(plan.seed, 1), plan.n_subjects, plan.n_repetitions, len(kinds), force_sd)
    if "covariate" in specials:
        fingers = _room_for_force(fingers, population, force_sd)
    look = partial(readings, plan, fingers)
    without = look((), ())
    alone = np.array([look((kind,), (v,), (k,)) for k, (kind, v) in enumerate(zip(kinds, values, strict=True))])
    clean = alone[0] if len(kinds) == 1 else look(kinds, values)
    noise = _stream(plan.seed, 2)
    recorded, sd = record(clean, plan.frequency_hz, conditions, noise)
    s = 2j * np.pi * plan.frequency_hz
    quantisation = plan.rig.quantisation_sd(s, clean)
    parts = noise.normal(size=(2, *clean.shape))
    recorded = recorded + quantisation * (parts[0] + 1j * parts[1]) - plan.rig.calibration_error(s, noise)
    temperature, age = (
        median * np.exp(sd * noise.normal(size=plan.n_subjects)) for median, sd in ((32, 0.06), (38, 0.35))
    )
    covariates = {"contact_force_n": fingers.force_n.mean(axis=1), "temperature_c": temperature, "age_y": age}
    sd = np.sqrt(sd**2 + quantisation**2)
    return Experiment(plan, population, fingers, values, without, alone, clean, recorded, sd, covariates)


def readings(
    plan: Plan, fingers: Fingers, kinds: Sequence[Kind], values: Sequence[Values], which: Sequence[int] | None = None
) -> np.ndarray:
    """Readings of the rig without noise, complex, shape (N, J, F), with some effects.

    Parameters
    ----------
    plan : Plan
    fingers : Fingers
    kinds : sequence of Kind
    values : sequence of dict
    which : sequence of int, optional
        Which rows of ``fingers.coefficients`` belong to the kinds; 0, 1, ... if not given.
    """
    frequency_hz, rig, changes = plan.frequency_hz, plan.rig, dict[str, Change]()
    s, log_elements = 2j * np.pi * frequency_hz, fingers.log_elements
    after: list[tuple[Kind, Own]] = []
    for k, kind, value in zip(range(len(kinds)) if which is None else which, kinds, values, strict=True):
        own: Own = {
            name: v * np.exp(kind.spread[name] * fingers.coefficients[k, :, i, None, None])
            if name in kind.spread
            else v
            for i, (name, v) in enumerate(value.items())
        }
        if kind.body is not None and kind.place is not None:
            some = fingers.members if kind.pooling == "some" else np.ones_like(fingers.members)
            _hook(changes, kind.place, partial(_with_body, kind.body, own, some[:, None, None]))
        elif kind.rig is not None:
            rig = kind.rig(rig, value)
        elif kind.special == "covariate":
            log_elements = log_elements + _hertz(fingers.force_n)
        elif kind.special.startswith("creep") and kind.place is not None:
            _hook(changes, kind.place, partial(_times, np.exp(-_creep(plan, kind.special, own))))
        elif kind.special == "hum":
            rig = replace(rig, hum_n=value["hum_n"])
        elif kind.special in ("friction", "crosstalk"):
            after.append((kind, own))
    z = impedance(log_elements, frequency_hz, changes)
    for kind, own in after:
        act = _friction if kind.special == "friction" else _crosstalk
        z = act(s, z, log_elements, own, rig, changes)
    shown = rig.measured(s, z)
    if rig.hum_n > 0:
        shown = shown + rig.hum(s, z, _stream(plan.seed, 3))
    return shown


def between_persons(z: np.ndarray) -> np.ndarray:
    """Standard deviation between persons of curves (N, F), shape (F,)."""
    return np.asarray(np.sqrt(np.mean(np.abs(z - z.mean(axis=0)) ** 2, axis=0)))


def calibration_readings(
    plan: Plan, population: Population, kind: Kind, value: Values, k: int
) -> tuple[np.ndarray, ...]:
    """Readings (N, F) by which a strength is defined, without and with an effect."""
    n = FRICTION_PEOPLE if kind.special == "friction" else CALIBRATION_PEOPLE
    fingers = _fingers(population, _stream(plan.seed, 4), n, 1, k + 1, FORCE_SD, MEMBERS)
    fingers = replace(
        fingers,
        log_elements=fingers.log_elements.mean(axis=1, keepdims=True),
        members=np.ones(n, dtype=bool),
    )
    return readings(plan, fingers, (), ())[:, 0], readings(plan, fingers, (kind,), (value,), (k,))[:, 0]


def _stream(seed: int, what: int) -> np.random.Generator:
    """Independent generators: switching something on does not change the people or the noise."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7, what)))


def _fingers(
    population: Population, rng: np.random.Generator, n: int, j: int, k: int, force_sd: float, share: float = MEMBERS
) -> Fingers:
    people = draw_people(population, rng, n, j)
    log_elements = population.log_centre + people.deviation[:, None] + people.repositioning
    force = FORCE_N * np.exp(force_sd * rng.normal(size=(n, 1)) + FORCE_WANDER * rng.normal(size=(n, j)))
    members = np.isin(np.arange(n), people.order[: max(1, round(share * n))])
    return Fingers(log_elements, force, rng.normal(size=(k, n, 8)), members)


def _room_for_force(fingers: Fingers, population: Population, force_sd: float) -> Fingers:
    """Reduce the other dispersion, so that the total dispersion of the skin's elements is unchanged."""
    person = fingers.log_elements.mean(axis=1, keepdims=True) - population.log_centre
    rest = np.ones(len(ELEMENTS))
    for name, exponent in hertz_exponents().items():
        i = ELEMENTS.index(name)
        rest[i] = np.sqrt(1 - (exponent * force_sd / population.between_persons[i]) ** 2)
    return replace(fingers, log_elements=fingers.log_elements - (1 - rest) * person)


def _hertz(force_n: np.ndarray) -> np.ndarray:
    """Change of the log elements, (N, J, P), by the force that was held."""
    change = np.zeros((*force_n.shape, len(ELEMENTS)))
    for name, exponent in hertz_exponents().items():
        change[..., ELEMENTS.index(name)] = exponent * np.log(force_n / FORCE_N)
    return change


def _hook(changes: dict[str, Change], place: str, change: Change) -> None:
    """Apply a change at a place, after the changes that are there already."""
    first = changes.get(place)
    changes[place] = change if first is None else lambda s, z: change(s, first(s, z))


def _with_body(
    body: Callable[..., np.ndarray], own: Own, members: np.ndarray, s: np.ndarray, z: np.ndarray
) -> np.ndarray:
    return np.where(members, body(s, z, own), z)


def _times(factor: np.ndarray, _s: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.asarray(z * factor)


def _creep(plan: Plan, special: str, own: Own) -> np.ndarray:
    """Decrease of a spring's log impedance at the time when a frequency is measured, (N or 1, J, F)."""
    now, whole = (
        measured_at(plan.frequency_hz, plan.rig.dead_time_s),
        sweep_seconds(plan.frequency_hz, plan.rig.dead_time_s),
    )
    if special == "creep.sweep":  # the finger is put down for every sweep
        q = logarithmic_creep(now, CREEP_ONSET_S) / logarithmic_creep(np.array(whole), CREEP_ONSET_S)
        return np.asarray(own["change"] * q[None, None])
    start = (whole + plan.rig.pause_s) * np.arange(plan.n_repetitions)
    q = 1 - np.exp(-(start[:, None] + now) / CREEP_TIME_S)
    q = q / (q[-1].mean() - q[0].mean())
    return np.asarray(own["change"] * q[None])


def _friction(
    s: np.ndarray, z: np.ndarray, log_elements: np.ndarray, own: Own, rig: Rig, changes: Mapping[str, Change]
) -> np.ndarray:
    """Friction: a Jenkins element beside skin or tissue."""
    seen: list[np.ndarray] = []

    def note(s: np.ndarray, tissue: np.ndarray) -> np.ndarray:
        seen.append(changes["tissue"](s, tissue) if "tissue" in changes else tissue)
        return seen[-1]

    impedance(log_elements, s.imag / (2 * np.pi), {**changes, "tissue": note})
    skin = 1 / (1 / z - 1 / seen[0])
    drive = partial(rig.drive_velocity, s)
    return sliding(s, seen[0], lambda tissue: 1 / (1 / skin + 1 / tissue), drive, own["stiffness"], own["breakaway_m"])


def _crosstalk(
    s: np.ndarray, z: np.ndarray, log_elements: np.ndarray, own: Own, _rig: Rig, _changes: Mapping[str, Change]
) -> np.ndarray:
    """Crosstalk: a tilt of the contactor adds part of the transverse impedance, through a damped rocking mode."""
    w0 = 2 * np.pi * np.asarray(own["frequency"])
    leak = own["leak"] / (1 + 2 * own["ratio"] * s / w0 + (s / w0) ** 2)
    other = impedance(log_elements + np.log([_TRANSVERSE[e] for e in ELEMENTS]), s.imag / (2 * np.pi))
    return np.asarray(z + leak * other)


def _solve(plan: Plan, population: Population, kind: Kind, strength: float, k: int) -> Values:
    """Parameters at which an effect has its strength."""
    start = kind.start(_stream(plan.seed, 10 + k))
    if kind.special == "covariate":
        tau = np.mean([BETWEEN_PERSONS[name] for name in hertz_exponents()])
        if strength >= 0.9:
            raise ValueError(f"a force cannot explain {strength} of the sd of two elements; stay below 0.9")
        return {"exponent": 1 / 3, "force_sd": float(3 * strength * tau)}
    if kind.special == "creep.session":
        return {"change": strength * BETWEEN_PERSONS[str(kind.place)]}
    if not kind.power:
        return start

    def reached(size: float) -> float:
        without, with_it = calibration_readings(plan, population, kind, kind.values(start, size), k)
        change = with_it - without
        moved = np.sqrt(np.mean(np.abs(change) ** 2, axis=0)) if kind.special == "hum" else np.abs(change.mean(axis=0))
        return float(np.max(moved / between_persons(without)))

    return kind.values(start, _bisect(reached, strength, kind.name))


def _bisect(reached: Callable[[float], float], strength: float, what: str) -> float:
    """Size > 0 at which an increasing function equals the strength, to 1e-3, by a secant in logarithms."""
    size = strength / reached(1.0)
    low, high = 0.0, np.inf
    for _ in range(60):
        found = reached(size)
        if abs(found / strength - 1) < 1e-3:
            return size
        low, high = (size, high) if found < strength else (low, size)
        guess = size * strength / found
        inside = low < guess < high
        size = (
            guess
            if inside
            else (np.sqrt(low * high) if low > 0 and np.isfinite(high) else (low + min(high, 4 * low)) / 2)
        )
    raise ValueError(f"{what} cannot reach the strength {strength}: ask for less")
