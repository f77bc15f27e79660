"""Datasets of a seed, the sealed answers, and the rule that a seed is used once.

``sealed.json`` holds for every case what was drawn, by how much it can be seen, and the SHA-256 of its dataset as the
package computes it (recordings, subjects, description). Its own SHA-256, the seal, is in ``seal.txt`` before the first
diagnosis. ``used.txt`` holds the state of the package's sources at that moment: a seed whose verdicts are complete, or
were begun with other sources, is refused, because whoever has seen a verdict may have tuned to it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from drawing import draw
from drawn_worlds import Experiment, World, conduct, described
from tree_networks import notation
from visible import visibilities

ROOT = Path(__file__).resolve().parents[2]
SEALED, SEAL, USED, VERDICTS, AGAIN = "sealed.json", "seal.txt", "used.txt", "verdicts.jsonl", "again.txt"


class SeedUsedError(ValueError):
    """A seed that must not be used a second time."""


def sources() -> str:
    """SHA-256 of the package's Python sources."""
    digest = hashlib.sha256()
    for file in sorted((ROOT / "bayes_impedance").rglob("*.py")):
        digest.update(str(file.relative_to(ROOT)).encode() + file.read_bytes())
    return digest.hexdigest()


def write_dataset(world: World, experiment: Experiment, folder: Path, title: str) -> str:
    """Write a dataset with the claimed network; returns the SHA-256 of its three files in the order of reading."""
    folder.mkdir(parents=True, exist_ok=True)
    n, j, f = experiment.recorded.shape
    people = [f"S{i + 1:02d}" for i in range(n)]
    hz = [f"{v:.10g}" for v in world.frequency_hz]
    lines = ["subject,repetition,frequency_hz,z_re,z_im"]
    for i in range(n):
        for k in range(j):
            z = experiment.recorded[i, k]
            lines += [f"{people[i]},{k + 1},{hz[m]},{z[m].real:.9g},{z[m].imag:.9g}" for m in range(f)]
    texts = {"recordings.csv": "\n".join(lines) + "\n"}
    if experiment.covariates:
        names = list(experiment.covariates)
        rows = [f"{people[i]}," + ",".join(f"{experiment.covariates[c][i]:.9g}" for c in names) for i in range(n)]
        texts["subjects.csv"] = "\n".join(["subject," + ",".join(names), *rows]) + "\n"
    texts["dataset.toml"] = (
        f'title = "{title}"\nunit = "N s/m"\nsign = "passive positive"\nnetwork = "{notation(world.network)}"\n'
        'source = "simulated: a world drawn from a seed, not measured"\nlicence = "MIT"\n'
    )
    digest = hashlib.sha256()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
        digest.update(text.encode())
    return digest.hexdigest()


def digest_of(folder: Path) -> str:
    """SHA-256 of a dataset on disk, as :func:`write_dataset` returns it."""
    digest = hashlib.sha256()
    for name in ("recordings.csv", "subjects.csv", "dataset.toml"):
        if (folder / name).is_file():
            digest.update((folder / name).read_bytes())
    return digest.hexdigest()


def answer(world: World, folder: Path, case: str) -> dict[str, Any]:
    """Conduct a case, write its dataset, and say what is true of it."""
    experiment = conduct(world)
    digest = write_dataset(world, experiment, folder, case)
    seen = visibilities(world, experiment)
    members = [None if row.all() else [f"S{i + 1:02d}" for i in np.flatnonzero(row)] for row in experiment.members]
    return {"case": case, "data_sha256": digest, "visible": seen, "members": members, **described(world)}


def prepare(seed: int, n_cases: int, out: Path, small: bool = False) -> str:
    """Write all datasets and seal the answers; returns the seal.

    Datasets that are there are written again from the seed, so that nothing on disk needs to be trusted.
    """
    out.mkdir(parents=True, exist_ok=True)
    answers = []
    for i in range(n_cases):
        case = f"{seed}-{i + 1:03d}"
        answers.append(answer(draw(seed, i, small), out / "datasets" / case, case))
    content = json.dumps({"seed": seed, "small": small, "cases": answers}, indent=1, sort_keys=True) + "\n"
    seal = hashlib.sha256(content.encode()).hexdigest()
    (out / SEALED).write_text(content, encoding="utf-8")
    (out / SEAL).write_text(seal + "\n", encoding="utf-8")
    (out / USED).write_text(sources() + "\n", encoding="utf-8")
    return seal


def answers_of(out: Path) -> list[dict[str, Any]]:
    """The answers, if they are those that were sealed.

    Raises
    ------
    ValueError
        If they are not.
    """
    content = (out / SEALED).read_bytes()
    if hashlib.sha256(content).hexdigest() != (out / SEAL).read_text(encoding="utf-8").strip():
        raise ValueError(f"{out / SEALED} is not what was sealed: its SHA-256 differs from {SEAL}")
    cases: list[dict[str, Any]] = json.loads(content)["cases"]
    return cases


def verdicts_of(out: Path) -> dict[str, dict[str, Any]]:
    """Records by the digest of their data; a line that a kill has cut off is skipped."""
    found: dict[str, dict[str, Any]] = {}
    path = out / VERDICTS
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else []:
        try:
            record = json.loads(line)
        except json.JSONDecodeError:
            continue
        found[record["data_sha256"]] = record
    return found


def may_run(out: Path, n_cases: int, again: bool) -> bool:
    """Whether a seed's cases are to be drawn and sealed; False if a run that was interrupted goes on.

    Raises
    ------
    SeedUsedError
        If its verdicts are complete, or begun with other sources or another number of cases.
    """
    if not (out / USED).is_file():
        return True
    if again:
        (out / VERDICTS).unlink(missing_ok=True)
        (out / AGAIN).write_text("used more than once: says nothing about new worlds\n", encoding="utf-8")
        return True
    answers, on_file = answers_of(out), verdicts_of(out)
    if len(answers) != n_cases:
        raise SeedUsedError(f"{out.name} was sealed with {len(answers)} cases, not {n_cases}; take another seed")
    if all(a["data_sha256"] in on_file for a in answers):
        raise SeedUsedError(f"{out.name} is used: all its verdicts are on file; take another seed, or --again")
    if (out / USED).read_text(encoding="utf-8").strip() != sources():
        raise SeedUsedError(f"{out.name} was begun with other sources of the package; take another seed, or --again")
    return False


def slim(verdict: Mapping[str, Any]) -> dict[str, Any]:
    """What the score and a reader need of a verdict."""
    physics = []
    for entry in verdict.get("physics") or []:
        kept = {k: v for k, v in entry.items() if k not in ("story", "look_for", "source", "evidence", "aliases")}
        kept["elpd_gain"] = (entry.get("evidence") or {}).get("elpd_gain")
        kept["elpd_gain_se"] = (entry.get("evidence") or {}).get("elpd_gain_se")
        kept["aliases"] = [
            {k: a.get(k) for k in ("id", "place", "elpd_behind", "separated")} for a in entry.get("aliases") or []
        ]
        physics.append(kept)
    keys = ("mismatch", "summary", "improvement", "reliable", "remarks", "shortcomings", "data_sha256", "version")
    return {k: verdict[k] for k in keys if k in verdict} | {"physics": physics}
