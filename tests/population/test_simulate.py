"""Virtual people: their statistics are what the truth says, and the shipped ones can be made again."""

import gzip
import json
import runpy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import DATA, SMALL, THREE_ELEMENTS
from scipy.stats import invgamma, kstest

from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.population.described_population import population_from
from bayes_impedance.population.fingertip import FINGERTIP
from bayes_impedance.population.simulate import simulate_recordings
from bayes_impedance.recordings.files import read_recordings

ANALYSES = DATA.parent / "analyses"


def test_people_are_distributed_as_the_truth_says() -> None:
    simulation = simulate_recordings(FINGERTIP, 4000, 1, np.array([10.0, 100.0, 1000.0]), seed=1)
    truth = simulation.truth["elements"]
    names = parse(FINGERTIP.network).elements
    tau = np.array([truth[e]["dispersion_between_persons"] for e in names])
    centre = np.log([truth[e]["central"] for e in names])
    z = (simulation.log_elements.mean(axis=0) - centre) / (tau / np.sqrt(4000))
    assert np.abs(z).max() < 3.5
    assert np.abs(np.log(simulation.log_elements.std(axis=0) / tau)).max() < 3.5 / np.sqrt(2 * 4000)
    found = np.corrcoef(simulation.log_elements.T)
    for a, b, value in simulation.truth["correlation"]:
        assert abs(found[names.index(a), names.index(b)] - value) < 3.5 / np.sqrt(4000)


def test_noise_has_the_stated_size_and_rises_at_low_frequencies() -> None:
    grid = np.array([2.0, 8.0, 1000.0])
    still = replace(SMALL, between_persons={}, between_repetitions={}, correlation={}, force_exponent={})
    recordings = simulate_recordings(still, 3000, 1, grid, seed=1).recordings
    clean = Kernel(parse(SMALL.network)).impedance(np.log(SMALL.vector(SMALL.central)), grid)
    ratio = np.array([s.z[0] / clean - 1 for s in recordings.subjects])
    sd = np.sqrt(np.mean(ratio.real**2 + ratio.imag**2, axis=0) / 2)
    scale = np.sqrt(np.exp(2 * 0.15**2))  # root mean square of the persons' log-normal scale
    assert sd == pytest.approx(0.01 * scale * np.sqrt(1 + (8.0 / grid) ** 4), rel=0.05)


def test_repetitions_differ_by_elements_and_contact_force_stays_in_the_band() -> None:
    quiet = replace(FINGERTIP, noise=1e-9)
    recordings = simulate_recordings(quiet, 20, 3, np.geomspace(5, 5000, 30), seed=1).recordings
    spread = [np.abs(s.z[0] / s.z[1] - 1).max() for s in recordings.subjects]
    assert min(spread) > 0.01
    force = np.array([s.covariates["contact_force_n"] for s in recordings.subjects])
    assert np.all(np.abs(force - 1) <= 0.1)


def test_a_population_survives_its_description() -> None:
    truth = simulate_recordings(FINGERTIP, 2, 1, np.array([10.0, 20.0, 30.0]), seed=3).truth
    again = population_from(truth, "truth.json")
    assert again.central == pytest.approx(FINGERTIP.central)
    assert again.noise == FINGERTIP.noise
    with pytest.raises(InputError, match=r"key .elements. is missing"):
        population_from({"network": "r1"}, "x.json")
    keys = ("central", "dispersion_between_persons", "dispersion_between_repetitions")
    unknown = {"r1": {key: {"median": None} for key in keys}}
    with pytest.raises(InputError, match="element 'r1' has no value"):
        population_from({"network": "r1", "elements": unknown, "correlation": []}, "x.json")


def test_a_fit_of_one_subject_is_no_population() -> None:
    """It has no dispersion: everybody would be the same person."""
    summary = {**GOOD_TRUTH, "schema": 1, "subjects": 1}  # type: ignore[dict-item]
    with pytest.raises(
        InputError, match=r"^x\.json: is the fit of one subject, which does not say how subjects differ"
    ):
        population_from(summary, "x.json")
    assert population_from({**summary, "subjects": 2}, "x.json").central == {"r1": 1.0, "m1": 1e-3}


