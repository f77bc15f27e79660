"""Whether what is printed of populations in which something is wrong covers, or carries a mark.

Run from the repository's root::

    python analyses/honesty/truth_suite.py --wrong 200 --good 100 --jobs 2 -o analyses/honesty/results

Every case is a population whose elements are known and whose recordings are spoilt in one way of :data:`KINDS`: the
network has redundant elements or the band shows little, people are flipped, copied, a hundred times off or of two
groups, noise is as large as the signal, physics is missing, or the recordings are of another quantity. Each is fitted
as ``bayes-impedance fit --quick`` does. An interval counts if it is printed: the element is identified, the fit
reliable, and the element carries no mark. Two numbers come out: the share of printed intervals that cover, and the
share of populations with nothing wrong in which anything is marked or withheld. Cases on file are skipped.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from bayes_impedance.diagnosis.examine import examine
from bayes_impedance.errors import InputError
from bayes_impedance.network.notation import parse
from bayes_impedance.population.fit import QUICK_SETTINGS, fit_population
from bayes_impedance.population.simulate import VirtualPopulation, simulate_recordings
from bayes_impedance.recordings.files import Recordings
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import make_result

Change = Callable[[int, np.ndarray, np.ndarray], np.ndarray]
"""Of a person's number, frequencies (F,) and impedances (J, F)."""

SMALL = "n1|r1|m1"
LAYERED = "(n3|r3)-(m2|r1|n1)"
CENTRAL = {"n1": 1e-3, "r1": 1.5, "m1": 1e-3, "m2": 8e-4, "n3": 2e-5, "r3": 10.0, "n2": 5e-4, "r2": 0.7}
"""Population medians, SI."""

