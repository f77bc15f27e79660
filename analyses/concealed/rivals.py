r"""Simpler methods on the same cases: the mean curve, eq. 5, single people, and a plain model search.

Run from the repository's root, after ``run.py``::

    python analyses/concealed/rivals.py --nulls 100 --jobs 2 -o analyses/concealed/results/challenge

Each method is a test statistic that grows with the misfit. Its threshold is exceeded by 5 % of simulated cases in which
nothing is missing (``--nulls`` of them, with the sizes and conditions of the challenge), so that all methods have the
same rate of false alarms.

- **mean curve**: the network is fitted to the mean over people; rms of the relative residual.
- **eq. 5**: the network with everybody's geometric mean elements against the look-up table of the mean: ratio of their
  :math:`\Delta_{m,A}` averaged over frequency.
- **single people**: the network is fitted to everybody; the largest chi-square of one person over its degrees of
  freedom, the noise taken from the roughness of the residual.
- **model search**: every entry of the package's catalogue at every place is fitted to the mean curve; the lowest
  :math:`n\ln(\text{RSS}/n) + k\ln n` wins. Its number is the gain in BIC over the network alone, its name the winner's.

Results are lines of ``rivals.jsonl``; the table goes to ``rivals.md`` and, with a full challenge, into CHALLENGE.md.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from challenge import Sizes, draw, recordings_of, sealed_answers
from challenge_scoring import rate
from people import CENTRAL, ELEMENTS, NETWORK
from runs import Record, read_lines, replace_between, run_cases
from world.experiment import Plan, conduct
from world.kinds import KINDS

from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.files import read_recordings
from bayes_impedance.results.curve_errors import error_curves, lookup_table

HERE = Path(__file__).resolve().parent
FILE = "rivals.jsonl"
LOOKS = ("mean curve", "eq. 5", "single people", "model search")
LEVEL = 0.05
"""Rate of false alarms of each method."""
_SHAPES_TRIED = 4
"""Shapes of an entry that the model search begins from, evenly spaced over its grid; the fit moves them."""
_POINTS = 61
"""Frequencies of the model search, 20 per decade of the challenge's band: its cost is proportional to them."""


