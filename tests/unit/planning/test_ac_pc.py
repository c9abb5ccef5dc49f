"""Coordinates of the AC-PC frame, and points that do not give one."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.planning.ac_pc import AcPcFrame, require_commissures
from procedures.planning.errors import AcPcUnfit
from procedures.planning.plan_file import parse_plan, read_plan, require_unaltered, seal_plan, write_plan
from procedures.planning.plan_model import AcPcPoints

# A head tilted back by the angle of the triangle 3-4-5, its commissures 25 mm apart about (2, 5, 30).
AC, PC, FALX = (2.0, -5.0, 37.5), (2.0, 15.0, 22.5), (2.0, 23.4, 66.2)
BELOW = (2.0, -19.0, -2.0)  # as far down as the falx is up, in the same plane


@pytest.mark.parametrize("midline", [FALX, BELOW])
def test_coordinates_are_right_anterior_and_superior_of_the_mid_commissural_point(midline) -> None:
    frame = AcPcFrame.from_points(AC, PC, midline)
    assert frame.length_mm == pytest.approx(25.0)
    assert frame.from_lps_mm((2.0, 5.0, 30.0)) == pytest.approx((0.0, 0.0, 0.0))
    assert frame.from_lps_mm(AC) == pytest.approx((0.0, 12.5, 0.0))
    # 12 mm to the right, 3 mm behind and 4 mm below, by hand: the axes in LPS are (-1, 0, 0), (0, -0.8, 0.6),
    # (0, 0.6, 0.8)
    assert frame.from_lps_mm((-10.0, 5.0, 25.0)) == pytest.approx((12.0, -3.0, -4.0))
    assert frame.to_lps_mm((12.0, -3.0, -4.0)) == pytest.approx((-10.0, 5.0, 25.0))


def test_a_head_tilted_to_the_side_keeps_its_midline_at_x_0() -> None:
    frame = AcPcFrame.from_points((1.0, -12.0, 3.0), (-1.0, 12.0, -3.0), (20.0, 4.0, 60.0))
    assert frame.from_lps_mm((20.0, 4.0, 60.0))[0] == pytest.approx(0.0)
    assert np.linalg.det(frame.axes) == pytest.approx(1.0)
    assert frame.axes @ frame.axes.T == pytest.approx(np.eye(3))
    assert frame.from_lps_mm((-60.0, 0.0, 0.0))[0] > 0.0  # the patient's right


@pytest.mark.parametrize(
    ("points", "what"),
    [
        ((AC, AC, FALX), r"10 to 50 mm.*0\.0 mm"),
        ((PC, AC, FALX), r"behind PC.*20\.0 mm"),
        ((AC, (2.0, 150.0, 22.5), FALX), "10 to 50 mm"),
        ((AC, PC, (2.0, -21.0, 49.5)), r"line through AC and PC.*10 mm.*0\.0 mm"),
        ((AC, PC, (60.0, 5.0, 30.0)), r"beside the midline.*45 degrees"),
    ],
    ids=["coincident", "swapped", "far apart", "midline on the line", "midline at the side"],
)
def test_points_that_define_no_frame_are_refused(points, what: str) -> None:
    with pytest.raises(AcPcUnfit, match=f"PLAN-031.*{what}"):
        AcPcFrame.from_points(*points)


def test_the_commissures_are_refused_before_the_midline_is_known() -> None:
    require_commissures(AC, PC)
    with pytest.raises(AcPcUnfit, match="PLAN-031"):
        require_commissures(PC, AC)


def test_a_plan_keeps_the_points_under_its_seal_and_refuses_degenerate_ones(
    plan_text: str, plan_path, tmp_path, make_volume
) -> None:
    plan = read_plan(plan_path(plan_text))
    assert "ac_pc" not in plan.model_dump(mode="json", exclude_none=True), (
        "plans without it keep their digest"
    )
    points = AcPcPoints(ac_mm=AC, pc_mm=PC, midline_mm=FALX)
    sealed = seal_plan(plan.model_copy(update={"ac_pc": points}), "Dr Test", make_volume())
    write_plan(tmp_path / "with.toml", sealed)
    assert read_plan(tmp_path / "with.toml").ac_pc == points
    require_unaltered(sealed, "plan")
    content = plan.model_dump(mode="json", by_alias=True, exclude_none=True)
    with pytest.raises(AcPcUnfit, match=r"PLAN-031.*ac_pc"):
        parse_plan({**content, "ac_pc": {"ac_mm": AC, "pc_mm": AC, "midline_mm": FALX}})
