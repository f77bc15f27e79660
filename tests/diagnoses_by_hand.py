"""Diagnoses made by hand: one small one of each kind, for pages and pictures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pages import Page

from bayes_impedance.diagnosis.types import Diagnosis, OnePort, Ranked, Snapshot
from bayes_impedance.diagnosis.verdict_types import (
    Alias,
    BlockGain,
    Detectable,
    EvidenceOfEffect,
    Improvement,
    Joint,
    Located,
    Parameter,
    ParameterDifference,
    Physics,
    Verdict,
    Where,
)
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.report.diagnosis_page import write_diagnosis_report

CIRCUIT = "r0|(r1-n1)|(r2-n2)"


VALUES = {"n3": 8e-6, "r3": 61.4, "m2": 7.9e-4, "r1": 5.0, "n1": 1.15e-3, "m1": 0.02, "n2": 4e-4, "r2": 3.0}


CELL = {"r0": 0.02, "r1": 0.01, "n1": 0.5, "r2": 0.03, "n2": 40.0}


SUMMARY = "The phase runs ahead above 700 Hz in everybody: 1.5 µs of channel delay explain it."


LIMITS = tuple(
    Detectable(id=effect, name="", place=place, parameter="size", above=above, unit=unit, shape={})
    for effect, place, above, unit in (
        ("rig.mass", "port", 2.1e-6, "kg"),
        ("rig.delay", "port", 3.1e-8, "s"),
        ("body.relaxation", "skin", 0.34, "N s/m"),
        ("body.relaxation", "tissue", 0.012, "N s/m"),
        ("rig.lowpass", "port", 41e3, "Hz"),
    )
)


ALIASES = (
    Alias(
        id="rig.mass",
        name="",
        place="port",
        elpd_behind=55.2,
        separated=True,
        would_separate="a recording without a finger",
    ),
    Alias(
        id="rig.series_compliance",
        name="",
        place="port",
        elpd_behind=1.3,
        separated=False,
        would_separate="frequencies above 8 kHz, or a stiff dummy in place of the finger",
    ),
)


DELAY = Physics(
    kind="effect",
    id="rig.delay",
    name="a delay between the channels",
    story="The force is sampled a little later than the acceleration. The phase falls with frequency.",
    formula="z e^(-s tau)",
    place="port",
    side="rig",
    pooling="shared",
    parameters={"delay": Parameter("s", 1.5e-6, 1.42e-6, 1.61e-6, 0.0)},
    dispersion_interval=(0.0, 0.031),
    evidence=EvidenceOfEffect(2096.3, 0.0, 985.0, 40.0),
    aliases=ALIASES,
)


RESONATOR = replace(
    DELAY,
    id="body.resonator",
    name="a further joint or bone that swings along",
    story="Another mass on a spring swings inside of the tissue. It takes energy near its own frequency.",
    formula="s m - (r + k/s)",
    place="tissue",
    side="body",
    pooling="varying",
    parameters={
        "mass": Parameter("kg", 2.4e-4, 1.9e-4, 3.1e-4, 0.31),
        "resonance": Parameter("Hz", 1310.0, 1240.0, 1390.0, 0.08),
    },
    dispersion_interval=(0.22, 0.44),
    evidence=EvidenceOfEffect(310.4, 3.2e-41, 121.0, None),
    aliases=tuple(replace(ALIASES[i % 2], id=f"body.line{i}", elpd_behind=3.0 * i) for i in range(30)),
)


UNKNOWN = Physics(
    kind="unknown",
    id="unknown",
    name="physics outside the catalogue",
    story="No effect of the catalogue explains what is missing.",
    formula="a small network",
    place="port",
    side=None,
    pooling="shared",
    parameters={},
    evidence=EvidenceOfEffect(None, None, 985.0, 40.0),
    network="r9-(n9|m9)",
    connection="beside",
)


def verdict_of(physics: tuple[Physics, ...], network: str, after: str | None, **changes: Any) -> Verdict:
    """A verdict by hand."""
    found = bool(physics)
    verdict = Verdict(
        summary=SUMMARY if found else "Nothing is missing that these recordings could show.",
        where=Where(
            bands_hz=((700.0, 5000.0),) if found else (),
            part="phase",
            place="port" if found else None,
            side="rig" if found else None,
            subjects="all",
            covariate=None,
        ),
        located=Located(
            p_value=1e-9 if found else 0.4,
            bands=(),
            magnitude_share=0.1,
            subjects_p_value=1.0,
        ),
        physics=physics,
        improvement=Improvement(
            delta_magnitude=(1.31, 1.27),
            delta_phase_deg=(8.7, 8.1),
            subject_rms_relative=(0.034, 0.021),
            coverage90=(0.82, 0.898),
            elpd_gain=985.0,
            elpd_gain_se=40.0,
            blocks=BlockGain(900.0, 50.0),
            held_out="5 subject folds, 8 frequency blocks",
        ),
        network=(network, after or network),
        detectable=LIMITS,
        not_identifiable=("gain",),
        elements_not_identified=("n3",),
        seed=7,
        data_sha256="ab12" * 16,
        title="ten <fingers> & a thumb",
        unit="N s/m",
        reliable=True,
        remarks=(),
        version="0.1.0",
    )
    return replace(verdict, **changes)


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
        person_curve=z * (1 + 0.01 * size),
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
    extra: dict[str, Any] = {}
    physics = {"found": (DELAY,), "two": (DELAY, RESONATOR), "unknown": (UNKNOWN,), "nothing": ()}[kind]
    if kind == "two":
        after = str(parse(before).beside("tissue", parse("m4-(n4|r4)")))
        extra["joint"] = Joint(
            ("rig.delay delay", "body.resonator mass", "body.resonator resonance"),
            ((1, 0.12, -0.61), (0.12, 1, 0.44), (-0.61, 0.44, 1)),
        )
    if kind == "unknown":
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
        fit=None,
        seconds={"screen": 1.2, "confirm": 33.0},
    )


def holes(diagnosis: Diagnosis) -> Diagnosis:
    """The same with all that may be missing missing."""
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
        person_curve=np.full(nan.shape, np.nan + 0j),
    )
    port = diagnosis.one_ports[0]
    nan_number = float("nan")
    entry = replace(
        DELAY,
        side=None,
        parameters={"delay": Parameter("s", nan_number, nan_number, nan_number, None)},
        evidence=EvidenceOfEffect(None, None, None, None),
        aliases=(replace(ALIASES[0], elpd_behind=nan_number),),
        dispersion_interval=None,
    )
    drift = replace(entry, kind="trend", id="body.drift", place="nowhere", parameters={}, aliases=())
    return replace(
        diagnosis,
        verdict=replace(
            diagnosis.verdict,
            physics=(entry, drift),
            improvement=None,
            where=replace(diagnosis.verdict.where, bands_hz=(), place=None, side=None),
            detectable=(),
            not_identifiable=(),
            elements_not_identified=(),
            data_sha256="",
        ),
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
        fit=None,
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
