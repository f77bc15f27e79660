"""Everything of a case, drawn from its seed: network, centres, people, experiment, noise and effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from drawn_worlds import Effect, Noise, World, curves, information
from left_out import ELSEWHERE, FIXED, KINDS, Kind, Setting
from tree_networks import FAMILIES, Node, elements, impedance, parts_in_parallel, places, random_tree

SHARES = {"none": 0.25, "one": 0.50, "two": 0.10, "outside": 0.15}
"""Shares of the cases."""

STRENGTHS = (0.02, 0.4)
"""Largest relative change of the median person's impedance, log-uniform. Much below, nothing is visible in any world;
above, nobody needs a tool to see it."""

SHARE_OF_SPREAD = (0.5, 0.9)
"""Of an element's standard deviation that a covariate explains; the trend of a drift in standard deviations of the
repetitions is four times as large."""


def draw(seed: int, index: int, small: bool = False) -> World:
    """The world of one case, everything from (seed, index); `small` has 8 people and 41 frequencies, for a trial."""
    rng = np.random.default_rng([seed, index])
    for _ in range(1000):
        world = _draw_people(rng, (seed, index), small)
        if _determined(world):
            break
    else:
        raise ValueError(f"no world in a thousand drawings for seed {seed}, case {index}")
    group = str(rng.choice(list(SHARES), p=list(SHARES.values())))
    for _ in range(1000):
        drawn = _draw_effects(group, world, rng)
        if drawn is not None:
            return replace(world, effects=drawn)
    raise ValueError(f"no effect in a thousand drawings for seed {seed}, case {index}")


def _draw_people(rng: np.random.Generator, seed: tuple[int, ...], small: bool) -> World:
    family = str(rng.choice([*FAMILIES, "tree", "tree", "tree"]))
    network = random_tree(rng) if family == "tree" else FAMILIES[family]
    low = float(10 ** rng.uniform(-0.3, 1.5))
    high = float(low * 10 ** rng.uniform(1.5, 3.3))
    n_points = 41 if small else int(rng.integers(51, 402))
    logarithmic = bool(rng.random() < 0.7)
    frequency = np.geomspace(low, high, n_points) if logarithmic else np.linspace(low, high, n_points)
    level = 10 ** rng.uniform(-1, 2)
    names = elements(network)
    centre = []
    for name in names:
        w = 2 * np.pi * low * (high / low) ** rng.uniform(0.05, 0.95)
        z = level * np.exp(0.8 * rng.normal())
        centre.append(np.log({"m": z / w, "n": 1 / (z * w), "r": z}[name[0]]))
    p = len(names)
    correlation = np.eye(p)
    if rng.random() < 0.6:
        loadings = rng.normal(size=(p, 2)) * rng.uniform(0.2, 1.2)
        covariance = loadings @ loadings.T + np.eye(p)
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
    moving = rng.random(p) < rng.choice([0.3, 0.6, 1.0])
    noise = Noise(
        level=float(np.exp(rng.uniform(np.log(0.003), np.log(0.03)))),
        rise=1.0 if rng.random() < 0.4 else float(rng.uniform(2, 5)),
        corner_hz=float(low * rng.uniform(1, 4)),
        tails=np.inf if rng.random() < 0.7 else float(rng.uniform(4, 10)),
        between_persons=float(rng.choice([0.0, 0.15])),
    )
    n_repetitions = int(rng.integers(1, 4))
    return World(
        family=family,
        network=network,
        centre=np.array(centre),
        spread=rng.uniform(0.1, 0.5, size=p),
        correlation=correlation,
        between_repetitions=np.where(moving, np.exp(rng.uniform(np.log(0.005), np.log(0.08), size=p)), 0.0),
        frequency_hz=frequency,
        n_people=8 if small else int(rng.integers(8, 72)),
        n_repetitions=n_repetitions,
        noise=noise,
        covariates=("contact_force_n",) if rng.random() < 0.5 else (),
        seed=seed,
    )


def _determined(world: World) -> bool:
    """Whether each element is known to a factor of e from one recording of the median person.

    Otherwise the network has an element that nobody could have put there on the strength of such recordings.
    """
    matrix = information(world, world.centre)
    scale = np.sqrt(np.diag(matrix))
    if not np.all(np.isfinite(scale)) or scale.min() <= 0:
        return False
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    if values[0] < 1e-9:
        return False
    variance = np.sum(vectors**2 / values, axis=1) / scale**2
    return bool(np.sqrt(variance.max()) < 1.0)


def _draw_effects(group: str, world: World, rng: np.random.Generator) -> tuple[Effect, ...] | None:
    if group == "none":
        return ()
    effects: list[Effect] = []
    for _ in range(2 if group == "two" else 1):
        effect = _draw_effect(group == "outside", world, rng)
        if effect is None or effect.id in [e.id for e in effects]:
            return None
        if effects and {effect.kind, effects[0].kind} & set(ELSEWHERE):
            return None  # a structure of the elements beside a change of formula: visibility would have two meanings
        effects.append(effect)
    return tuple(effects)


def _draw_effect(outside: bool, world: World, rng: np.random.Generator) -> Effect | None:
    names = [k for k in (*KINDS, *ELSEWHERE) if k.startswith("outside") == outside]
    name = str(rng.choice(names))
    return _elsewhere(name, world, rng) if name in ELSEWHERE else _at_a_place(name, world, rng)


def _at_a_place(name: str, world: World, rng: np.random.Generator) -> Effect | None:
    kind = KINDS[name]
    here = _place(kind, world, rng)
    if here is None or (kind.id == "body.reflex" and world.frequency_hz[0] > 15):
        return None
    place, node = here
    if kind.absorbed_by and {p[0] for p in parts_in_parallel(node) if isinstance(p, str)} >= set(kind.absorbed_by):
        return None
    f = world.frequency_hz
    parts = dict(zip(elements(world.network), np.exp(world.centre)[:, None], strict=True))
    level = float(np.median(np.abs(impedance(node, world.s, parts, {}))))
    values = kind.start(rng, Setting(float(f[0]), float(f[-1]), level))
    strength = float(np.exp(rng.uniform(*np.log(STRENGTHS))))
    sign = -1.0 if kind.signed and rng.random() < 0.5 else 1.0
    sized = scaled_to(world, kind, place, values, strength, sign)
    if sized is None:
        return None
    shared = kind.side == "rig" or (kind.where == "spring" and rng.random() < 0.2)
    spreads = {n: 0.0 if shared or n in FIXED else _spread(n, rng) for n in sized}
    share = float(rng.uniform(0.15, 0.4)) if kind.some else 1.0
    if kind.some and world.n_people < 15:
        return None
    return Effect(name, place, sized, spreads, share, strength)


def _spread(name: str, rng: np.random.Generator) -> float:
    """People differ in sizes by 20 to 45 %, in exponents, latencies and time laws by less."""
    return float(rng.uniform(0.2, 0.45) * (0.15 if name in ("exponent", "latency", "time_law") else 1.0))


def _place(kind: Kind, world: World, rng: np.random.Generator) -> tuple[str, Node] | None:
    """One of the places at which the catalogue says that an entry may stand; physics outside of it stands anywhere."""
    if kind.where == "port":
        return "port", world.network
    if kind.where in ("beside", "spring_group"):
        found = list(places(world.network))
        if kind.where == "spring_group":
            found = [(p, n) for p, n in found if p != "port" and any(e[0] == "n" for e in elements(n))]
            found += [(e, e) for e in elements(world.network) if e[0] == "n" and (e, e) not in found]
        elif kind.id in ("body.mass", "body.reflex"):
            found = [(p, n) for p, n in found if p == "port" or not isinstance(n, str)]
        elif not kind.id.startswith("outside"):
            found = [(p, n) for p, n in found if p == "port" or not isinstance(n, str) or n[0] != "m"]
        if not found:
            return None
        return found[int(rng.integers(len(found)))]
    letters = {"spring": "n", "mass": "m", "element": "nr"}[kind.where]
    leaves = [e for e in elements(world.network) if e[0] in letters]
    if not leaves:
        return None
    leaf = str(rng.choice(leaves))
    return leaf, leaf


def scaled_to(
    world: World, kind: Kind, place: str, values: Mapping[str, float], strength: float, sign: float
) -> dict[str, float] | None:
    """Parameters with all sizes scaled so that the median person's impedance changes by the strength; None if never."""
    base = curves(world.network, world.s, world.centre)
    sizes = [kind.size, *(["stiffness"] if kind.id == "body.bypass" else [])]

    def at(times: float) -> tuple[float, dict[str, float]]:
        p = dict(values) | {n: sign * times * values[n] for n in sizes}
        own = {n: np.full(1, v) for n, v in p.items()}
        with np.errstate(all="ignore"):
            changed = curves(world.network, world.s, world.centre, {place: lambda s, z: kind.form(s, z, own) + 0 * s})
        return float(np.max(np.abs(changed / base - 1))), p

    low, high = 1e-7, 1e-7
    while at(high)[0] < strength:
        low, high = high, 2 * high
        if high > 1e5:
            return None
    for _ in range(40):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if at(middle)[0] < strength else (low, middle)
    found, p = at(high)
    limits = {"exponent": 0.8, "loss_factor": 2.0}
    return p if np.isfinite(found) and abs(p[kind.size]) < limits.get(kind.size, np.inf) else None


