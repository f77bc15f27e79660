"""A diagnosis ends with the posterior of the population of the network with what was found."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_diagnoses import CASES, diagnosis_of

from bayes_impedance.diagnosis import Diagnosis
from bayes_impedance.population.fit import QUICK_SETTINGS, PopulationFit, fit_population

TRUE_DELAY = 2e-5
SHORT = replace(QUICK_SETTINGS, sampler=replace(QUICK_SETTINGS.sampler, longest=40))


def fitted_by(monkeypatch: pytest.MonkeyPatch, fit: Any) -> None:
    monkeypatch.setattr(sys.modules["bayes_impedance.diagnosis.diagnose"], "fit_population", fit)


def said_of(diagnosis: Diagnosis, name: str) -> list[float]:
    said = diagnosis.verdict.physics[0].parameters[name]
    return [said.q05, said.median, said.q95]


def test_intervals_are_those_of_the_population_of_the_extended_network() -> None:
    delayed = diagnosis_of("shared")
    assert delayed.fit is not None
    assert str(delayed.fit.written) == delayed.verdict.extended_network == "delay[d1*](m1|r1|n1)"
    drawn = delayed.fit.parameters.mu[:, list(delayed.fit.kernel.elements).index("d1")]
    np.testing.assert_allclose(said_of(delayed, "delay"), np.quantile(drawn, [0.05, 0.5, 0.95]), rtol=1e-9)
    assert said_of(delayed, "delay")[0] < TRUE_DELAY < said_of(delayed, "delay")[2]


@pytest.mark.long
def test_two_effects_of_the_body_and_the_rig_have_one_posterior(monkeypatch: pytest.MonkeyPatch) -> None:
    """A time constant is the product of two elements; its spread and the correlations are those of the posterior."""
    fits = []

    def quick(*arguments: Any, **options: Any) -> PopulationFit:
        fits.append(fit_population(*arguments, **{**options, "settings": QUICK_SETTINGS}))
        return fits[-1]

    fitted_by(monkeypatch, quick)
    verdict = replace(CASES["two"], quick=False).diagnosed().verdict
    (fit,) = fits
    parameters = fit.parameters
    by_id = {entry.id: entry.parameters for entry in verdict.physics}
    relaxing = by_id["body.relaxation"]
    added = [name for name in fit.kernel.elements if name not in ("m1", "r1", "n1", "d1")]
    r, n = (list(fit.kernel.elements).index(name) for name in sorted(added, reverse=True))
    time = np.exp(parameters.mu[:, r] + parameters.mu[:, n])
    assert relaxing["time_constant"].median == pytest.approx(np.median(time), rel=1e-9)
    assert relaxing["damping"].median == pytest.approx(np.median(np.exp(parameters.mu[:, r])), rel=1e-9)
    covariance = parameters.covariance
    spread = np.sqrt(covariance[:, r, r] + covariance[:, n, n] + 2 * covariance[:, r, n])
    if relaxing["time_constant"].dispersion:
        assert relaxing["time_constant"].dispersion == pytest.approx(np.median(spread), rel=1e-3)
    assert relaxing["damping"].dispersion == pytest.approx(np.median(parameters.between_persons[:, r]), rel=1e-3)
    assert verdict.joint is not None
    delay = parameters.mu[:, list(fit.kernel.elements).index("d1")]
    names = list(verdict.joint.parameters)
    i, k = names.index("rig.delay delay"), names.index("body.relaxation time_constant")
    assert verdict.joint.correlation[i][k] == pytest.approx(np.corrcoef(delay, np.log(time))[0, 1], abs=2e-3)


@pytest.mark.long
def test_a_posterior_that_is_not_reliable_gives_no_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    def failed(*arguments: Any, **options: Any) -> PopulationFit:
        fit = fit_population(*arguments, **{**options, "settings": SHORT})
        return replace(fit, diagnostics=replace(fit.diagnostics, rhat_max=9.0))

    fitted_by(monkeypatch, failed)
    wrong = CASES["shared"].diagnosed()
    assert any("Laplace's approximation" in line and "R-hat" in line for line in wrong.verdict.remarks)
    quick = replace(CASES["shared"], quick=True).diagnosed()
    assert quick.fit is None
    assert said_of(wrong, "delay") == said_of(quick, "delay")


def test_a_network_with_parameters_that_all_share_can_be_diagnosed() -> None:
    """The delay is in the claimed network: nothing is missing. Without it, it would be found."""
    case = replace(CASES["shared"], quick=True)
    recordings = case.recordings()
    claimed = replace(recordings, network=f"delay[d1*]({recordings.network})")
    verdict = replace(case, given=claimed).diagnosed().verdict
    assert not verdict.mismatch
    assert verdict.network[0] == "delay[d1*](m1|r1|n1)"
