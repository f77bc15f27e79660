"""Speed in populations that nothing was tuned to, beside the shipped one.

A sampler that is quick in one population may be slow in another: dispersions that are nearly zero, few people, an
element that the recordings hardly determine, a narrow band, an unknown rig. Five such populations and the shipped one
are fitted in one run, each twice:

* **at the size of the shipped recordings** (71 people, three repetitions, 401 frequencies; twelve people in one of
  them): processor seconds, autocorrelation time, effective samples of the worst coordinate, R-hat;
* **at a smaller size**, at which NUTS comes to an end on the joint posterior of the same recordings
  (`tests/extended_nuts_model.py`): ratio of effective samples per processor second, and moments compared.

Processor seconds of this process are the measure, because they depend less on who else uses the machine; fits have one
thread. Run from the repository's root: ``python benchmarks/other_worlds.py``; ``--only band`` measures one of them, the
others keep their last numbers, and so does a size that ``--only-part`` leaves out. Results go to
``other_worlds.json`` and into the README beside this script.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from population import beside_nuts
from report import replace_between
from this_machine import machine

from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings, read_recordings

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

HERE = Path(__file__).resolve().parent
DEMO = HERE.parent / "data" / "fingertip_71"
REPETITIONS = 3
_SEED, _FIT_SEED = 71, 1
_DRAWS = {"warmup": 300, "draws": 500}
"""Of each of four chains of NUTS. By choice: some hundred effective samples of the worst parameter, which give a spread
to about 5 %, in a few minutes."""


@dataclass(frozen=True)
class Size:
    """Number of people and of frequencies."""

    people: int
    points: int


FULL, BESIDE_NUTS = Size(71, 401), Size(12, 31)
"""The size of the shipped recordings, and a smaller one. By choice, for time: a step of NUTS takes the longer the more
people there are. Fewer than ten would have no correlations."""


@dataclass(frozen=True, kw_only=True)
class World:
    """A population, and what is unlike the shipped one.

    Attributes
    ----------
    unlike : str
    population : VirtualPopulation
    shipped : bool
        Whether its recordings are those of the package.
    most_people : int
    band_hz : tuple of float
    shared : tuple of str
        Parameters that are the same for everybody.
    """

    unlike: str
    population: VirtualPopulation
    shipped: bool = False
    most_people: int = FULL.people
    band_hz: tuple[float, float] = (5.0, 5000.0)
    shared: tuple[str, ...] = ()

    def recordings(self, size: Size) -> Recordings:
        """Its recordings; those of a smaller size are the first people at every so many frequencies."""
        if self.shipped:
            every = read_recordings(DEMO)
        else:
            frequency = np.geomspace(*self.band_hz, FULL.points)
            every = simulate_recordings(self.population, self.most_people, REPETITIONS, frequency, _SEED).recordings
        return thinned(every, size)


def thinned(recordings: Recordings, size: Size) -> Recordings:
    """The first people, at frequencies that are evenly spread over the grid."""
    subjects = recordings.subjects[: size.people]
    kept = np.unique(np.linspace(0, subjects[0].frequency_hz.size - 1, size.points).round().astype(int))
    return replace(
        recordings,
        subjects=tuple(replace(s, frequency_hz=s.frequency_hz[kept], z=s.z[:, kept]) for s in subjects),
    )


_HAND = VirtualPopulation(
    network=FINGERTIP.network,
    central={"m1": 17e-3, "m2": 0.9e-3, "n1": 1.2e-3, "n2": 5e-3, "n3": 9e-5, "r1": 1.5, "r2": 3.2, "r3": 30.0},
    between_persons={"m1": 0.2, "m2": 0.25, "n1": 0.3, "n2": 0.35, "n3": 0.3, "r1": 0.35, "r2": 0.4, "r3": 0.3},
    between_repetitions={"n3": 0.02, "r3": 0.02, "n1": 0.01},
    noise=0.012,
    noise_corner_hz=12.0,
)
"""The population of another hand in `analyses/other_worlds/another_hand.py`, as the package simulates it."""

WORLDS: Mapping[str, World] = {
    "shipped": World(unlike="the recordings of `make demo`", population=FINGERTIP, shipped=True),
    "nearly zero": World(
        unlike="another hand: five of eight elements do not change between repetitions, the others by 1 to 2 %",
        population=_HAND,
    ),
    "twelve people": World(unlike="virtual fingertips, twelve of them", population=FINGERTIP, most_people=12),
    "weakly determined": World(
        unlike="virtual fingertips with a third of the mass m2, which one person's recordings hardly determine",
        population=replace(FINGERTIP, central={**FINGERTIP.central, "m2": 2.5e-4}),
    ),
    "band": World(unlike="virtual fingertips from 20 to 800 Hz", population=FINGERTIP, band_hz=(20.0, 800.0)),
    "high-pass": World(
        unlike="another hand in a rig with a high-pass of 0.25 Hz that is the same for everybody and is estimated",
        population=replace(_HAND, network=f"highpass[f1*]({FINGERTIP.network})", central={**_HAND.central, "f1": 0.25}),
        shared=("f1",),
    ),
}
"""By name, the shipped one first. They are fixed: a change makes earlier numbers incomparable."""


def impedance_of(world: World) -> Callable[..., Any]:
    """Impedance of a world's network for JAX, written out, from theta (..., P), phi (S,) and angular frequency (F,)."""
    import jax.numpy as jnp

    names = varying(world)

    def impedance(theta: Any, phi: Any, omega: Any) -> Any:
        value = {name: jnp.exp(theta[..., p : p + 1]) for p, name in enumerate(names)}
        s = 1j * omega
        skin = 1 / (s * value["n3"]) + value["r3"]
        finger = 1 / (1 / (s * value["m1"]) + 1 / (1 / (s * value["n2"]) + value["r2"]))
        tissue = s * value["m2"] + value["r1"] + 1 / (s * value["n1"]) + finger
        z = skin * tissue / (skin + tissue)
        return z * s / (s + 2 * jnp.pi * phi[0]) if world.shared else z

    return impedance


