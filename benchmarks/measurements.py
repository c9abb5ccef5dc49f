"""Measurements by name, each with the module that makes it."""

from __future__ import annotations

from collections.abc import Sequence

import typer

MEASUREMENTS = {
    "robot-link": "robot.robot_link",
    "ur-link": "robot.ur_link",
    "set-points": "robot.set_points",
    "tracker": "tracker",
    "stereo": "stereo_head.stereo",
    "stereo-calibration": "stereo_head.stereo_calibration",
    "stereo-rate": "stereo_head.stereo_rate",
    "laser-line": "stereo_head.line_speed",
    "tracker-frame": "mount.tracker_frame_calibration",
    "tool-tip": "mount.tool_tip_calibration",
    "ct": "scans.ct",
    "dicom": "dicom_reception",
    "registration": "registration",
    "mini-case": "mini_case",
    "recording": "recording",
    "openigtlink": "openigtlink",
    "console": "pages.console_page",
    "planner": "pages.planner_page",
}


def require_measurements(names: Sequence[str]) -> None:
    """Raise BadParameter unless all are names of measurements."""
    if unknown := [name for name in names if name not in MEASUREMENTS]:
        raise typer.BadParameter(
            f"unknown measurement {', '.join(unknown)}; expected one of {', '.join(MEASUREMENTS)}"
        )
