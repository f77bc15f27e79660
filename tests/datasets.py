"""Small datasets, as files and in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bayes_impedance.recordings.files import Recordings, Subject

HEADER = "subject,repetition,frequency_hz,z_re,z_im\n"
GOOD = HEADER + "A,1,10,1.0,-0.5\nA,1,20,1.1,-0.4\nA,1,30,1.2,-0.3\nB,1,10,2.0,-0.5\nB,1,20,2.1,0.5\nB,1,30,2.2,1e0\n"
POLAR = "subject,repetition,frequency_hz,magnitude,phase_deg\nA,1,10,2,90\nA,1,20,3,0\nA,1,30,4,-60\n"


def dataset(
    folder: Path, recordings: str | bytes = GOOD, *, subjects: str | None = None, toml: str | None = None
) -> Path:
    content = recordings if isinstance(recordings, bytes) else recordings.encode()
    (folder / "recordings.csv").write_bytes(content)
    if subjects is not None:
        (folder / "subjects.csv").write_text(subjects, encoding="utf-8")
    if toml is not None:
        (folder / "dataset.toml").write_text(toml, encoding="utf-8")
    return folder


def subject(
    name: str = "A", repetitions: int = 2, points: int = 5, *, noise: bool = False, **covariates: float
) -> Subject:
    f = np.geomspace(3.0, 700.0, points)
    j = np.arange(1, repetitions + 1)[:, None]
    z = j / 3 + 2j * np.pi * f * 1e-3
    return Subject(
        name=name,
        frequency_hz=f,
        z=z,
        repetitions=tuple(map(str, j[:, 0])),
        noise_sd=np.abs(z) / 70 if noise else None,
        covariates=covariates,
    )


def recordings(*subjects: Subject) -> Recordings:
    return Recordings(title="Title", unit="N s/m", network="r1|m1", source="a source", licence="MIT", subjects=subjects)


def assert_same(one: Recordings, other: Recordings, rtol: float = 0.0) -> None:
    for name in ("title", "unit", "network", "source", "licence", "names"):
        assert getattr(one, name) == getattr(other, name)
    for a, b in zip(one.subjects, other.subjects, strict=True):
        assert a.repetitions == b.repetitions
        np.testing.assert_array_equal(a.frequency_hz, b.frequency_hz)
        np.testing.assert_allclose(a.z.view(float), b.z.view(float), rtol=rtol)
        assert (a.noise_sd is None) == (b.noise_sd is None)
        if a.noise_sd is not None and b.noise_sd is not None:
            np.testing.assert_allclose(a.noise_sd, b.noise_sd, rtol=rtol)
        for name in {*a.covariates, *b.covariates}:
            np.testing.assert_equal(b.covariates.get(name, np.nan), a.covariates.get(name, np.nan))
