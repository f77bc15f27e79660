"""A prior of the user: read and checked, the one that is sampled, and nothing else changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.fit import PopulationFit, fit_population, prior_for
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior, read_prior
from bayes_impedance.population.sample_prior import sample_prior
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.dataset import Recordings
from bayes_impedance.results.predictive import predict
from bayes_impedance.results.result import load_result, make_result, save_result

TEXT = """
concentration = 4.0
dispersion = 0.5
[elements.m1]
centre = 2e-4
unit = "kg"
scale = 0.1
dispersion = 0.3
[elements.r1]
scale = 1.5
"""


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return simulate_recordings(THREE_ELEMENTS, 6, 1, np.geomspace(5, 5000, 12), seed=3).recordings


@pytest.fixture(scope="module")
def default(recordings: Recordings) -> PopulationFit:
    return fit_population(recordings, settings=SHORT, seed=1)


def written(folder: Path, text: str) -> Path:
    file = folder / "prior.toml"
    file.write_text(text, encoding="utf-8")
    return file


def test_a_file_says_what_replaces_the_default(recordings: Recordings, tmp_path: Path) -> None:
    given = read_prior(str(written(tmp_path, TEXT)))
    kernel = Kernel(parse(THREE_ELEMENTS.network))
    usual = prior_for(kernel, recordings, SHORT)
    prior = prior_for(kernel, recordings, replace(SHORT, prior=given))
    m, r, n = (kernel.elements.index(e) for e in ("m1", "r1", "n1"))
    assert prior.centre[m] == pytest.approx(np.log(2e-4))
    assert (prior.centre[r], prior.centre[n]) == (usual.centre[r], usual.centre[n])
    assert (prior.centre_sds[m], prior.centre_sds[r], prior.centre_sds[n]) == (0.1, 1.5, 3.0)
    assert (prior.dispersion_sds[m], prior.dispersion_sds[n]) == (0.3, 0.5)
    assert (prior.concentration, prior.slope_sd) == (4.0, usual.slope_sd)
    assert GivenPrior.of_text(given.text()) == given
    assert GivenPrior.of_text("") is None
    assert set(given.only(["r1", "n1"]).elements) == {"r1"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[elements.m1]\ncenter = 1.0", 'key "center" is not used'),
        ("[elements.m1]\nscale = -1.0", "scale is -1"),
        ("[elements.m1]\nscale = 50.0", "at most 10"),
        ("[elements.m1]\ncentre = true", "centre is true"),
        ("concentration = 0", "concentration is 0"),
        ("elements = 3", "must be tables"),
        ("", "says nothing"),
        ("[elements", "prior.toml"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message.replace("[", r"\[")):
        read_prior(written(tmp_path, text))


@pytest.mark.parametrize(
    ("element", "own", "message"),
    [
        ("m9", {"scale": 1.0}, '"m9" is not an element'),
        ("m1", {"centre": 20.0, "unit": "g"}, 'given in "g", but must be in kg'),
        ("m1", {"centre": -1.0}, "must be above zero"),
    ],
)
def test_what_does_not_belong_to_the_network_is_refused(
    element: str, own: dict[str, Any], message: str, recordings: Recordings
) -> None:
    given = GivenPrior(elements={element: ElementPrior(**own)})
    with pytest.raises(InputError, match=message):
        fit_population(recordings, settings=replace(SHORT, prior=given))


def test_what_is_the_same_for_all_has_no_dispersion(recordings: Recordings) -> None:
    given = GivenPrior(elements={"m1": ElementPrior(dispersion=0.1)})
    with pytest.raises(InputError, match="the same for all"):
        prior_for(Kernel(parse("m1*|r1|n1")), recordings, replace(SHORT, prior=given))


def test_a_prior_that_says_the_default_changes_no_number(recordings: Recordings, default: PopulationFit) -> None:
    same = GivenPrior(concentration=2.0, dispersion=1.0, slope=1.0, elements={"m1": ElementPrior(scale=3.0)})
    fit = fit_population(recordings, settings=replace(SHORT, prior=same), seed=1)
    np.testing.assert_array_equal(fit.parameters.mu, default.parameters.mu)
    np.testing.assert_array_equal(fit.person_draws, default.person_draws)


def test_a_narrow_prior_is_the_one_that_is_sampled(
    recordings: Recordings, default: PopulationFit, tmp_path: Path
) -> None:
    """Two normal distributions of a centre multiply; dispersions stay within what is allowed for them."""
    k = default.kernel.elements.index("m1")
    mean, sd = default.parameters.mu[:, k].mean(), default.parameters.mu[:, k].std()
    scale = 0.5 * sd
    given = GivenPrior(
        elements={
            "m1": ElementPrior(centre=float(np.exp(mean + sd)), scale=float(scale)),
            "r1": ElementPrior(dispersion=0.02),
        }
    )
    fit = fit_population(recordings, settings=replace(SHORT, prior=given), seed=1)
    expected = (mean / sd**2 + (mean + sd) / scale**2) / (1 / sd**2 + 1 / scale**2)
    # The default's posterior of few people has heavier tails than a normal one: a third of its width is allowed.
    assert fit.parameters.mu[:, k].mean() == pytest.approx(expected, abs=sd / 3)
    assert fit.parameters.mu[:, k].std() < 0.6 * sd
    r = default.kernel.elements.index("r1")
    assert np.median(fit.parameters.between_persons[:, r]) < 0.5 * np.median(default.parameters.between_persons[:, r])
    result = make_result(fit, predict(fit, n_draws=20, n_replicates=4), {})
    told = result.summary["prior"]
    assert told["given"]
    assert told["elements"]["m1"]["scale"] == pytest.approx(scale)
    assert told["elements"]["r1"]["dispersion"] == 0.02
    save_result(result, tmp_path)
    read = load_result(tmp_path)
    assert GivenPrior.of_text(read.attributes["prior"]) == given
    np.testing.assert_array_equal(read.groups["constant_data"]["prior_dispersion_sd"], fit.prior.dispersion_sds)
    drawn = read.groups["prior"]["mu"][0, :, k]
    assert drawn.std() == pytest.approx(scale, rel=0.2)


def test_a_fit_with_another_prior_is_not_resumed(recordings: Recordings, tmp_path: Path) -> None:
    class StoppedError(Exception):
        pass

    def stop(stage: str, done: int, total: int) -> None:
        if stage != "modes" and done:
            raise StoppedError

    with pytest.raises(StoppedError):
        fit_population(recordings, settings=SHORT, checkpoint=tmp_path / "kept", progress=stop)
    other = replace(SHORT, prior=GivenPrior(dispersion=0.5))
    with pytest.raises(InputError, match="other"):
        fit_population(recordings, settings=other, checkpoint=tmp_path / "kept")


def test_the_prior_alone_can_be_drawn(recordings: Recordings) -> None:
    given = GivenPrior(elements={"m1": ElementPrior(centre=2e-4, scale=0.1, dispersion=0.2)})
    drawn = sample_prior(recordings, settings=replace(SHORT, prior=given), n=2000, seed=1)
    table = drawn.to_dataframe()
    assert np.median(table["m1"]) == pytest.approx(2e-4, rel=0.02)
    assert np.log(table["m1"]).std() == pytest.approx(0.1, rel=0.1)
    # A person differs from the centre by a half-normal dispersion, whose mean square is its scale's square.
    assert np.log(table["m1_person"] / table["m1"]).std() == pytest.approx(0.2, rel=0.15)
    assert table.attrs["units"]["m1_person"] == "kg"
    z = drawn.impedance([10.0, 100.0])
    assert z.shape == (2000, 2)
    again = sample_prior(recordings, settings=replace(SHORT, prior=given), n=2000, seed=1)
    np.testing.assert_array_equal(again.people, drawn.people)
    assert "PriorSample" in repr(drawn)
    assert "m1" in drawn._repr_html_()
