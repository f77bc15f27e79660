"""The paper's figures 3 to 5 and its table of errors, made from recordings.

Run from the repository's root: python analyses/paper/make.py [DATASET]
Without a dataset the virtual fingertips are taken. Results go to analyses/paper/results.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from bayes_impedance.commands.comparison import compare_dataset
from bayes_impedance.commands.fit_options import FitOptions

ROOT = Path(__file__).parents[2]
OUT = Path(__file__).parent / "results"


def main() -> None:
    dataset = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "data" / "fingertip_71"
    started = time.perf_counter()
    comparison = compare_dataset(dataset, OUT, FitOptions(quick=True), None, False, lambda *_: None)
    table = comparison.method("lookup_median").errors.summary()
    print(f"{'':34}{'the paper':20}{'|z|':>16}{'phase (deg)':>16}{'over the table (%)':>22}")
    for method in comparison.methods:
        errors = method.errors.summary()
        cells = [f"{errors[key]:.2f} ± {errors[key + '_sd']:.2f}" for key in ("delta_magnitude", "delta_phase_deg")]
        excess = [100 * (errors[key] / table[key] - 1) for key in ("delta_magnitude", "delta_phase_deg")]
        more = f"{excess[0]:+.1f}, {excess[1]:+.1f}"
        print(f"{method.label:34}{method.paper:20}{cells[0]:>16}{cells[1]:>16}{more:>22}")
        stopped = {e: n for e, n in (method.stopped or {}).items() if n}
        if stopped:
            print(f"{'':4}not determined by somebody's curve: {stopped}")
    print(f"\nmapping of the system identification: {100 * comparison.mapping.distance:.2f} % off")
    truth = dataset / "truth.json"
    if truth.is_file():
        known = {k: e["central"] for k, e in json.loads(truth.read_text(encoding="utf-8"))["elements"].items()}
        print(f"\n{'elements over the true centre':34}" + "".join(f"{e:>9}" for e in known))
        found = {m.label: m.elements for m in comparison.methods if m.elements}
        found["mapping of the identification"] = {k: e.value for k, e in comparison.mapping.elements.items()}
        for label, elements in found.items():
            print(f"{label:34}" + "".join(f"{(elements[e] or np.nan) / known[e]:9.3g}" for e in known))
    if comparison.normality is not None:
        print("\nshare of frequencies that pass a test of normality at 5 %, and rejections after correction")
        shares = comparison.normality.summary()
        for test in (k for k in shares if f"{k}_rejected" in shares):
            print(f"  {test:28}{100 * shares[test]:5.1f} %{shares[f'{test}_rejected']:8.0f}")
    print(f"\n{time.perf_counter() - started:.0f} s; figures and tables in {OUT.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
