"""Objects say in a line what they are, show a table in a notebook, and become DataFrames."""

from __future__ import annotations

import inspect
from dataclasses import fields, is_dataclass, replace
from html import escape
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import SHORT, THREE_ELEMENTS
from diagnoses_by_hand import make_diagnosis
from results_by_hand import make_result as result_by_hand

from bayes_impedance import display
from bayes_impedance.classical import map_to_network, vector_fit
from bayes_impedance.classical.methods import compare_methods
from bayes_impedance.design import population_of, representatives
from bayes_impedance.design.answer import design_answer
from bayes_impedance.design.loop.device import PHANTOM, Section
from bayes_impedance.diagnosis.types import OnePort
from bayes_impedance.diagnosis.verdict_tables import COLUMNS
from bayes_impedance.diagnosis.verdict_types import Physics
from bayes_impedance.intake import ImportSettings
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import PAPER_NETWORK, parse
from bayes_impedance.population.diagnostics import Diagnostics
from bayes_impedance.population.fit import PopulationFit, fit_population
from bayes_impedance.population.given_prior import ElementPrior, GivenPrior
from bayes_impedance.population.parameters import PopulationParameters
from bayes_impedance.population.settings import FitSettings
from bayes_impedance.population.simulate import Simulation, VirtualPopulation, simulate_recordings
from bayes_impedance.quality.findings import Finding
from bayes_impedance.recordings.files import read_recordings, write_recordings
from bayes_impedance.results.leave_one_out import leave_one_out
from bayes_impedance.results.network_comparison import Entry, NetworkComparison
from bayes_impedance.results.predictive import Band, predict
from bayes_impedance.results.result import load_result, make_result, save_result
from bayes_impedance.units import rounded

LONGEST = 300
"""Characters of a line that says what an object is."""


