"""HTML generation from untrusted text, with all text escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from procedures.operator.question import Evidence
from ronna_hw.text import printable


def text(words: object) -> str:
    return escape(printable(str(words)))


def tag(name: str, content: str, **attributes: str) -> str:
    """Wrap HTML in an element. `class_` is its CSS class; underscores become hyphens."""
    shown = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"'
        for key, value in attributes.items()
        if value
    )
    return f"<{name}{shown}>{content}</{name}>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> str:
    body = "".join(tag("tr", "".join(tag("td", text(cell)) for cell in row)) for row in rows)
    return table_of(head_row(*head), body, caption)


def head_row(*headings: str) -> str:
    return tag("tr", "".join(tag("th", text(heading), scope="col") for heading in headings))


def table_of(head: str, body: str, caption: str = "") -> str:
    title = tag("caption", text(caption)) if caption else ""
    return tag("div", tag("table", f"{title}<thead>{head}</thead><tbody>{body}</tbody>"), class_="wide")


def evidence_table(evidence: Evidence) -> str:
    return table(evidence.head, evidence.rows, evidence.title)
