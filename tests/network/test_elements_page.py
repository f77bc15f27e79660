"""The page of all elements is that of the tables, and the README's networks are networks."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from bayes_impedance.network.constructs import CONSTRUCTS
from bayes_impedance.network.electrical import CIRCUIT_ELEMENTS
from bayes_impedance.network.notation import parse

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
