"""Diagnoses with chosen contents, for tests of pages and pictures; nothing in them is computed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pages import Page

from bayes_impedance.diagnosis.types import Diagnosis, OnePort, ParameterDifference, Ranked, Snapshot
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.report.diagnosis_page import write_diagnosis_report

CIRCUIT = "r0|(r1-n1)|(r2-n2)"
VALUES = {"n3": 8e-6, "r3": 61.4, "m2": 7.9e-4, "r1": 5.0, "n1": 1.15e-3, "m1": 0.02, "n2": 4e-4, "r2": 3.0}
CELL = {"r0": 0.02, "r1": 0.01, "n1": 0.5, "r2": 0.03, "n2": 40.0}
SUMMARY = "The phase runs ahead above 700 Hz in everybody: 1.5 µs of channel delay explain it."
LIMITS = [
    {"id": "rig.mass", "place": "port", "above": 2.1e-6, "unit": "kg"},
    {"id": "rig.delay", "place": "port", "above": 3.1e-8, "unit": "s"},
    {"id": "body.relaxation", "place": "skin", "above": 0.34, "unit": "N s/m"},
    {"id": "body.relaxation", "place": "tissue", "above": 0.012, "unit": "N s/m"},
    {"id": "body.relaxation", "place": "limb", "above": None, "unit": "N s/m"},
    {"id": "rig.lowpass", "place": "port", "above": 41e3, "unit": "Hz"},
]


def delay_entry(**changes: Any) -> dict[str, Any]:
    """The card of a channel delay."""
    entry = {
        "id": "rig.delay",
        "name": "a delay between the channels",
        "story": "The force is sampled a little later than the acceleration. The phase falls with frequency.",
        "formula": "z e^(-s tau)",
        "place": "port",
        "side": "rig",
        "pooling": "shared",
        "parameters": {"delay": {"unit": "s", "median": 1.5e-6, "q05": 1.42e-6, "q95": 1.61e-6, "dispersion": 0.012}},
        "dispersion_interval": [0.0, 0.031],
        "evidence": {"score": 2096.3, "p_value": 0.0, "elpd_gain": 985.0, "elpd_gain_se": 40.0},
        "aliases": [
            {
                "id": "rig.mass",
                "place": "port",
                "elpd_behind": 55.2,
                "separated": True,
                "would_separate": "a recording without a finger",
            },
            {
                "id": "rig.series_compliance",
                "place": "port",
                "elpd_behind": 1.3,
                "separated": False,
                "would_separate": "frequencies above 8 kHz, or a stiff dummy in place of the finger",
            },
        ],
    }
    return entry | changes


def verdict_of(physics: list[dict[str, Any]], network: str, after: str | None, **changes: Any) -> dict[str, Any]:
    """A verdict by the schema."""
    found = bool(physics)
    verdict = {
        "schema": 1,
        "mismatch": found,
        "summary": SUMMARY if found else "Nothing is missing that these recordings could show.",
        "where": {
            "bands_hz": [[700.0, 5000.0]] if found else [],
            "part": "phase" if found else None,
            "place": "port" if found else None,
            "side": "rig" if found else None,
            "subjects": "all",
            "covariate": None,
        },
        "physics": physics,
        "improvement": {
            "delta_magnitude": [1.31, 1.27],
            "delta_phase_deg": [8.7, 8.1],
            "subject_rms_relative": [0.034, 0.021],
            "coverage90": [0.82, 0.898],
            "elpd_gain": 985.0,
            "elpd_gain_se": 40.0,
            "held_out": "5 subject folds, 8 frequency blocks",
        },
        "network": [network, after or network],
        "unexplained": None,
        "detectable": LIMITS,
        "not_identifiable": ["gain"],
        "elements_not_identified": ["n3"],
        "seed": 7,
        "data_sha256": "ab12" * 16,
        "version": "0.1.0",
    }
    return verdict | changes


def snapshot(label: str, network: str, z: np.ndarray, f: np.ndarray, shift: np.ndarray, seed: int) -> Snapshot:
    """Noise as residuals, with `shift` (2, F) in magnitude and phase added to everybody's."""
    rng = np.random.default_rng(seed)
    n = len(z)
    near = np.exp(-0.5 * (np.subtract.outer(np.log(f), np.log(f)) / 0.15) ** 2)
    smooth = near / near.sum(axis=1, keepdims=True)
    spread = np.exp(0.3 * np.array([-1.64, 0.0, 1.64]))[:, None]
    middle = np.exp(smooth @ np.log(np.abs(z)).mean(axis=0))
    each = np.linspace(0.5, 1.5, n)[:, None] if n > 1 else np.ones((1, 1))
    size = np.abs(shift).mean()
    return Snapshot(
        label=label,
        network=network,
        frequency_hz=f,
        magnitude=spread * middle,
        phase_deg=np.degrees(smooth @ np.angle(z).mean(axis=0)) + np.array([-12.0, 0.0, 12.0])[:, None],
        residual_magnitude=rng.normal(size=(n, f.size)) + each * shift[0],
        residual_phase=rng.normal(size=(n, f.size)) + each * shift[1],
        delta_magnitude=0.25 * middle * (1 + 0.05 * size),
        delta_phase_deg=np.full(f.size, 8.0 + size) + rng.normal(0, 0.3, f.size),
        subject_rms_relative=np.exp(rng.normal(np.log(0.02 + 0.01 * size), 0.2, n)),
        coverage90=np.clip(0.9 - 0.1 * size + rng.normal(0, 0.03, (2, f.size)), 0, 1),
    )


