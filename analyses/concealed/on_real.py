"""Known physics added to real recordings, and whether a diagnosis recovers it.

Run from the repository's root::

    python analyses/concealed/on_real.py [--every 5] [--jobs 1] [-o analyses/concealed/results/on_real]

An effect is added by its formula to every single recording: a mass (for spectra of a battery an inductance, s L), a
delay, or a high-pass. The recordings with it are diagnosed *alone*, and *against* the recordings as they were, which
then stand for what is known already (``diagnose(..., simulation=...)``). *Measured* does not ask for the name: the
model found without the addition is fitted to both with the effect at the port (``known_model.py``), and the
difference of the estimates is compared with what was added. What was added counts as recovered if

- its id is listed and the 90 % interval, widened to 10 % of the value, holds what was added; where it was listed
  without the addition too, the difference of both estimates counts; or
- the entries listed at the port change the recordings as the addition does, to 10 % of the sum of squares (a small
  delay of a resistance is a negative inductance).

Sizes are chosen by their effect: the largest relative change of the median recording is the given share. Curves of the
appendix are one recording each, so that rig and body cannot be told apart. The battery spectra are found through the
environment variable BAYES_IMPEDANCE_REAL_DATA; every fifth of them is taken by default.
"""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from runs import Record, read_lines, replace_between, run_cases

from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.recordings.files import read_recordings

HERE = Path(__file__).resolve().parent
DATA = HERE.parents[1] / "data" / "appendix_a"
FILE = "on_real.jsonl"
EFFECTS: Mapping[str, tuple[str, ...]] = {
    "mass": ("rig.mass", "body.mass"),
    "delay": ("rig.delay",),
    "highpass": ("rig.highpass",),
}
"""Additions, and the ids that count as right: an effect that is equal in all spectra may be of the rig or the body."""

PARAMETER = {"mass": ("mass",), "delay": ("delay",), "highpass": ("corner", "corner_hz")}
MODES = ("alone", "against", "measured")
SHARE = 0.1
"""Largest relative change by an addition: ten times a noise of 1 %."""
_TOLERANCE = 0.1
"""Of the size and of the sum of squares, in the criteria of the module's docstring."""