def test_impossible_populations_are_refused() -> None:
    with pytest.raises(InputError, match="inconsistent"):
        replace(SMALL, correlation={("n3", "r3"): 0.9, ("r3", "m2"): 0.9, ("n3", "m2"): -0.9}).correlation_matrix()
    with pytest.raises(InputError, match="'r3' has no central value"):
        simulate_recordings(replace(SMALL, central={"n3": 1e-6}), 1, 1, np.array([1.0, 2.0, 3.0]), seed=1)
    with pytest.raises(InputError, match="at least one subject"):
        simulate_recordings(SMALL, 0, 1, np.array([1.0, 2.0, 3.0]), seed=1)


def test_the_shipped_population_is_what_its_script_makes() -> None:
    module = runpy.run_path(str(ANALYSES / "fingertip_71" / "make.py"))
    simulation = simulate_recordings(FINGERTIP, 71, 3, np.geomspace(5, 5000, 401), module["SEED"])
    shipped = read_recordings(DATA / "fingertip_71")
    assert len(shipped.subjects) == 71
    for made, read in zip(simulation.recordings.subjects, shipped.subjects, strict=True):
        assert made.name == read.name
        assert made.z == pytest.approx(read.z, rel=2e-5)
    truth = json.loads((DATA / "fingertip_71" / "truth.json").read_text(encoding="utf-8"))
    assert truth == json.loads(json.dumps(simulation.truth))
    assert "simulated" in shipped.source
    assert "simulated" in shipped.title
    header = gzip.decompress((DATA / "fingertip_71" / "recordings.csv.gz").read_bytes())[:60]
    assert header.startswith(b"subject,repetition,frequency_hz,z_re,z_im")


def test_the_published_curves_are_passive_once_the_sign_is_turned() -> None:
    module = runpy.run_path(str(ANALYSES / "appendix_a" / "make.py"))
    import tomllib

    coefficients = tomllib.loads((DATA / "appendix_a" / "coefficients.toml").read_text(encoding="utf-8"))
    for key, folder in (("sit", "sit"), ("vf_median", "vf_median")):
        curve = module["published_curve"](coefficients[key])
        assert np.all(curve.real > 0)  # as printed, all of it is negative
        shipped = read_recordings(DATA / "appendix_a" / folder)
        assert shipped.subjects[0].z[0] == pytest.approx(curve, rel=1e-7)
    both = read_recordings(DATA / "appendix_a")
    assert both.names == ("SIT", "VFMedian")
    # A value worked out by hand from the printed coefficients: the limit at low frequency.
    stiffness = -coefficients["sit"]["numerator"][-1] / coefficients["sit"]["denominator"][-2]
    assert stiffness == pytest.approx(964.2, rel=1e-3)  # N/m: SIT keeps a pole at zero, the spring of all springs
    assert coefficients["vf_median"]["denominator"][-1] != 0  # vector fitting does not


GOOD_TRUTH = {
    "network": "r1|m1",
    "elements": {
        "r1": {"central": 1.0, "dispersion_between_persons": 0.2, "dispersion_between_repetitions": 0.0},
        "m1": {"central": 1e-3, "dispersion_between_persons": 0.2, "dispersion_between_repetitions": 0.0},
    },
    "correlation": [["r1", "m1", 0.2]],
    "noise": {"relative_sd": 0.01, "corner_hz": 8.0},
}


