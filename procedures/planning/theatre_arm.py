"""The arm of a theatre file for planning, without opening any device."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

from procedures.planning.head_in_ct import fit_head
from procedures.planning.line_of_sight import StereoSight
from procedures.planning.plan_model import FiducialKind
from procedures.planning.scene import PlanningScene, build_frame_bodies
from procedures.planning.tool_records import ToolRecords
from procedures.planning.visits import ArmSetting
from procedures.registration.error_sources import GUIDE_TIP, STEREO_HEAD
from procedures.registration.errors import LayoutNotFound
from procedures.strategies.strategy import Strategy
from ronna_hw.arm.motion.planning import require_in_range
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.clock import HostClock
from ronna_hw.collision_config import CollisionConfig
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.config import DeviceConfig, read_theatre_file
from ronna_hw.devices.sensors import VolumeSections, measuring_volume_mm
from ronna_hw.frames import Frame, Transform
from ronna_hw.registry import make_device
from ronna_hw.roles import MASTER
from ronna_hw.tool_record import GuideBore

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume
    from ronna_hw.devices import RobotArm

SixNumbers = tuple[float, float, float, float, float, float]
Points = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class TheatreArm:
    """Arm, surroundings and stated errors from a theatre file."""

    arm: ArmSetting
    surroundings: CollisionConfig
    sight: StereoSight
    stereo_from_marker: Transform  # the frame on the arm that the tracker sees
    tracker: DeviceConfig | None
    bore: GuideBore
    reserve_mm: float  # extra clearance for the stereo head's error: the servo leaves the path
    seating_error_mm: float  # per axis
    guide_direction_rad: float  # stated error of the bore's direction
    at_target_mm: tuple[tuple[str, float], ...]  # stated by calibrations, 3-D rms, by source

    @property
    def volume_mm(self) -> VolumeSections:
        """Measuring volume of the tracker, as far as it is known before that is connected."""
        return measuring_volume_mm(self.tracker and make_device("tracker", self.tracker, HostClock()))

    def with_scene(self, volume: Volume, fiducials: FiducialKind, markers_mm: Points) -> ArmSetting:
        """Return the arm with the theatre's obstacles and this CT's head and markers. Raises PLAN-014."""
        try:
            frame = build_frame_bodies(fiducials, markers_mm)
        except LayoutNotFound:  # refused by the check itself
            frame = ()
        scene = PlanningScene(self.surroundings, fit_head(volume), markers_mm, frame)
        return replace(self.arm, scene=scene.with_reserve(self.reserve_mm))


def theatre_arm(
    config: Path, robot_from_ct: SixNumbers, home_deg: SixNumbers | None, strategy: Strategy
) -> TheatreArm:
    """Read the arm from a theatre file, with the CT pose in $ROBROOT (mm, deg) and start at `home_deg`."""
    theatre = read_theatre_file(config)
    if MASTER not in theatre.robot or theatre.calibration is None:
        lacking = f"[robot.{MASTER}]" if MASTER not in theatre.robot else "[calibration]"
        raise UsageMistake(
            f"{config.name} has no {lacking}, without which the reach cannot be checked",
            expected=f"[robot.{MASTER}] and [calibration]",
            action="Give the file of a theatre with a calibrated arm, or omit --config.",
        )
    arm_device = cast("RobotArm", make_device(f"robot.{MASTER}", theatre.robot[MASTER], HostClock()))
    kinematics = arm_device.kinematics
    start_rad = kinematics.home_rad if home_deg is None else radians6(*home_deg)
    require_in_range(kinematics, start_rad)
    pose = Pose.from_kuka(*robot_from_ct)
    calibration = theatre.calibration
    sizes = ErrorSizes.stated(theatre.procedure, calibration.arm)
    guide = ToolRecords.of(theatre).guide
    arm = ArmSetting(
        kinematics=kinematics,
        robot_from_ct=Transform.of(
            Frame.ROBOT, Frame.CT, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
        ),
        flange_from_tool=calibration.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
        strategy=strategy,
        flange_from_stereo=calibration.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
        start_rad=start_rad,
        limits=arm_device.limits(),
        approach_mm=theatre.procedure.approach_mm,
        sizes=sizes,
        gauge_rad=radians6(*guide.gauge.joints_deg),
    )
    return TheatreArm(
        arm=arm,
        surroundings=theatre.cell_with_tools,
        sight=StereoSight.of(calibration.stereo_head),
        stereo_from_marker=calibration.tracker_frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER),
        tracker=theatre.tracker,
        bore=guide.bore,
        reserve_mm=sizes.tool_mm,
        seating_error_mm=theatre.procedure.seating_error_mm,
        guide_direction_rad=calibration.tool_tip.stated_direction_error_rad,
        at_target_mm=(
            (STEREO_HEAD, calibration.stereo_head.stated_error_mm),
            (GUIDE_TIP, calibration.tool_tip.stated_error_mm),
        ),
    )
