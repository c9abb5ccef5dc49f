"""Records of the tools in the theatre file, as a laboratory would have them: measured in good order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ronna_hw.calibration import PoseRecord
from ronna_hw.tool_record import GAUGE_APPROACHES, GAUGE_MOUNTINGS, TipInHead
from sim.world.noise import noise
from sim.world.rigid import inverse, matrix_of, pose_of
from sim.world.scene.model import Mount, Scene
from sim.world.scene.parts import GUIDE_FRAME_NAME as GUIDE_FRAME

STEREO_HEAD_KG = 2.1
CENTRE_OF_GRAVITY_MM = (110.0, 0.0, 30.0)  # of either tool including the common mount, flange frame
# From home, with the arm turned aside: the gauge is on the table next to the patient.
GAUGE_TURN_DEG = -40.0
GAUGE_BASE_MM = 60.0


def refer_to_tip(content: dict[str, Any]) -> None:
    """Make the guide's record in a theatre file refer to the calibration of its tip in it."""
    guide, records = content["tools"]["guide"], content["calibration"]
    guide["tip"] = records["tool_tip"]["identifier"]
    head, tip = (_pose(records[name]["flange_from_tool"]) for name in ("stereo_head", "tool_tip"))
    guide["tip_in_head"] = TipInHead.of(head, tip).model_dump(mode="json")


def _pose(plain: dict[str, Any]) -> PoseRecord:
    return PoseRecord.model_validate({key: tuple(value) for key, value in plain.items()})


def tool_records(
    scene: Scene, dated: Callable[[str], dict[str, Any]], flange: str
) -> dict[str, dict[str, Any]]:
    """By name; `dated` creates the fields common to all dated records."""
    mount = scene.mount
    guide = mount.guide
    A1, *others = scene.arm.home_deg
    common = {"flange": flange, "centre_of_gravity_mm": list(CENTRE_OF_GRAVITY_MM)}
    return {
        "stereo_head": {
            **dated("tool-stereo-head"),
            **common,
            "purpose": "stereo_head",
            "number": mount.tool_number_stereo,
            "mass_kg": STEREO_HEAD_KG,
        },
        "guide": {
            **dated("tool-guide"),
            **common,
            "purpose": "needle_guide",
            "number": mount.tool_number_guide,
            "mass_kg": guide.mass_kg,
            "bore": {
                "reach_mm": guide.reach_mm,
                "length_mm": guide.bore_mm,
                "play_mm": guide.play_mm,
            },
            **_frame(mount),
            "gauge": {
                "joints_deg": [A1 + GAUGE_TURN_DEG, *others],
                "base_mm": GAUGE_BASE_MM,
                **gauge_read(scene),
            },
        },
    }


def gauge_read(scene: Scene, mountings: int = GAUGE_MOUNTINGS) -> dict[str, Any]:
    """The dials as read for the record: with other seats, arrivals and readings than those of a case."""
    draws, each = noise(scene.seed, "gauge of the record", 0), GAUGE_APPROACHES // mountings
    seated = draws.normal(0.0, scene.mount.guide.seat_mm, (mountings, 1, 3))
    end = (seated + draws.normal(0.0, scene.arm.repeatability_mm, (mountings, each, 3))).reshape(-1, 3)
    read = np.hstack([end, end[:, :2]])  # the mandrel is displaced as a whole
    read += draws.normal(0.0, scene.hands.gauge_mm, read.shape)
    x, y, z, upper_x, upper_y = read.mean(axis=0).round(6).tolist()
    return {
        "reading_mm": [x, y, z],
        "upper_reading_mm": [upper_x, upper_y],
        "approaches": len(read),
        "spread_mm": round(float(np.sqrt(read.var(axis=0, ddof=1).mean())), 6),
    }


def _frame(mount: Mount) -> dict[str, Any]:
    """How the tracker sees the guide, if it has a frame."""
    if mount.guide.tip_from_frame is None:
        return {}
    mount_from_tip = inverse(matrix_of(mount.tool_from_marker_true)) @ matrix_of(mount.tool_from_tip_true)
    pose = pose_of(mount_from_tip @ matrix_of(mount.guide.tip_from_frame))
    return {"frame": {"tool": GUIDE_FRAME, "mount_from_frame": pose.model_dump(mode="json")}}
