"""A world in which everything is drawn from one seed: network, people, recordings, and what the claimed network lacks.

The claim is the true network without the effect. With no effect the recordings are those of the network and noise.
Everything that a reader may want to doubt is in :class:`World`; :func:`conduct` makes its recordings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from left_out import ELSEWHERE, FIXED, KINDS, Kind, Setting, Values
from tree_networks import (
    FAMILIES,
    Change,
    Node,
    elements,
    impedance,
    notation,
    parts_in_parallel,
    places,
    random_tree,
    velocity_of,
)

SHARES = {"none": 0.25, "one": 0.50, "two": 0.10, "outside": 0.15}
"""Shares of the cases."""

STRENGTHS = (0.02, 0.4)
"""Largest relative change of the median person's impedance, log-uniform. Much below, nothing is visible in any world;
above, nobody needs a tool to see it."""

SHARE_OF_SPREAD = (0.5, 0.9)
"""Of an element's standard deviation that a covariate explains; the trend of a drift in standard deviations of the
repetitions is four times as large."""


@dataclass(frozen=True)
class Effect:
    """One thing that the claimed network lacks.

    Attributes
    ----------
    kind : str
        Key of :data:`left_out.KINDS` or of :data:`left_out.ELSEWHERE`.
    place : str
        ``port``, or the notation of a part; the element, for a covariate or a drift.
    values : mapping of str to float
        Medians over people.
    spreads : mapping of str to float
        Standard deviations between people of the logarithm; zero is the same for everybody.
    share : float
        Of the people who have it.
    strength : float
        Largest relative change of the median person's impedance; of structures see :data:`SHARE_OF_SPREAD`.
    """

    kind: str
    place: str
    values: Mapping[str, float]
    spreads: Mapping[str, float]
    share: float = 1.0
    strength: float = 0.0

    @property
    def id(self) -> str:
        return self.kind.split(":")[0]

    @property
    def side(self) -> str:
        return KINDS[self.kind].side if self.kind in KINDS else ELSEWHERE[self.kind]


@dataclass(frozen=True)
class Noise:
    """Noise of one recording.

    Attributes
    ----------
    level : float
        Root mean square of the complex error over abs(z), in the plateau.
    rise, corner_hz : float
        Towards low frequencies: 1 + (rise - 1)/(1 + (f/corner)^2) times as much.
    tails : float
        Degrees of freedom of a t distribution of the same variance; infinite for the normal one.
    between_persons : float
        Standard deviation of the logarithm of a person's factor.
    """

    level: float
    rise: float = 1.0
    corner_hz: float = 1.0
    tails: float = np.inf
    between_persons: float = 0.0


@dataclass(frozen=True)
class World:
    """A claim, people, an experiment and effects; see the fields of :class:`Effect` and :class:`Noise`.

    Attributes
    ----------
    family : str
    network : Node
        Claimed.
    centre, spread : ndarray, shape (P,)
        Of the log elements.
    correlation : ndarray, shape (P, P)
    between_repetitions : ndarray, shape (P,)
        Zero for elements that do not change.
    frequency_hz : ndarray, shape (F,)
    n_people, n_repetitions : int
    noise : Noise
    effects : tuple of Effect
    covariates : tuple of str
        Noted for everybody; log-normal.
    seed : tuple of int
        Of people and noise.
    """

    family: str
    network: Node
    centre: np.ndarray
    spread: np.ndarray
    correlation: np.ndarray
    between_repetitions: np.ndarray
    frequency_hz: np.ndarray
    n_people: int
    n_repetitions: int
    noise: Noise
    effects: tuple[Effect, ...] = ()
    covariates: tuple[str, ...] = ()
    seed: tuple[int, ...] = (1,)

    @property
    def s(self) -> np.ndarray:
        """Laplace variable, shape (F,)."""
        return 2j * np.pi * self.frequency_hz


@dataclass(frozen=True)
class Experiment:
    """Recordings of a world and what is behind them.

    Attributes
    ----------
    log_elements : ndarray, shape (N, J, P)
        True, with what covariates and drift over repetitions do to them.
    clean, sd, recorded : ndarray, shape (N, J, F)
        Impedance with all effects; standard deviation of real and of imaginary part; the clean one with noise.
    members : ndarray of bool, shape (number of effects, N)
        Who has which effect.
    covariates : mapping of str to ndarray (N,)
    """

    log_elements: np.ndarray
    clean: np.ndarray
    sd: np.ndarray
    recorded: np.ndarray
    members: np.ndarray
    covariates: Mapping[str, np.ndarray] = field(default_factory=dict)


def curves(
    network: Node, s: np.ndarray, log_elements: np.ndarray, changes: Mapping[str, Change] | None = None
) -> np.ndarray:
    """Impedances (..., F) of log elements (..., P)."""
    x = np.exp(log_elements)[..., None]
    values = {name: x[..., i, :] for i, name in enumerate(elements(network))}
    return impedance(network, s, values, changes or {})


def conduct(world: World) -> Experiment:
    """Draw people and record them."""
    rng = np.random.default_rng([*world.seed, 1])
    n, j, p = world.n_people, world.n_repetitions, world.centre.size
    root = np.linalg.cholesky(world.correlation + 1e-9 * np.eye(p))
    x = world.centre + (rng.normal(size=(n, p)) @ root.T) * world.spread
    log_elements = x[:, None] + rng.normal(size=(n, j, p)) * world.between_repetitions
    noted = {name: np.exp(0.3 * rng.normal(size=n)) for name in world.covariates}
    changes: dict[str, list[tuple[Kind, Values, np.ndarray]]] = {}
    members = np.ones((len(world.effects), n), dtype=bool)
    names = elements(world.network)
    hum = np.zeros((n, j, world.s.size), dtype=complex)
    stiffening: Effect | None = None
    for k, effect in enumerate(world.effects):
        if effect.share < 1:
            members[k] = False
            members[k, rng.permutation(n)[: max(3, round(effect.share * n))]] = True
        if effect.kind == "body.covariate":
            i = names.index(effect.place)
            log_x = np.log(noted[world.covariates[0]])
            kept = np.sqrt(1 - effect.strength**2)
            centred = log_elements[..., i] - world.centre[i]
            log_elements[..., i] = world.centre[i] + kept * centred + effect.values["slope"] * log_x[:, None]
        elif effect.kind == "body.drift:repetitions":
            log_elements[..., names.index(effect.place)] += effect.values["trend"] * (np.arange(j) - (j - 1) / 2)
        elif effect.kind == "rig.mains":
            hum = _hum(world, effect, rng)
        elif effect.kind == "outside.stiffening":
            stiffening = effect
        else:
            own = {
                name: np.broadcast_to(
                    value * np.exp(effect.spreads.get(name, 0.0) * rng.normal(size=(n, 1, 1))), (n, 1, 1)
                )
                for name, value in effect.values.items()
            }
            changes.setdefault(effect.place, []).append((KINDS[effect.kind], own, members[k][:, None, None]))
    acting = {place: chained(rows) for place, rows in changes.items()}
    if stiffening is not None:
        acting[stiffening.place] = _stiffened(world, stiffening, log_elements)
    clean = curves(world.network, world.s, log_elements, acting)
    factor = np.exp(world.noise.between_persons * rng.normal(size=(n, 1, 1)))
    f = world.frequency_hz
    shape = 1 + (world.noise.rise - 1) / (1 + (f / world.noise.corner_hz) ** 2)
    sd = world.noise.level / np.sqrt(2) * shape * factor * np.abs(clean)
    noise = rng.normal(size=(*clean.shape, 2)) @ np.array([1, 1j])
    if np.isfinite(world.noise.tails):
        nu = world.noise.tails
        noise *= np.sqrt((nu - 2) / rng.chisquare(nu, size=clean.shape))
    return Experiment(log_elements, clean + hum, sd, clean + hum + sd * noise, members, noted)


def chained(rows: list[tuple[Kind, Values, np.ndarray]]) -> Change:
    """Several changes of one place, one after the other."""

    def change(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        for kind, values, who in rows:
            z = np.where(who, kind.form(s, z, values), z)
        return z

    return change


def _hum(world: World, effect: Effect, rng: np.random.Generator) -> np.ndarray:
    """Force of the mains through a lock-in that averages ten periods: a sinc around each harmonic, of random phase."""
    f = world.frequency_hz
    total = np.zeros((world.n_people, world.n_repetitions, f.size), dtype=complex)
    for harmonic, part in ((1, 1.0), (2, 0.3), (3, 0.5)):
        skirt = part * effect.values["amplitude"] * np.sinc(10 * (f - harmonic * effect.values["frequency"]) / f)
        total += skirt * np.exp(2j * np.pi * rng.random((*total.shape[:2], f.size)))
    return total


def _stiffened(world: World, effect: Effect, log_elements: np.ndarray) -> Change:
    """Stiffness of a spring under a force of constant amplitude: k (1 + g a^2/(1 + a^2)), a the motion over its median.

    The motion is that of the linear network, which differs from the true one by the stiffening itself: the world is
    one of many in which a spring follows the amplitude.
    """
    values = {name: np.exp(log_elements[..., i, None]) for i, name in enumerate(elements(world.network))}
    motion = np.abs(velocity_of(world.network, effect.place, world.s, values) / world.s)
    a = motion / np.median(motion) / effect.values["knee"]
    factor = 1 + effect.values["gain"] * a**2 / (1 + a**2)
    return lambda _s, z: z * factor


# --- drawing -----------------------------------------------------------------------------------------------------


def draw(seed: int, index: int) -> World:
    """The world of one case, everything from (seed, index)."""
    rng = np.random.default_rng([seed, index])
    for _ in range(1000):
        world = _draw_people(rng, (seed, index))
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


def _draw_people(rng: np.random.Generator, seed: tuple[int, ...]) -> World:
    family = str(rng.choice([*FAMILIES, "tree", "tree", "tree"]))
    network = random_tree(rng) if family == "tree" else FAMILIES[family]
    low = float(10 ** rng.uniform(-0.3, 1.5))
    high = float(low * 10 ** rng.uniform(1.5, 3.3))
    n_points = int(rng.integers(51, 402))
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
        n_people=int(rng.integers(8, 72)),
        n_repetitions=n_repetitions,
        noise=noise,
        covariates=("contact_force_n",) if rng.random() < 0.5 else (),
        seed=seed,
    )


def information(world: World, log_elements: np.ndarray) -> np.ndarray:
    """Fisher information (P, P) of one recording's log elements (P,)."""
    step = 1e-5 * np.eye(log_elements.size)
    up, down = (curves(world.network, world.s, log_elements + sign * step) for sign in (1, -1))
    f = world.frequency_hz
    shape = 1 + (world.noise.rise - 1) / (1 + (f / world.noise.corner_hz) ** 2)
    sd = world.noise.level / np.sqrt(2) * shape * np.abs(curves(world.network, world.s, log_elements))
    g = (up - down) / 2e-5 / sd
    return np.asarray((g.conj() @ g.T).real)


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
    if kind.where == "port":
        return "port", world.network
    if kind.where in ("beside", "spring_group"):
        found = list(places(world.network))
        if kind.where == "spring_group":
            found = [(p, n) for p, n in found if p != "port" and any(e[0] == "n" for e in elements(n))]
            found += [(e, e) for e in elements(world.network) if e[0] == "n" and (e, e) not in found]
        elif kind.id == "body.mass":
            found = [(p, n) for p, n in found if p == "port" or not isinstance(n, str)]
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
            changed = curves(
                world.network, world.s, world.centre, {place: lambda s, z: np.broadcast_to(kind.form(s, z, own), s.shape)}
            )
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


def described(world: World) -> dict[str, object]:
    """What is drawn, for the answers: plain numbers and texts."""
    return {
        "family": world.family,
        "network": notation(world.network),
        "elements": {n: float(np.exp(c)) for n, c in zip(elements(world.network), world.centre, strict=True)},
        "spread": [round(float(v), 4) for v in world.spread],
        "between_repetitions": [round(float(v), 5) for v in world.between_repetitions],
        "band_hz": [float(world.frequency_hz[0]), float(world.frequency_hz[-1])],
        "points": int(world.frequency_hz.size),
        "people": world.n_people,
        "repetitions": world.n_repetitions,
        "noise": {k: (v if np.isfinite(v) else None) for k, v in vars(world.noise).items()},
        "effects": [
            {"kind": e.kind, "id": e.id, "side": e.side, "place": e.place, "values": dict(e.values),
             "spreads": dict(e.spreads), "share": e.share, "strength": e.strength}
            for e in world.effects
        ],
    }  # fmt: skip
