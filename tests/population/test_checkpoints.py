"""Checkpoints of a fit: an interrupted fit continues to the same result; another fit's folder is refused."""

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SHORT

from bayes_impedance.errors import InputError
from bayes_impedance.mcmc.ensemble import SamplerSettings
from bayes_impedance.population import starting_fits
from bayes_impedance.population.fit import FitSettings, PopulationFit, fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior
from bayes_impedance.population.simulate import Simulation
from bayes_impedance.population.starting_fits import FirstFits
from bayes_impedance.recordings.files import Recordings, Subject
from bayes_impedance.runtime import checkpoint


def test_an_interrupted_fit_continues_to_the_same_result(small_simulation: Simulation, tmp_path: Path) -> None:
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:6])
    whole = fit_population(recordings, settings=SHORT, seed=7)

    class KilledError(Exception):
        pass

    calls = {"burn-in": 0, "sampling": 0}

    def stop_in_sampling(stage: str, _done: int, _total: int) -> None:
        calls[stage] = calls.get(stage, 0) + 1
        if stage == "sampling" and calls[stage] > 3:
            raise KilledError

    with pytest.raises(KilledError):
        fit_population(recordings, settings=SHORT, seed=7, progress=stop_in_sampling, checkpoint=tmp_path)
    assert calls["burn-in"] > 0
    assert calls["first fits"] > 0
    calls = {"burn-in": 0, "first fits": 0, "common solutions": 0, "population estimate": 0}
    again = fit_population(
        recordings,
        settings=SHORT,
        seed=7,
        progress=lambda stage, done, total: calls.update({stage: calls.get(stage, 0) + 1}),
        checkpoint=tmp_path,
    )
    # The stages are announced, but no step of them is made again.
    assert (calls["burn-in"], calls["first fits"], calls["common solutions"]) == (1, 0, 0)
    assert calls["population estimate"] == 1
    assert np.array_equal(whole.parameters.mu, again.parameters.mu)
    assert np.array_equal(whole.person_draws, again.person_draws)


VERY_SHORT = replace(SHORT, draws=64, sampler=SamplerSettings(ensembles=2, burn_in=(20,), chunk=20, longest=20))


@pytest.fixture(scope="module")
def five(small_simulation: Simulation) -> tuple[Recordings, PopulationFit]:
    """Five people and their fit, not interrupted."""
    recordings = small_simulation.recordings.select(small_simulation.recordings.names[:5])
    return recordings, fit_population(recordings, settings=VERY_SHORT, seed=7)


@pytest.mark.parametrize(
    ("stage", "times"),
    [("first fits", 2), ("common solutions", 1), *(("population estimate", n) for n in (1, 3, 4, 7)), ("draws", 3)],
)
def test_a_fit_interrupted_before_sampling_continues_to_the_same_result(
    five: tuple[Recordings, PopulationFit], tmp_path: Path, stage: str, times: int
) -> None:
    recordings, whole = five
    reached = 0

    class KilledError(Exception):
        pass

    def stop(now: str, _done: int, _total: int) -> None:
        nonlocal reached
        reached += now == stage
        if reached == times:
            raise KilledError

    with contextlib.suppress(KilledError):
        fit_population(recordings, settings=VERY_SHORT, seed=7, progress=stop, checkpoint=tmp_path)
    assert reached == times  # or the test shows nothing
    assert (tmp_path / "first_fits.npz").exists() == (stage != "first fits")
    again = fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    assert np.array_equal(whole.parameters.mu, again.parameters.mu)
    assert np.array_equal(whole.person_draws, again.person_draws)
    assert np.array_equal(whole.noise[0], again.noise[0])


