"""A world: network, people, an experiment, and what the claimed network lacks (drawn in ``drawing.py``).

The claim is the true network without the effect. With no effect the recordings are those of the network and noise.
Everything that a reader may want to doubt is in :class:`World`; :func:`conduct` makes its recordings.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from left_out import ELSEWHERE, KINDS, Kind, Values
from tree_networks import Change, Node, elements, impedance, notation, velocity_of


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
        Largest relative change of the median person's impedance; of structures see ``drawing.SHARE_OF_SPREAD``.
    """

    kind: str
    place: str
    values: Mapping[str, float]
    spreads: Mapping[str, float]
    share: float = 1.0
    strength: float = 0.0

    @property
    def id(self) -> str:
        """Right name."""
        return self.kind.split(":")[0]

    @property
    def side(self) -> str:
        """``rig`` or ``body``."""
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


CHANNELS = ("rig.delay", "rig.highpass", "rig.lowpass")
"""Effects of the electronics, behind all mechanics."""


def chained(rows: list[tuple[Kind, Values, np.ndarray]]) -> Change:
    """Several changes of one place: the body's, then the rig's mechanics, and its recording channels last."""
    ordered = sorted(rows, key=lambda row: (row[0].side == "rig", row[0].id in CHANNELS))

    def change(s: np.ndarray, z: np.ndarray) -> np.ndarray:
        for kind, values, who in ordered:
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


def information(world: World, log_elements: np.ndarray) -> np.ndarray:
    """Fisher information (P, P) of one recording's log elements (P,)."""
    step = 1e-5 * np.eye(log_elements.size)
    up, down = (curves(world.network, world.s, log_elements + sign * step) for sign in (1, -1))
    f = world.frequency_hz
    shape = 1 + (world.noise.rise - 1) / (1 + (f / world.noise.corner_hz) ** 2)
    sd = world.noise.level / np.sqrt(2) * shape * np.abs(curves(world.network, world.s, log_elements))
    g = (up - down) / 2e-5 / sd
    return np.asarray((g.conj() @ g.T).real)


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