def _elsewhere(name: str, world: World, rng: np.random.Generator) -> Effect | None:
    names = elements(world.network)
    f = world.frequency_hz
    if name == "rig.mains":
        mains = float(rng.choice([50.0, 60.0]))
        if not f[0] < 0.8 * mains < 1.2 * mains < f[-1]:
            return None
        base = np.abs(curves(world.network, world.s, world.centre))
        strength = float(np.exp(rng.uniform(np.log(0.03), np.log(0.3))))
        amplitude = strength * float(base[np.argmin(np.abs(f - mains))])
        return Effect(name, "port", {"amplitude": amplitude, "frequency": mains}, {}, 1.0, strength)
    i = int(rng.integers(len(names)))
    share = float(rng.uniform(*SHARE_OF_SPREAD))
    if name == "body.covariate":
        if not world.covariates:
            return None
        return Effect(name, names[i], {"slope": float(share * world.spread[i] / 0.3)}, {}, 1.0, share)
    if name == "body.drift:repetitions":
        if world.n_repetitions < 2:
            return None
        trend = float(4 * share * max(world.between_repetitions[i], 0.01)) * float(rng.choice([-1.0, 1.0]))
        return Effect(name, names[i], {"trend": trend}, {}, 1.0, share)
    springs = [e for e in names if e[0] == "n"]
    if not springs:
        return None
    spring = str(rng.choice(springs))
    gain = float(np.exp(rng.uniform(np.log(0.05), np.log(0.4))))
    return Effect(name, spring, {"gain": -gain / (1 + gain), "knee": float(rng.uniform(0.3, 3.0))}, {}, 1.0, gain)
