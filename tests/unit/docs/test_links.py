"""The documentation index lists every page, and no link is broken."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/**/*.md")])
DECISIONS = ROOT / "docs/explanation/decisions"
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")


def links_of(page: Path) -> set[Path]:
    return {(page.parent / link).resolve() for link in LINK.findall(page.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_link_is_broken(page: Path) -> None:
    assert [link for link in links_of(page) if not link.exists()] == []


def test_the_index_links_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    decisions = set(DECISIONS.glob("0*.md"))  # in an index of their own
    pages = {page.resolve() for page in ROOT.glob("docs/**/*.md")} - decisions - {index}
    assert pages - links_of(index) == set()


def test_decisions_are_numbered_consecutively_and_all_in_their_index() -> None:
    entry = re.compile(r"^(\d+)\. \[.+\]\((\d{4})-[\w-]+\.md\)", re.MULTILINE)
    listed = [
        (int(one), int(file)) for one, file in entry.findall((DECISIONS / "README.md").read_text("utf-8"))
    ]
    pages = sorted(DECISIONS.glob("0*.md"))
    titled = [int(page.read_text("utf-8").removeprefix("# ").partition(".")[0]) for page in pages]
    assert listed == [(number, number) for number in range(1, len(pages) + 1)]
    assert titled == [number for number, _ in listed]
