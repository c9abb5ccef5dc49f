"""Each figure that a page states comes from a kept result, and still has its value."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from kept_tables import KeptTable, find_block, read_tables
from stated_figures import (
    COVERED_PAGES,
    FigureMismatch,
    StatedFigure,
    UnkeptFigure,
    compare,
    read_figures,
    read_unkept,
    read_value,
    uncovered,
)

FIGURES = read_figures()
KEPT_TABLES = read_tables()
UNKEPT = [*read_unkept("exception"), *read_unkept("pending")]


def stated_on(page: str, but: UnkeptFigure | None = None) -> list[str]:
    """Words of all entries of a page, but for one."""
    entries: list[StatedFigure | UnkeptFigure] = [*FIGURES, *UNKEPT]
    rows = [row for table in KEPT_TABLES if table.page == page for row in table.write().splitlines()]
    return [one.states for one in entries if one.page == page and one is not but] + rows


@pytest.mark.parametrize("figure", FIGURES, ids=[f"{one.page}: {one.states[:40]}" for one in FIGURES])
def test_a_stated_figure_is_that_of_its_kept_result(figure: StatedFigure) -> None:
    compare(figure)
    assert figure.command


@pytest.mark.parametrize("table", KEPT_TABLES, ids=[one.name for one in KEPT_TABLES])
def test_a_table_of_kept_results_is_as_its_command_writes_it(table: KeptTable) -> None:
    assert find_block(table) == table.write(), "run make docs"


@pytest.mark.parametrize("page", COVERED_PAGES)
def test_every_figure_of_a_page_has_a_kept_result_or_a_reason_why_not(page: str) -> None:
    assert uncovered(page, stated_on(page)) == []


@pytest.mark.parametrize("one", UNKEPT, ids=[f"{one.page}: {one.states[:40]}" for one in UNKEPT])
def test_a_reason_is_given_only_where_a_page_states_a_figure_without_a_result(one: UnkeptFigure) -> None:
    assert uncovered(one.page, stated_on(one.page, but=one)), f"{one.page}: {one.states!r} needs no reason"
    assert one.reason


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"states": "0.54 mm"}, "does not state"),
        ({"states": "0.55 mm"}, "states this 2 times"),
        ({"kept": "gone.json"}, "gone.json does not exist"),
        ({"values": ("depth.deep",)}, "there is no 'deep'"),
        ({"values": ("depth.other",)}, "gives '0.54 mm'"),
    ],
)
def test_a_figure_that_is_not_that_of_its_result_is_refused_with_page_and_words(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    (tmp_path / "page.md").write_text("The mean is 0.53\nmm, not 0.55 mm, nor again 0.55 mm.")
    (tmp_path / "x.json").write_text(json.dumps({"depth": {"mean": 0.5321, "other": 0.5399}}))
    right = {"page": "page.md", "states": "0.53 mm", "kept": "x.json", "values": ("depth.mean",)}
    right |= {"format": "{:.2f} mm", "command": "ronna-campaign x"}
    compare(StatedFigure(**right), tmp_path)  # type: ignore[arg-type]
    with pytest.raises(FigureMismatch, match=r"page\.md, '0\.5. mm'.*" + message):
        compare(StatedFigure(**{**right, **change}), tmp_path)  # type: ignore[arg-type]


CASES = (
    '{"seed": 100, "arm": "kr6", "errors_mm": [0.1, 0.3]}\n{"seed": 101, "arm": "kr6", "errors_mm": [0.5]}\n'
)
TABLES = """# Study
## Seed 0
| strategy | mean mm |
|---|---|
| `ocs` | **0.18** |
## Seed 1
| strategy | mean mm |
|---|---|
| `ocs` | 0.19 |
"""


@pytest.mark.parametrize(
    ("name", "text", "address", "value"),
    [
        ("x.jsonl", CASES, "mean:arm=kr6:errors_mm", 0.3),
        ("x.jsonl", CASES, "max:seed=90..100:errors_mm", 0.3),
        ("x.jsonl", CASES, "count:arm=ur5:errors_mm", 0),
        ("x.csv", 'e mm,"false, %"\n1.0,0.2\n2.0,0.4\n', "row:e mm=2:false, %", 0.4),
        ("x.md", TABLES, "row:strategy=ocs;heading=Study / Seed 1:mean mm", 0.19),
        ("x.json", '{"a": [{"b": 2}]}', "a.0.b", 2),
    ],
)
def test_a_value_is_found_by_its_address(
    name: str, text: str, address: str, value: float, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    assert read_value(tmp_path / name, address) == pytest.approx(value)


def test_two_rows_of_one_address_are_no_value(tmp_path: Path) -> None:
    (tmp_path / "x.md").write_text(TABLES)
    with pytest.raises(LookupError, match="2 rows, expected one"):
        read_value(tmp_path / "x.md", "row:strategy=ocs:mean mm")


def test_decimals_and_figures_with_a_unit_need_a_result_but_labels_code_and_headings_do_not(
    tmp_path: Path,
) -> None:
    (tmp_path / "page.md").write_text(
        "# 1.4\nSee `--e 2.5`. Mean 0.18\nmm, 95 % of 3 cases.\n\n| 5.1 | 0.7 |\n|---|---|\n"
    )
    assert len(uncovered("page.md", [], tmp_path)) == 3
    assert len(uncovered("page.md", ["0.18 mm, 95 %"], tmp_path)) == 1


def test_a_table_takes_each_row_from_its_own_row_of_the_kept_file(tmp_path: Path) -> None:
    (tmp_path / "docs/reference/figures").mkdir(parents=True)
    (tmp_path / "x.csv").write_text("strategy,arm,mean mm\nocs,kr6,0.18\njdms,kr6,0.27\nocs,ur5,0.3\n")
    (tmp_path / "docs/reference/figures/x.toml").write_text(
        '[[table]]\npage = "page.md"\nname = "means"\ncommand = "x"\nheader = "| | mean mm |"\n'
        '[table.sources.x]\nkept = "x.csv"\nrows = "strategy={strategy}"\n'
        '[[table.rows]]\nform = "| `{strategy}` | {:.1f} |"\nfigures = ["x;arm=kr6:mean mm"]\n'
        'each = [{ strategy = "ocs" }, { strategy = "jdms" }]\n'
    )
    [table] = read_tables(tmp_path)
    begin, end = table.marks
    assert table.write(tmp_path).splitlines()[2:-2] == [
        "| | mean mm |",
        "|---|---|",
        "| `ocs` | 0.2 |",
        "| `jdms` | 0.3 |",
    ]
    (tmp_path / "page.md").write_text(f"Before\n{begin}\nold\n{end}\nafter")
    assert find_block(table, tmp_path) == f"{begin}\nold\n{end}"