def rank(i: int, **changes: Any) -> Ranked:
    """A line of the ranking."""
    row = Ranked(
        id=("rig.delay", "rig.mass", "rig.series_compliance", "body.springpot", "body.resonator")[i % 5],
        place=("port", "port", "port", "skin", "tissue")[i % 5],
        pooling=("shared", "shared", "shared", "varying", "some")[i % 5],
        shape="" if i % 5 < 3 else "peak at 310 Hz",
        score=2096.3 * 0.62**i,
        p_value=0.0 if i == 0 else min(1.0, 10.0 ** (-200 + 14 * i)),
        size=f"{1.5 / (i + 1):.2g} µs",
        physical=i % 4 != 3,
        likeness=(-1.0) ** i * 0.985**i,
        note="found" if i == 0 else "alias, 55 behind" if i == 1 else "",
    )
    return replace(row, **changes)


def make_diagnosis(
    kind: str = "found", *, subjects: int = 20, repetitions: int = 3, electrical: bool = False, size: int = 40
) -> Diagnosis:
    """A diagnosis by hand: ``found`` (a delay), ``two``, ``unknown`` or ``nothing``."""
    rng = np.random.default_rng(11)
    f = np.geomspace(0.1, 1000, size) if electrical else np.geomspace(5, 5000, size)
    before, values = (CIRCUIT, CELL) if electrical else (PAPER_NETWORK, VALUES)
    each = {name: value * np.exp(0.3 * rng.normal(size=(subjects, 1))) for name, value in values.items()}
    noise = rng.normal(size=(subjects, size)) + 1j * rng.normal(size=(subjects, size))
    z = parse(before).impedance(2j * np.pi * f, each) * (1 + 0.02 * noise)
    after: str | None = None
    physics: list[dict[str, Any]] = []
    extra: dict[str, Any] = {}
    if kind in ("found", "two"):
        physics = [delay_entry()]
    if kind == "two":
        after = str(parse(before).beside("tissue", parse("m4-(n4|r4)")))
        parameters = {
            "mass": {"unit": "kg", "median": 2.4e-4, "q05": 1.9e-4, "q95": 3.1e-4, "dispersion": 0.31},
            "resonance": {"unit": "Hz", "median": 1310.0, "q05": 1240.0, "q95": 1390.0, "dispersion": 0.08},
        }
        physics.append(
            delay_entry(
                id="body.resonator",
                name="a further joint or bone that swings along",
                story="Another mass on a spring swings inside of the tissue. It takes energy near its own frequency.",
                formula="s m - (r + k/s)",
                place="tissue",
                side="body",
                pooling="varying",
                parameters=parameters,
                dispersion_interval=[0.22, 0.44],
                evidence={"score": 310.4, "p_value": 3.2e-41, "elpd_gain": 121.0, "elpd_gain_se": None},
                aliases=[
                    delay_entry()["aliases"][i % 2] | {"id": f"body.line{i}", "elpd_behind": 3.0 * i} for i in range(30)
                ],
            )
        )
        extra["joint"] = {
            "parameters": ["rig.delay delay", "body.resonator mass", "body.resonator resonance"],
            "correlation": [[1, 0.12, -0.61], [0.12, 1, 0.44], [-0.61, 0.44, 1]],
        }
    if kind == "unknown":
        entry = delay_entry(id="unknown", formula=None, network="r9-(n9|m9)", place="port", side=None)
        physics = [entry | {"name": None, "story": None, "dispersion_interval": None, "parameters": {}, "aliases": []}]
        extra["unexplained"] = {"place": "port", "side": "body", "network": "r9-(n9|m9)", "share": 0.8}
        extra["summary"] = "Something is missing that nothing in the catalogue describes."
    verdict = verdict_of(physics, before, after, **extra)
    high = f > f[-1] / 7
    shift = np.stack([0.2 * high, -1.8 * high * (f / f[-1])]) if physics else np.zeros((2, size))
    ratio = (f / f[-1]) ** 2 * (0.15 + 0.3j) + 0.01 * (rng.normal(size=size) + 1j * rng.normal(size=size))
    places = ("port", "tissue", "skin", "limb", "m2", "r1") if not electrical else ("port",)
    return Diagnosis(
        title="ten <fingers> & a thumb",
        unit="ohm" if electrical else "N s/m",
        subjects=tuple(f"P{i:02d}" for i in range(1, subjects + 1)),
        repetitions=repetitions,
        verdict=verdict,
        before=snapshot("before", before, z, f, shift, 1),
        after=snapshot("after", after or before, z, f, np.zeros((2, size)), 2) if physics else None,
        observed=z,
        ranking=tuple(rank(i) for i in range(22))
        if physics
        else tuple(rank(i, score=6.0 - i, p_value=1.0, note="") for i in (0, 2)),
        one_ports=tuple(
            OnePort(p, f, ratio * (i + 1), np.full(size, 0.02 * (i + 1)), 0.96 / (i + 1)) for i, p in enumerate(places)
        ),
        differences=(),
        seconds={"screen": 1.2, "confirm": 33.0},
    )


