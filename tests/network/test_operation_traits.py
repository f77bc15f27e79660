"""The table of traits against the formulas, and who compares names of operations."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest
from operation_cases import (
    CASE,
    CASES,
    OF_THE_PLACE,
    Case,
    five,
    some_impedances,
)

import bayes_impedance
from bayes_impedance.network.operation_traits import PLACES, Setting
from bayes_impedance.network.operations import N_PARAMETERS, NAMES, TRAITS

PACKAGE = Path(bayes_impedance.__file__).parent


@CASE
def test_the_table_knows_the_parameters_of_the_formula(case: Case) -> None:
    """Each parameter that the table names changes the impedance, and none besides."""
    traits = TRAITS[case.name]
    assert len(traits.parameters) == len(traits.links) == len(case.u)
    u = np.array([*case.u, 0.3, 0.3])[:N_PARAMETERS]
    by_parameter = five(case, u, some_impedances(5))[2:]
    assert [bool(d.any()) for d in by_parameter] == [k < len(traits.parameters) for k in range(N_PARAMETERS)]


@pytest.mark.parametrize("name", OF_THE_PLACE)
def test_the_table_knows_how_an_operation_is_connected(name: str) -> None:
    """What is beside a place adds an impedance that the place does not change, what is in series a mobility."""
    case = next(c for c in CASES if c.name == name)
    one, other = some_impedances(6), some_impedances(7)
    a, b = five(case, case.u, one)[0], five(case, case.u, other)[0]
    beside = np.allclose(a - one, b - other, rtol=1e-6, atol=0)
    in_series = np.allclose(1 / a - 1 / one, 1 / b - 1 / other, rtol=1e-6, atol=0)
    assert (beside, in_series) == (TRAITS[name].connection == "beside", TRAITS[name].connection == "series")


def test_traits_are_complete() -> None:
    for name, traits in TRAITS.items():
        assert 1 <= len(traits.parameters) == len(traits.links) <= N_PARAMETERS, name
        assert set(traits.links) <= {"linear", "log", "logit"}, name
        assert traits.links[0] == "linear", name
        assert traits.connection in ("beside", "series", "replaces"), name
        assert set(traits.places) <= set(PLACES), name
        assert traits.built_as in ("elements", "ladder", "filter", ""), name
        setting = Setting(units=("m", "", ""), scales=(2.0, 3.0, 5.0), low=7.0, middle=11.0, high=13.0, compliance=0.5)
        x = [np.array([0.2, 0.4])] * len(traits.parameters)
        if traits.constants is not None:
            assert len(traits.constants(setting)) == N_PARAMETERS - 1, name
        for said, unit, values in traits.derived(x, setting) if traits.derived else ():
            assert said not in traits.parameters, name
            assert unit in ("m", "n", "r", "k", "c", "s", "Hz", ""), name
            assert np.all(np.isfinite(values)), name
        assert traits.allows(np.ones(len(traits.parameters))), name
        assert not traits.allows(-np.ones(len(traits.parameters))), name
        assert (traits.scanned is None) == (traits.direction is None and traits.secant is None), name


def test_one_part_of_a_bypass_may_be_absent() -> None:
    allows = TRAITS["bypass"].allows
    assert allows(np.array([1.0, -0.09]))
    assert allows(np.array([-0.09, 1.0]))
    assert not allows(np.array([1.0, -0.11]))
    assert not allows(np.array([0.0, 0.0]))


def test_only_formulas_and_circuits_know_operations_by_name() -> None:
    """A further operation needs an entry of the table, a formula, and an arm in the circuits that can build it."""
    allowed = ("network", "design/circuits")
    found = []
    for file in sorted(PACKAGE.rglob("*.py")):
        where = file.relative_to(PACKAGE).as_posix()
        if where.startswith(allowed):
            continue
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            compared: list[ast.AST] = []
            if isinstance(node, ast.Compare):
                compared = [node.left, *node.comparators]
            elif isinstance(node, ast.match_case):
                compared = [node.pattern]
            names = {n.value for c in compared for n in ast.walk(c) if isinstance(n, ast.Constant)} & set(NAMES)
            found += [f"{where}:{getattr(node, 'lineno', 0)} {name}" for name in names]
    assert not found
