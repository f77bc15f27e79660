"""Published values: complete, as printed, with their source; compared only where elements are the same thing."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from tiny_fits import fit_arguments

import bayes_impedance.datasets.published_sets as module
from bayes_impedance.commands.beside_lines import beside_lines
from bayes_impedance.commands.cli import main
from bayes_impedance.datasets import PublishedSet, published_set, published_values
from bayes_impedance.datasets.beside import beside
from bayes_impedance.errors import InputError
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.notation import parse


@pytest.mark.parametrize("own", published_values(), ids=lambda own: own.name)
def test_a_set_is_complete(own: PublishedSet) -> None:
    network = parse(own.network)
    assert [value.element for value in own.values] == list(network.elements)
    for value, parameter in zip(own.values, Kernel(network).parameters, strict=True):
        assert value.unit == parameter.unit("N s/m")
        assert value.limits is None or value.limits[0] < value.value < value.limits[1]
    assert own.people > 0
    assert "doi:" in own.source
    assert own.conditions
    assert own.found
    assert len(repr(own)) < 120
    table = own.to_dataframe()
    assert list(table.index) == list(network.elements)
    assert list(table["unit"]) == [value.unit for value in own.values]


def test_a_printed_stiffness_is_a_compliance() -> None:
    printed = tomllib.loads(Path(module.__file__).with_name("published_values.toml").read_text(encoding="utf-8"))
    own = {value.element: value for value in published_set("pen_grip_x").values}
    entry = printed["pen_grip_x"]["values"]["n1"]
    assert own["n1"].value * entry["printed"] == pytest.approx(1.0)
    assert own["n1"].limits == pytest.approx((1 / entry["limits"][1], 1 / entry["limits"][0]))
    assert own["r1"].value == printed["pen_grip_x"]["values"]["r1"]["printed"]


def test_an_unknown_name_gets_a_hint() -> None:
    with pytest.raises(InputError, match='"pen_grip" is not a set of published values; did you mean "pen_grip_'):
        published_set("pen_grip")


def summary_of(network: str, unit: str = "N s/m", **medians: float | None) -> dict[str, Any]:
    elements = {
        name: {"identified": m is not None, "central": {"median": m, "q05": m and 0.9 * m, "q95": m and 1.1 * m}}
        for name, m in medians.items()
    }
    return {"network": network, "unit": unit, "elements": elements, "beside": ["pen_grip_y"]}


def test_the_same_network_by_other_names_is_compared() -> None:
    summary = summary_of("(m7|r8|n8)-(r9|n9)", n9=2 / 552.4, r9=3.609, m7=None, n8=1e-2, r8=1.0)
    (own,) = beside(summary, summary["beside"])
    assert own.same
    ratio = {row.element: row.ratio for row in own.rows}
    assert ratio == {"n1": "2", "r1": "1", "m1": "", "n2": "1.05", "r2": "0.156"}
    assert next(row.own for row in own.rows if row.element == "m1") == "m7 has no number"
    lines = beside_lines(summary)
    assert any("n9 0.00362 (0.00326 to 0.00398)" in line for line in lines)
    assert any("Fu, M. J." in line for line in lines)


@pytest.mark.parametrize(("network", "unit"), [("m1|r1|n1", "N s/m"), ("(n1|r1)-(m1|n2|r2)", "ohm")])
def test_what_is_not_the_same_thing_is_not_compared(network: str, unit: str) -> None:
    (own,) = beside(summary_of(network, unit, n1=1.0, r1=1.0, m1=1.0, n2=1.0, r2=1.0), ["pen_grip_y"])
    assert not own.same
    assert all(not row.own and not row.ratio for row in own.rows)
    assert "its elements are not those of this fit" in own.sentence
    assert beside_lines({}) == []


@pytest.mark.long
def test_terminal_summary_and_page_show_them(tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main([*fit_arguments(tiny / "data", out), "--beside", "pen_grip_x"]) == 0
    assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["beside"] == ["pen_grip_x"]
    assert "published: Hand and arm at a stylus" in capsys.readouterr().out
    assert main(["report", str(out), "--beside", "pen_grip_z"]) == 0
    assert "pen_grip_z" in capsys.readouterr().out
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "Published values" in page
    assert "to and fro" in page
    assert "doi:10.1109/TSMCB.2012.2197387" in page


def test_a_wrong_name_is_refused_before_anything_is_written(
    tiny: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*fit_arguments(tiny / "data", tmp_path / "out"), "--beside", "pen"]) == 2
    assert "not a set of published values" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