def holes(diagnosis: Diagnosis) -> Diagnosis:
    """The same with all that may be missing missing."""
    nothing = dict.fromkeys(diagnosis.verdict)
    nan = np.full_like(diagnosis.before.residual_phase, np.nan)
    some = diagnosis.before.residual_magnitude.copy()
    some[:, :5] = np.nan
    observed = diagnosis.observed.copy()
    observed[:, 3], observed[0, 20:] = np.nan, np.nan
    empty = np.full(nan.shape[1], np.nan)
    broken = replace(
        diagnosis.before,
        residual_phase=nan,
        residual_magnitude=some,
        delta_phase_deg=empty,
        delta_magnitude=empty,
        subject_rms_relative=np.full(nan.shape[0], np.nan),
        coverage90=np.full((2, nan.shape[1]), np.nan),
    )
    port = diagnosis.one_ports[0]
    entry = dict.fromkeys(delay_entry()) | {
        "id": "rig.delay",
        "parameters": {"delay": {"unit": "s", "median": None, "q05": None, "q95": None, "dispersion": None}},
        "evidence": {"score": None, "p_value": None, "elpd_gain": None, "elpd_gain_se": None},
        "aliases": [{"id": "rig.mass", "place": "port", "elpd_behind": None, "separated": None}],
    }
    return replace(
        diagnosis,
        verdict=nothing | {"mismatch": True, "physics": [entry, {"id": "body.drift", "place": "nowhere"}]},
        before=broken,
        after=replace(broken, label="after"),
        observed=observed,
        one_ports=(replace(port, sd=empty, share=np.nan), replace(port, ratio=1j * empty)),
        ranking=(rank(0, score=np.nan, p_value=np.nan, likeness=np.nan, size=""),),
        differences=(
            ParameterDifference(
                element="m2",
                unit="kg",
                what="central",
                simulation=8e-4,
                recordings=np.nan,
                ratio=np.nan,
                q05=np.nan,
                q95=np.nan,
                p_value=np.nan,
            ),
        ),
        seconds={},
    )


def page_of(diagnosis: Diagnosis, folder: Path) -> tuple[str, Page]:
    """The page without pictures: those are slow, and tested by themselves."""
    text = write_diagnosis_report(diagnosis, folder, pictures={}).read_text(encoding="utf-8")
    return text, Page(text)


VARIANTS: dict[str, dict[str, Any]] = {
    "found": {"kind": "found"},
    "two": {"kind": "two", "subjects": 130},
    "unknown": {"kind": "unknown", "subjects": 1, "repetitions": 1, "electrical": True},
    "nothing": {"kind": "nothing", "subjects": 71},
}
