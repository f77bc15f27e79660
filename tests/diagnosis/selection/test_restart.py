"""Rig or body where they cannot be told apart, and a new beginning where the rig has driven the network far off."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from experiments import TOY, Experiment, concealing, entry, toy
from scipy.integrate import quad
from scipy.stats import multivariate_normal, norm

from bayes_impedance.diagnosis import diagnose
from bayes_impedance.diagnosis.catalogue.effect import Candidate, registered, shape_grid
from bayes_impedance.diagnosis.fit.baseline import fit_network
from bayes_impedance.diagnosis.fit.extend import extended, extended_start, gain, is_physical
from bayes_impedance.diagnosis.fit.fitter import Refit
from bayes_impedance.diagnosis.fit.normal_equations import quadratic
from bayes_impedance.diagnosis.fit.person_residuals import person_residuals
from bayes_impedance.diagnosis.selection.restart import another_beginning, without
from bayes_impedance.diagnosis.selection.rig_or_body import log_odds_of_differing, same_for_all, sided
from bayes_impedance.diagnosis.selection.score_scan import screen
from bayes_impedance.diagnosis.selection.shortlist import Trial, try_candidate
from bayes_impedance.diagnosis.selection.stepwise import Step
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


def trial_of(experiment: Experiment, fit: Refit, effect_id: str, place: str) -> Trial:
    """An effect that is the same for all, begun at the truth."""
    effect, scales, values = entry(effect_id), fit.model.scales, experiment.case.values
    mass = values["mass"]
    if "compliance" in values:
        omega, ratio = (
            (mass * values["compliance"]) ** -0.5,
            0.5 * values["damping"] * np.sqrt(values["compliance"] / mass),
        )
    else:
        omega, ratio = 2 * np.pi * values["frequency"], values["ratio"]
    shape = {"frequency": float(omega), "damping_ratio": float(ratio)}
    candidate = Candidate(effect, place, shape)
    model = extended(fit.model, candidate, "shared", values["mass"])
    u, population = extended_start(fit, model)
    u[:, model.columns(0)[0]] = effect.coefficients[0].unbounded(values["mass"], scales)
    grown = experiment.refitter.fit(model, u, population, 60)
    return Trial(candidate, "shared", grown, gain(grown, fit), is_physical(grown))


@pytest.mark.parametrize(
    ("hidden", "first"), [("rig.resonance", "rig.resonance"), ("body.resonator", "body.resonator")]
)
def test_what_is_the_same_for_all_is_the_rigs_if_the_recordings_allow_it(hidden: str, first: str) -> None:
    experiment = concealing(hidden, "port", 0.3, seed=2, n=16)
    fit = experiment.fit()
    rig, body = (trial_of(experiment, fit, name, "port") for name in ("rig.resonance", "body.resonator"))
    body = replace(body, gain=rig.gain + 1.0)  # the search prefers it by a hair
    ranked = same_for_all(experiment.refitter, fit, [body, rig], [body, rig], 1)
    assert ranked[0].effect.id == hidden
    assert {t.effect.id for t in ranked} == {"rig.resonance", "body.resonator"}
    # The rig's is not preferred where the recordings tell the two apart.
    far = replace(body, gain=rig.gain + 100.0, fit=replace(body.fit, evidence=body.fit.evidence + 100 / 16))
    assert same_for_all(experiment.refitter, fit, [far, rig], [far, rig], 1)[0] is far


def test_an_explanation_by_the_rig_that_is_first_stays_first() -> None:
    experiment = concealing("rig.resonance", "port", 0.3, seed=2, n=16)
    fit = experiment.fit()
    rig = trial_of(experiment, fit, "rig.resonance", "port")
    assert same_for_all(experiment.refitter, fit, [rig], [rig], 1) == [rig]


def masses(experiment: Experiment, fit: Refit) -> tuple[Trial, Trial]:
    """A mass at the port as the rig's and as the body's."""
    rig, body = (
        try_candidate(experiment.refitter, fit, Candidate(entry(name), "port", {}), 1e-4, (pooling,))[0]
        for name, pooling in (("rig.mass", "shared"), ("body.mass", "varying"))
    )
    return rig, body


@pytest.mark.parametrize("hidden", ["rig.mass", "body.mass"])
def test_of_one_formula_that_is_first_which_is_more_probable(hidden: str) -> None:
    experiment = concealing(hidden, "port", 2.0, seed=2, n=16)
    fit = experiment.fit()
    rig, body = masses(experiment, fit)
    assert (log_odds_of_differing(rig.fit, 0) > 0) == (hidden == "body.mass")
    for ranked in ([rig, replace(body, gain=rig.gain - 1)], [replace(body, gain=rig.gain + 1), rig]):
        assert sided(experiment.refitter, fit, ranked[:1], ranked, 1)[0].effect.id == hidden
    other = replace(body, candidate=replace(body.candidate, place="n1"))  # not the same formula there
    assert sided(experiment.refitter, fit, [rig, other], [rig, other], 1) == [rig, other]


def test_odds_of_differing_are_those_of_normal_coefficients() -> None:
    """With one coefficient alone everybody's estimate is normal, and so are all of them together."""
    experiment = concealing("rig.mass", "port", 0.3, seed=3, n=12)
    rig, _ = masses(experiment, experiment.fit())
    fit = rig.fit
    h, d, _ = quadratic(fit.model, fit.data, fit.u, fit.equations, fit.population.covariance)
    estimates, variances = h[:, 0] / d[:, 0, 0], 1 / d[:, 0, 0]
    mean, prior = abs(fit.u[0, -1]), fit.model.parameters[0].prior_sd

    def density(relative: float) -> float:
        covariance = np.diag(variances + (relative * mean) ** 2) + prior**2
        return float(np.exp(multivariate_normal.logpdf(estimates, np.zeros(12), covariance) - offset))

    offset = multivariate_normal.logpdf(estimates, np.zeros(12), np.diag(variances) + prior**2)
    integral = quad(lambda x: norm.pdf(x) * density(0.35 * 2**x), -8, 8, epsabs=1e-10)[0]
    assert log_odds_of_differing(fit, 0) == pytest.approx(np.log(integral), abs=1e-3)


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


def test_a_verdict_without_a_name_is_looked_at_again() -> None:
    experiment, recordings = strong_high_pass()
    candidates = [entry(name) for name in ("rig.highpass", "body.relaxation")]
    with ThreadPoolExecutor(1) as executor:
        fitted = fit_network(recordings, None, 1, executor, quiet)
        screening = screen(fitted.fit, person_residuals(fitted.fit, recordings.names), candidates[:1], 1, executor)
        step = Step(fitted.fit, (), screening, (), None)
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
