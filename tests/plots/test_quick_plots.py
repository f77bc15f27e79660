"""Pictures in one call: into given axes or new ones, with the numbers of the recordings and the result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from results_by_hand import make_result

from bayes_impedance.errors import InputError
from bayes_impedance.plots import plot_bode, plot_nyquist, plot_person, plot_predictive_check
from bayes_impedance.recordings.dataset import Recordings, Subject
from bayes_impedance.results.person_curves import person_band
from bayes_impedance.results.result import Result


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    plt.close("all")


def recorded() -> Recordings:
    f = np.geomspace(5, 5000, 20)
    subjects = tuple(
        Subject(name=f"P{i:02d}", frequency_hz=f, z=(1 + i) * np.array([3 + 2j * f / 100]), repetitions=("1",))
        for i in range(6)
    )
    return Recordings(title="t", unit="N s/m", network=None, source="", licence="", subjects=subjects)


def result_with_predictions() -> Result:
    result = make_result()
    data = result.groups
    z = data["constant_data"]["observed_re"] + 1j * data["constant_data"]["observed_im"]
    rng = np.random.default_rng(0)
    observed = {"log_magnitude": np.log(np.abs(z)), "phase_deg": np.angle(z, deg=True)}
    predicted = {name: v + 0.2 * rng.normal(size=(2, 50, *v.shape)) for name, v in observed.items()}
    groups = data | {"observed_data": data["observed_data"] | observed, "posterior_predictive": predicted}
    coords = result.coords | {"predictive_frequency_hz": result.coords["frequency_hz"]}
    return replace(result, groups=groups, coords=coords)


def test_bode_of_recordings_draws_everybody() -> None:
    recordings = recorded()
    upper, lower = plot_bode(recordings, color="red")
    assert len(upper.lines) == len(lower.lines) == 6
    np.testing.assert_array_equal(upper.lines[2].get_ydata(), np.abs(recordings.subjects[2].mean))
    np.testing.assert_allclose(lower.lines[2].get_ydata(), np.angle(recordings.subjects[2].mean, deg=True))
    assert upper.lines[0].get_color() == "red"
    assert (upper.get_xscale(), upper.get_yscale()) == ("log", "log")
    assert "N s/m" in upper.get_ylabel()
    assert plt.get_fignums()  # a notebook shows it


def test_bode_of_a_result_has_the_predicted_band() -> None:
    _, axes = plt.subplots(2, 1)
    result = make_result()
    upper, lower = plot_bode(result, axes)
    assert (upper, lower) == tuple(axes)
    assert len(upper.lines) == 7
    assert len(upper.collections) == len(lower.collections) == 1
    assert len(plt.get_fignums()) == 1
    with pytest.raises(InputError, match="two axes"):
        plot_bode(result, [upper])


def test_nyquist_follows_the_custom_of_its_field() -> None:
    axes = plot_nyquist(recorded())
    np.testing.assert_array_equal(axes.lines[1].get_ydata(), recorded().subjects[1].mean.imag)
    electrical = make_result(electrical=True)
    axes = plot_nyquist(electrical, plt.subplots()[1])
    np.testing.assert_array_equal(axes.lines[0].get_ydata(), -electrical.groups["constant_data"]["observed_im"][0])
    assert axes.get_ylabel() == "-Im z (ohm)"


def test_a_person_is_shown_with_the_own_network() -> None:
    result = make_result()
    upper, lower = plot_person(result, "P02")
    seen, fitted = (np.asarray(line.get_ydata()) for line in upper.lines)
    z = result.groups["constant_data"]["observed_re"][2] + 1j * result.groups["constant_data"]["observed_im"][2]
    np.testing.assert_allclose(seen, np.abs(z))
    np.testing.assert_allclose(fitted, seen, rtol=0.15)
    assert len(lower.collections) == 1
    other, _ = plot_person(result, "P02", recorded())
    np.testing.assert_allclose(other.lines[0].get_ydata(), np.abs(recorded().subjects[2].z[0]))
    with pytest.raises(InputError, match='"P2" is not in the result'):
        plot_person(result, "P2")


@pytest.mark.parametrize("lost", [("n3",), tuple(make_result().elements)])
def test_a_person_is_shown_without_a_band_where_an_element_is_not_determined(lost: tuple[str, ...]) -> None:
    result = make_result(unidentified=lost)
    upper, lower = plot_person(result, "P02")
    kept = result.groups["constant_data"]
    z = kept["person_curve_re"][2] + 1j * kept["person_curve_im"][2]
    np.testing.assert_array_equal(upper.lines[1].get_ydata(), np.abs(z))
    np.testing.assert_array_equal(lower.lines[1].get_ydata(), np.angle(z, deg=True))
    assert not upper.collections
    assert f"no band: {', '.join(lost)} not determined" in str(upper.lines[1].get_label())
    assert len(plot_person(result, "P02", recorded())[0].lines) == 2
    with pytest.raises(InputError, match='"P2" is not in the result'):
        plot_person(result, "P2")
    with pytest.raises(InputError, match="do not determine n3"):
        person_band(make_result(unidentified=("n3",)), "P02", np.array([10.0]))
    del kept["person_curve_re"]
    with pytest.raises(InputError, match="fit it again"):
        plot_person(result, "P02")


def test_a_predictive_check_compares_quantiles_over_people() -> None:
    result = result_with_predictions()
    upper, lower = plot_predictive_check(result)
    assert len(upper.lines) == len(upper.collections) == len(lower.lines) == 3
    expected = np.exp(np.median(result.groups["observed_data"]["log_magnitude"], axis=0))
    np.testing.assert_allclose(upper.lines[1].get_ydata(), expected)
    with pytest.raises(InputError, match="earlier version"):
        plot_predictive_check(make_result())
    few = result.groups["observed_data"]["log_magnitude"][:3]
    groups = result.groups | {"observed_data": result.groups["observed_data"] | {"log_magnitude": few}}
    with pytest.raises(InputError, match="5 subjects or more"):
        plot_predictive_check(replace(result, groups=groups))
