"""The restart of a search from recordings corrected for an effect of the rig."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Experiment, concealing, entry, toy

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.effect import Candidate, registered, shape_grid
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.extend import extended, extended_start
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.fit.refit import Refit
from bayes_impedance.diagnosis.selection.restart import another_beginning, without
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.step import Step
from bayes_impedance.diagnosis.selection.trial import try_candidate
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.recordings.files import Recordings, Subject

FREQUENCY = np.geomspace(2, 2000, 41)
RIG = [effect for effect in registered() if effect.side == "rig" and effect.operation]


@pytest.mark.parametrize("effect", RIG, ids=[effect.id for effect in RIG])
def test_an_effect_of_the_rig_is_taken_off_whatever_the_elements(effect) -> None:  # type: ignore[no-untyped-def]
    """The fit may be far from the people: what the rig does at the port does not depend on them."""
    experiment = toy(*TOY, seed=1, n=6)
    fit = experiment.fit()
    scales = fit.model.scales
    shapes = list(shape_grid(effect, scales))
    candidate = Candidate(effect, "port", shapes[len(shapes) // 2])
    size = 0.3 * effect.coefficients[0].scale(scales)
    model = extended(fit.model, candidate, "shared", size)
    u, _ = extended_start(fit, model)
    u[:, model.columns(0)[0]] = effect.coefficients[0].unbounded(size, scales)
    u[:, :2] += np.random.default_rng(1).normal(size=(len(u), 2))  # other people than those of the fit
    with_it = model.kernel.impedance(u, FREQUENCY).reshape(6, 2, -1)
    alone = Kernel(fit.model.network).impedance(u[:, :2], FREQUENCY).reshape(6, 2, -1)
    assert np.abs(with_it / alone - 1).max() > 0.02
    sd = 1e-6 * np.abs(with_it)
    subjects = tuple(
        Subject(name=str(i), frequency_hz=FREQUENCY, z=z, repetitions=("1", "2"), noise_sd=sd[i], covariates={})
        for i, z in enumerate(with_it)
    )
    freed = without(
        Recordings(
            title="t", unit="N s/m", network="n1|r1", source="s", licence="l", subjects=subjects, sha256="", warnings=()
        ),
        fit,
        candidate,
        size,
    )
    for subject, z in zip(freed.subjects, alone, strict=True):
        np.testing.assert_allclose(subject.z, z, rtol=1e-9)
    # A little noise comes through as it would by the derivative.
    noisy = tuple(replace(s, z=s.z + s.noise_sd) for s in subjects)
    moved = without(
        Recordings(
            title="t", unit="N s/m", network="n1|r1", source="s", licence="l", subjects=noisy, sha256="", warnings=()
        ),
        fit,
        candidate,
        size,
    )
    for one, other in zip(freed.subjects, moved.subjects, strict=True):
        assert one.noise_sd is not None
        np.testing.assert_allclose(np.abs(other.z - one.z), one.noise_sd, rtol=1e-3)


def quiet(*_: object) -> None:
    pass


def strong_high_pass() -> tuple[Experiment, Recordings]:
    """So strong that the network alone ends where nobody is."""
    experiment = concealing("rig.highpass", "port", 1.0, seed=1, n=10)
    frequency = experiment.case.frequency_hz
    subjects = tuple(
        Subject(
            name=f"p{i}",
            frequency_hz=frequency,
            z=d.z[:, 0] + 1j * d.z[:, 1],
            repetitions=("1", "2"),
            noise_sd=experiment.sd[i],
            covariates={},
        )
        for i, d in enumerate(experiment.data)
    )
    return experiment, Recordings(
        title="t",
        unit="N s/m",
        network=experiment.model.network,
        source="s",
        licence="l",
        subjects=subjects,
        sha256="",
        warnings=(),
    )


@pytest.mark.long
def test_a_verdict_without_a_name_is_looked_at_again() -> None:
    experiment, recordings = strong_high_pass()
    candidates = [entry(name) for name in ("rig.highpass", "body.relaxation")]
    with ThreadPoolExecutor(1) as executor:
        fitted = fit_network(recordings, None, 1, executor, quiet)
        screening = screen(fitted.fit, person_residuals(fitted.fit, recordings.names), candidates[:1], 1, executor)
        step = Step(before=fitted.fit, residuals=(), screening=screening)
        begin = another_beginning(fitted, step, 0.0, 1, executor, quiet)
        high_pass, size = screening.candidates[0], float(screening.size[0])

        def gained(start: Refit | None) -> float:
            return try_candidate(fitted.refitter, fitted.fit, high_pass, size, ("shared",), 40, start)[0].gain

        assert begin is not None
        true = gained(experiment.fit())
        assert gained(None) < 0.3 * true
        assert gained(begin) > 0.98 * true
    verdict = diagnose(recordings, effects=candidates, seed=1, quick=True).verdict
    assert [entry.id for entry in verdict.physics] == ["rig.highpass"]
    corner = verdict.physics[0].parameters["corner"]
    assert corner.q05 < experiment.case.values["corner"] < corner.q95
