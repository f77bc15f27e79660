"""The results as a table and as a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from constructs import NETWORKS

Results = Mapping[str, Any]


def table(results: Results) -> str:
    """Markdown: quantity, number with its spread, goal."""
    machine = results["machine"]
    packages = ", ".join(f"{name} {number}" for name, number in machine["packages"].items())
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, {machine['date']}; {packages}.",
        "",
        "| what | measured | goal |",
        "|---|---|---|",
    ]
    for part, rows in (
        ("kernel", _kernel),
        ("constructs", _constructs),
        ("one_curve", _one_curve),
        ("population", _population),
        ("diagnosis", _diagnosis),
        ("end_to_end", _end_to_end),
    ):
        if part in results:
            lines += [f"| {what} | {measured} | {goal} |" for what, measured, goal in rows(results[part])]
    return "\n".join(lines)


Row = tuple[str, str, str]


def _kernel(r: Results) -> list[Row]:
    def micro(name: str) -> str:
        return f"{1e6 * r['seconds'][name][0]:.1f} µs"

    def times(name: str) -> str:
        return f"{micro(name)}, {_range(r['times ours'][name], 'x')}"

    floor = r["floor"]
    rows = [
        ("one likelihood, 8 elements, 401 frequencies", micro("ours"), ""),
        (
            "... over the arithmetic floor, shortest timings" + (f" ({floor['date']})" if "date" in floor else ""),
            f"{_short(floor['ours over floor'])}x",
            "at most 4",
        ),
        ("... by numpy, all parameter sets at once", times("numpy at once"), "at least 8"),
        ("... by numpy in blocks that fit the cache", times("numpy"), ""),
        ("... by impedance.py", times("impedance.py"), "at least 50"),
    ]
    if "jax" in r["seconds"]:
        rows.append(("... by JAX, compiled", times("jax"), ""))
    rows += [
        ("likelihood and gradient", micro("ours, gradient"), ""),
        ("... by numpy in blocks that fit the cache", times("numpy, gradient"), ""),
    ]
    if "jax, gradient" in r["seconds"]:
        rows.append(("... by JAX, compiled", times("jax, gradient"), ""))
    return rows


def _constructs(r: Results) -> list[Row]:
    value, slope = r["impedance"], r["derivative"]
    alone = [f"{row[next(iter(row))]['nanoseconds'][0]:.2g} ns" for row in (value, slope)]
    rows = [(f"a damper alone, for each frequency ({r['date']})", f"{alone[0]}; with its derivative {alone[1]}", "")]
    for name in list(value)[1:]:
        times = [_range(row[name]["times a damper"], "x") for row in (value, slope)]
        rows.append((f"... `{name}`".replace("|", r"\|"), f"{times[0]}; {times[1]}", ""))
    # What the language got after these numbers were measured is in the table all the same.
    return rows + [
        (f"... `{name}`".replace("|", r"\|"), "not measured yet", "") for name in NETWORKS if name not in value
    ]


def _one_curve(r: Results) -> list[Row]:
    return [
        (
            f"one curve fitted by {name}",
            f"{row['found']} of {row['people']} optima, {1e3 * row['seconds'][0]:.0f} ms"
            + ("" if name == "ours" else f", {row['times ours']:.1f} times ours")
            + (f"; {row['stopped']} stopped after {row['seconds allowed']:.0f} s" if row.get("stopped") else ""),
            "",
        )
        for name, row in r.items()
        if isinstance(row, Mapping)
    ]


def _population(results: Results) -> list[Row]:
    rows: list[Row] = []
    for r in (results["few"], results["many"]):
        ours = r["ours"]
        rows.append(
            (
                f"population of {r['people']}, worst of {r['parameters']} parameters",
                f"{ours['per second']:.0f} effective samples per second ({ours['seconds']:.1f} s)",
                "",
            )
        )
        for name, goal in (("joint", "at least 30"), ("marginal", "")):
            rows += _nuts(name, goal, r[name]) if name in r else []
        rows += _nlme(r["nlme"]) if "nlme" in r else []
    return rows


def _nuts(name: str, goal: str, row: Results) -> list[Row]:
    low, high = row["ratio of standard deviations"]
    who, ratio, error = row["farthest from one"]
    return [
        (
            f"... by NUTS on the {name} posterior",
            f"{row['per second']:.2f} ({row['seconds']:.0f} s); ours {row['times as many by ours']:.1f} times",
            goal,
        ),
        (
            "... largest difference of means",
            f"{row['largest difference of means, in standard deviations']:.3f} standard deviations",
            "at most 0.15",
        ),
        (
            "... ratio of standard deviations",
            f"{low:.3f} to {high:.3f}; farthest: {who}, {ratio:.3f} ± {error:.3f}",
            "0.9 to 1.1",
        ),
    ]


def _nlme(r: Results | None) -> list[Row]:
    what = "... by R's nlme, point estimates"
    if r is None:
        return [(what, "R or its package nlme was not installed", "")]
    if "failed" in r:
        return [(what, f"failed: {r['failed']}", "")]
    away = r["standard deviations from our mean"]
    largest = {k: max(abs(v) for name, v in away.items() if name.startswith(k)) for k in ("mu", "tau", "rho")}
    return [
        (
            what,
            f"{r['seconds']:.0f} s; at most {largest['mu']:.2f} of our standard deviations away in central values, "
            f"{largest['tau']:.2f} in dispersions of people, {largest['rho']:.2f} of repetitions",
            "",
        )
    ]


def _diagnosis(r: Results) -> list[Row]:
    screening = r["screening, 40 people, 201 frequencies"]
    growth = ", ".join(f"{name}: {value:.2f}" for name, value in r["growth"].items())
    whole = r["whole diagnosis of 40 people without anything missing, seconds"]
    return [
        (
            f"screening of {screening['candidates']} candidates in 40 people",
            f"{screening['seconds']:.1f} s, {screening['microseconds per candidate and person']:.1f} µs each",
            "",
        ),
        ("... exponents of its growth", growth, ""),
        ("whole diagnosis of them, nothing missing", f"{whole:.0f} s", ""),
    ]


def _end_to_end(r: Results) -> list[Row]:
    rows = []
    for command, goal in (("run", "warm under 45 s"), ("diagnose", "under 45 s")):
        for state in ("cold", "warm"):
            t = r[command][state]
            measured = f"{t['seconds']:.1f} s, {t['processor seconds']:.0f} s of processor, {t['peak MB']:.0f} MB"
            rows.append((f"`{command} data/fingertip_71`, {state}", measured, goal if state == "warm" else ""))
    return rows


def _range(values: Sequence[float], unit: str) -> str:
    """Median and the tenth to ninetieth percentile."""
    return f"{_short(values[0])}{unit} ({_short(values[1])} to {_short(values[2])})"


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}"


def replace_between(path: Path, name: str, content: str) -> None:
    """Put content between a document's markers of a name."""
    start, end = f"<!-- {name}:start -->", f"<!-- {name}:end -->"
    head, rest = path.read_text(encoding="utf-8").split(start)
    path.write_text(f"{head}{start}\n{content.strip()}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def draw(results: Results, path: Path) -> None:
    """Ratios to ours on one logarithmic axis."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    bars: list[tuple[str, float]] = []
    if "kernel" in results:
        bars += [(f"one likelihood: {name}", row[0]) for name, row in results["kernel"]["times ours"].items()]
    if "one_curve" in results:
        rows = results["one_curve"].items()
        bars += [
            (f"one curve: {name} ({row['found']}/{row['people']} optima)", row["times ours"])
            for name, row in rows
            if isinstance(row, Mapping) and name != "ours"
        ]
    if "population" in results:
        bars += [
            (f"effective sample: NUTS, {name} posterior, {r['people']} people", r[name]["times as many by ours"])
            for r in (results["population"]["few"], results["population"]["many"])
            for name in ("joint", "marginal")
            if name in r
        ]
    if not bars:
        return
    figure, axes = plt.subplots(figsize=(8, 1.2 + 0.32 * len(bars)), layout="constrained")
    names, values = [name for name, _ in bars][::-1], [value for _, value in bars][::-1]
    axes.barh(names, values, color="#4878a8", height=0.6, left=0)
    axes.set_xscale("log")
    axes.axvline(1.0, color="0.2", linewidth=1)
    for i, value in enumerate(values):
        axes.text(value * 1.08, i, _short(value), va="center", fontsize=8)
    axes.set_xlim(min(0.5, *values) / 1.3, max(values) * 3)
    axes.set_xlabel("time over that of bayes_impedance")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=130)
    plt.close(figure)
