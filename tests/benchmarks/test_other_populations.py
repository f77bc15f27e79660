"""The populations that are compared are what they are said to be, and the table says what was measured."""

import importlib
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population import sampling
from bayes_impedance.population.settings import FitSettings

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
worlds, report = (importlib.import_module(name) for name in ("other_worlds", "report"))
NAMES = list(worlds.WORLDS)


def result(seconds: float, ratio: float, problems: tuple[str, ...] = ()) -> dict[str, Any]:
    full = {"processor seconds": seconds, "autocorrelation time": 39.6, "per processor second": 80.2, "R-hat": 1.0049}
    joint = {
        "times as many by ours": ratio,
        "ratio of standard deviations": [0.93, 1.04],
        "farthest mean": ["mu n1", -0.111, 0.032],
        "farthest from one": ["rho m2", 0.93, 0.04],
    }
    return {"at full size": full | {"problems": list(problems)}, "at a smaller size": {"joint": joint}}


@pytest.mark.parametrize("name", NAMES)
def test_smaller_sizes_are_the_same_people_at_fewer_frequencies(name: str) -> None:
    world = worlds.WORLDS[name]
    whole, few = world.recordings(worlds.FULL), world.recordings(worlds.Size(7, 13))
    assert len(whole.subjects) == world.most_people
    assert len(few.subjects) == 7
    for own, all_of_it in zip(few.subjects, whole.subjects, strict=False):
        kept = np.isin(all_of_it.frequency_hz, own.frequency_hz)
        assert own.frequency_hz.size == 13
        assert own.frequency_hz[[0, -1]].tolist() == all_of_it.frequency_hz[[0, -1]].tolist()
        np.testing.assert_array_equal(own.z, all_of_it.z[:, kept])
        assert len(own.repetitions) == worlds.REPETITIONS


@pytest.mark.parametrize("name", NAMES)
def test_the_rival_has_the_same_impedance(name: str) -> None:
    jax = pytest.importorskip("jax", reason="JAX is not installed (extra: oracle)")
    jax.config.update("jax_enable_x64", True)
    world = worlds.WORLDS[name]
    kernel = Kernel(parse(world.population.network))
    central = world.population.central
    u = {p.name: float(p.u(central[p.name])) + 0.1 * i for i, p in enumerate(kernel.parameters)}
    frequency = np.geomspace(*world.band_hz, 9)
    theirs = worlds.impedance_of(world)(
        np.array([u[e] for e in worlds.varying(world)]), np.array([u[e] for e in world.shared]), 2 * np.pi * frequency
    )
    ours = kernel.impedance(np.array([u[e] for e in kernel.elements]), frequency)
    np.testing.assert_allclose(np.asarray(theirs), ours, rtol=1e-10)


@pytest.mark.long
def test_a_fit_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sampling, "ERROR_WANTED", np.inf)  # so few draws would be made again
    short = SamplerSettings(ensembles=2, burn_in=(20, 20), chunk=20, longest=40, effective=np.inf)
    settings = FitSettings(draws=64, sampler=short)
    _, row = worlds.timed_fit(worlds.WORLDS["nearly zero"], worlds.Size(11, 15), settings)
    assert (row["people"], row["points"]) == (11, 15)
    assert row["steps"] == short.longest
    assert row["per processor second"] == pytest.approx(row["effective"] / row["processor seconds"])
    assert json.loads(json.dumps(row)) == row


def test_the_table_says_what_was_measured() -> None:
    results = {"shipped": result(24.0, 60.0), "band": result(36.0, 250.4, ("R-hat",))}
    del results["shipped"]["at a smaller size"]
    lines = worlds.table(results).splitlines()
    assert lines[2] == "| shipped | 24 (1.00x) | 40 | 80 | 1.005 | not measured |  |  |"
    assert lines[3].startswith(
        "| band | 36 (1.50x) | 40 | 80 | 1.005 **refused** | 250 times as quick | 0.11 ± 0.03 sd"
    )
    assert lines[3].endswith("0.93 to 1.04; rho m2 0.93 ± 0.04 |")
    assert len(lines) == 4
    readme = (Path(worlds.__file__).parent / "README.md").read_text(encoding="utf-8")
    assert readme.count("<!-- other_worlds:start -->") == readme.count("<!-- other_worlds:end -->") == 1
