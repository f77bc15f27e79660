"""The page of all elements is that of the tables, and the README's networks are networks."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.electrical import CIRCUIT_ELEMENTS
from bayes_impedance.network.elements import KINDS
from bayes_impedance.network.notation import parse
from bayes_impedance.network.parameters import EXPONENTS
from bayes_impedance.network.passivity import known_passive
from bayes_impedance.network.tree import Network

ROOT = Path(__file__).resolve().parents[2]
S = 2j * np.pi * np.geomspace(0.1, 100, 9)


def networks_of(page: str) -> list[str]:
    """First column of the page's tables of networks, wrappers around something."""
    tables = re.findall(
        r"^\| (?:network|written|circuits) \|[^\n]*\n\|[^\n]*\n((?:\|[^\n]*\n)+)", page, flags=re.MULTILINE
    )
    cells = [cell for table in tables for cell in re.findall(r"^\| `([^`]+)`", table, flags=re.MULTILINE)]
    return [cell.replace(r"\|", "|").replace("(...)", "(n7|r7)") for cell in cells]


def test_the_page_is_up_to_date() -> None:
    """If not: python docs/elements.py."""
    script = runpy.run_path(str(ROOT / "docs" / "elements.py"))
    assert script["PAGE"].read_text(encoding="utf-8") == script["page"]()


def test_the_page_has_everything() -> None:
    page = (ROOT / "docs" / "elements.md").read_text(encoding="utf-8")
    for word in CONSTRUCTS:
        assert f"`{word}[" in page
    for word in CIRCUIT_ELEMENTS:
        assert f"| `{word}1` |" in page


def rows_of(page: str) -> dict[str, dict[str, str]]:
    """The tables of elements and wrappers: each row by what is written, its cells by their heads."""
    rows = {}
    for head, body in re.findall(r"^\| (written \|[^\n]*) \|\n\|[^\n]*\n((?:\|[^\n]*\n)+)", page, flags=re.MULTILINE):
        for line in body.splitlines():
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            rows[cells[0]] = dict(zip(re.split(r" *\| *", head), cells, strict=True))
    return rows


def language() -> list[str]:
    """What stands in the first column for everything that a network may hold besides its two connections."""
    laws = [f"`p1^{letter}1`" for letter in EXPONENTS] + ["`p1^0.5`", "`p1^a1@100`"]
    return [*(f"`{letter}1`" for letter in KINDS), *laws, *(f"`{word}[" for word in CONSTRUCTS)]


def test_each_node_of_a_network_is_of_the_language() -> None:
    """A new kind of node has to be added to the page, and to :func:`language`."""

    def final(node: type) -> set[str]:
        return set().union(*(final(own) for own in node.__subclasses__())) or {node.__name__}

    assert final(Network) == {"Element", "PowerLaw", "Wrapped", "Parallel", "Series"}


@pytest.mark.parametrize("written", language())
def test_each_has_unit_passivity_and_a_source_in_full(written: str) -> None:
    page = (ROOT / "docs" / "elements.md").read_text(encoding="utf-8")
    (row,) = (cells for first, cells in rows_of(page).items() if first.startswith(written))
    in_full = dict(
        re.findall(r"^\| ([^|`]+) \| ([^|]+, (?:18|19|20)\d\d[^|]*|ISO [^|]+) \|$", page, flags=re.MULTILINE)
    )
    sources = row["source"].split("; ")
    assert all(source in in_full for source in sources)
    first = row["written"].split("` or `")[0].strip("`").replace("(...)", "(n7|r7)")
    for parameter in parse(first).parameters:
        if parameter.name and not parameter.held and parameter.name[1:] != "7":
            assert f"`{parameter.letter}`: {parameter.unit('N s/m') or '1'}" in row["units"]
    assert row["passive"].startswith("yes" if known_passive(parse(first)) else "no")


def test_each_source_is_one_of_something() -> None:
    script = runpy.run_path(str(ROOT / "docs" / "elements.py"))
    used = {source for row in rows_of(script["page"]()).values() for source in row["source"].split("; ")}
    assert used == set(script["REFERENCES"])


@pytest.mark.parametrize(
    ("page", "count"),
    [("README.md", 10), ("docs/elements.md", 7 + len(CONSTRUCTS) + len(CIRCUIT_ELEMENTS))],
)
def test_what_is_written_on_pages_can_be_read(page: str, count: int) -> None:
    networks = networks_of((ROOT / page).read_text(encoding="utf-8"))
    assert len(networks) == count
    for text in networks:
        network = parse(text)
        assert np.isfinite(network.impedance(S, dict.fromkeys(network.elements, 0.7))).all()


FUNCTIONS = {"exp": np.exp, "sqrt": lambda x: np.sqrt(x + 0j), "coth": lambda x: 1 / np.tanh(x), "tanh": np.tanh}


@pytest.mark.parametrize("word", CONSTRUCTS)
def test_printed_formulas_are_those_that_are_computed(word: str) -> None:
    """The text, with its products written out, is evaluated as it stands."""
    construct = CONSTRUCTS[word]
    texts, _, where = construct.text.partition(", w = ")
    for k, whole in enumerate(texts.replace(" or", ",").split(", ")):
        text = whole.replace("w", f"({where})") if where else whole
        several = {"offset": "mrk", "reflex": "kr"}.get(word, construct.letters[0][0] * (k + 1))
        letters = [several[k], *(c[0] for c in construct.letters[1:])]
        values = dict(zip(letters, (0.3, 0.02, 7.0), strict=False))
        z = 2.0 + 0.3 * S + 5 / S
        known = {"s": S, "z": z, "j": 1j, "pi": np.pi, "y": S * values.get("m", np.nan)} | values | FUNCTIONS
        product = re.sub(
            r"(?<=[\w)]) (?=[\w(])", "*", re.sub(r"\b(coth|tanh) (sqrt\((?:[^()]|\([^()]*\))*\))", r"\1(\2)", text)
        ).replace("^", "**")
        expected = eval(product, {}, known)
        np.testing.assert_allclose(construct.formula(S, z, list(values.values()), letters), expected, rtol=1e-12)
