"""The benchmarks compare what is equal, and count what they say they count. No time is asserted."""

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.elements import KINDS
from bayes_impedance.network.extensions import Wrapped
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse
from bayes_impedance.person.likelihood import Likelihood, log_likelihood

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
peers, floor, timing, report, constructs, kernel, vector_peak = (
    importlib.import_module(name)
    for name in ("peers", "floor", "timing", "report", "constructs", "kernel", "vector_peak")
)


@pytest.fixture
def case() -> dict[str, Any]:
    kernel = Kernel(parse(peers.NETWORK))
    order = [peers.ELEMENTS.index(name) for name in kernel.elements]
    rng = np.random.default_rng(1)
    theta = rng.normal(np.log([2e-5, 8.0, 1e-4, 3.0, 1e-3, 3e-3, 3e-3, 2.0]), 0.3, (5, 8))
    frequency = np.geomspace(5, 5000, 33)
    z = kernel.impedance(theta[0, order], frequency) * (1 + 0.02 * rng.normal(size=33))
    return {"kernel": kernel, "order": order, "theta": theta, "frequency": frequency, "z": z, "sd": 0.01 * np.abs(z)}


@pytest.mark.long
def test_numpy_and_the_package_agree_on_value_and_gradient(case: dict[str, Any]) -> None:
    theta, order, omega = case["theta"], case["order"], 2 * np.pi * case["frequency"]
    likelihood = Likelihood.make(case["frequency"], case["z"][None], case["sd"][None], np.zeros((1, 8)))
    own = theta[:, order]
    values, gradients = kernel.log_likelihood_gradient(case["kernel"], likelihood, own)
    np.testing.assert_allclose(values, log_likelihood(case["kernel"], likelihood, own), rtol=1e-12)
    chi, slope = peers.numpy_gradient(theta, omega, case["z"], case["sd"] ** -2.0)
    np.testing.assert_allclose(chi, peers.numpy_chi_square(theta, omega, case["z"], case["sd"] ** -2.0), rtol=1e-12)
    alpha, count = 2.0, likelihood.count
    np.testing.assert_allclose(values, -(alpha + count) * np.log(alpha + 0.5 * chi), rtol=1e-10)
    expected = -(alpha + count) / (alpha + 0.5 * chi)[:, None] * 0.5 * slope
    np.testing.assert_allclose(gradients, expected[:, order], rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_the_gradient_is_that_of_several_repetitions_with_deviations(case: dict[str, Any]) -> None:
    rng = np.random.default_rng(2)
    deviations = rng.normal(0, 0.05, (3, 8))
    z = np.stack([case["z"]] * 3) * (1 + 0.01 * rng.normal(size=(3, 33)))
    likelihood = Likelihood.make(case["frequency"], z, 0.01 * np.abs(z), deviations - deviations.mean(axis=0))
    theta = case["theta"][:1, case["order"]]
    _, gradient = kernel.log_likelihood_gradient(case["kernel"], likelihood, theta)
    steps = 1e-5 * np.eye(8)
    ahead, behind = (log_likelihood(case["kernel"], likelihood, theta + sign * steps) for sign in (1, -1))
    np.testing.assert_allclose(gradient[0], (ahead - behind) / 2e-5, rtol=1e-5, atol=1e-4)


def test_impedance_py_evaluates_the_same_circuit(case: dict[str, Any]) -> None:
    pytest.importorskip("impedance", reason="impedance.py is not installed (extra: bench)")
    weight = case["sd"] ** -2.0
    chi = peers.impedance_py(case["theta"][2], 2 * np.pi * case["frequency"], case["z"], weight)()
    assert chi == pytest.approx(
        peers.numpy_chi_square(case["theta"], 2 * np.pi * case["frequency"], case["z"], weight)[2]
    )


def test_jax_evaluates_the_same(case: dict[str, Any]) -> None:
    pytest.importorskip("jax", reason="JAX is not installed (extra: oracle)")
    arguments = 2 * np.pi * case["frequency"], case["z"], case["sd"] ** -2.0
    value, with_gradient = peers.jax_functions(*arguments)
    chi, slope = peers.numpy_gradient(case["theta"], *arguments)
    np.testing.assert_allclose(value(case["theta"]), chi, rtol=1e-9)
    np.testing.assert_allclose(with_gradient(case["theta"])[1], slope, rtol=1e-8, atol=1e-8 * np.abs(slope).max())


@pytest.mark.parametrize(
    ("network", "plain", "divisions"),
    [
        ("r1", 7, 0),  # chi-square alone
        ("m1|r1|n1", 7 + 3, 0),  # omega m, k/omega, their difference
        ("m1-n1", 7 + 3 + 5, 1),  # the same of the mobilities, and one inverse
    ],
)
def test_operations_are_counted(network: str, plain: int, divisions: int) -> None:
    assert floor.counted(parse(network)) == (plain, divisions)


def test_the_floor_is_the_longer_of_multiply_adds_and_divisions() -> None:
    network = parse("m1-n1")  # 15 multiplications and additions, 1 division
    assert floor.floor_seconds(network, 1.0, 1e9) == 7.5
    assert floor.floor_seconds(network, 1e9, 0.25) == 4.0


@pytest.mark.parametrize("operation", ["multiply-add", "division"])
def test_the_peak_is_of_operations_that_are_done(operation: str, monkeypatch: pytest.MonkeyPatch) -> None:
    width, n_vectors, times = 2, 4, 7
    value = np.array([[1.0 + 0.1 * k + 0.01 * i for i in range(width)] for k in range(n_vectors)])
    for _ in range(times):
        value = (1 - 1e-9) * value + 1e-9 if operation == "multiply-add" else (1 - 1e-9) / value
    assert vector_peak._loop(operation, width, n_vectors)(times) == pytest.approx(value.sum(), rel=1e-14)
    monkeypatch.setattr(vector_peak, "_WIDTHS", (width,))
    monkeypatch.setattr(vector_peak, "_VECTORS", {operation: (n_vectors,)})
    assert 0 < vector_peak.per_second(operation) < np.inf


def test_rivals_take_turns() -> None:
    order: list[str] = []
    found = timing.seconds_of({name: lambda name=name: order.append(name) for name in ("a", "b")}, rounds=3)
    turns = [name for i, name in enumerate(order) if i == 0 or order[i - 1] != name]
    assert turns == ["a", "b"] * 4  # once to begin with, then every round
    assert all(values.shape == (3,) for values in found.values())
    assert timing.ratio(np.array([2.0, 4.0, 6.0]), np.array([1.0, 2.0, 2.0]))[0] == 2.0


def test_the_table_says_what_was_measured(tmp_path: Path) -> None:
    one = {"found": 70, "people": 71, "seconds": [0.1, 0.09, 0.2], "times ours": 1.0}
    machine = {"processor": "P", "cores": 2, "python": "3.11", "date": "2026-01-01", "packages": {"numpy": "2.0"}}
    results = {"machine": machine, "one_curve": {"ours": one, "rival": one | {"times ours": 7.5}, "load before": 0.1}}
    text = report.table(results)
    assert "one curve fitted by rival | 70 of 71 optima, 100 ms, 7.5 times ours" in text
    report.draw(results, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 5000


def test_every_construct_is_timed_and_in_the_table(monkeypatch: pytest.MonkeyPatch) -> None:
    timed = [parse(text) for text in constructs.NETWORKS.values()]
    nodes = [node for network in timed for _, node in network.walk()]
    wrappers = {(node.construct.word, node.symbols[0].name[0]) for node in nodes if isinstance(node, Wrapped)}
    assert wrappers == {(word, letter) for word, own in CONSTRUCTS.items() for letter in own.letters[0]}
    assert {letter + "1" for letter in KINDS} <= set(constructs.NETWORKS)
    monkeypatch.setattr(
        constructs, "seconds_of", lambda work: {name: 2.0 + np.arange(3) + len(work[name]()) for name in work}
    )
    result = constructs.measure() | {"date": "2026-01-02"}
    machine = {"processor": "P", "cores": 2, "python": "3.11", "date": "2026-01-01", "packages": {"numpy": "2.0"}}
    text = report.table({"machine": machine, "constructs": result})
    assert "a damper alone, for each frequency (2026-01-02)" in text
    for name in list(constructs.NETWORKS)[1:]:
        assert f"| ... `{name}` | 1x (1 to 1); 1x (1 to 1) |" in text
    assert "not measured yet" not in text
    del result["impedance"]["squeeze_film[...](r1)"]
    assert "| ... `squeeze_film[...](r1)` | not measured yet |" in report.table(
        {"machine": machine, "constructs": result}
    )
