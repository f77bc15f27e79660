"""From a finished fit to a design answer: up to which stiffness a desktop device is stable with 99 % of its users.

    python analyses/design_inputs/design_answer.py out/demo out/design

draws 1000 virtual users, couples each to a PHANTOM 1.0 (the sources of its numbers: `PHANTOM.source`), and prints the
answer, also with virtual damping and with delay, each time beside the limit for the mean user alone.
"""

import sys
from dataclasses import replace
from pathlib import Path

from bayes_impedance.design import PHANTOM, design_answer, limit_of, population_of
from bayes_impedance.plots import save_figure, style
from bayes_impedance.plots.design import felt, stability, worst_user
from bayes_impedance.results.result import load_result
from bayes_impedance.units import rounded


def main(result: Path, out: Path) -> None:
    population = population_of(load_result(result))
    users = population.draw(1000, seed=1)
    answer = design_answer(population, users, PHANTOM, damping=0.0, share=0.99)
    print(answer.sentence, end="\n\n")
    with style():
        for name, figure in (
            ("stability", stability(answer)),
            ("worst_user", worst_user(answer, population)),
            ("transparency", felt(answer)),
        ):
            if figure is not None:
                save_figure(figure, out, name)

    header = (
        "delay (ms)",
        "B (N s/m)",
        "99 % of users (90 % interval)",
        "mean user alone",
        "stable there",
        "KT/2 + B < b",
    )
    rows = ["| " + " | ".join(header) + " |", "|" + 6 * "---|"]
    for delay in (0.0, 1e-3):
        for damping in (0.0, 2.0, 5.0):
            device = replace(PHANTOM, delay_s=delay)
            limit = limit_of(population, users, device, damping)
            interval = f"{rounded(limit.stiffness)} ({rounded(limit.low)} to {rounded(limit.high)})"
            kept = f"{100 * (limit.each >= limit.mean_user).mean():.0f} %"
            mean_user, classical = rounded(limit.mean_user), rounded(limit.classical)
            cells = [f"{1e3 * delay:g}", f"{damping:g}", interval, mean_user, kept, classical]
            rows.append("| " + " | ".join(cells) + " |")
    table = "\n".join(rows)
    print(table)
    (out / "limits.md").write_text(f"{answer.sentence}\n\nLimits of K in N/m:\n\n{table}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
