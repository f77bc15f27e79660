"""A report as a reader of HTML sees it."""

from __future__ import annotations

import json
import re
from html.parser import HTMLParser
from typing import Any

from bayes_impedance.report.live_page import LIBRARY, script


class Page(HTMLParser):
    """Tags opened and closed in order, text outside of styles and scripts, and the attributes that load something."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.text: list[str] = []
        self.sources: list[str] = []
        self.drawn: list[str] = []
        self.tags: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "action", "data") and not (value or "").startswith("#"):
                self.sources.append(value or "")
            if name == "data-element":
                self.drawn.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.text.append(data)

    @property
    def words(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.text))


def without_library(text: str) -> str:
    """A page without the plotting library, which knows addresses that it does not visit."""
    library = script(LIBRARY)
    assert text.count(library) == 1
    return text.replace(library, "")


def data_of(text: str) -> Any:
    """What a page holds for its charts."""
    found = re.search(r'<script type="application/json" id="page-data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return json.loads(found.group(1))


VOID = {"meta", "img", "br", "link", "input", "hr"}
