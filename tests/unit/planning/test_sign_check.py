"""Plans in RAS or from a mirrored picture, and plans as they should be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from painted_ct import SERIES_UID

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.plan_check import PlanCheck, check_plan
from procedures.planning.plan_file import read_plan
from procedures.planning.plan_model import PatientPosition, Plan

RADIUS_MM, THICK_MM, SKIN_MM = 80.0, 7.0, 5.0
DEPTH_MM = 60.0
RAS, MIRRORED = (-1.0, -1.0, 1.0), (-1.0, 1.0, 1.0)
FRONT, LEFT = (0.2, -0.7, 0.7), (0.9, -0.1, 0.4)  # ways out of the head
Ways = tuple[tuple[float, float, float], ...]


@pytest.fixture
def plan(plan_text, plan_path) -> Plan:
    return read_plan(plan_path(plan_text))


def head(centre_mm: tuple[float, float, float]) -> Volume:
    """A ball of skin, bone and brain in air."""
    shape = (110, 110, 110)
    geometry = VoxelGeometry(
        shape,
        np.full(3, -109.0),
        np.array([[0.0, 0, 1], [0, 1, 0], [1, 0, 0]]),
        np.full(3, 2.0),
    )
    places = geometry.to_patient_mm(np.moveaxis(np.indices(shape), 0, -1))
    away = np.linalg.norm(places - centre_mm, axis=-1)
    hu = np.select(
        [away > RADIUS_MM + SKIN_MM, away > RADIUS_MM, away > RADIUS_MM - THICK_MM], [-1000, 40, 1200], 35
    )
    return Volume(hu.astype(np.int16), geometry, SERIES_UID, "1.2.3", "HFS")


def checked(
    plan: Plan,
    centre_mm: tuple[float, float, float],
    ways: Ways,
    signs: tuple[float, float, float] = (1.0, 1.0, 1.0),
    inwards_mm: float = 0.0,
    table: PatientPosition | None = None,
) -> PlanCheck:
    """Check a plan with entries on the skin, or so far inwards of it, as read off with these signs."""
    trajectories = []
    for number, way in enumerate(ways, start=1):
        out = np.array(way) / math.hypot(*way)
        ends = [centre_mm + (RADIUS_MM + SKIN_MM - deep_mm) * out for deep_mm in (inwards_mm, DEPTH_MM)]
        entry, target = (tuple(map(float, end * signs)) for end in ends)
        changed = {"id": f"T{number}", "entry_mm": entry, "target_mm": target}
        trajectories.append(plan.trajectories[0].model_copy(update=changed))
    update = {"trajectories": tuple(trajectories), "table_position": table}
    return check_plan(plan.model_copy(update=update), head(centre_mm))


@pytest.mark.hazard(7)
@pytest.mark.parametrize(
    ("signs", "reading"), [(RAS, "RAS"), (MIRRORED, "mirrored left and right")], ids=["ras", "mirrored"]
)
def test_a_plan_that_fits_only_with_other_signs_is_told_so_after_what_is_wrong_with_it(
    plan: Plan, signs: tuple[float, float, float], reading: str
) -> None:
    *own, wrong = checked(plan, (20.0, -18.0, 0.0), (FRONT, LEFT), signs).findings
    assert own
    assert {one.code for one in own} <= {"PLAN-006", "PLAN-011"}
    assert wrong.code == "PLAN-033"
    assert reading in wrong.what
    assert "LPS mm" in str(wrong.expected)
    assert "change the sign" not in wrong.advice


def test_a_plan_in_lps_with_an_entry_too_deep_is_refused_for_that_first(plan: Plan) -> None:
    deep_mm = SKIN_MM + THICK_MM + 14.0
    findings = checked(plan, (0.0, -14.0, 0.0), ((0.1, 0.1, 1.0),), inwards_mm=deep_mm).findings
    assert findings[0].code == "PLAN-011"
    assert "in front of the entry" in findings[0].what


@pytest.mark.hazard(7)
def test_a_plan_mirrored_about_the_middle_of_the_picture_is_recognized_there(plan: Plan) -> None:
    centre_mm = (0.0, 20.0, 10.0)  # where the picture's middle is the origin, both readings would be one
    volume = head(centre_mm)
    offset_mm = np.array([0.0, -60.0, 0.0])
    shifted = replace(
        volume, geometry=replace(volume.geometry, origin_mm=volume.geometry.origin_mm + offset_mm)
    )
    out = np.array(FRONT) / math.hypot(*FRONT)
    ends = []
    for away_mm in (RADIUS_MM + SKIN_MM, RADIUS_MM + SKIN_MM - DEPTH_MM):
        place = np.array(centre_mm) + offset_mm + away_mm * out
        place[1] = 2.0 * offset_mm[1] - place[1]
        ends.append(tuple(map(float, place)))
    one = plan.trajectories[0].model_copy(update={"entry_mm": ends[0], "target_mm": ends[1]})
    findings = check_plan(plan.model_copy(update={"trajectories": (one,)}), shifted).findings
    assert findings[-1].code == "PLAN-033"
    assert "mirrored front and back" in findings[-1].what


def test_where_a_plan_mirrored_left_and_right_fits_as_well_only_the_side_tells(plan: Plan) -> None:
    assert checked(plan, (0.0, 0.0, 0.0), (FRONT,)).only_side_tells
    assert not checked(plan, (20.0, 0.0, 0.0), (LEFT,)).only_side_tells


@pytest.mark.hazard(7)
def test_a_plan_in_ras_on_a_head_at_the_origin_is_doubted_because_it_enters_through_the_table(
    plan: Plan,
) -> None:
    centre_mm = (0.0, 0.0, 0.0)
    check = checked(plan, centre_mm, (FRONT, FRONT), RAS)
    assert check.passed
    assert "may not be LPS, but RAS" in check.sign_doubt
    assert check.sign_doubt in check.warnings
    prone = checked(plan, centre_mm, (FRONT, FRONT), RAS, table=PatientPosition.HFP)
    assert prone.sign_doubt == ""


@pytest.mark.parametrize("inwards_mm", [-8.0, 0.0, SKIN_MM, SKIN_MM + THICK_MM], ids="{:g} mm".format)
@pytest.mark.parametrize("centre_mm", [(0.0, 0.0, 0.0), (4.0, 4.0, 0.0), (6.0, -6.0, 0.0), (3.0, -20.0, 0.0)])
def test_no_plan_in_lps_is_doubted_with_its_entries_before_on_or_in_the_skull(
    plan: Plan, centre_mm: tuple[float, float, float], inwards_mm: float
) -> None:
    check = checked(plan, centre_mm, (FRONT, LEFT), inwards_mm=inwards_mm)
    assert check.sign_doubt == ""
    assert "PLAN-033" not in [one.code for one in check.findings]