PEOPLE = 24
MANY_DRAWS = 200_000
"""Of a population, to know the median of a combination to 0.1 %."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """A way in which something is wrong.

    Attributes
    ----------
    change : callable
        Of the recordings.
    network : str
        Of the simulation and, unless another is named, of the fit.
    fitted : str
        Network that is fitted; empty for the simulated one.
    band_hz : tuple of float
    noise : float
        Relative, of each part.
    larger : float
        Factor by which the change makes the population's median impedance larger.
    """

    change: Change = lambda _i, _f, z: z
    network: str = SMALL
    fitted: str = ""
    band_hz: tuple[float, float] = (5.0, 1000.0)
    noise: float = 0.01
    larger: float = 1.0


def _some(i: int, every: int) -> bool:
    return i % every == 0


KINDS: dict[str, Kind] = {
    "two springs in series": Kind(network="(n1-n2)|r1|m1"),
    "two dampers side by side": Kind(network="n1|r1|r2|m1"),
    "four elements of three coefficients": Kind(network="m1|((r1-(r2|n1))|r3)"),
    "band of one per cent": Kind(band_hz=(100.0, 101.0)),
    "band of a third": Kind(band_hz=(90.0, 120.0)),
    "low band": Kind(band_hz=(5.0, 15.0), network=LAYERED),
    "one flipped": Kind(change=lambda i, _, z: -z if i == 3 else z),
    "one conjugated": Kind(change=lambda i, _, z: z.conj() if i == 3 else z),
    "one a hundred times": Kind(change=lambda i, _, z: 100 * z if i == 3 else z),
    "one in other units": Kind(change=lambda i, _, z: 5 * z if i == 3 else z),
    "two groups": Kind(change=lambda i, _, z: 2.5 * z if _some(i, 3) else z, larger=2.5 ** (1 / 3)),
    "two groups, near": Kind(change=lambda i, _, z: 1.6 * z if _some(i, 2) else z, larger=1.6**0.5),
    "noise of 100 %": Kind(noise=1.0),
    "noise of 200 %": Kind(noise=2.0),
    "all conjugated": Kind(change=lambda _i, _f, z: z.conj()),
    "mobility": Kind(change=lambda _i, _f, z: 1 / z),
    "accelerance": Kind(change=lambda _i, f, z: 2j * np.pi * f / z),
    "lost high-pass": Kind(change=lambda _i, f, z: z * 1j * f / (1j * f + 3.0)),
    "lost delay": Kind(change=lambda _i, f, z: z * np.exp(-2j * np.pi * f * 1e-4)),
    "lost power law": Kind(change=lambda _i, f, z: z + 0.3 * np.sqrt(1j * f / 50)),
    "lost relaxation": Kind(change=lambda _i, f, z: z + 1 / (1 / 1.0 + 2j * np.pi * f * 2e-3)),
    "lost layer": Kind(network=LAYERED, fitted="m2|r1|n1"),
    "copies": Kind(),
}


def recordings_of(kind: str, seed: int) -> tuple[Recordings, dict[str, float]]:
    """Recordings, and the true population median of every element that may be printed."""
    k = KINDS.get(kind, Kind())
    network = LAYERED if kind == "nothing" and seed % 2 else k.network
    elements = parse(network).elements
    population = VirtualPopulation(
        network=network,
        central={e: CENTRAL[e] for e in elements},
        between_persons=dict.fromkeys(elements, 0.2),
        noise=k.noise,
        noise_corner_hz=0.0,
    )
    own = 1000 * [*KINDS, "nothing"].index(kind) + seed  # noise and people of its own
    made = simulate_recordings(population, PEOPLE, 1, np.geomspace(*k.band_hz, 40), own).recordings
    people = [replace(s, z=k.change(i, s.frequency_hz, s.z)) for i, s in enumerate(made.subjects)]
    if kind == "copies":
        people = [replace(people[i % 2], name=s.name) for i, s in enumerate(people)]
    truth = {e: value * k.larger ** (-1 if e[0] == "n" else 1) for e, value in population.central.items()}
    return replace(made, subjects=tuple(people), network=k.fitted or network), truth


def median_of(expression: str, seed: int) -> float:
    """Population median of a combination of elements, exp of the mean logarithm."""
    rng = np.random.default_rng(seed)
    draws = {name: value * np.exp(0.2 * rng.normal(size=MANY_DRAWS)) for name, value in CENTRAL.items()}
    return float(np.exp(np.mean(np.log(eval(expression, {}, draws)))))


def one_case(case: tuple[str, int]) -> dict[str, Any]:
    """Simulate, fit, examine; what was printed, and whether it covers."""
    kind, seed = case
    recordings, truth = recordings_of(kind, seed)
    try:
        fit = fit_population(recordings, settings=QUICK_SETTINGS, seed=seed, workers=1)
    except InputError as error:
        return {"kind": kind, "seed": seed, "refused": str(error), "marked": True, "printed": {}}
    adequacy = examine(fit, workers=1)
    summary = make_result(fit, predict(fit, seed=seed), {}, adequacy=adequacy).summary
    truth |= {c["name"]: median_of(c["expression"], 1) for c in summary["combinations"]}
    printed = {}
    for name, element in summary["elements"].items():
        central = element["central"]
        if central["median"] is not None and not element["marked"]:
            printed[name] = {**central, "truth": truth[name], "covers": central["q05"] <= truth[name] <= central["q95"]}
    marked = bool(summary["problems"] or any(e["marked"] for e in summary["elements"].values()))
    return {
        "kind": kind,
        "seed": seed,
        "problems": summary["problems"],
        "misfit": list(adequacy.misfit),
        "bent": sorted(adequacy.bent),
        "marked": marked,
        "printed": printed,
    }


def _cases(wrong: int, good: int) -> Iterator[tuple[str, int]]:
    kinds = list(KINDS)
    yield from ((kinds[i % len(kinds)], 1 + i // len(kinds)) for i in range(wrong))
    yield from (("nothing", 1 + i) for i in range(good))


def table(rows: list[dict[str, Any]]) -> str:
    """What came out, kind by kind, as a table in Markdown."""
    lines = [
        "| what is wrong | populations | marked or withheld | intervals printed | of them cover |",
        "|---|---|---|---|---|",
    ]
    everything = [*dict.fromkeys(row["kind"] for row in rows)]
    groups = [(kind, [row for row in rows if row["kind"] == kind]) for kind in everything]
    groups.append(("**all that are wrong**", [row for row in rows if row["kind"] != "nothing"]))
    for kind, own in groups:
        printed = [entry["covers"] for row in own for entry in row["printed"].values()]
        share = f"{100 * np.mean(printed):.0f} %" if printed else "-"
        lines.append(f"| {kind} | {len(own)} | {sum(row['marked'] for row in own)} | {len(printed)} | {share} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--wrong", type=int, default=200)
    parser.add_argument("--good", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path(__file__).parent / "results")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    file = options.out / "truth_suite.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {(row["kind"], row["seed"]) for row in rows}
    left = [case for case in _cases(options.wrong, options.good) if case not in done]
    with ProcessPoolExecutor(options.jobs) as pool, file.open("a") as lines:
        for row in pool.map(one_case, left):
            rows.append(row)
            lines.write(json.dumps(row) + "\n")
            lines.flush()
    text = table(rows)
    (options.out / "truth_suite.md").write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