def varying(world: World) -> tuple[str, ...]:
    """Elements that differ between people."""
    return tuple(name for name in world.population.central if name not in world.shared)


def timed_fit(world: World, size: Size, settings: FitSettings | None = None) -> tuple[PopulationFit, dict[str, Any]]:
    """A fit on one thread, with its seconds and the state of its chains; default settings if none are given."""
    recordings = world.recordings(size)
    started, processor = time.perf_counter(), time.process_time()
    fit = fit_population(recordings, world.population.network, settings=settings, seed=_FIT_SEED, workers=1)
    spent = time.process_time() - processor
    d = fit.diagnostics
    return fit, {
        "people": len(recordings.subjects),
        "points": recordings.subjects[0].frequency_hz.size,
        "seconds": time.perf_counter() - started,
        "processor seconds": spent,
        "stages, seconds": dict(fit.seconds),
        "effective": float(d.effective_min),
        "per processor second": float(d.effective_min) / spent,
        "autocorrelation time": float(d.autocorrelation_max),
        "steps": d.steps,
        "acceptance": float(d.acceptance),
        "R-hat": float(d.rhat_max),
        "draws made again": d.redrawn,
        "error by the draws": float(d.draw_error.interval_end),
        "problems": list(d.problems),
    }


def against_nuts(world: World, size: Size, length: Mapping[str, int]) -> dict[str, Any]:
    """The same recordings by NUTS on the joint posterior: how much slower, and how far its moments are from ours."""
    from extended_nuts_model import Case, from_fit, run_nuts
    from nuts_model import Samples, compare

    fit, ours = timed_fit(world, size)
    central = {name: world.population.central[name] for name in (*varying(world), *world.shared)}
    case = Case(
        network=world.population.network,
        impedance=impedance_of(world),
        values=central,
        shared=world.shared,
        repetitions=REPETITIONS,
        correlated=fit.settings.covariance == "full",
    )

    def of_population(samples: Samples) -> Samples:
        """Dispersions themselves: a logarithm has a tail without end where a dispersion may be zero."""
        own = {
            name.removeprefix("log "): np.exp(values) if name.startswith("log ") else values
            for name, values in samples.values.items()
            if not name.startswith("person")
        }
        return replace(samples, values=own)

    processor = time.process_time()
    nuts = run_nuts(case, fit, seed=_FIT_SEED, **length)
    spent = time.process_time() - processor
    table = compare(of_population(from_fit(case, fit)), of_population(nuts))
    row = beside_nuts(table, spent, nuts.divergences, ours["per processor second"])
    shifted = max(table, key=lambda c: abs(c.shift))
    row["farthest mean"] = [shifted.name, shifted.shift, shifted.shift_error]
    return {"ours": ours, "joint": row}


