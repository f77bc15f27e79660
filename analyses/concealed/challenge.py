"""A blind challenge: datasets drawn at random, answers fixed by a hash before any diagnosis, then a score.

``sealed.json`` holds for every case the true effects and the digest of its dataset. Its SHA-256 is printed and written
to ``seal.txt`` before the first diagnosis. A diagnosis gets the folder of a dataset and nothing else; its verdict
holds the digest of the data it has read. The score is computed only if seal, datasets and verdicts are still
consistent.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from people import NETWORK, Conditions
from runs import Record
from visible_in_world import truth_of
from world.experiment import Experiment, Plan, conduct
from world.kinds import KINDS, PAIRS

from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.recordings.files import read_recordings, write_recordings

SHARES = {"catalogue": 0.45, "pair": 0.10, "outside": 0.15, "trap": 0.12, "nothing": 0.18}
"""Shares of the cases. Kinds within a group are drawn without replacement until all have been drawn once."""

STRENGTHS = (0.1, 0.5)
"""A strength of 0.3 is a change by about a tenth of the magnitude (``cases.py``): here from a thirtieth to a sixth."""

STRUCTURE_STRENGTHS = (0.4, 0.85)
"""A covariate or a creep below 0.4 of a standard deviation can be detected with hundreds of people only."""

SEALED, SEAL = "sealed.json", "seal.txt"


@dataclass(frozen=True)
class Sizes:
    """Possible sizes of a dataset; each case draws one of each."""

    subjects: tuple[int, ...] = (20, 30, 40, 60)
    points: tuple[int, ...] = (101, 201)


def draw(seed: int, n_cases: int, sizes: Sizes | None = None) -> list[Plan]:
    """Plans of a challenge, in random order."""
    sizes = sizes or Sizes()
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(11,)))
    counts = {group: round(share * n_cases) for group, share in SHARES.items()}
    counts["catalogue"] += n_cases - sum(counts.values())
    drawn = [kinds for group, count in counts.items() for kinds in _dealt(group, count, rng)]
    return [_plan(drawn[i], rng, sizes) for i in rng.permutation(len(drawn))]


def _dealt(group: str, count: int, rng: np.random.Generator) -> Iterator[tuple[str, ...]]:
    if group == "pair":
        deck: list[tuple[str, ...]] = list(PAIRS)
    else:
        deck = [(kind.name,) for kind in KINDS.values() if kind.group == group]
    order: list[int] = []
    for _ in range(count):
        order = order or [int(i) for i in rng.permutation(len(deck))]
        yield deck[order.pop()]


def _plan(kinds: tuple[str, ...], rng: np.random.Generator, sizes: Sizes) -> Plan:
    strengths = []
    for name in kinds:
        structure = KINDS[name].special in ("covariate", "creep.session")
        low, high = STRUCTURE_STRENGTHS if structure else STRENGTHS
        strengths.append(round(float(np.exp(rng.uniform(np.log(low), np.log(high)))), 3))
    return Plan(
        kinds=kinds,
        strengths=tuple(strengths),
        seed=int(rng.integers(1, 2**31)),
        n_subjects=int(rng.choice(sizes.subjects)),
        n_points=int(rng.choice(sizes.points)),
        conditions=Conditions(
            gain_error=round(float(rng.uniform(-0.03, 0.03)), 4),
            communality=round(float(rng.uniform(0.0, 0.9)), 3),
            centre_sd=0.1,
        ),
    )


def recordings_of(experiment: Experiment, title: str) -> Recordings:
    """The experiment as the package gets it: readings and covariates, without any information on the true effects."""
    plan = experiment.plan
    subjects = tuple(
        Subject(
            name=f"P{i + 1:03d}",
            frequency_hz=plan.frequency_hz,
            z=z,
            repetitions=tuple(str(j + 1) for j in range(plan.n_repetitions)),
            covariates={name: float(values[i]) for name, values in experiment.covariates.items()},
        )
        for i, z in enumerate(experiment.recorded)
    )
    return Recordings(
        title=title,
        unit="N s/m",
        network=NETWORK,
        source="simulated: a virtual world, not measured",
        licence="MIT",
        subjects=subjects,
    )


def reachable(plan: Plan) -> tuple[Plan, Experiment]:
    """Conduct the experiment; an effect that cannot reach the requested strength gets less."""
    for _ in range(20):
        try:
            return plan, conduct(plan)
        except ValueError:
            plan = replace(plan, strengths=tuple(round(0.8 * s, 3) for s in plan.strengths))
    raise ValueError(f"{plan.kinds} cannot be made at any strength")


def prepare(plans: Sequence[Plan], out: Path, seed: int) -> str:
    """Write datasets and sealed answers, anew from the plans; returns the seal, the SHA-256 of the answers."""
    answers = []
    for i, asked in enumerate(plans):
        folder = f"case_{i + 1:03d}"
        plan, experiment = reachable(asked)
        write_recordings(recordings_of(experiment, folder), out / "datasets" / folder, significant_digits=8)
        digest = read_recordings(out / "datasets" / folder).sha256
        answers.append({"case": folder, "data_sha256": digest, "plan": plan_dict(plan), "truth": truth_of(experiment)})
    content = json.dumps({"seed": seed, "cases": answers}, indent=1, sort_keys=True) + "\n"
    (out / SEALED).write_text(content, encoding="utf-8")
    seal = hashlib.sha256(content.encode()).hexdigest()
    (out / SEAL).write_text(seal + "\n", encoding="utf-8")
    return seal


def plan_dict(plan: Plan) -> dict[str, Any]:
    """What is needed to conduct the same experiment again."""
    return {
        "kinds": list(plan.kinds),
        "strengths": list(plan.strengths),
        "seed": plan.seed,
        "n_subjects": plan.n_subjects,
        "n_repetitions": plan.n_repetitions,
        "n_points": plan.n_points,
        "band": list(plan.band),
        "conditions": {k: list(v) if isinstance(v, tuple) else v for k, v in vars(plan.conditions).items()},
    }


def plan_from(content: Mapping[str, Any]) -> Plan:
    """The plan of :func:`plan_dict`."""
    conditions = {k: tuple(v) if isinstance(v, list) else v for k, v in content["conditions"].items()}
    own = {k: tuple(v) if isinstance(v, list) else v for k, v in content.items() if k != "conditions"}
    return Plan(**own, conditions=Conditions(**conditions))


def sealed_answers(out: Path) -> list[dict[str, Any]]:
    """The answers, if they match the seal.

    Raises
    ------
    ValueError
        If the answers or a dataset are not those that were sealed.
    """
    content = (out / SEALED).read_bytes()
    if hashlib.sha256(content).hexdigest() != (out / SEAL).read_text(encoding="utf-8").strip():
        raise ValueError(f"{out / SEALED} is not what was sealed: its SHA-256 differs from {SEAL}")
    answers: list[dict[str, Any]] = json.loads(content)["cases"]
    for answer in answers:
        if read_recordings(out / "datasets" / answer["case"]).sha256 != answer["data_sha256"]:
            raise ValueError(f"{out / 'datasets' / answer['case']} is not what was sealed: its digest differs")
    return answers


def blind(case: Mapping[str, Any]) -> Record:
    """Diagnose a dataset given by its folder alone, in a process of its own."""
    from bayes_impedance.diagnosis.diagnose import diagnose
    from bayes_impedance.diagnosis.verdict_file import to_json

    recordings = read_recordings(Path(case["folder"]))
    return {"verdict": to_json(diagnose(recordings, quick=not case.get("full"), seed=case["seed"]).verdict)}


def to_diagnose(out: Path, n_cases: int, full: bool = False) -> list[Record]:
    """Cases for :func:`blind`, from the folders alone; the digest prevents that an old verdict counts for new data.

    `full` diagnoses end with the population's posterior, from which their intervals then are.
    """
    folders = [out / "datasets" / f"case_{i + 1:03d}" for i in range(n_cases)]
    return [
        {"folder": str(folder), "data_sha256": read_recordings(folder).sha256, "seed": i + 1}
        | ({"full": True} if full else {})
        for i, folder in enumerate(folders)
    ]


def matched(answers: Sequence[Mapping[str, Any]], records: Sequence[Record]) -> list[tuple[Mapping[str, Any], Record]]:
    """Each answer with the record of its dataset.

    Raises
    ------
    ValueError
        If a verdict is of other data than it was filed under.
    """
    by_data = {}
    for record in records:
        digest = record["case"]["data_sha256"]
        if "error" not in record and record["verdict"].get("data_sha256", digest) != digest:
            raise ValueError(f"the verdict on {record['case']['folder']} is of other data")
        by_data[digest] = record
    return [(answer, by_data[answer["data_sha256"]]) for answer in answers if answer["data_sha256"] in by_data]
