"""Lines drawn in 3D Slicer become trajectories in the right frame with the right target, or nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises

from procedures.exchange.allowed_fields import PLANNED
from procedures.exchange.errors import MARKUP_ENDS, MARKUP_OF_ANOTHER_FRAME, MARKUP_UNREADABLE
from procedures.exchange.export_tables import CtIdentity
from procedures.exchange.line_order import LineOrder
from procedures.exchange.markup_lines import MarkupLine, read_lines
from procedures.exchange.trajectory_lines import format_lines, planned_line
from procedures.planning.plan_model import PlannedTrajectory

FRAME = "1.2.7"
ENTRY, TARGET = (-26.9, -109.7, 863.9), (-4.9, -81.2, 838.7)


def point(position: Any, label: str = "", **changed: Any) -> dict[str, Any]:
    return {"label": label, "position": list(position), "positionStatus": "defined", **changed}


def line(**changed: Any) -> dict[str, Any]:
    """A line as 3D Slicer saves it, in LPS, with labels that say nothing."""
    points = [point(ENTRY, "T1-1"), point(TARGET, "T1-2")]
    known = {"type": "Line", "coordinateSystem": "LPS", "coordinateUnits": "mm", "name": "T1"}
    return {**known, "controlPoints": points, **changed}


def read(folder: Path, *markups: dict[str, Any], order: LineOrder | None = None, **top: Any) -> Any:
    file = folder / "lines.mrk.json"
    file.write_text(json.dumps({**top, "markups": markups}))
    return read_lines(file, FRAME, order)


def test_an_exported_plan_is_read_back_as_it_was(tmp_path: Path) -> None:
    planned = PlannedTrajectory(id="T1", entry_mm=ENTRY, target_mm=TARGET, margin_mm=2.0)
    file = tmp_path / "planned.mrk.json"
    file.write_text(format_lines([planned_line("T1", planned)], CtIdentity("1.2.3", FRAME), PLANNED))
    assert read_lines(file, FRAME, None) == (MarkupLine("T1", ENTRY, TARGET, is_frame_stated=True),)
    with raises(MARKUP_OF_ANOTHER_FRAME, match="frame of reference"):
        read_lines(file, "1.2.8", None)


def test_ras_is_converted_and_no_system_is_refused(tmp_path: Path) -> None:
    (found,) = read(tmp_path, line(coordinateSystem="RAS"), order=LineOrder.ENTRY_FIRST)
    assert found.entry_mm == (26.9, 109.7, 863.9)
    for system in ("IJK", 0, None):
        with raises(MARKUP_OF_ANOTHER_FRAME, match="coordinate system"):
            read(tmp_path, line(coordinateSystem=system), order=LineOrder.ENTRY_FIRST)
    with raises(MARKUP_OF_ANOTHER_FRAME, match="unit"):
        read(tmp_path, line(coordinateUnits="m"), order=LineOrder.ENTRY_FIRST)


def test_the_target_is_told_by_label_or_order_and_never_guessed(tmp_path: Path) -> None:
    labelled = line(controlPoints=[point(TARGET, "Target"), point(ENTRY, "2")])
    assert read(tmp_path, labelled) == (MarkupLine("T1", ENTRY, TARGET),)
    assert read(tmp_path, line(), order=LineOrder.TARGET_FIRST) == (MarkupLine("T1", TARGET, ENTRY),)
    with raises(MARKUP_ENDS, match="does not say"):
        read(tmp_path, line())
    with raises(MARKUP_ENDS, match="contradict --order"):
        read(tmp_path, labelled, order=LineOrder.ENTRY_FIRST)
    with raises(MARKUP_ENDS, match="contradict each other"):
        read(tmp_path, line(controlPoints=[point(TARGET, "target"), point(ENTRY, "target")]))


@pytest.mark.parametrize(
    ("markup", "reason"),
    [
        (line(type="Fiducial"), "no line"),
        (line(controlPoints=[point(ENTRY), point(TARGET), point(TARGET)]), "two points"),
        (line(controlPoints=[point(ENTRY), point(TARGET, positionStatus="undefined")]), "not placed"),
        (line(controlPoints=[point(ENTRY), point((1.0, 2.0))]), "without a position"),
        (line(controlPoints=[point(ENTRY), point((1.0, 2.0, True))]), "without a position"),
        (line(name="left STN"), "name"),
    ],
)
def test_what_is_no_line_of_two_placed_points_is_refused(
    tmp_path: Path, markup: dict[str, Any], reason: str
) -> None:
    with raises(MARKUP_UNREADABLE, match=reason):
        read(tmp_path, markup, order=LineOrder.ENTRY_FIRST)


def test_a_file_without_markups_is_refused(tmp_path: Path) -> None:
    with raises(MARKUP_UNREADABLE, match="no markups"):
        read(tmp_path)
    with raises(MARKUP_UNREADABLE, match="cannot read"):
        read_lines(tmp_path / "none.mrk.json", FRAME, None)
