"""Digests of what the pages in the pictures of the docs are made of, kept inside each picture.

A page is made of its styles, its scripts, and the constants of its Python modules: texts, names, sizes and
colours, in the order in which they stand. Comments, docstrings, types, names of functions and the words of
errors change often and change no picture, so they do not count. What a case itself says, such as the words of
a question, is not part of a page: where that has changed, `make docs ALL=1` takes every picture anew.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

from PIL import Image
from PIL.PngImagePlugin import PngImageFile, PngInfo

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
SCRIPT = "tools/docs/page_pictures.py"
# By the beginning of a picture's name. Folders and files, from the root of the repository.
MADE_OF = {
    "console": (
        *("console/web", "console/panels", "console/scene"),
        *("procedures/imaging/trajectory_cuts.py", SCRIPT),
    ),
    "planner": (
        *("console/planning", "console/web/style.css", "console/web/fresh.js"),
        *("console/panels/elements.py", "console/panels/html.py", SCRIPT),
    ),
}
KEY = "page digest"  # of the text chunk of a PNG
COMMENT = re.compile(r"/\*.*?\*/|^\s*//.*?$", re.DOTALL | re.MULTILINE)


def page_digest(page: str, root: Path = ROOT) -> str:
    """Return the SHA-256 (hex) of what a page, `console` or `planner`, is made of."""
    digest = hashlib.sha256()
    for file in _list_files(page, root):
        parts = _constants(file) if file.suffix == ".py" else _lines(file)
        for part in (file.relative_to(root).as_posix(), *parts):
            digest.update(part.encode() + b"\0")
    return digest.hexdigest()


def stale_pictures(page: str, folder: Path = PICTURES) -> list[Path]:
    """Return the pictures of a page that were taken before it last changed."""
    digest = page_digest(page)
    return [file for file in sorted(folder.glob(f"{page}-*.png")) if _read_digest(file) != digest]


def digest_chunk(page: str) -> PngInfo:
    """Return the text chunk by which a new picture of the page keeps its digest."""
    chunk = PngInfo()
    chunk.add_text(KEY, page_digest(page))
    return chunk


def _read_digest(file: Path) -> str:
    with Image.open(file) as picture:
        return str(picture.text.get(KEY, "")) if isinstance(picture, PngImageFile) else ""


def _list_files(page: str, root: Path) -> Iterator[Path]:
    for place in (root / name for name in MADE_OF[page]):
        if place.is_file():
            yield place
        for suffix in ("css", "js", "svg", "py"):
            yield from sorted(place.rglob(f"*.{suffix}"))


def _lines(file: Path) -> Iterator[str]:
    """Yield the lines of a style or a script, without comments, indents and empty lines."""
    bare = COMMENT.sub("", file.read_text(encoding="utf-8"))
    yield from filter(None, map(str.strip, bare.splitlines()))


def _constants(file: Path) -> Iterator[str]:
    """Yield the constants of a module in their order."""
    yield from _visit(ast.parse(file.read_text(encoding="utf-8")))


def _visit(node: ast.AST) -> Iterator[str]:
    if isinstance(node, ast.Raise):
        return
    if isinstance(node, ast.Constant):
        yield repr(node.value)
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and not _is_docstring(child):
                yield from _visit(child)


def _is_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
