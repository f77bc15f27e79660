"""The whole challenge from one command: draw, seal, diagnose blindly, open the seal, score.

Run from the repository's root::

    python analyses/concealed/run.py --cases 60 --seed 1 --jobs 2 -o analyses/concealed/results/challenge

Each diagnosis appends a line to ``verdicts.jsonl`` when it ends. Cases on file are skipped: a run may be interrupted.
``--score`` scores the cases on file; ``--with`` also counts the rows of other challenges' folders. The table goes to
``challenge.md`` and, for 60 cases or more, between its markers into CHALLENGE.md; the picture to ``confusion.png``.
``--full`` ends each diagnosis with the population's posterior, from which its intervals then are; without it they are
those of a normal approximation. ``--small`` is for a trial: 10 people, 61 frequencies.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from challenge import SEAL, SEALED, Sizes, blind, draw, matched, plan_from, prepare, sealed_answers, to_diagnose
from challenge_scoring import draw_confusion, markdown, scored
from runs import read_lines, replace_between, run_cases
from world.experiment import conduct

HERE = Path(__file__).resolve().parent
FILE = "verdicts.jsonl"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("--small", action="store_true", help="10 people and 61 frequencies in every case")
    parser.add_argument("--full", action="store_true", help="diagnoses that end with the population's posterior")
    parser.add_argument("--score", action="store_true", help="diagnose nothing: score what is on file")
    parser.add_argument("--with", dest="others", nargs="+", type=Path, default=[], help="folders of other challenges")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results" / "challenge")
    options = parser.parse_args(arguments)
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    if not options.score:
        plans = draw(options.seed, options.cases, Sizes((10,), (61,)) if options.small else None)
        seal = prepare(plans, out, options.seed)
        print(f"sealed {len(plans)} cases: SHA-256 {seal}", flush=True)
        run_cases(to_diagnose(out, len(plans), options.full), blind, out / FILE, options.jobs)
    answers = sealed_answers(out)
    pairs = matched(answers, read_lines(out / FILE))
    rows = scored(pairs, lambda plan: conduct(plan_from(plan)))
    (out / "rows.json").write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    runs = [_named(out)] + [_named(other) for other in options.others]
    for other in options.others:
        rows += json.loads((other / "rows.json").read_text(encoding="utf-8"))
    text = markdown(rows, len(pairs) - sum("error" not in r for _, r in pairs), len(answers) - len(pairs))
    (out / "challenge.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    if rows:
        draw_confusion(rows, out / "confusion.png")
    if len(rows) >= 60 and not options.small:
        head = f"{len(rows)} cases: {'; '.join(runs)}."
        replace_between(HERE / "CHALLENGE.md", "challenge", f"{head}\n\n{text}")


def _named(folder: Path) -> str:
    """Seed and seal of a challenge."""
    seed = json.loads((folder / SEALED).read_text(encoding="utf-8"))["seed"]
    return f"seed {seed}, sealed as `{(folder / SEAL).read_text(encoding='utf-8').strip()}`"


if __name__ == "__main__":
    main()
