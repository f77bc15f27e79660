"""`diagnose` with the user's knowledge of the elements: where it holds, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import THREE_ELEMENTS
from small_diagnoses import CASES, diagnosis_of

from bayes_impedance.commands.cli import main
from bayes_impedance.diagnosis import diagnose, registered
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior
from bayes_impedance.recordings.files import write_recordings

KNOWN = 1.15 * THREE_ELEMENTS.central["r1"]
"""Damper that the prior claims to 0.5 %: 15 % off, some standard errors of ten people."""


@pytest.mark.long
def test_the_posterior_of_what_was_found_holds_the_prior() -> None:
    case, without = CASES["shared"], diagnosis_of("shared")
    allowed = [effect for effect in registered() if effect.id in case.candidates]
    prior = GivenPrior(elements={"r1": ElementPrior(centre=KNOWN, scale=0.005)})
    found = diagnose(case.recordings(), effects=allowed, workers=1, seed=1, prior=prior)
    assert [p.id for p in found.verdict.physics] == [p.id for p in without.verdict.physics] == ["rig.delay"]
    assert found.fit is not None
    assert without.fit is not None
    centres = {}
    for name, fit in (("with", found.fit), ("without", without.fit)):
        r1 = fit.kernel.elements.index("r1")
        centres[name] = float(np.exp(fit.parameters.mu[:, r1].mean()))
    assert centres["with"] == pytest.approx(KNOWN, rel=0.02)
    assert abs(centres["without"] / KNOWN - 1) > 0.05
    told = [remark for remark in found.verdict.remarks if "given prior" in remark]
    assert len(told) == 1
    assert not [remark for remark in without.verdict.remarks if "given prior" in remark]


def test_a_prior_of_another_network_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recordings(CASES["nothing"].recordings(), tmp_path / "data")
    prior = tmp_path / "prior.toml"
    prior.write_text("[elements.n9]\nscale = 0.5\n", encoding="utf-8")
    command = ["diagnose", str(tmp_path / "data"), "-o", str(tmp_path / "out"), "--network", "m1|r1|n1"]
    assert main([*command, "--priors", str(prior)]) == 2
    assert '"n9" is not an element of the fitted network' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