def table(results: Mapping[str, Mapping[str, Any]]) -> str:
    """One line for each world; seconds relative to those of the shipped recordings."""
    head = ["population", "processor seconds", "autocorrelation time", "effective per second", "R-hat"]
    head += ["NUTS: ours is", "means differ by", "spreads, ratio"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    base = results.get("shipped", {}).get("at full size", {}).get("processor seconds")
    for name in (name for name in WORLDS if "at full size" in results.get(name, {})):
        row = results[name]["at full size"]
        seconds = f"{row['processor seconds']:.0f}" + (f" ({row['processor seconds'] / base:.2f}x)" if base else "")
        rate, rhat = f"{row['per processor second']:.0f}", f"{row['R-hat']:.3f}"
        cells = [
            name,
            seconds,
            f"{row['autocorrelation time']:.0f}",
            rate,
            rhat + (" **refused**" * bool(row["problems"])),
        ]
        if "at a smaller size" in results[name]:
            joint = results[name]["at a smaller size"]["joint"]
            low, high = joint["ratio of standard deviations"]
            who, shift, error = joint["farthest mean"]
            odd, ratio, of_ratio = joint["farthest from one"]
            cells += [
                f"{joint['times as many by ours']:.0f} times as quick",
                f"{abs(shift):.2f} ± {error:.2f} sd ({who})",
                f"{low:.2f} to {high:.2f}; {odd} {ratio:.2f} ± {of_ratio:.2f}",
            ]
        else:
            cells += ["not measured", "", ""]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _compile() -> None:
    """Fit a few people with three elements, so that compiled functions are on disk before the clock starts."""
    simple = VirtualPopulation(
        network="m1|r1|n1",
        central={"m1": 1e-3, "r1": 2.0, "n1": 1e-3},
        between_persons={"m1": 0.2, "r1": 0.2, "n1": 0.2},
    )
    fit_population(simulate_recordings(simple, 12, 2, np.geomspace(5, 5000, 40), _SEED).recordings, seed=_FIT_SEED)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(WORLDS), default=list(WORLDS), metavar="WORLD")
    parser.add_argument("--only-part", choices=("at full size", "at a smaller size"), help="the latter beside NUTS")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "other_worlds.json")
    options = parser.parse_args(arguments)
    results: dict[str, Any] = json.loads(options.out.read_text(encoding="utf-8")) if options.out.is_file() else {}
    _compile()
    here = machine()
    for name in options.only:
        parts: dict[str, Callable[[], Any]] = {
            "at full size": lambda world=WORLDS[name]: timed_fit(world, FULL)[1],
            "at a smaller size": lambda world=WORLDS[name]: against_nuts(world, BESIDE_NUTS, _DRAWS),
        }
        for part in parts if options.only_part is None else [options.only_part]:
            row = parts[part]() | {"machine": here["processor"], "load": os.getloadavg()[0], "date": here["date"]}
            results.setdefault(name, {})[part] = row
            print(json.dumps({name: {part: row}}), flush=True)
            options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    text = table(results)
    print(text)
    if options.out == HERE / "other_worlds.json":
        replace_between(HERE / "README.md", "other_worlds", text)


if __name__ == "__main__":
    main()
