"""The pages on the thesis name what exists: modules, commands, links, and what Python answers."""

from __future__ import annotations

import re
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer
from documented import run_exercises
from thesis_table import BEYOND, CODE, PAGE, table_rows
from user_commands import Commands

from procedures.journal.journal import JOURNAL_FILE
from procedures.registration.correspondence import MatchStatus
from ronna_hw.command_line.launch import COMMANDS
from studies.thesis_figures import MATRIX_FIDUCIALS, draw_matrix_run, figures

ROOT = Path(__file__).resolve().parents[3]
LINK = re.compile(r"\[[^\]]+\]\(([^)\s]+)\)")
FILES, FOLDERS = ("FILE", "PLAN"), ("DIR", "RUN")  # what words in capitals stand for
STATES = ("yes", "in part", "no")


ROWS = table_rows()
NOT_COUNTED = [{"thesis": row["beside"], "here": "yes", **row} for row in table_rows(BEYOND)]
NO_EQUATION = 34  # missing in the numbering of the thesis


@pytest.fixture(
    params=ROWS + NOT_COUNTED, ids=[f"{row['thesis']}: {row['what'][:40]}" for row in ROWS + NOT_COUNTED]
)
def row(request: pytest.FixtureRequest) -> dict[str, str]:
    found: dict[str, str] = request.param
    return found


def test_the_table_is_there_with_sections_equations_tables_and_figures() -> None:
    places = " ".join(row["thesis"] for row in ROWS)
    for place in ("1.4", "5.1", "5.3.1", "5.3.2", "5.4", "eq. 35", "eq. 36", "table 2", "table 3", "table 4"):
        assert place in places
    for figure in range(1, 17):
        assert re.search(rf"figures? [\d, ]*(and )?\b{figure}\b", places), figure
    for equation in set(range(1, 44)) - {NO_EQUATION}:
        assert equation in _numbers_after("eq.", places), equation


def test_the_page_begins_with_the_number_of_rows_of_each_state() -> None:
    yes, in_part, no = (sum(row["here"] == state for row in ROWS) for state in STATES)
    stated = f"**{yes} yes, {in_part} in part, {no} no**"
    assert stated in PAGE.read_text(encoding="utf-8").partition("\n## ")[0], stated


def _numbers_after(word: str, places: str) -> set[int]:
    """Numbers and ranges of numbers that follow a word, such as those of `eq. 20, 32 and 33`."""
    found = set[int]()
    for listed in re.findall(rf"{re.escape(word)} ([\d, ]*\d(?: (?:to|and) \d+)?)", places):
        numbers = [int(one) for one in re.findall(r"\d+", listed)]
        found.update(range(numbers[0], numbers[-1] + 1) if " to " in listed else numbers)
    return found


def test_each_row_says_whether_it_is_here_and_if_so_by_which_command_and_to_which_figure(
    row: dict[str, str],
) -> None:
    assert row["here"] in STATES
    if row["here"] == "yes":
        assert CODE.search(row["command"])
        assert row["reached"]
    else:
        assert row["reached"], "a row that is not whole says what is missing"


def test_each_module_of_a_row_imports(row: dict[str, str]) -> None:
    for name in CODE.findall(row["module"]):
        module, _, member = name.partition(":")
        assert not member or hasattr(import_module(module), member), name
        import_module(module)


def test_each_command_of_a_row_exists_with_its_options(
    row: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in FILES:
        (tmp_path / name).touch()
    for name in FOLDERS:
        (tmp_path / name).mkdir()
    (tmp_path / "RUN" / JOURNAL_FILE).touch()
    monkeypatch.chdir(tmp_path)
    for command in CODE.findall(row["command"]):
        if command.startswith("make "):
            target = command.split()[1]
            assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
        elif command.startswith("python -m "):
            assert find_spec(command.split()[2]) is not None
        else:
            parse(command)


def parse(line: str) -> None:
    """Parse a command as its program does, without running it."""
    program, *words = line.split()
    found: Any = typer.main.get_command(import_module(COMMANDS[program]).app)
    while getattr(found, "commands", None):
        found = found.commands[words.pop(0)]
    found.make_context(program, words)


def test_each_link_of_a_row_resolves(row: dict[str, str]) -> None:
    for target in LINK.findall(" ".join(row.values())):
        path, _, anchor = target.partition("#")
        file = (PAGE.parent / path).resolve() if path else PAGE
        assert file.exists(), target
        assert not anchor or anchor in anchors_of(file), target


def anchors_of(file: Path) -> set[str]:
    """The anchors of a page's headings, as a reader of Markdown makes them."""
    headings = re.findall(r"^#+ (.+)$", file.read_text(encoding="utf-8"), re.MULTILINE)
    plain = [re.sub(r"[`*]|\[([^\]]+)\]\([^)]+\)", r"\1", one).lower() for one in headings]
    return {re.sub(r"[^\w\- ]", "", one).replace(" ", "-") for one in plain}


CHAPTER_2 = "docs/reference/thesis-chapter-2.md"
PNG = b"\x89PNG"


def test_the_page_shows_what_python_answers(commands: Commands, tmp_path: Path) -> None:
    assert run_exercises(CHAPTER_2, commands, tmp_path) >= 20


def test_the_matrix_of_figure_11_loses_all_four_outliers_of_both_sets_at_once() -> None:
    steps, found = draw_matrix_run()
    sizes = [(len(step.rows), len(step.columns)) for step in steps]
    assert sizes == [(MATRIX_FIDUCIALS + 4,) * 2, (MATRIX_FIDUCIALS,) * 2]
    assert found.status is MatchStatus.UNIQUE
    assert len(found.pairs) == MATRIX_FIDUCIALS
    last = steps[-1]
    for image, physical in found.pairs.tolist():
        cell = last.matrix[last.rows.tolist().index(image), last.columns.tolist().index(physical)]
        assert cell == MATRIX_FIDUCIALS - 1


@pytest.mark.slow
def test_every_figure_is_drawn() -> None:
    drawn = {name.split("-")[1] for name, picture in figures().items() if picture.startswith(PNG)}
    assert drawn == {"4", "5", "6", "11"}
