"""Users for MATLAB, Modelica and python-control: what these files say of the impedance is the impedance."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from bayes_impedance.commands.cli import main
from bayes_impedance.design.circuits.equivalent import equivalent
from bayes_impedance.design.circuits.matlab import mat_bytes, variables, with_warnings
from bayes_impedance.design.circuits.modelica import identifier, package
from bayes_impedance.design.circuits.transfer_functions import to_control
from bayes_impedance.design.users import Users
from bayes_impedance.network.notation import parse

F = np.geomspace(5, 5000, 9)
NETWORKS = (
    "skin:(n3|r3)-tissue:(m2|r1|n1|limb:(m1-(n2|r2)))",
    "m1|r1|n1",
    "(m1|n1)-(m2|r2)-(n3|r3)",
    "r1-n1",
)


def users_of(text: str, number: int = 3, unit: str = "N s/m") -> Users:
    network = parse(text)
    typical = {"m": 1e-3, "n": 1e-4, "r": 3.0, "p": 5.0, "a": 0.6}
    rng = np.random.default_rng(4)
    centre = np.log([typical[e[0]] for e in network.elements])
    u = centre + 0.3 * rng.normal(size=(number, centre.size))
    return Users(network, unit, tuple(f"user_{i}" for i in range(number)), u, (5.0, 5000.0))


def impedance_of_model(text: str, user: str, frequency_hz: np.ndarray) -> np.ndarray:
    """Impedance at the finger by the balance of forces at all points, read from the text alone."""
    match = re.search(rf"model {user} = User\((.*)\);", text)
    assert match is not None
    values = {k.strip().strip("'"): float(v) for k, v in (pair.split("=") for pair in match.group(1).split(","))}
    parts = dict(re.findall(r"\b(?:Inertia|[\w.]+\.Spring|[\w.]+\.Damper) (\w+)\((.*)\);", text))
    ends: dict[str, dict[str, str]] = {name: {} for name in parts}
    for one, other in re.findall(r"connect\(([\w.]+), ([\w.]+)\);", text):
        for part, point in ((one, other), (other, one)):
            name, _, flange = part.partition(".")
            if name in ends:
                ends[name][flange] = point
    points = sorted({p for both in ends.values() for p in both.values()} - {"ground.flange"})
    assert "finger" in points
    found = []
    for s in 2j * np.pi * frequency_hz:
        matrix = np.zeros((len(points), len(points)), dtype=complex)
        for name, given in parts.items():
            kind, expression = given.split("=")
            value = values[expression.removeprefix("1/").strip("'")]
            z = {"m": s * value, "c": 1 / (s * value), "d": value}[kind]
            at = [points.index(p) for p in ends[name].values() if p != "ground.flange"]
            for i in at:
                for j in at:
                    matrix[i, j] += z if i == j else -z
        force = np.zeros(len(points))
        force[points.index("finger")] = 1.0
        found.append(1 / np.linalg.solve(matrix, force)[points.index("finger")])
    return np.array(found)


@pytest.mark.parametrize("text", NETWORKS)
def test_a_modelica_model_has_the_impedance_of_its_user(text: str) -> None:
    users = users_of(text)
    written = package(users)
    for i, name in enumerate(users.names):
        z = users.impedance(F)[i]
        np.testing.assert_allclose(impedance_of_model(written, name, F), z, rtol=1e-9)
    assert written.count("\n  end ") == 2
    assert written.endswith("end Users;\n")


def test_masses_of_a_chain_are_at_the_fixed_end() -> None:
    written = package(users_of(NETWORKS[0]))
    masses = re.findall(r"connect\(m\d_part\.flange_b, ([\w.]+)\);", written)
    assert masses == ["ground.flange", "ground.flange"]


def test_words_of_the_language_are_quoted() -> None:
    assert identifier("model") == "'model'"
    assert identifier("m1") == "m1"
    users = users_of("model|r1")
    z = impedance_of_model(package(users), "user_0", F)
    np.testing.assert_allclose(z, users.impedance(F)[0], rtol=1e-9)


@pytest.mark.parametrize("text", [*NETWORKS, "m1|p1^0.6"])
def test_a_mat_file_has_elements_impedances_and_state_spaces(text: str) -> None:
    users = users_of(text)
    made = equivalent(users)
    content = loadmat(io.BytesIO(mat_bytes(variables(users, F, made))))
    assert [str(cell[0][0]) for cell in content["users"]] == list(users.names)
    assert [str(cell[0][0]) for cell in content["elements"]] == list(users.elements)
    np.testing.assert_array_equal(content["z"], users.impedance(F))
    signals = [str(content[name][0]) for name in ("input_name", "output_name")]
    for k in range(len(users)):
        a, b, c, d = (content[name][..., k] if content[name].ndim == 3 else content[name] for name in "ABCD")
        states = np.eye(len(a))
        h = np.array([(c @ np.linalg.solve(s * states - a, b) + d)[0, 0] for s in 2j * np.pi * F])
        z = 1 / h if signals == ["force_n", "velocity_m_per_s"] else h
        np.testing.assert_allclose(z, users.impedance(F)[k], rtol=max(2 * made.error, 1e-8))


def test_equal_mat_files_are_equal_bytes_and_carry_warnings() -> None:
    content = variables(users_of("m1|r1|n1"), F)
    assert "A" not in content
    once = mat_bytes(content)
    assert once == mat_bytes(content)
    warned = loadmat(io.BytesIO(with_warnings(once, ["one", "two"])))
    assert [str(cell[0][0]) for cell in warned["warnings"]] == ["one", "two"]
    np.testing.assert_array_equal(warned["z"], content["z"])


def test_systems_of_python_control_name_their_signals() -> None:
    pytest.importorskip("control", reason="python-control is not installed (extra: design)")
    users = users_of("m1|r1|n1")
    for form in ("state_space", "transfer", "zeros_poles"):
        system = to_control(users.network, users.of(0), form)
        assert (system.input_labels, system.output_labels) == (["force_n"], ["velocity_m_per_s"])
    cell = users_of("r0|(r1-n1)", unit="ohm")
    system = to_control(cell.network, cell.of(0), "transfer", mobility=False, unit="ohm")
    assert (system.input_labels, system.output_labels) == (["current_a"], ["voltage_v"])


def test_both_by_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("control", reason="python-control is not installed (extra: design)")
    from bayes_impedance.design import read_control

    monkeypatch.chdir(tmp_path)
    what = [word for name in ("mat", "modelica", "transfer") for word in ("--what", name)]
    assert main(["export", "fingertip_71", "-o", "out", *what, "--users", "5", "--no-pictures"]) == 0
    content = loadmat(tmp_path / "out" / "users.mat")
    names = [str(cell[0][0]) for cell in content["users"]]
    text = (tmp_path / "out" / "Users.mo").read_text(encoding="utf-8")
    frequency = content["frequency_hz"].ravel()[::40]
    for row in (0, len(names) - 1):
        np.testing.assert_allclose(impedance_of_model(text, names[row], frequency), content["z"][row, ::40], rtol=1e-6)
    system = read_control(tmp_path / "out" / "transfer.json")[names[0]]
    assert (system.name, system.input_labels) == (names[0], ["force_n"])