def least_squares(
    kernel: Kernel, start: np.ndarray, frequency_hz: np.ndarray, z: np.ndarray, rounds: int = 60
) -> tuple[np.ndarray, np.ndarray]:
    """Levenberg-Marquardt for many curves or starts at once, residuals relative to |z|.

    Parameters
    ----------
    kernel : Kernel
    start : ndarray, shape (M, P)
    frequency_hz : ndarray, shape (F,)
    z : ndarray, complex, shape (M, F)
    rounds : int

    Returns
    -------
    u : ndarray, shape (M, P)
    rss : ndarray, shape (M,)
        Sum of squares of the relative residual.
    """
    u, damping = np.ascontiguousarray(start), np.full(len(start), 1e-2)
    weight = 1 / np.abs(z)

    def cost(v: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            found = np.sum((np.abs(kernel.impedance(np.ascontiguousarray(v), frequency_hz) - z) * weight) ** 2, axis=1)
        return np.where(np.isfinite(found), found, np.inf)

    best = cost(u)
    for _ in range(rounds):
        model, slope = kernel.derivative(u, frequency_hz)
        residual, slope = (z - model) * weight, slope * weight[:, None]
        a = np.concatenate([slope.real, slope.imag], axis=2)
        b = np.concatenate([residual.real, residual.imag], axis=1)
        normal, right = a @ np.swapaxes(a, 1, 2), np.einsum("mpf,mf->mp", a, b)
        diagonal = np.einsum("mpp->mp", normal)
        floor = 1e-9 * diagonal.max(axis=1, keepdims=True) + 1e-300
        extra = damping[:, None] * np.maximum(diagonal, floor) + floor
        step = np.linalg.solve(normal + extra[:, None] * np.eye(u.shape[1]), right[..., None])[..., 0]
        trial = u + np.clip(step, -1.0, 1.0)
        new = cost(trial)
        better = new < best
        u = np.where(better[:, None], trial, u)
        best = np.where(better, new, best)
        damping = np.clip(np.where(better, damping / 4, damping * 4), 1e-9, 1e9)
        if np.all(damping >= 1e9) or not np.any(better | (damping < 1e6)):
            break
    return u, best


def best_of_starts(kernel: Kernel, frequency_hz: np.ndarray, z: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The network fitted to curves (N, F) from five starts around published fingertips, the best of each."""
    rng = np.random.default_rng(seed)
    centre = np.log([CENTRAL[e] for e in ELEMENTS])
    found = []
    for k in range(5):
        start = centre + (0.5 * rng.normal(size=(len(z), len(centre))) if k else 0.0)
        found.append(least_squares(kernel, np.broadcast_to(start, (len(z), len(centre))).copy(), frequency_hz, z))
    pick = np.argmin([rss for _, rss in found], axis=0)
    rows = np.arange(len(z))
    return np.array([u for u, _ in found])[pick, rows], np.array([rss for _, rss in found])[pick, rows]


def looks(recordings: Recordings, seed: int) -> dict[str, Any]:
    """The statistic of each method, and the name that the model search gives."""
    kernel = Kernel(parse(NETWORK))
    frequency_hz = recordings.subjects[0].frequency_hz
    people = np.array([s.mean for s in recordings.subjects])
    mean = people.mean(axis=0)
    own, _ = best_of_starts(kernel, frequency_hz, people, seed)
    u_mean, rss = best_of_starts(kernel, frequency_hz, mean[None], seed)
    centre = kernel.impedance(np.ascontiguousarray(np.median(own, axis=0)[None]), frequency_hz)[0]
    network = error_curves(np.abs(centre), np.angle(centre, deg=True), people).magnitude
    lookup = error_curves(*lookup_table(people, "mean"), people).magnitude
    residual = (people - kernel.impedance(own, frequency_hz)) / np.abs(people)
    named, gain = model_search(recordings, u_mean[0], mean)
    return {
        "mean curve": float(np.sqrt(rss[0] / frequency_hz.size)),
        "eq. 5": float(network.mean() / lookup.mean()),
        "single people": float(np.max(_chi_square(residual))),
        "model search": gain,
        "named": named,
    }


def _chi_square(residual: np.ndarray) -> np.ndarray:
    """Of each person over its degrees of freedom; the noise may differ between low and high frequencies."""
    rough = residual[:, 1:-1] - 0.5 * (residual[:, :-2] + residual[:, 2:])
    halves = np.array_split(np.arange(rough.shape[1]), 4)
    parts = [
        np.sum(np.abs(residual[:, 1:-1][:, h]) ** 2, axis=1) / (np.mean(np.abs(rough[:, h]) ** 2, axis=1) / 1.5)
        for h in halves
    ]
    return np.asarray(np.sum(parts, axis=0) / (rough.shape[1] - len(ELEMENTS) / 2))


def model_search(recordings: Recordings, u: np.ndarray, mean: np.ndarray) -> tuple[str | None, float]:
    """Winner among all entries on the mean curve, and its gain in BIC; (None, 0) if the network alone wins."""
    from bayes_impedance.diagnosis import catalogue  # noqa: F401  (fills the register)
    from bayes_impedance.diagnosis.catalogue.effect import registered, shape_grid
    from bayes_impedance.diagnosis.fit.model import Addition, build, scales_of

    frequency_hz = recordings.subjects[0].frequency_hz
    keep = np.unique(np.linspace(0, frequency_hz.size - 1, min(_POINTS, frequency_hz.size)).astype(int))
    f, z = frequency_hz[keep], mean[keep]
    network, scales, n = parse(NETWORK), scales_of(recordings), 2 * keep.size
    base = build(network, (), scales, ())
    _, rss = least_squares(base.kernel, u[None].copy(), f, z[None], 30)
    alone = n * np.log(rss[0] / n) + len(u) * np.log(n)
    best: tuple[str | None, float] = (None, 0.0)
    for effect in registered():
        shapes = list(shape_grid(effect, scales))
        chosen = [shapes[i] for i in np.unique(np.linspace(0, len(shapes) - 1, _SHAPES_TRIED).astype(int))]
        for place in effect.sites(network):
            addition = Addition(effect=effect, place=place.name, pooling="shared")
            models = [build(network, (addition,), scales, (shape,)) for shape in chosen]
            k = len(u) + len(models[0].parameters)
            starts = np.array([np.concatenate([u, [p.start for p in m.parameters]]) for m in models])
            found, rss = least_squares(models[0].kernel, starts, f, np.broadcast_to(z, (len(starts), f.size)), 30)
            if not effect.signed:
                column = len(u) + next((i for i, p in enumerate(models[0].parameters) if p.is_coefficient), 0)
                rss = np.where(found[:, column] > 0, rss, np.inf)
            gain = float(alone - (n * np.log(max(rss.min(), 1e-300) / n) + k * np.log(n)))
            if np.isfinite(gain) and gain > best[1]:
                best = (effect.id, gain)
    return best


def one_case(case: Mapping[str, Any]) -> Record:
    """Apply all methods to a dataset, or to a simulated one in which nothing is missing."""
    if "folder" in case:
        return looks(read_recordings(Path(case["folder"])), 1)
    plan = draw(case["seed"], 1, Sizes((case["subjects"],), (case["points"],)))[0]
    nothing = Plan(
        kinds=("nothing",),
        strengths=(0.0,),
        seed=plan.seed,
        n_subjects=plan.n_subjects,
        n_repetitions=3,
        n_points=plan.n_points,
        conditions=plan.conditions,
    )
    return looks(recordings_of(conduct(nothing), "nothing"), 1)


def table(
    answers: Sequence[Mapping[str, Any]],
    rows: Sequence[Mapping[str, Any]],
    seen: Mapping[str, Record],
    nulls: Sequence[Record],
) -> str:
    """Detections of each method and of the population method; the margin, with a sign test on the cases that differ."""
    from scipy.stats import binomtest

    thresholds = {look: float(np.quantile([r[look] for r in nulls], 1 - LEVEL)) for look in LOOKS}
    by_case = {row["case"]: row for row in rows}
    both = [a for a in answers if a["case"] in seen and a["case"] in by_case]
    there = [a for a in both if a["truth"]["visible"] >= 6 and a["truth"]["mismatch"]]
    empty = [a for a in both if not a["truth"]["mismatch"]]
    named_cases = [a for a in there if a["truth"]["group"] in ("catalogue", "pair")]

    def found(look: str, case: str) -> bool:
        return bool(seen[case][look] > thresholds[look])

    def named(case: Mapping[str, Any]) -> bool:
        right = {answer for kind in case["truth"]["kinds"] for answer in KINDS[kind].answers}
        return found("model search", case["case"]) and seen[case["case"]]["named"] in right

    population = {a["case"]: bool(by_case[a["case"]]["detected"]) for a in both}
    lines = [
        f"Thresholds from {len(nulls)} simulated cases with nothing missing; {len(there)} detectable cases.",
        "",
        "| look | detected | margin of the population method | only it / only the look, sign test | false claims |",
        "|---|---|---|---|---|",
    ]
    n = len(there)
    hits = sum(population[a["case"]] for a in there)
    false = sum(population[a["case"]] for a in empty)
    lines.append(f"| population (diagnose) | {rate(hits, n)} | - | - | {rate(false, len(empty))} |")
    for look in LOOKS:
        own = [found(look, a["case"]) for a in there]
        only = [
            sum(population[a["case"]] and not o for a, o in zip(there, own, strict=True)),
            sum(o and not population[a["case"]] for a, o in zip(there, own, strict=True)),
        ]
        p = binomtest(only[0], sum(only)).pvalue if sum(only) else 1.0
        margin = f"{100 * (hits - sum(own)) / n:+.0f} points" if n else "-"
        wrong = rate(sum(found(look, a["case"]) for a in empty), len(empty))
        lines.append(f"| {look} | {rate(sum(own), n)} | {margin} | {only[0]} / {only[1]}, p = {p:.2g} | {wrong} |")
    right = sum(bool(by_case[a["case"]]["first"]) for a in named_cases)
    honest = sum(bool(by_case[a["case"]]["first_or_undecided"]) for a in named_cases)
    other, m = sum(named(a) for a in named_cases), len(named_cases)
    lines += [
        "",
        f"Right name of {m} detectable cases with a catalogue entry: model search {rate(other, m)}, population method "
        f"{rate(right, m)} first and {rate(honest, m)} first or undecided"
        + (f", a margin of {100 * (right - other) / m:+.0f} points." if m else "."),
    ]
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nulls", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=900001)
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results" / "challenge", help="of run.py")
    options = parser.parse_args(arguments)
    out = options.out.resolve()
    answers = sealed_answers(out)
    folders = {answer["case"]: str(out / "datasets" / answer["case"]) for answer in answers}
    real = [
        {"folder": folder, "data_sha256": a["data_sha256"]} for a, folder in zip(answers, folders.values(), strict=True)
    ]
    sizes = [(a["plan"]["n_subjects"], a["plan"]["n_points"]) for a in answers]
    nulls = [
        {"seed": options.first_seed + i, "subjects": sizes[i % len(sizes)][0], "points": sizes[i % len(sizes)][1]}
        for i in range(options.nulls)
    ]
    run_cases([*real, *nulls], one_case, out / FILE, options.jobs)
    records = [r for r in read_lines(out / FILE) if "error" not in r]
    by_data = {r["case"]["data_sha256"]: r for r in records if "data_sha256" in r["case"]}
    seen = {a["case"]: by_data[a["data_sha256"]] for a in answers if a["data_sha256"] in by_data}
    rows = json.loads((out / "rows.json").read_text(encoding="utf-8"))
    text = table(answers, rows, seen, [r for r in records if "folder" not in r["case"]])
    (out / "rivals.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    if len(rows) >= 60 and options.nulls >= 100:
        replace_between(HERE / "CHALLENGE.md", "rivals", text)


if __name__ == "__main__":
    main()
