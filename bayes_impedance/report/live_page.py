"""What makes a page answer: its charts as data, the scripts that draw them, and the rule that nothing else may run.

A page stands alone: the plotting library (plotly.js, see ``assets/README.md``) and ``page.js``, which hands it the
charts, are written into it. Titles and names come from users' files. In the data they cannot end the element that holds
them, because no character that HTML knows remains in them; and should one end up elsewhere, the page's content security
policy runs only the two scripts, known by their digests, and loads nothing.
"""

from __future__ import annotations

import base64
import hashlib
import json
import re
from functools import cache
from html import unescape
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from markupsafe import Markup

_HERE = Path(__file__).parent
LIBRARY = "assets/plotly-cartesian.min.js"
GLUE = "page.js"
_HTML = {ord(c): f"\\u{ord(c):04x}" for c in "<>&'"}
_HEADING = re.compile(r'<h2 id="([\w-]+)">(.*?)</h2>', re.DOTALL)


def embedded_data(data: Any) -> Markup:
    """Data as JSON for the inside of a script element that is not run."""
    from markupsafe import Markup

    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Markup(text.translate(_HTML))


@cache
def script(name: str) -> str:
    """Text of a script in this folder.

    Raises
    ------
    ValueError
        If it would end the element that holds it.
    """
    text = (_HERE / name).read_text(encoding="utf-8")
    if "</script" in text.lower() or "<!--" in text:
        raise ValueError(f"{name} cannot be written into a page")
    return f"\n{text}\n"


def scripts() -> list[Markup]:
    """The scripts of a page, in the order in which they run."""
    from markupsafe import Markup

    return [Markup(script(name)) for name in (LIBRARY, GLUE)]


def security_policy() -> str:
    """Content security policy of a page: its own two scripts, pictures inside of it, and nothing from elsewhere."""
    digests = " ".join(f"'sha256-{_digest(script(name))}'" for name in (LIBRARY, GLUE))
    return f"default-src 'none'; script-src {digests}; style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'"


def _digest(text: str) -> str:
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode("ascii")


def contents(body: str) -> list[tuple[str, str]]:
    """Headings of a page's sections that have an id: id and text, for the table of contents."""
    return [(id, unescape(re.sub(r"<[^>]*>", "", text)).strip()) for id, text in _HEADING.findall(body)]