def change(effect: str, size: float, s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A recording with the effect: s (F,), z (..., F); size in kg (or H), s, or Hz."""
    match effect:
        case "mass":
            return np.asarray(z + s * size)
        case "delay":
            return np.asarray(z * np.exp(-s * size))
        case "highpass":
            return np.asarray(z * s / (s + 2 * np.pi * size))
    raise ValueError(f"no effect is called {effect!r}: there are {', '.join(EFFECTS)}")


def size_for(effect: str, recordings: Recordings, share: float) -> float:
    """Size at which the largest relative change of the median recording is the share."""
    w = np.concatenate([2 * np.pi * s.frequency_hz for s in recordings.subjects])
    magnitude = np.concatenate([np.abs(s.mean) for s in recordings.subjects])
    match effect:
        case "mass":
            high = w > 0.99 * w.max()
            return float(share * np.median(magnitude[high]) / w.max())
        case "delay":
            return share / float(w.max())
    return share * float(w.min()) / (2 * np.pi)


def changed(recordings: Recordings, effect: str, size: float) -> Recordings:
    """Every single recording with the effect in it."""
    subjects = tuple(replace(s, z=change(effect, size, 2j * np.pi * s.frequency_hz, s.z)) for s in recordings.subjects)
    return replace(recordings, subjects=subjects, sha256="")


def source(name: str, every: int) -> Recordings:
    """Real recordings: a curve of the appendix, or some of the battery spectra."""
    if name != "battery_130":
        return read_recordings(DATA / name)
    recordings = read_recordings(Path(os.environ["BAYES_IMPEDANCE_REAL_DATA"]) / name)
    return recordings.select(recordings.names[::every])


def one_case(case: Mapping[str, Any]) -> Record:
    """Verdict, with an effect added or (size 0) without."""
    from bayes_impedance.diagnosis.diagnose import diagnose
    from bayes_impedance.diagnosis.verdict_file import to_json

    recordings = source(case["data"], case["every"])
    if case["mode"] == "measured":
        from known_model import without_and_with

        size = size_for(case["effect"], recordings, case["share"])
        after = changed(recordings, case["effect"], size)
        pair = without_and_with(recordings, after, EFFECTS[case["effect"]][0])
        return {"size": size, "estimates": [list(estimate) for estimate in pair]}
    if not case["effect"]:
        return {"size": 0.0, "verdict": to_json(diagnose(recordings, quick=True, seed=1, workers=1).verdict)}
    size = size_for(case["effect"], recordings, case["share"])
    known = recordings if case["mode"] == "against" else None
    after = changed(recordings, case["effect"], size)
    found = to_json(diagnose(after, simulation=known, quick=True, seed=1, workers=1).verdict)
    return {"size": size, "verdict": found, "explained": explained(found, recordings, case["effect"], size)}


def explained(verdict: Mapping[str, Any], recordings: Recordings, effect: str, size: float) -> float:
    """Share (sum of squares) of the relative change by an addition that the entries listed at the port reproduce."""
    left = total = 0.0
    for subject in recordings.subjects:
        s = 2j * np.pi * subject.frequency_hz
        z = subject.z
        for entry in verdict["physics"]:
            if entry["place"] == "port":
                z = claimed_change(entry, s, z)
        true = change(effect, size, s, subject.z)
        left += float(np.sum(np.abs((z - true) / subject.z) ** 2))
        total += float(np.sum(np.abs((true - subject.z) / subject.z) ** 2))
    return 1 - left / total


def claimed_change(entry: Mapping[str, Any], s: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Change at the port by an entry of a verdict; None if its formula is not known here."""
    p = {name: row["median"] for name, row in entry["parameters"].items()}
    match entry["id"]:
        case "rig.mass" | "body.mass":
            return change("mass", p["mass"], s, z)
        case "rig.delay":
            return change("delay", p["delay"], s, z)
        case "rig.highpass":
            return change("highpass", p.get("corner", p.get("corner_hz", 0.0)), s, z)
        case "rig.lowpass":
            return np.asarray(z / (1 + s * p["time_constant"]))
        case "rig.damping":
            return z + p["damping"]
        case "rig.stiffness":
            return np.asarray(z + p["stiffness"] / s)
        case "rig.resonance" | "body.resonator":
            return z + 1 / (1 / (s * p["mass"]) + 1 / (p["damping"] + 1 / (s * p["compliance"])))
        case "rig.series_compliance":
            return np.asarray(1 / (1 / z + s * p["compliance"]))
    return z


def estimate(verdict: Mapping[str, Any], effect: str) -> tuple[float, float, float] | None:
    """Lower end, median and upper end of the effect's size at the port, where the verdict lists it."""
    for entry in verdict["physics"]:
        if entry["id"] in EFFECTS[effect] and entry["place"] == "port":
            for name in PARAMETER[effect]:
                if name in entry["parameters"]:
                    p = entry["parameters"][name]
                    return float(p["q05"]), float(p["median"]), float(p["q95"])
    return None


def recovered(
    before: Mapping[str, Any], after: Mapping[str, Any], effect: str, size: float, share: float
) -> tuple[bool, str]:
    """Whether what was added was found, and the numbers that say so.

    Parameters
    ----------
    before, after : mapping
        Verdicts; an empty list of physics before if what is known already was given.
    effect : str
    size : float
    share : float
        Of :func:`explained`.
    """
    old, new = estimate(before, effect), estimate(after, effect)
    if new is None:
        return share > 1 - _TOLERANCE, f"not listed; the same to {100 * share:.0f} %" if share > 0 else "not listed"
    right, numbers = difference(old or (0.0, 0.0, 0.0), new, size)
    return right or share > 1 - _TOLERANCE, numbers + ("" if old is None else " (difference)")


def difference(old: Sequence[float], new: Sequence[float], size: float) -> tuple[bool, str]:
    """Whether two estimates (lower end, median, upper end) differ by what was added."""
    middle = new[1] - old[1]
    half = math.hypot(0.5 * (new[2] - new[0]), 0.5 * (old[2] - old[0]))
    return abs(middle - size) <= max(half, _TOLERANCE * abs(size)), f"{middle:.3g} ± {half:.2g}"


def table(records: Sequence[Record]) -> str:
    """One line for each addition."""
    head = ["recordings", "added", "size", "diagnosed", "found", "recovered", "said"]
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    for name in dict.fromkeys(r["case"]["data"] for r in records):
        own = [r for r in records if r["case"]["data"] == name]
        before = next((r for r in own if not r["case"]["effect"]), None)
        if before is not None:
            lines.append(f"| {name} | nothing | - | alone | - | - | {_said(before['verdict'])} |")
        for r in sorted(own, key=lambda r: (MODES.index(r["case"]["mode"]), r["case"]["effect"])):
            effect, mode = r["case"]["effect"], r["case"]["mode"]
            if not effect or (before is None and mode == "alone"):
                continue
            if mode == "measured":
                right, numbers = difference(*r["estimates"], r["size"])
            else:
                against = mode == "against" or before is None
                known: Mapping[str, Any] = {"physics": []} if against or before is None else before["verdict"]
                right, numbers = recovered(known, r["verdict"], effect, r["size"], r["explained"] if against else 0.0)
            said = "-" if mode == "measured" else _said(r["verdict"])
            cells = [name, effect, f"{r['size']:.3g}", mode, numbers, "yes" if right else "no", said]
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _said(verdict: Mapping[str, Any]) -> str:
    return ", ".join(f"{p['id']} at {p['place']}" for p in verdict["physics"]) or "nothing"


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--every", type=int, default=5, help="take every so-many-th battery spectrum")
    parser.add_argument("--share", type=float, default=SHARE, help="largest change over the magnitude")
    parser.add_argument("--only", nargs="+", metavar="DATA", help="some of: vf_median sit battery_130")
    parser.add_argument("--jobs", type=int, default=2, help="processes; 0 works in this one")
    parser.add_argument("-o", "--out", type=Path, default=HERE / "results" / "on_real")
    options = parser.parse_args(arguments)
    names = options.only or ["vf_median", "sit", "battery_130"]
    if "battery_130" in names and not os.environ.get("BAYES_IMPEDANCE_REAL_DATA"):
        print("BAYES_IMPEDANCE_REAL_DATA is not set: the battery spectra are left out")
        names.remove("battery_130")
    asked = [
        {"data": name, "effect": effect, "share": options.share, "every": options.every, "mode": mode}
        for name in names
        for effect in ("", *EFFECTS)
        for mode in (MODES if effect else MODES[:1])
    ]
    run_cases(asked, one_case, options.out / FILE, options.jobs)
    text = table([r for r in read_lines(options.out / FILE) if "error" not in r and r["case"] in asked])
    (options.out / "on_real.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    if not options.only:
        replace_between(HERE / "CHALLENGE.md", "on-real", text)


if __name__ == "__main__":
    main()
