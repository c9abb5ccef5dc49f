"""Safety figures, read from their definitions in the code.

A comment that ends in `Safety against HAZARD.` holds for the assignments below it, up to a blank line or the
next comment. After it stands `Source: ...`; `(U)`, there or beside the figure, says that it is unconfirmed.
"""

from __future__ import annotations

import ast
import re
import tokenize
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from reference_tables import ROOT, table

PACKAGES = ("ronna_hw", "drivers", "procedures")
MARK = "# Safety against "
UNCONFIRMED = "(U)"
_STATEMENT = re.compile(r"Safety against ([^.]+?)(?: \(U\))?\.(?: Source: (.+)\.)?$")


@dataclass(frozen=True)
class SafetyFigure:
    """A safety figure. `source` is empty if neither a source is named nor the figure unconfirmed."""

    path: str
    name: str
    value: str
    hazard: str
    reason: str
    source: str


def read_safety_figures(root: Path = ROOT) -> list[SafetyFigure]:
    """Read all safety figures, sorted by module; raises ValueError for a comment that states no hazard."""
    paths = sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))
    marked = ((path, text) for path in paths if MARK in (text := path.read_text(encoding="utf-8")))
    return [
        figure
        for path, text in marked
        for figure in _read_module(path.relative_to(root).as_posix(), text.splitlines())
    ]


def safety_table() -> str:
    figures = read_safety_figures()
    unconfirmed = sum(figure.source == UNCONFIRMED for figure in figures)
    rows = [
        (
            one.hazard,
            f"`{one.name}`",
            f"`{one.value}`",
            one.reason,
            one.source,
            f"[{one.path}](../../{one.path})",
        )
        for one in figures
    ]
    headings = ("against", "figure", "value", "why", "source", "defined in")
    return f"{len(figures)} figures, {unconfirmed} of them unconfirmed.\n\n{table(headings, rows)}"


def _read_module(path: str, lines: Sequence[str]) -> Iterator[SafetyFigure]:
    nodes = ast.walk(ast.parse("\n".join(lines), path))
    starts = {node.lineno: node for node in nodes if isinstance(node, (ast.Assign, ast.AnnAssign))}
    beside = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(iter([f"{line}\n" for line in lines]).__next__)
        if token.type == tokenize.COMMENT
    }
    for number, line in enumerate(lines, start=1):
        if not line.lstrip().startswith(MARK):
            continue
        above = list(takewhile(_is_comment, reversed(lines[:number])))
        below = list(takewhile(_is_comment, lines[number:]))
        comment = " ".join(one.strip().lstrip("# ") for one in (*reversed(above), *below))
        stated = _STATEMENT.search(comment)
        if stated is None:
            raise ValueError(f"{path}:{number}: expected `Safety against HAZARD.`, then a source if any")
        at = number + len(below) + 1
        while at in starts:
            node = starts[at]
            assert node.end_lineno is not None
            note = " ".join(beside[k] for k in range(at, node.end_lineno + 1) if k in beside)
            unconfirmed = UNCONFIRMED if UNCONFIRMED in f"{comment} {note}" else ""
            reason = f"{comment[: stated.start()]} {note}".replace(f" {UNCONFIRMED}", "").strip()
            for name, value in _list_values(node):
                yield SafetyFigure(path, name, value, stated[1], reason, stated[2] or unconfirmed)
            at = node.end_lineno + 1


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")


def _list_values(node: ast.Assign | ast.AnnAssign) -> Iterator[tuple[str, str]]:
    """List names and values as written; a field of a model has that of its default."""
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    assert node.value is not None
    targets = target.elts if isinstance(target, ast.Tuple) else [target]
    values = (
        node.value.elts
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple)
        else [node.value]
    )
    for name, value in zip(targets, values, strict=True):
        default = (
            [one.value for one in value.keywords if one.arg == "default"]
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "Field"
            else []
        )
        yield ast.unparse(name), ast.unparse(default[0] if default else value)
