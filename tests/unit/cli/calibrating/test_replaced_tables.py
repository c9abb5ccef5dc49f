"""A calibration that rewrites the theatre file keeps the user's own content."""

from __future__ import annotations

import tomllib

import pytest

from procedures.runs.theatre_tables import replace_tables
from ronna_hw.config import BadTheatreFile

FORMER = """# Our cell.
theatre = "lab"  # on the third floor

[calibration.tool_tip]
identifier = "old"
[calibration.tool_tip.flange_from_tool]
translation_mm = [
  1.0,  # from the drawing
]

# The frame on the mount.
[calibration.tracker_frame]
identifier = "frame"  # as drawn

[[tools.guide.bodies]]  # two of them
radius_mm = 5.0
[[tools.guide.bodies]]
radius_mm = 6.0
"""
TIP = {"identifier": "new", "flange_from_tool": {"translation_mm": [2.0]}}


@pytest.mark.parametrize(
    "tables",
    [
        {"calibration": {"tool_tip": TIP}},
        {"calibration": {"arm": TIP}},
        {"calibration": {"tool_tip": TIP, "tracker_frame": {"identifier": "f"}}},
        {"tools": {"guide": {"number": 2}, "drill": {"number": 3}}},
    ],
)
def test_only_the_named_tables_change(tables: dict[str, dict[str, object]]) -> None:
    meant = tomllib.loads(FORMER)
    for name, entries in tables.items():
        meant[name] = {**meant[name], **entries}
    written = replace_tables(FORMER, tables)
    assert tomllib.loads(written) == meant
    for comment in ("# Our cell.", "# on the third floor", "# The frame on the mount."):
        assert comment in written


@pytest.mark.parametrize(
    "former",
    ['calibration = { tool_tip = { identifier = "old" } }\n', '[calibration]\ntool_tip.identifier = "old"\n'],
)
def test_inline_tables_and_dotted_keys_are_replaced_too(former: str) -> None:
    written = replace_tables(former, {"calibration": {"tool_tip": TIP}})
    assert tomllib.loads(written) == {"calibration": {"tool_tip": TIP}}


def test_text_outside_a_replaced_record_stays_as_written() -> None:
    before, _, rest = FORMER.partition("[calibration.tool_tip]")
    after = rest[rest.index("# The frame on the mount.") :]
    written = replace_tables(FORMER, {"calibration": {"tool_tip": TIP}})
    assert written.startswith(before)
    assert written.endswith(after)
    assert "from the drawing" not in written  # a remark on the old value


def test_a_remark_above_the_next_header_stays_where_the_table_is_in_two_places() -> None:
    former = "[calibration.arm]\na = 1\n\n# Ours.\n[y]\nb = 1\n[calibration.tool_tip]\nc = 1\n"
    written = replace_tables(former, {"calibration": {"arm": {"a": 2}}})
    assert written.endswith(former[former.index("# Ours.") :])


def test_dotted_keys_that_would_draw_other_entries_into_the_record_are_refused() -> None:
    with pytest.raises(BadTheatreFile, match="CFG-001"):
        replace_tables('calibration.arm.a = 1\ntheatre = "lab"\n', {"calibration": {"arm": {"a": {"b": 2}}}})
