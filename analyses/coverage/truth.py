"""The demo's result against the truth of the virtual population.

Run from the repository's root, after `make demo`: python analyses/coverage/truth.py [out/demo]
"""

import json
import sys
from pathlib import Path

TRUTH = Path(__file__).parents[2] / "data" / "fingertip_71" / "truth.json"
KINDS = ("central", "dispersion_between_persons", "dispersion_between_repetitions")


def main() -> None:
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "out/demo")
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    truth = json.loads(TRUTH.read_text(encoding="utf-8"))
    for kind in KINDS:
        inside = 0
        print(f"{kind:32}{'truth':>11}{'median':>11}{'q05':>11}{'q95':>11}")
        for name, element in summary["elements"].items():
            true, found = truth["elements"][name][kind], element[kind]
            good = found["q05"] <= true <= found["q95"]
            inside += good
            numbers = "".join(f"{value:11.3g}" for value in (true, found["median"], found["q05"], found["q95"]))
            print(f"  {name:30}{numbers}{'' if good else '   outside'}")
        print(f"  {inside} of {len(summary['elements'])} inside\n")


if __name__ == "__main__":
    main()
