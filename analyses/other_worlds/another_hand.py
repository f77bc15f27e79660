"""A population of another hand: twelve recordings of one virtual population, with one thing missing in each.

Run from the repository's root::

    python analyses/other_worlds/another_hand.py                        # 71 people x 3 x 401: all twelve
    python analyses/other_worlds/another_hand.py --people 30 --points 101 --only mount

The paper's network with centres, spreads, noise and effects by which the diagnosis was wrong in 9 of 16 verdicts when
it had been tuned to one virtual finger. It is no fresh seed any more: a means of repair, and no measure of rightness.
Verdicts go to ``results/another_hand_71x401/``; those of the same data and the same sources are not made again.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import sealed_cases
from blind import diagnosed
from drawn_worlds import Effect, Noise, World
from same_curve import same_curve
from strict_scoring import Row, markdown, score, write
from tree_networks import FAMILIES, elements

HERE = Path(__file__).resolve().parent

CENTRES = {"m1": 17e-3, "m2": 0.9e-3, "n1": 1.2e-3, "n2": 5e-3, "n3": 9e-5, "r1": 1.5, "r2": 3.2, "r3": 30.0}
SPREADS = {"m1": 0.2, "m2": 0.25, "n1": 0.3, "n2": 0.35, "n3": 0.3, "r1": 0.35, "r2": 0.4, "r3": 0.3}
BETWEEN_REPETITIONS = {"n3": 0.02, "r3": 0.02, "n1": 0.01}
BAND_HZ = (5.0, 5000.0)
"""That of the paper."""

EFFECTS = {
    "nothing": None,
    "highpass": Effect("rig.highpass", "port", {"corner": 0.25}, {}),
    "residual_mass": Effect("rig.mass", "port", {"mass": 40e-6}, {}),
    "over_subtracted": Effect("rig.mass", "port", {"mass": -60e-6}, {}),
    "skin_springpot": Effect("body.springpot:element", "n3", {"exponent": 0.15}, {"exponent": 0.2}),
    "limb_springpot": Effect("body.springpot:element", "n2", {"exponent": 0.15}, {"exponent": 0.2}),
    "delay_in_some": Effect("rig.delay", "port", {"delay": 5e-6}, {}, share=12 / 71),
    "mount": Effect("rig.series_compliance", "port", {"compliance": 2e-7}, {}),
    "line": Effect("outside.free_line", "m2", {"compliance": 3e-5}, {"compliance": 0.25}),
    "squeeze_film": Effect(
        "outside.squeeze_film", "n3|r3", {"damping": 4.0, "time_constant": 5e-4}, {"damping": 0.3, "time_constant": 0.3}
    ),
    "stiffening": Effect("outside.stiffening", "n1", {"gain": 0.25, "knee": 1.0}, {}),
    "hysteresis": Effect("body.hysteresis", "n1", {"loss_factor": 0.12}, {"loss_factor": 0.25}),
}
"""By name; the compliance of n1 falls by a fifth where it moves most."""


def population(name: str, people: int = 71, points: int = 401) -> World:
    """One of the twelve."""
    network = FAMILIES["finger"]
    names = elements(network)
    effect = EFFECTS[name]
    world = World(
        family="another hand",
        network=network,
        centre=np.log([CENTRES[n] for n in names]),
        spread=np.array([SPREADS[n] for n in names]),
        correlation=np.eye(len(names)),
        between_repetitions=np.array([BETWEEN_REPETITIONS.get(n, 0.0) for n in names]),
        frequency_hz=np.geomspace(*BAND_HZ, points),
        n_people=people,
        n_repetitions=3,
        noise=Noise(level=0.012, rise=3.0, corner_hz=12.0),
        seed=(71, list(EFFECTS).index(name)),
    )
    if effect is None:
        return world
    values = dict(effect.values)
    if effect.kind == "body.springpot:element":
        values["middle"] = float(2 * np.pi * np.sqrt(BAND_HZ[0] * BAND_HZ[1]))
    if effect.kind == "outside.stiffening":
        values["gain"] = -values["gain"] / (1 + values["gain"])  # of a compliance
    return replace(world, effects=(replace(effect, values=values),))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=71)
    parser.add_argument("--points", type=int, default=401)
    parser.add_argument("--only", choices=list(EFFECTS), nargs="+", default=list(EFFECTS))
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results")
    options = parser.parse_args(arguments)
    out = options.out.resolve() / f"another_hand_{options.people}x{options.points}"
    out.mkdir(parents=True, exist_ok=True)
    file = out / sealed_cases.VERDICTS
    for name in options.only:
        world = population(name, options.people, options.points)
        answer = sealed_cases.answer(world, out / "datasets" / name, name)
        old = sealed_cases.verdicts_of(out).get(answer["data_sha256"])
        if old is None or old["sources"] != sealed_cases.sources():
            record = diagnosed(out / "datasets" / name) | {"answer": answer}
            with file.open("a", encoding="utf-8") as lines:
                lines.write(json.dumps(record) + "\n")
            row = _row(record, options.people, options.points)
            print(f"{name}: {'right' if row['right'] else 'WRONG'}: {row['said']} ({row['seconds']:.0f} s)", flush=True)
    rows = [_row(record, options.people, options.points) for record in sealed_cases.verdicts_of(out).values()]
    write(rows, out)
    print(markdown(rows))
    return 0


def _row(record: dict, people: int, points: int) -> Row:
    world = population(record["case"], people, points)
    return score(record["answer"], record, lambda verdict: same_curve(world, verdict))


if __name__ == "__main__":
    raise SystemExit(main())