def test_first_fits_continue_from_the_last_piece(
    five: tuple[Recordings, PopulationFit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed after the third of five persons, of whom two make a piece: nobody of the first piece is fitted again."""
    monkeypatch.setattr(checkpoint, "_SMALLEST_PIECE", 2)
    recordings, whole = five
    tried: list[str] = []
    really = starting_fits._try_all

    def counted(kernel: Any, candidates: Any, centre: Any, precision: Any, subject: Subject) -> Any:
        tried.append(subject.name)
        return really(kernel, candidates, centre, precision, subject)

    monkeypatch.setattr(starting_fits, "_try_all", counted)

    class KilledError(Exception):
        pass

    def stop(now: str, done: int, _total: int) -> None:
        if now == "first fits" and done == 3:
            raise KilledError

    with pytest.raises(KilledError):
        fit_population(recordings, settings=VERY_SHORT, seed=7, progress=stop, checkpoint=tmp_path)
    assert sorted(f.name for f in tmp_path.glob("*.npz")) == [
        "first_fits_00000000.npz",
        *(f"searching_{k:08d}.npz" for k in (0, 2, 4)),
    ]
    tried.clear()
    again = fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    assert sorted(tried) == sorted(recordings.names[2:])
    assert not list(tmp_path.glob("*_0*.npz"))
    assert np.array_equal(whole.person_draws, again.person_draws)


@pytest.mark.parametrize("other", ["a number", "a subject", "seed", "network", "settings"])
def test_a_folder_of_another_fit_is_refused(five: tuple[Recordings, PopulationFit], tmp_path: Path, other: str) -> None:
    recordings, _ = five
    checkpoint.claim(tmp_path, (s.digest for s in recordings.subjects), VERY_SHORT, 7, "m1|r1|n1")
    checkpoint.claim(tmp_path, (s.digest for s in recordings.subjects), VERY_SHORT, 7, "m1|r1|n1")
    settings, seed, network = VERY_SHORT, 7, "m1|r1|n1"
    if other == "a number":
        first = recordings.subjects[0]
        z = first.z.copy()
        z[0, 0] *= 1 + 1e-15
        recordings = replace(recordings, subjects=(replace(first, z=z), *recordings.subjects[1:]))
    elif other == "a subject":
        recordings = recordings.select(recordings.names[1:])
    elif other == "seed":
        seed = 8
    elif other == "network":
        network = "m1|r1"
    else:
        settings = replace(VERY_SHORT, draws=65)
    with pytest.raises(InputError, match="other data or other options"):
        checkpoint.claim(tmp_path, (s.digest for s in recordings.subjects), settings, seed, network)


def test_a_checkpoint_of_another_seed_is_refused(five: tuple[Recordings, PopulationFit], tmp_path: Path) -> None:
    recordings, _ = five
    fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path, workers=1)
    fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path, workers=2)  # does not matter
    with pytest.raises(InputError, match="other data or other options"):
        fit_population(recordings, settings=VERY_SHORT, seed=8, checkpoint=tmp_path)


def test_a_checkpoint_of_another_format_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its arrays may lack what this version resumes from."""
    checkpoint.claim(tmp_path, ["a"], 1)
    checkpoint.claim(tmp_path, ["a"], 1)
    monkeypatch.setattr(checkpoint, "_FORMAT", 0)
    with pytest.raises(InputError, match="another version"):
        checkpoint.claim(tmp_path, ["a"], 1)


def test_settings_are_told_with_what_is_the_default_and_with_what_they_hold() -> None:
    told = repr(checkpoint.complete(replace(SHORT, prior=GivenPrior(elements={"m1": ElementPrior(scale=0.1)}))))
    for part in ("('noise_distribution', 'normal')", "('rhat', ", "'m1': ('ElementPrior'", "('kind', None)"):
        assert part in told
    assert "file" not in told


def test_a_checkpoint_from_before_a_setting_existed_is_refused(
    five: tuple[Recordings, PopulationFit], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What that version did in its place is not known for sure, and its arrays may lack what the setting needs."""
    recordings, _ = five
    complete = checkpoint.complete

    def without(value: Any) -> Any:
        told = complete(value)
        return [own for own in told[1] if own[0] != "distribution"] if isinstance(value, FitSettings) else told

    with monkeypatch.context() as earlier:
        earlier.setattr(checkpoint, "complete", without)
        assert "('distribution', 'normal')" not in repr(checkpoint.complete(VERY_SHORT))
        fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    assert "('distribution', 'normal')" in repr(checkpoint.complete(VERY_SHORT))
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    with pytest.raises(InputError, match="another version of the package; give the same ones, or start anew"):
        fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_damaged_first_fits_and_point_estimate_are_made_anew(
    five: tuple[Recordings, PopulationFit], tmp_path: Path
) -> None:
    recordings, whole = five
    fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    for file in tmp_path.glob("ensemble_*.h5"):
        file.unlink()
    for name in ("first_fits.npz", "point_estimate.npz"):
        content = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content[: len(content) // 2])
    assert FirstFits.load(tmp_path / "first_fits.npz") is None
    again = fit_population(recordings, settings=VERY_SHORT, seed=7, checkpoint=tmp_path)
    assert np.array_equal(whole.person_draws, again.person_draws)
