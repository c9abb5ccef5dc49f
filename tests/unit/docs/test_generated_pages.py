"""Generated pages are up to date, models become tables, figures have names, and links lead somewhere."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import generate
import pytest
from model_tables import model_tables
from pydantic import BaseModel, Field
from reference_tables import REFERENCE

from procedures.planning.plan_file import read_plan
from procedures.runs.answers import read_answers


def test_the_generated_tables_are_up_to_date() -> None:
    tables = generate.tables()
    pages = {name: (generate.REFERENCE / name).read_text(encoding="utf-8") for name in tables}
    stale = [name for name, page in pages.items() if page != generate.with_table(page, tables[name])]
    assert stale == [], "run make docs"


class Sphere(BaseModel):
    """One sphere."""

    radius_mm: float = Field(description="Its radius.")


class Spheres(BaseModel):
    """What was found."""

    spheres: list[Sphere] = Field(description="Each of them.")


class Check(BaseModel):
    """What was checked."""

    worst: Sphere = Field(description="The least round one.")


def test_each_step_lists_its_fields_and_a_shared_model_is_listed_once() -> None:
    page = model_tables({"localization": Spheres, "check": Check})
    assert "## localization\n\nWhat was found.\n" in page
    assert "| `spheres` | list of Sphere | required | Each of them. |" in page
    assert page.count("| `radius_mm` | number | required | Its radius. |") == 1


ROOT = Path(__file__).resolve().parents[3]
MODELS = ROOT / "procedures/reporting/calibration_figures.py"
EXPLAINED = re.compile(r"^- \*\*(.+?)\*\*", re.MULTILINE)


@pytest.mark.parametrize(
    "page", ["calibrate-tracker-frame", "calibrate-tool-tip", "stereo-calibration", "arm-calibration"]
)
def test_every_explained_figure_has_a_printed_name(page: str) -> None:
    text = (ROOT / f"docs/how-to/calibration/{page}.md").read_text(encoding="utf-8")
    section = text.partition("## What the figures mean")[2].partition("\n## ")[0]
    printed = MODELS.read_text(encoding="utf-8")
    named = EXPLAINED.findall(section)
    assert named
    assert [name for name in named if f'"{name}' not in printed] == []


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


PAGE = (ROOT / "docs/explanation/rooms.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "package", ["ronna_hw", "conformance", "drivers", "sim", "procedures", "studies", "console"]
)
def test_every_subpackage_is_listed_once(package: str) -> None:
    section = PAGE.partition(f"\n## `{package}`\n")[2].partition("\n## ")[0]
    listed = re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE)
    there = sorted(one.parent.name for one in (ROOT / package).glob("*/__init__.py"))
    assert sorted(listed) == there


def test_what_the_console_may_import_is_all_that_its_contract_does_not_forbid() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    (console,) = (one for one in contracts if one.get("source_modules") == ["console"])
    named = PAGE.partition("| `console` |")[2].partition("of `procedures` only ")[2].partition("\n")[0]
    allowed = {f"procedures.{room}" for room in re.findall(r"`(\w+)`", named)}
    rooms = {f"procedures.{one.parent.name}" for one in (ROOT / "procedures").glob("*/__init__.py")}
    assert allowed == rooms - set(console["forbidden_modules"])


@pytest.mark.parametrize(
    ("page", "read"), [("plan-file.md", read_plan), ("answers.md", read_answers)], ids=["plan", "answers"]
)
def test_the_example_of_a_reference_page_is_accepted(
    page: str, read: Callable[[Path], object], tmp_path: Path
) -> None:
    text = (REFERENCE / page).read_text(encoding="utf-8")
    (example,) = (part.partition("\n```")[0] for part in text.split("```toml\n")[1:])
    file = tmp_path / "example.toml"
    file.write_text(example, encoding="utf-8")
    read(file)
