"""Parts of a verdict: where an effect acts, what it improves, how a model's bands cover people, what would be found."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from experiments import TOY, Experiment, Serial, entry, recovered, toy

from bayes_impedance.diagnosis.extended_network import extended_network
from bayes_impedance.diagnosis.fit.baseline import Fitted
from bayes_impedance.diagnosis.fit.coefficient_posterior import coefficient_posterior
from bayes_impedance.diagnosis.fit.person_residuals import PersonResiduals, person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.hum.line import Hum
from bayes_impedance.diagnosis.residuals.locate import Location, locate
from bayes_impedance.diagnosis.selection.cross_validation import HeldOut
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.stepwise import Found, search
from bayes_impedance.diagnosis.types import Snapshot
from bayes_impedance.diagnosis.verdict import entries
from bayes_impedance.diagnosis.verdict.entries import joint_of
from bayes_impedance.diagnosis.verdict.model_bands import own_errors, snapshot
from bayes_impedance.diagnosis.verdict.ranking import critical_z, detection_limits, ranking
from bayes_impedance.diagnosis.verdict.structure_entries import hum_entry
from bayes_impedance.diagnosis.verdict.verdict import Evidence, change_of, improvement, make_verdict, reach_of
from bayes_impedance.diagnosis.verdict_file import from_json, to_json
from bayes_impedance.diagnosis.verdict_types import BlockGain, ParameterDifference, Verdict
from bayes_impedance.recordings.files import Recordings, Subject

NAMES = [str(i) for i in range(20)]


def quiet(*_: object) -> None:
    pass


def delayed(s: np.ndarray, z: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return z * np.exp(-s * 2e-5), np.full(len(z), 2e-5)


@cache
def experiment(hidden: bool) -> Experiment:
    return toy(*TOY, seed=3, hidden=delayed if hidden else None)


@cache
def with_delay() -> Refit:
    return recovered(experiment(True), entry("rig.delay"), "port", "shared")


def residuals_of(fit: Refit) -> tuple[PersonResiduals, ...]:
    return tuple(person_residuals(fit, NAMES))


@cache
def found() -> Found:
    e = experiment(True)
    candidates = [entry("rig.delay"), entry("rig.mass"), entry("rig.damping")]
    with ThreadPoolExecutor(1) as executor:
        return search(e.refitter, e.fit(), NAMES, candidates, 1, executor, quiet)


def recordings_of(e: Experiment) -> Recordings:
    subjects = tuple(
        Subject(
            name=name,
            frequency_hz=data.omega / (2 * np.pi),
            z=data.z[:, 0] + 1j * data.z[:, 1],
            repetitions=("1", "2"),
            noise_sd=sd,
            covariates={},
        )
        for name, data, sd in zip(NAMES, e.data, e.sd, strict=True)
    )
    return Recordings(
        title="t",
        unit="N s/m",
        network=e.model.network,
        source="s",
        licence="l",
        subjects=subjects,
        sha256="",
        warnings=(),
    )


# ---------------------------------------------------------------- where


def test_a_delay_acts_on_the_phase_at_high_frequencies() -> None:
    part, bands = change_of(with_delay(), residuals_of(experiment(True).fit()))
    assert part == "phase"
    assert len(bands) == 1
    assert bands[0][0] > 200
    assert bands[0][1] > 1500


def test_elements_reach_where_their_impedance_dominates() -> None:
    """1/(s n) + r: the compliance below 1/(2 pi n r), about 80 Hz, the damper above."""
    fit = experiment(False).fit()
    (low,), (high,) = (reach_of(fit, [name], residuals_of(fit)) for name in ("n1", "r1"))
    assert low[0] < 3 < low[1] < 200
    assert 20 < high[0] < high[1]
    assert high[1] > 1500


@cache
def location() -> Location:
    return locate(residuals_of(found().base), 1)


def verdict_with(*bands_hz: tuple[float, float], **changes: Any) -> Verdict:
    """Of the delay that was found, with located bands given by hand."""
    e, look = experiment(True), found()
    bands = tuple(replace(location().bands[0], low_hz=low, high_hz=high) for low, high in bands_hz)
    before, after = snapshots()
    evidence = Evidence(
        found=look,
        gains=((7.0, 2.0),),
        unknown=None,
        structures=(),
        hum=None,
        location=replace(location(), bands=bands),
        gain=HeldOut(9.0, 1.0, None, None, "folds"),
        before=before,
        after=after,
        spoilt=None,
        differences=None,
        remarks=("the search's",),
        quick=True,
        posterior=coefficient_posterior(look.final, 1),
    )
    recordings = recordings_of(e)
    fitted = Fitted(
        recordings=recordings,
        fit=look.base,
        refitter=e.refitter,
        determined=np.array([True, False]),
        remarks=("the fit's",),
    )
    return make_verdict(recordings, fitted, replace(evidence, **changes), extended_network(look.final.model), seed=5)


def test_bands_that_touch_become_one() -> None:
    assert verdict_with((300.0, 500.0), (20.0, 100.0), (90.0, 300.0)).where.bands_hz == ((20.0, 500.0),)
    assert verdict_with((300.0, 500.0), (20.0, 100.0)).where.bands_hz == ((20.0, 100.0), (300.0, 500.0))
    (acting,) = verdict_with().where.bands_hz  # nothing was located: where the delay acts
    assert acting[0] > 200


def test_a_verdict_says_what_its_evidence_says() -> None:
    verdict = verdict_with((300.0, 500.0))
    (entry,) = verdict.physics
    assert verdict.mismatch
    assert (entry.kind, entry.id, entry.place, entry.subjects) == ("effect", "rig.delay", "port", "all")
    assert (entry.evidence.elpd_gain, entry.evidence.elpd_gain_se) == (7.0, 2.0)
    assert entry.parameters["delay"].q05 < 2e-5 < entry.parameters["delay"].q95
    assert (verdict.where.part, verdict.where.place, verdict.where.side) == ("phase", "port", "rig")
    assert entry.dispersion_interval is not None
    assert 0 <= entry.dispersion_interval[0] < entry.dispersion_interval[1]
    assert entry.side_decided
    assert verdict.network[1].startswith("n1|r1")
    assert verdict.elements_not_identified == ("r1",)
    assert verdict.remarks == ("the fit's", "the search's")
    assert (verdict.seed, verdict.title, verdict.unit) == (5, "t", "N s/m")
    assert verdict.unexplained is None
    assert verdict.joint is None
    assert verdict.parameters_differ is None


def test_only_significant_differences_from_a_simulation_are_listed() -> None:
    sure = ParameterDifference(
        element="r1",
        unit="N s/m",
        what="central",
        simulation=1.0,
        recordings=2.0,
        ratio=2.0,
        q05=1.9,
        q95=2.1,
        p_value=0.049,
    )
    verdict = verdict_with(differences=(sure, replace(sure, p_value=0.051)))
    assert verdict.parameters_differ == (sure,)
    assert verdict_with(differences=()).parameters_differ == ()


def test_structure_that_nothing_predicts_is_not_called_noise() -> None:
    look = found()
    withdrawn = replace(look, final=look.base, steps=look.steps[:1])
    never = replace(withdrawn, steps=(replace(look.steps[0], chosen=None),))
    changes: dict[str, Any] = {"found": withdrawn, "gains": (), "gain": None, "after": None, "posterior": None}
    verdict = verdict_with((300.0, 500.0), **changes)
    (entry,) = verdict.physics
    assert (entry.kind, entry.place, entry.network, entry.evidence.elpd_gain) == ("unknown", "port", "", None)
    assert verdict.unexplained == entry
    assert verdict.improvement is None
    assert verdict.where.bands_hz == ((300.0, 500.0),)
    assert "something that no effect of the catalogue and no small network predicts" in verdict.summary
    assert from_json(to_json(verdict)).physics == verdict.physics
    people = tuple(replace(band, kind="incoherent") for band in location().bands)
    for less in ({"found": never}, {"location": replace(location(), bands=people)}):  # may be people in other optima
        verdict = verdict_with(**{**changes, **less})
        assert not verdict.physics
        assert verdict.summary.startswith("No effect was found that is missing, but the residuals")
        assert "noise alone" in verdict.summary
    verdict = verdict_with(**{**changes, "found": never, "location": replace(location(), bands=(), p_value=0.01)})
    assert verdict.summary.startswith("Nothing is missing")


# ---------------------------------------------------------------- improvement and bands


@cache
def snapshots() -> tuple[Snapshot, Snapshot]:
    e = experiment(True)
    recordings, before, after = recordings_of(e), e.fit(), with_delay()
    return (
        snapshot("before", recordings, before, residuals_of(before), 1),
        snapshot("after", recordings, after, residuals_of(after), 1),
    )


def test_improvement_pairs_means_over_frequency_and_the_median_person() -> None:
    before, after = snapshots()
    made = improvement(before, after, HeldOut(3.0, 1.0, 2.0, 0.5, "folds"))
    assert made.delta_phase_deg == tuple(np.nanmean(s.delta_phase_deg) for s in (before, after))
    assert made.subject_rms_relative == tuple(np.median(s.subject_rms_relative) for s in (before, after))
    assert made.subject_rms_relative[1] < 0.5 * made.subject_rms_relative[0]
    assert (made.elpd_gain, made.elpd_gain_se, made.held_out) == (3.0, 1.0, "folds")
    assert made.blocks == BlockGain(2.0, 0.5)
    few = improvement(before, after, HeldOut(None, None, 2.0, 0.5, "blocks"))
    assert (few.elpd_gain, few.elpd_gain_se) == (2.0, 0.5)
    nothing = improvement(before, after, None)
    assert nothing.elpd_gain is None
    assert nothing.blocks is None


def test_bands_cover_ninety_of_a_hundred_people() -> None:
    before, after = snapshots()
    assert (before.label, after.label) == ("before", "after")
    assert 0.8 < after.coverage90.mean() < 0.97
    for quantiles in (after.magnitude, after.phase_deg):
        assert np.all(np.diff(quantiles, axis=0) > 0)
    assert after.network.startswith("n1|r1")
    assert abs(np.nanstd(after.residual_phase) - 1) < 0.1
    assert np.nanstd(before.residual_phase) > 1.5


def test_own_error_is_that_of_the_noise_where_nothing_is_missing() -> None:
    e = experiment(False)
    fit = e.fit()
    own = own_errors(recordings_of(e), residuals_of(fit))
    assert own.shape == (20,)
    np.testing.assert_allclose(np.median(own), np.sqrt(2) * 0.01, rtol=0.1)


# ---------------------------------------------------------------- candidates


def test_limits_are_the_critical_score_over_the_information() -> None:
    e = experiment(False)
    fit = e.fit()
    screening = screen(fit, residuals_of(fit), [entry("rig.delay")], 1, Serial())
    limits, hidden = detection_limits(fit.model, screening)
    (limit,) = limits
    level = critical_z(screening) + 1.2816
    np.testing.assert_allclose(limit.above, level * abs(screening.size[0] / screening.z[0]), rtol=1e-12)
    assert (limit.id, limit.place, limit.parameter, limit.unit) == ("rig.delay", "port", "delay", "s")
    assert hidden == ()
    p = np.exp(screening.log_p(critical_z(screening)))
    assert p < 0.01 < np.exp(screening.log_p(critical_z(screening) - 0.02))


def test_what_the_elements_absorb_is_hidden() -> None:
    e = experiment(False)
    fit = e.fit()
    screening = screen(fit, residuals_of(fit), [entry("rig.damping")], 1, Serial())
    assert detection_limits(fit.model, screening) == ((), ("rig.damping at port",))


def test_ranking_begins_with_what_was_found() -> None:
    rows = ranking(found().steps[0])
    assert [rows[0].id, rows[0].place, rows[0].note] == ["rig.delay", "port", "found"]
    assert rows[0].likeness == pytest.approx(1.0)
    assert [row.score for row in rows] == sorted((row.score for row in rows), reverse=True)
    assert all(0 <= row.p_value <= 1 for row in rows)
    other = next(row for row in rows if row.id == "rig.mass")
    assert other.note.startswith(("alias", "behind", "unphysical"))
    last = found().steps[-1]
    invisible = replace(last.screening, z=np.full_like(last.screening.z, np.nan))
    assert ranking(replace(last, screening=invisible)) == ()


# ---------------------------------------------------------------- entries


def test_the_amplitude_of_hum_is_that_of_a_complex_number() -> None:
    hum = Hum(
        line_hz=60.0,
        harmonics=(1,),
        frequencies_hz=(60.0, 61.0),
        near=0.02,
        amplitude=1.0,
        q05=0.5,
        q95=2.0,
        coherent=False,
        p_value=1e-6,
    )
    made = hum_entry(hum, "ohm")
    row = made.parameters["amplitude"]
    np.testing.assert_allclose([row.median, row.q05, row.q95], np.sqrt(2) * np.array([1.0, 0.5, 2.0]))
    assert row.unit == "ohm"
    assert made.name == "hum of the mains at 60 Hz"
    assert made.frequencies_hz == (60.0, 61.0)


def test_joint_correlations_are_those_of_the_draws() -> None:
    fit = with_delay()
    posterior = coefficient_posterior(fit, 1)
    made = joint_of(fit.model, posterior)
    assert made.parameters == ("rig.delay delay",)
    assert made.correlation == ((1.0,),)


def test_forms_of_one_effect_at_one_place_are_one_alias(monkeypatch: pytest.MonkeyPatch) -> None:
    """The closest is listed, excluded if all of its forms are; those of the choice's own effect and place are none."""

    def trial(id: str, place: str, form: str) -> SimpleNamespace:
        effect = SimpleNamespace(id=id, name=id, form=form, separates="more")
        return SimpleNamespace(effect=effect, candidate=SimpleNamespace(place=place))

    chosen = trial("body.bypass", "port", "full")
    rows = [
        (trial("body.bypass", "port", "reduced"), 0.5, False),
        (trial("body.resonator", "port", "full"), 2.0, True),
        (trial("body.resonator", "n1", "full"), 3.0, True),
        (trial("body.resonator", "port", "reduced"), 4.0, False),
        (trial("body.resonator", "n1", "reduced"), 9.0, True),
    ]
    monkeypatch.setattr(entries, "rivals", lambda *_: rows)
    found = entries.aliases_of(SimpleNamespace(chosen=chosen), True)  # type: ignore[arg-type]
    assert [(a.id, a.place, a.elpd_behind, a.separated) for a in found] == [
        ("body.resonator", "port", 2.0, False),
        ("body.resonator", "n1", 3.0, True),
    ]