def _changed(path: tuple[str | int, ...], value: object) -> dict[str, object]:
    changed: Any = json.loads(json.dumps(GOOD_TRUTH))
    place = changed
    for key in path[:-1]:
        place = place[key]
    if isinstance(place, dict) or path[-1] < len(place):
        place[path[-1]] = value
    else:
        place.append(value)
    return changed


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("nois",), {}, 'key "nois" is not used; did you mean "noise"'),
        (("network",), 3, "network is 3, but must be text"),
        (("network",), "r1|", "ends too early"),
        (("network",), "r1|m2", "no such element"),
        (("elements",), [], "elements is a list"),
        (("elements",), {}, "must be a table"),
        (("elements", "r1"), 3, "is 3, but must be a table"),
        (("elements", "r1", "centre"), 3, 'did you mean "central"'),
        (("elements", "r1", "central"), True, "central is true"),
        (("elements", "r1", "central"), -1.0, "must be a finite number at least"),
        (("elements", "r1", "central"), float("nan"), "is nan"),
        (("elements", "r1", "central"), 10**400, "integer of"),
        (("elements", "r1", "central"), {"q05": 1.0}, 'key "median" is missing'),
        (("elements", "r1", "dispersion_between_persons"), -0.1, "at least 0"),
        (("elements", "r1", "dispersion_between_persons"), 1e3, "at most 10"),
        (("elements", "r9"), GOOD_TRUTH["elements"]["r1"], "no such element"),  # type: ignore[index]
        (("correlation",), {}, "correlation is a table"),
        (("correlation", 0), ["r1", "m1"], "entry 1 of correlation"),
        (("correlation", 0), ["r1", "r1", 0.1], "two different elements"),
        (("correlation", 0), ["r1", "q1", 0.1], "two different elements"),
        (("correlation", 0), ["r1", "m1", 1.5], "at most 1"),
        (("noise", "relative"), 0.1, 'did you mean "relative_sd"'),
        (("noise", "relative_sd"), -0.1, "at least 0"),
        (("noise", "relative_sd"), False, "is false"),
        (("noise", "corner_hz"), float("inf"), "is inf"),
    ],
)
def test_descriptions_that_make_no_population_are_refused(path: tuple[str, ...], value: object, words: str) -> None:
    assert population_from(GOOD_TRUTH, "x.json").central == {"r1": 1.0, "m1": 1e-3}
    with pytest.raises(InputError) as told:
        population_from(_changed(path, value), "x.json")
    assert str(told.value).startswith("x.json")
    assert words in str(told.value)


@pytest.mark.parametrize(
    ("frequency", "words"),
    [([5.0, 5.0, 6.0], "must ascend"), ([1.0, 2.0, np.inf], "must ascend"), ([0.0, 1.0, 2.0], "must ascend")],
)
def test_frequencies_that_do_not_ascend_are_refused(frequency: list[float], words: str) -> None:
    with pytest.raises(InputError, match=words):
        simulate_recordings(SMALL, 2, 1, np.array(frequency), seed=1)


def test_more_numbers_than_memory_holds_are_refused() -> None:
    with pytest.raises(InputError, match="simulate fewer"):
        simulate_recordings(SMALL, 10**6, 10, np.linspace(1, 1000, 500), seed=1)


def test_people_with_heavier_tails_and_their_description() -> None:
    """The factor on people has a stream of its own: noise, forces and deviations are those of the normal population."""
    population = replace(THREE_ELEMENTS, degrees_of_freedom=3.0, force_exponent={})
    frequency = np.geomspace(5, 500, 5)
    tails = simulate_recordings(population, 2000, 1, frequency, 3)
    normal = simulate_recordings(replace(population, degrees_of_freedom=np.inf), 2000, 1, frequency, 3)
    central = np.log([population.central[e] for e in ("m1", "r1", "n1")])
    away, plain = tails.log_elements - central, normal.log_elements - central
    factor = away / plain
    np.testing.assert_allclose(factor, factor[:, :1] * np.ones(3), rtol=1e-8)
    assert kstest(factor[:, 0] ** 2, invgamma(1.5, scale=1.5).cdf).pvalue > 0.01
    again = population_from(tails.truth, "truth.json")
    assert again.degrees_of_freedom == 3.0
    assert population_from(normal.truth, "truth.json").degrees_of_freedom == np.inf
    assert "distribution" not in normal.truth
    of_fit = {**tails.truth, "schema": 1, "distribution": {"degrees_of_freedom": {"median": 4.0, "q05": 3, "q95": 9}}}
    assert population_from(of_fit, "summary.json").degrees_of_freedom == 4.0


@pytest.mark.parametrize("described", [{"degrees_of_freedom": 2}, {"degrees_of_freedom": "many"}, {"nu": 3}, 3])
def test_impossible_distributions_are_refused(described: Any) -> None:
    truth = simulate_recordings(THREE_ELEMENTS, 1, 1, np.geomspace(5, 500, 5), 1).truth
    with pytest.raises(InputError, match=r"truth\.json"):
        population_from({**truth, "distribution": described}, "truth.json")
