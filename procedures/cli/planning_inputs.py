"""What the planning commands are given: the arm of a theatre file, the CT and the markers in it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, cast

from ronna_hw.command_line import console
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.imaging import Volume
    from procedures.planning.plan import Plan
    from procedures.planning.sight import StereoSight
    from procedures.planning.visits import ArmSetting
    from ronna_hw.collision_config import CollisionConfig
    from ronna_hw.devices import RobotArm
    from ronna_hw.tool_record import GuideBore

READING_SHARE = 0.4  # of the progress bar; the rest is for localizing the markers
SixNumbers = tuple[float, float, float, float, float, float]


class Theatre(NamedTuple):
    """The arm of a theatre file and its surroundings."""

    arm: ArmSetting
    cell: CollisionConfig
    sight: StereoSight
    bore: GuideBore
    reserve_mm: float  # more clearance for the stereo head: its own error, as the servo goes beside the path


def theatre_of(
    config: Path | None, robot_from_ct: SixNumbers | None, home_deg: SixNumbers | None, strategy: str
) -> Theatre | None:
    """The theatre of a file with the head at the given pose; None when no option asks for it."""
    from procedures.strategies.catalogue import strategy_named

    chosen = strategy_named(strategy)
    if config is None and robot_from_ct is None and home_deg is None:
        return None
    if config is None or robot_from_ct is None:
        raise UsageMistake("checking the motions needs both --config and --robot-from-ct")
    for option, numbers in (("--robot-from-ct", robot_from_ct), ("--home", home_deg or ())):
        if not all(math.isfinite(value) for value in numbers):
            raise UsageMistake(
                f"{option} needs finite numbers", got=" ".join(f"{value:g}" for value in numbers)
            )
    from procedures.calibration.arm_sources import ErrorSizes
    from procedures.planning.sight import StereoSight
    from procedures.planning.visits import ArmSetting
    from procedures.workcell.tool_records import ToolRecords
    from procedures.workcell.workcell import MASTER
    from ronna_hw.arm.angles import radians6
    from ronna_hw.arm.motion.planning import require_in_range
    from ronna_hw.arm.pose import Pose
    from ronna_hw.clock import HostClock
    from ronna_hw.config import read_theatre_file
    from ronna_hw.frames import Frame, Transform
    from ronna_hw.registry import make_device

    theatre = read_theatre_file(config)
    if MASTER not in theatre.robot or theatre.calibration is None:
        raise UsageMistake(f"{config.name} needs robot.{MASTER} and a calibration to check reach")
    opens_nothing = make_device(f"robot.{MASTER}", theatre.robot[MASTER], HostClock())
    kinematics = cast("RobotArm", opens_nothing).kinematics
    start_rad = kinematics.home_rad if home_deg is None else radians6(*home_deg)
    require_in_range(kinematics, start_rad)
    pose = Pose.from_kuka(*robot_from_ct)
    arm = ArmSetting(
        kinematics=kinematics,
        robot_from_ct=Transform.of(
            Frame.ROBOT, Frame.CT, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
        ),
        flange_from_tool=theatre.calibration.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
        strategy=chosen,
        flange_from_stereo=theatre.calibration.stereo_head.flange_from_tool.transform(
            Frame.FLANGE, Frame.TOOL
        ),
        start_rad=start_rad,
        approach_mm=theatre.procedure.standoff_mm,
        sizes=ErrorSizes.stated(
            theatre.procedure.arm_error_mm,
            theatre.procedure.tool_error_mm,
            calibrated=theatre.calibration.arm is not None,
        ),
    )
    bore = ToolRecords.of(theatre).guide.bore
    return Theatre(
        arm,
        theatre.cell_with_tools,
        StereoSight.of(theatre.calibration.stereo_head),
        bore,
        theatre.procedure.tool_error_mm,
    )


def in_its_scene(
    theatre: Theatre, volume: Volume, planned: Plan, fiducials_mm: list[tuple[float, float, float]] | None
) -> ArmSetting:
    """The arm with its surroundings and the head and markers of this CT. Raises PLAN-014."""
    from procedures.planning.frame_bodies import frame_bodies
    from procedures.planning.head_shape import head_shape
    from procedures.planning.planning_scene import PlanningScene
    from procedures.registration.errors import LayoutNotFound

    markers = tuple(fiducials_mm or ())
    try:
        frame = frame_bodies(planned.fiducials, markers)
    except LayoutNotFound:  # which the check refuses by itself
        frame = ()
    scene = PlanningScene(theatre.cell, head_shape(volume), markers, frame).with_reserve(theatre.reserve_mm)
    return replace(theatre.arm, scene=scene)


def read_ct(
    series_dir: Path, needs_markers: bool
) -> tuple[Volume, list[tuple[float, float, float]] | None, tuple[str, ...]]:
    """The series, the centres of its markers and, where they cannot be had and need not be, why not."""
    from procedures.imaging import localize, read_series

    with console.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=lambda share: advance(share * READING_SHARE))
        try:
            found = localize(
                volume, progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share)
            )
        except RonnaError as refused:
            if needs_markers:
                raise
            why = f"the fiducials in the CT were not counted: {refused.code} {refused.what}"
            return volume, None, (why,)
    return volume, [tuple(marker.centre_mm.tolist()) for marker in found.markers], ()
