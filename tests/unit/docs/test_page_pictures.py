"""Pictures in the docs are those of today's pages, as their digests tell without a browser."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from page_digest import MADE_OF, PICTURES, page_digest, stale_pictures

RETAKE = "make docs"
MODULE = '''"""Panel."""


def show(count: int) -> str:
    """Show it."""
    if count < 0:
        raise ValueError("too few")
    return f"<b>{count} spheres</b>"  # in bold
'''
STYLE = "/* Cards. */\n.card { color:red; }\n"
Digest = Callable[[str, str], str]


@pytest.mark.parametrize("page", MADE_OF)
def test_the_pictures_of_a_page_were_taken_since_it_last_changed(page: str) -> None:
    assert list(PICTURES.glob(f"{page}-*.png"))
    stale = [file.name for file in stale_pictures(page)]
    assert stale == [], f"the {page} has changed since these were taken: run {RETAKE}, and look at them"


@pytest.fixture
def digest(tmp_path: Path) -> Digest:
    """Digest of a planner made of one module and one style."""
    folder = tmp_path / "console" / "planning"
    folder.mkdir(parents=True)

    def made_of(module: str, style: str) -> str:
        (folder / "panel.py").write_text(module)
        (folder / "planner.css").write_text(style)
        return page_digest("planner", tmp_path)

    return made_of


@pytest.mark.parametrize(("old", "new"), [("spheres", "markers"), ("red", "blue"), ("<b>", "<i>")])
def test_another_text_or_style_is_another_page(digest: Digest, old: str, new: str) -> None:
    assert digest(MODULE, STYLE) != digest(MODULE.replace(old, new), STYLE.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new"),
    [("in bold", "bold"), ("Show it.", "Show the count."), ("too few", "too few spheres"), ("Cards", "Card")],
    ids=["comment", "docstring", "error", "comment of a style"],
)
def test_what_no_picture_shows_does_not_count(digest: Digest, old: str, new: str) -> None:
    renamed = MODULE.replace("show", "render").replace("count: int", "count: float")
    assert digest(MODULE, STYLE) == digest(renamed.replace(old, new), STYLE.replace(old, new))
