"""Checks across the records of a theatre file; each raises ValueError with the name of the table."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ronna_hw.calibration import Dated, PoseRecord
from ronna_hw.plausible import LONGEST_LIFE
from ronna_hw.theatre_kind import is_simulated
from ronna_hw.tool_record import GuideBore

if TYPE_CHECKING:
    from ronna_hw.config import TheatreFile


def require_expiry(theatre: TheatreFile) -> None:
    """Records of a real theatre expire within a year; in a simulated one nothing is knocked or worn."""
    calibrations = {} if theatre.calibration is None else theatre.calibration.records
    records: dict[str, Dated] = {f"calibration.{name}": one for name, one in calibrations.items()}
    records |= {f"tools.{name}": one for name, one in theatre.tools.items()}
    endless = [f"[{table}]" for table, one in records.items() if one.expires - one.created > LONGEST_LIFE]
    if endless and not is_simulated(theatre):
        raise ValueError(
            f"{', '.join(endless)}: expected to expire at most {LONGEST_LIFE.days} days after `created`"
        )


def require_outside_hand(theatre: TheatreFile) -> None:
    """Tools, and the axis of the guide, are outside the arm's hand; in centimetres they would be inside."""
    if theatre.calibration is None:
        return
    hand_mm, records = theatre.cell.arm.hand_mm, theatre.calibration
    bore = theatre.tools["guide"].bore if "guide" in theatre.tools else None
    for name, near_mm in (
        ("stereo_head", closest_to_flange_mm(records.stereo_head.flange_from_tool)),
        ("tool_tip", closest_to_flange_mm(records.tool_tip.flange_from_tool, bore)),
    ):
        if near_mm < hand_mm:
            raise ValueError(
                f"[calibration.{name}] flange_from_tool.translation_mm: the tool is {near_mm:.0f} mm from "
                f"the centre of the flange, expected more than cell.arm.hand_mm = {hand_mm:g}, the radius of "
                "the arm's hand: give millimetres, not centimetres"
            )


def closest_to_flange_mm(flange_from_tool: PoseRecord, bore: GuideBore | None = None) -> float:
    """Distance of the flange's centre from a tip, or from a guide's axis between tip and upper end."""
    w, x, y, z = flange_from_tool.quaternion_wxyz
    axis = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
    tip_mm = flange_from_tool.translation_mm
    length_mm = 0.0 if bore is None else bore.reach_mm + bore.length_mm
    up_mm = sum(at * along for at, along in zip(tip_mm, axis, strict=True))
    up_mm = min(max(up_mm, 0.0), length_mm)
    return math.dist(tip_mm, [up_mm * along for along in axis])
