"""Power laws, wrappers, and parameters that are shared or held, in the drawn network."""

from __future__ import annotations

import re

import pytest
from hypothesis import given, settings
from pages import Page
from strategies import language, repeatable

from bayes_impedance.network.notation import parse
from bayes_impedance.network.schematic import schematic


def box(svg: str, kind: str) -> list[tuple[float, float, float, float]]:
    """Left, top, right and bottom of each rectangle of a class."""
    pattern = rf'<rect class="{kind}" x="([-\d.]+)" y="([-\d.]+)" width="([\d.]+)" height="([\d.]+)"'
    found = [tuple(map(float, numbers)) for numbers in re.findall(pattern, svg)]
    return [(x, y, x + width, y + height) for x, y, width, height in found]


def names(svg: str) -> dict[str, tuple[float, float]]:
    """Positions of the names of elements."""
    found = re.findall(r'<text class="n" x="([\d.]+)" y="([\d.]+)" text-anchor="\w+">([^<]+)</text>', svg)
    return {name: (float(x), float(y)) for x, y, name in found}


@pytest.mark.parametrize("electrical", [False, True])
@settings(repeatable, max_examples=60)
@given(network=language())
def test_every_parameter_is_drawn_once_and_inside_the_picture(network, electrical: bool) -> None:
    svg = schematic(network, dict.fromkeys(network.elements, "0.68 µm/N"), electrical=electrical)
    page = Page(svg)
    assert sorted(page.drawn) == sorted(p.name for p in network.parameters if p.name)
    for parameter in network.parameters:
        assert any(text.strip() == str(parameter.symbol) for text in page.text), str(parameter.symbol)
    width, height = map(float, re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
    assert all(-0.5 <= float(x) <= width + 0.5 for x in re.findall(r' (?:x|cx)="([-\d.]+)"', svg))
    assert all(-0.5 <= float(y) <= height + 0.5 for y in re.findall(r' (?:y|cy)="([-\d.]+)"', svg))
    wrappers = len(box(svg, "o"))
    assert wrappers == sum(hasattr(node, "construct") for _, node in network.walk())


def test_a_wrapper_s_box_is_around_what_it_wraps_and_no_other() -> None:
    svg = schematic(parse("m1|reflex[k1, d1*, f1=3](n1|hysteretic[e1](n2))"), {"k1": "210 N/m", "d1": "35 ms"})
    outer, inner = sorted(box(svg, "o"), key=lambda b: b[0])
    at = names(svg)

    def within(around: tuple[float, float, float, float]) -> set[str]:
        return {n for n, (x, y) in at.items() if around[0] < x < around[2] and around[1] < y < around[3]}

    assert within(outer) == {"n1", "n2"}
    assert within(inner) == {"n2"}
    title = re.search(r'<text class="h"[^>]*>reflex .*?</text>', svg).group()
    assert re.sub(r"<[^>]*>", "", title) == "reflex &#160;k1 = 210 N/m, d1* = 35 ms, f1=3"


def test_a_power_law_has_a_symbol_its_exponent_and_where_its_size_is_told() -> None:
    text, values = "p1^a1@100|r1", {"p1": "31 N s/m", "a1": "0.25"}
    mechanical, circuit = schematic(parse(text), values), schematic(parse(text), values, electrical=True)
    assert mechanical.count("<polygon") == 1
    assert circuit.count("<polygon") == 0
    assert circuit != schematic(parse("r2|r1"), values, electrical=True)
    for svg in (mechanical, circuit):
        assert "31 N s/m at 100 Hz" in Page(svg).text
        assert "a1 = 0.25" in Page(svg).text
        place, raised = names(svg)["p1"], re.search(r'<text class="x" x="([\d.]+)" y="([\d.]+)"[^>]*>a1<', svg)
        assert float(raised.group(1)) > place[0]
        assert float(raised.group(2)) < place[1]
    assert Page(schematic(parse("p1^0.5"))).text.count("0.5") == 1


def test_shared_and_held_are_written_as_in_the_notation() -> None:
    page = Page(schematic(parse("m9*|m8=0.0115|p1*^a1=0.3|offset[k1*](n1)")))
    assert {"m9*", "m8=0.0115", "p1*", "a1=0.3", "k1*", "n1"} <= {text.strip() for text in page.text}
    assert sorted(page.drawn) == ["a1", "k1", "m8", "m9", "n1", "p1"]


def test_marks_inside_wrappers_are_around_their_part() -> None:
    network = parse("delay[d1*](m1|(n1-r1))")
    for place in network.places():
        if place.path:
            (around,) = box(schematic(network, mark=place), "k")
            at = names(schematic(network, mark=place))
            inside = {n for n, (x, y) in at.items() if around[0] < x < around[2] and around[1] < y < around[3]}
            assert inside == {e for e in network.at(place).elements if e != "d1"}


def test_what_has_a_mass_at_its_end_is_drawn_last() -> None:
    at = names(schematic(parse("delay[d1](m1)-n1")))
    assert at["m1"][0] > at["n1"][0]
    at = names(schematic(parse("m1=0.01-r1")))
    assert at["m1=0.01"][0] > at["r1"][0]
