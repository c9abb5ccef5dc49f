"""Hazard 24: the arm keeps clear of the bodies that the theatre file describes, such as a moved clamp."""

from __future__ import annotations

from pathlib import Path

import pytest
from clinical_case import SPHERES_MM, ClinicalCell
from prepared_results import (
    checked_plan,
    checked_set_up,
    correspondence,
    global_localization,
    localized_fiducials,
)

from procedures.steps.clinical import path_check
from ronna_hw.collision_config import BodyFrame, RoomBody
from ronna_hw.errors import RonnaError

# So wide and high that the guide meets it on its way to the gauge. A body met over the spheres only is in
# test_motions: every angle in every branch is tried before it is refused.
ABOVE_MM = 300.0
RADIUS_MM = 80.0


def with_body(cell: ClinicalCell, name: str, *, away_mm: float) -> None:
    """An upright body beside the first sphere, so far from it along the table."""
    x, y, z = (float(value) for value in SPHERES_MM[0])
    body = RoomBody(
        name=name,
        frame=BodyFrame.ROBOT,
        start_mm=(x, y + away_mm, z),
        end_mm=(x, y + away_mm, z + ABOVE_MM),
        radius_mm=RADIUS_MM,
    )
    bodies = cell.theatre.cell.model_copy(update={"bodies": (*cell.theatre.cell.bodies, body)})
    cell.theatre = cell.theatre.model_copy(update={"cell": bodies})


def check(cell: ClinicalCell) -> None:
    found = (global_localization(), correspondence(), localized_fiducials())
    cell.run(*found, checked_plan(), checked_set_up(cell), path_check.STEP)


@pytest.mark.hazard(24)
def test_only_a_body_in_the_way_is_named_and_the_case_refused_before_anything_moves(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "in the way")
    with_body(cell, "place of the staff", away_mm=0.0)
    with pytest.raises(RonnaError, match="place of the staff"):
        check(cell)
    assert cell.arm.motions == []
    cell = ClinicalCell(tmp_path / "far from the path")
    with_body(cell, "clamp", away_mm=900.0)
    check(cell)