class Balanced(HTMLParser):
    """Raises if tags do not match."""

    VOID = frozenset({"img", "br"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.cells: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        pass

    def handle_data(self, data: str) -> None:
        self.cells.append(data)


@pytest.fixture(scope="module")
def fit() -> PopulationFit:
    recordings = simulate_recordings(THREE_ELEMENTS, 6, 2, np.geomspace(5, 5000, 12), seed=2).recordings
    return fit_population(recordings, settings=SHORT, seed=1)


def shown(thing: Any) -> str:
    assert len(repr(thing)) < LONGEST
    assert "array(" not in repr(thing)
    html = thing._repr_html_()
    Balanced(html)
    return str(html)


def test_recordings_and_subjects(fit: PopulationFit) -> None:
    html = shown(fit.recordings)
    assert html.count("<polyline") == 12  # magnitude and phase of six people
    assert "6 subjects" in html
    for name in fit.recordings.names:
        assert f">{name}<" in html
    one = fit.recordings.subjects[0]
    assert shown(one).count("<polyline") == 4
    frame = one.to_dataframe()
    assert len(frame) == one.z.size
    np.testing.assert_array_equal(frame["z_re"], one.z.real.ravel())


def test_names_from_files_are_text_and_not_html(tmp_path: Path) -> None:
    recordings = result_by_hand()
    assert "<fingers>" not in display.heading(str(recordings.attributes["title"]))
    assert "&lt;b&gt;" in display.table(["<b>"], [["<i>"]])


@pytest.mark.parametrize("text", [PAPER_NETWORK, "m1", "delay[d1*](m1|p1^a1=0.3)-n1"])
def test_networks(text: str) -> None:
    network = parse(text)
    assert eval(repr(network), {"parse": parse}) == network
    assert "data:image/svg+xml" in shown(network)


def test_fits_results_and_predictions(fit: PopulationFit) -> None:
    predictive = predict(fit, n_draws=50, n_replicates=20)
    result = make_result(fit, predictive, {})
    table = fit.to_dataframe()
    expected = result.to_dataframe()
    for column in ("central", "central_q05", "between_persons", "between_repetitions_q95"):
        np.testing.assert_allclose(table[column], expected[column])
    for thing in (fit, result):
        html = shown(thing)
        assert all(f">{element}<" in html for element in ("m1", "r1", "n1"))
    assert "polyline" in shown(predictive)
    bands = predictive.to_dataframe()
    np.testing.assert_array_equal(bands["recording_magnitude_q95"], predictive.recording.magnitude[4])
    np.testing.assert_array_equal(bands["centre_phase_deg_q05"], predictive.centre.phase_deg[0])
    users = population_of(result).draw(30, seed=1)
    assert "and 20 more" in shown(users)


def test_numbers_that_must_not_be_used_are_not_shown() -> None:
    html = shown(result_by_hand(problems=("the ensembles disagree",)))
    assert "the ensembles disagree" in html
    assert "7.9e-4" not in html
    assert "0.00079" not in html


def test_verdicts_and_diagnoses() -> None:
    diagnosis = make_diagnosis()
    verdict = diagnosis.verdict
    table = verdict.to_dataframe()
    assert list(table)[: len(COLUMNS)] == list(COLUMNS)
    assert len(table) == sum(max(1, len(entry.parameters)) for entry in verdict.physics)
    first = verdict.physics[0]
    (name, parameter), *_ = first.parameters.items()
    row = table[(table["id"] == first.id) & (table["parameter"] == name)].iloc[0]
    assert row["median"] == parameter.median
    assert shown(verdict) == shown(diagnosis)
    assert len(diagnosis.to_dataframe()) == len(diagnosis.ranking)


def test_comparisons(fit: PopulationFit) -> None:
    result = make_result(fit, predict(fit, n_draws=50, n_replicates=20), {})
    left_out = leave_one_out(result)
    assert len(left_out.to_dataframe()) == 6
    comparison = NetworkComparison.of([Entry("a", "a", result, left_out), Entry("b", "b", result, left_out)])
    assert list(comparison.to_dataframe()["elpd"]) == [left_out.total[0]] * 2
    shown(left_out)
    shown(comparison)


@pytest.mark.parametrize(
    "kernel",
    [
        Kernel(parse(PAPER_NETWORK)),
        Kernel(parse("delay[d1*](m1|p1^a1)")),
        Kernel(parse("m1|r1|n1")).holding({"r1": 0.0}),
        Kernel(parse("|".join(f"m{i}" for i in range(100)))),
    ],
    ids=["paper", "wrapped", "held", "long"],
)
def test_kernels(kernel: Kernel) -> None:
    html = shown(kernel)
    assert f"{len(kernel.elements)} parameters" in repr(kernel)
    assert all(f">{name}<" in html for name in kernel.elements)


def test_findings() -> None:
    everywhere = Finding(
        id="lag", severity="note", subject=None, repetition=None, frequency_hz=None, message="A <lag>."
    )
    one = replace(everywhere, id="jump", severity="warning", subject="P01", repetition="2", frequency_hz=(50.0, 61.25))
    assert repr(everywhere) == "<Finding lag (note): all subjects>"
    assert repr(one) == "<Finding jump (warning): P01, repetition 2, 50 to 61.25 Hz>"
    assert "A &lt;lag&gt;." in shown(one)
    assert one != everywhere
    shown(replace(one, subject="x" * 1000))


def test_devices_and_their_answers(fit: PopulationFit) -> None:
    html = shown(PHANTOM)
    assert repr(PHANTOM) == "<Device PHANTOM 1.0, one axis: 3 section(s), 1000 Hz>"
    assert "m1 = 0.072, r1 = 0.005" in html
    assert "Diolaiti" in html
    assert "ratio = 2" in shown(replace(PHANTOM, sections=(*PHANTOM.sections, Section("lever", "", {"ratio": 2.0}))))
    population = population_of(make_result(fit, predict(fit, n_draws=50, n_replicates=20), {}))
    answer = design_answer(population, population.draw(5, seed=1), PHANTOM, damping=2.0, grid=3)
    html = shown(answer)
    assert f"{rounded(answer.limit.stiffness)} N/m for 99 % of users at B = 2 N s/m" in repr(answer)
    assert display.number(answer.limit.mean_user) in html
    assert escape(answer.sentence) in html


def test_inputs_for_designers(fit: PopulationFit) -> None:
    """Every object of an answer, and what else designers get, in a line and a table."""
    population = population_of(make_result(fit, predict(fit, n_draws=50, n_replicates=20), {}))
    users = population.draw(40, seed=1)
    answer = design_answer(population, users, PHANTOM, damping=2.0, grid=3)
    for one in (answer.map, answer.limit, answer.reason, answer.transparency):
        shown(one)
    assert repr(answer.limit).startswith("<Limit: damping 2, share 0.99, stiffness ")
    table = answer.map.to_dataframe()
    assert len(table) == answer.map.probability.size
    row = table.iloc[answer.map.stiffness.size + 1]  # second damping, second stiffness
    assert (row["damping"], row["stiffness"]) == (answer.map.damping[1], answer.map.stiffness[1])
    assert row["share"] == answer.map.probability[1, 1]
    assert answer.transparency is not None
    error = answer.transparency.to_dataframe()
    np.testing.assert_array_equal(error["velocity_error"], np.median(answer.transparency.velocity_error, axis=0))
    empty = replace(
        answer.transparency, transmitted=np.zeros((0, len(error))), velocity_error=np.zeros((0, len(error)))
    )
    assert empty.to_dataframe()["transmitted"].isna().all()
    few = representatives(population, users, (5, 5000), number=2)
    shown(few)
    assert list(few.to_dataframe()["rule"]) == list(few.rules)


def test_methods_of_the_paper_one_by_one(fit: PopulationFit) -> None:
    frequency, z = fit.recordings.subjects[0].frequency_hz, fit.recordings.subjects[0].mean
    fitted = vector_fit(frequency, z, n_poles=1, pole_at_zero=True, linear=True)
    mapping = map_to_network(fitted.model.transfer_function(), parse("m1|r1|n1"), frequency)
    for one in (fitted, fitted.model, mapping):
        shown(one)
    table = mapping.to_dataframe()
    assert list(table.index) == list(mapping.elements)
    assert table["value"]["r1"] == mapping.elements["r1"].value


def test_no_public_class_shows_its_arrays() -> None:
    """A dataclass with arrays has a line of its own: what dataclasses make would print every number."""
    import bayes_impedance

    rooms = sorted({module.split(".")[0] for module in bayes_impedance._MODULES.values()} | {"mcmc", "person"})
    wrong = []
    for room in rooms:
        module = import_module(f"bayes_impedance.{room}")
        for name in getattr(module, "__all__", ()):
            one = getattr(module, name)
            if isinstance(one, type) and is_dataclass(one) and any("ndarray" in str(f.type) for f in fields(one)):
                wrong += [name] if one.__dataclass_params__.repr and "__repr__" not in inspect.getsource(one) else []
    assert not wrong


def reached_from(one: Any, found: dict[type, Any]) -> None:
    """What is held by an object of the package, one of each class."""
    if isinstance(one, dict | list | tuple):
        for value in list(one.values() if isinstance(one, dict) else one)[:1]:
            reached_from(value, found)
    elif type(one).__module__.startswith("bayes_impedance") and type(one) not in found:
        found[type(one)] = one
        for field in fields(one) if is_dataclass(one) else ():
            reached_from(getattr(one, field.name), found)


def test_what_results_hold_is_short(fit: PopulationFit) -> None:
    predictive = predict(fit, n_draws=50, n_replicates=20)
    result = make_result(fit, predictive, {})
    simulation = simulate_recordings(THREE_ELEMENTS, 3, 2, np.geomspace(5, 5000, 12), seed=2)
    found: dict[type, Any] = {}
    for one in (fit, predictive, result, simulation, make_diagnosis(), make_diagnosis("unknown"), THREE_ELEMENTS):
        reached_from(one, found)
    assert len(found) > 30
    for one in found.values():
        assert len(repr(one)) < LONGEST
        assert "array(" not in repr(one)
        if hasattr(one, "_repr_html_"):
            Balanced(one._repr_html_())
    for kind in (Simulation, PopulationParameters, Diagnostics, Band, Physics, OnePort, VirtualPopulation):
        shown(found[kind])
    true = simulation.to_dataframe()
    assert list(true.index) == list(simulation.recordings.names)
    np.testing.assert_allclose(true["r1"], np.exp(simulation.log_elements[:, list(true).index("r1")]))
    ratio = found[OnePort].to_dataframe()
    np.testing.assert_array_equal(ratio["ratio_im"], found[OnePort].ratio.imag)


@pytest.mark.parametrize(
    "settings",
    [
        FitSettings(),
        FitSettings(covariance="diagonal", prior=GivenPrior(elements={"m1": ElementPrior(centre=0.02, scale=0.4)})),
        ImportSettings(),
    ],
)
def test_settings_say_what_was_chosen_and_can_be_made_again(settings: Any) -> None:
    names = {one.__name__: one for one in (FitSettings, GivenPrior, ElementPrior, ImportSettings)}
    assert eval(repr(settings), names) == settings
    assert "draws" not in repr(settings)
    assert isinstance(settings, ImportSettings) or f">{settings.draws}<" in shown(settings)
    assert repr(type(settings)()) == f"{type(settings).__name__}()"


def test_comparisons_of_methods(fit: PopulationFit) -> None:
    result = make_result(fit, predict(fit, n_draws=50, n_replicates=20), {})
    comparison = compare_methods(fit.recordings, result)
    html = shown(comparison)
    assert all(escape(method.label) in html for method in comparison.methods)
    assert f"{len(comparison.methods)} methods, 6 subjects" in repr(comparison)
    assert ">yes<" in html
    assert "withheld" in shown(replace(comparison, problems=("withheld",)))


def test_paths_may_be_text(fit: PopulationFit, tmp_path: Path) -> None:
    from bayes_impedance.plots import save_figure
    from bayes_impedance.plots.style import style

    with style():
        from matplotlib.figure import Figure

        assert save_figure(Figure(), str(tmp_path / "pictures"), "one", ["png"]).is_file()
    result = make_result(fit, predict(fit, n_draws=50, n_replicates=20), {})
    save_result(result, str(tmp_path / "out"))
    assert load_result(str(tmp_path / "out")).elements == result.elements
    write_recordings(fit.recordings, str(tmp_path / "data"))
    assert len(read_recordings(str(tmp_path / "data"))) == 6
    from bayes_impedance.design.loop.device import read_device

    device = tmp_path / "mine.toml"
    device.write_text(
        'period_s = 1e-3\n[[section]]\narrangement = "beside"\nnetwork = "m1"\nvalues = {m1 = 0.1}\n', encoding="utf-8"
    )
    assert read_device(str(device)).name == "mine"
