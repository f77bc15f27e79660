"""Marks on the drawn circuit: where physics was added, and nowhere else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from diagnoses_by_hand import make_diagnosis, page_of
from pages import Page, without_library

from bayes_impedance.network.notation import PAPER_NETWORK, Place, parse
from bayes_impedance.network.schematic import schematic
from bayes_impedance.report.diagnosis_page import added


def box(svg: str) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of the highlight."""
    found = re.findall(r'<rect class="k" x="([-\d.]+)" y="([-\d.]+)" width="([\d.]+)" height="([\d.]+)"', svg)
    assert len(found) == 1
    x, y, width, height = map(float, found[0])
    return x, y, x + width, y + height


def inside(svg: str) -> set[str]:
    """Elements whose name is in the highlight."""
    left, top, right, bottom = box(svg)
    names = re.findall(r'<text class="n" x="([\d.]+)" y="([\d.]+)" text-anchor="middle">(\w+)</text>', svg)
    return {name for x, y, name in names if left < float(x) < right and top < float(y) < bottom}


@pytest.mark.parametrize("electrical", [False, True])
def test_a_mark_is_around_its_part_and_no_other(electrical: bool) -> None:
    network = parse(PAPER_NETWORK)
    for place in network.places()[1:]:
        svg = schematic(network, electrical=electrical, mark=place)
        assert inside(svg) == set(network.at(place).elements), place.name
        width, height = map(float, re.search(r'viewBox="0 0 (\d+) (\d+)"', svg).groups())
        left, top, right, bottom = box(svg)
        assert 0 <= left < right <= width
        assert 0 <= top < bottom <= height
        assert sorted(Page(svg).drawn) == sorted(network.elements)


def test_the_port_is_marked_at_its_end() -> None:
    network = parse(PAPER_NETWORK)
    svg = schematic(network, mark=Place((), "port"))
    left, top, right, bottom = box(svg)
    x, y = map(float, re.search(r'<circle class="w" cx="([\d.]+)" cy="([\d.]+)"', svg).groups())
    assert left < x < right
    assert top < y < bottom
    assert inside(svg) == set()
    assert svg == schematic(network, mark=()) == schematic(network, mark={(): ""})


def test_nothing_marked_is_the_drawing_as_it_was() -> None:
    network = parse(PAPER_NETWORK)
    assert schematic(network) == schematic(network, mark=None) == schematic(network, mark={})
    assert ".k{" not in schematic(network)
    two = schematic(network, mark={(): "1, 2", network.place("skin").path: "<3>"})
    assert two.count('<rect class="k"') == 2
    assert ">1, 2</text>" in two
    assert "&lt;3&gt;" in two


def test_places_and_new_parts_are_marked_on_the_page(tmp_path: Path) -> None:
    diagnosis = make_diagnosis("two")
    text, _ = page_of(diagnosis, tmp_path)
    before, after = re.findall(r"<svg.*?</svg>", without_library(text), re.DOTALL)
    assert before.count('<rect class="k"') == 2  # the port and the tissue
    assert ">1</text>" in before
    assert ">2</text>" in before
    assert inside(after) == {"m4", "n4", "r4"}
    assert ">new</text>" in after


def test_added_parts_are_the_largest_new_ones() -> None:
    assert added("n1|r1", "n1|r1|(m2-r2)") == [(2,)]
    assert added("n1|r1", "(n1|r1|n2)-r3") == [(0, 2), (1,)]
    assert added("n1|r1", "n1|r1") == added("n1", "no network (") == []
