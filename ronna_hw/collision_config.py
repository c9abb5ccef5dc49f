"""Theatre-file table `[cell]`: collision bodies of the arm, patient and room.

Every body is a capsule: two ends and a radius. Tools are described in the tool frame (origin at the tool
centre point, z along the tool), the patient's surroundings in the head frame (origin at the centre of the
head in the CT, axes of the CT: x left, y posterior, z superior), the room in the robot's.

The defaults fit a patient in a three-pin clamp, lying straight on a table, and the tools of the simulated
theatre. They are estimates: before the arm moves near anything real, measure and enter your own.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from ronna_hw.arm.clearance.bodies import (
    Capsule,
    Corridor,
    MeasuredRadii,
    Obstacle,
    Part,
    SpeedZone,
    Surroundings,
    covering_ellipsoid,
)
from ronna_hw.arm.motion.limits import REDUCED_SPEED_MM_S
from ronna_hw.arm.pose import Pose
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.plausible import FARTHEST_MM, Length, farther_than

Millimetres = Annotated[float, Field(gt=0, le=5000), Length]
NotNegative = Annotated[float, Field(ge=0, le=5000), Length]
Speed = Annotated[float, Field(gt=0, le=2000)]
Place = Annotated[Numbers3, farther_than(0.0, FARTHEST_MM)]

# The largest values that still limit anything.
# Safety against a corridor that no longer limits the needle (U).
LARGEST_CORRIDOR_MM = 15.0  # no burr hole is wider than 30 mm
# Safety against a fast arm at the head. Source: `REDUCED_SPEED_MM_S`.
FASTEST_NEAR_HEAD_MM_S = REDUCED_SPEED_MM_S

SPHERE_POST_RADIUS_MM = 7.0  # an 11.5 mm marker on its post, plus the error of the coarse localization
POST_MM = 14.0  # from the sphere's centre towards the head
HEAD, FIDUCIAL = "head", "fiducial"


class BodyFrame(StrEnum):
    """Reference frame of a collision body."""

    HEAD = "head"
    ROBOT = "robot"


class BodyConfig(Strict):
    """Capsule defined by its axis end points and its radius."""

    name: Annotated[str, Field(min_length=1)] = Field(description="Name used in messages.")
    start_mm: Place = Field(description="Start of the axis.")
    end_mm: Place = Field(description="End of the axis.")
    radius_mm: Millimetres = Field(description="Radius of the cylinder and of its rounded ends.")

    @property
    def capsule(self) -> Capsule:
        """Capsule as plain numbers."""
        return Capsule(self.start_mm, self.end_mm, self.radius_mm)


class ToolBody(BodyConfig):
    """Body of a tool, in the tool frame. Only parts meant to enter the head may set `enters_head`."""

    enters_head: bool = Field(default=False, description="True if the body is meant to enter the head.")


class RoomBody(BodyConfig):
    """Body near the arm, in the head frame or the robot frame."""

    frame: Annotated[BodyFrame, Field(strict=False)] = Field(
        default=BodyFrame.HEAD, description="Reference frame of the coordinates."
    )


class ArmThickness(Strict):
    """Conservative capsule radii of the arm's bodies; those left out are the arm's own.

    They hold for the master, and for an assistant of the same model.
    """

    column_mm: Millimetres | None = Field(
        default=None, description="Radius from the base to the second joint."
    )
    upper_arm_mm: Millimetres | None = Field(default=None, description="Radius from shoulder to elbow.")
    forearm_mm: Millimetres | None = Field(default=None, description="Radius from the elbow to the wrist.")
    wrist_mm: Millimetres | None = Field(default=None, description="Radius of the wrist.")
    hand_mm: Millimetres | None = Field(default=None, description="Radius from the wrist to the flange.")

    @property
    def measured(self) -> MeasuredRadii:
        """Radii as plain numbers."""
        return MeasuredRadii(self.column_mm, self.upper_arm_mm, self.forearm_mm, self.wrist_mm, self.hand_mm)


class HeadZone(Strict):
    """Speed limit for all moving parts, interpolated linearly over the distance to the head."""

    near_mm: NotNegative = Field(default=20.0, description="Up to this distance, near_speed_mm_s applies.")
    # Safety against a fast arm at the head (U).
    near_speed_mm_s: Annotated[float, Field(gt=0, le=FASTEST_NEAR_HEAD_MM_S)] = Field(
        default=60.0, description="Largest speed up to near_mm."
    )

    far_mm: Millimetres = Field(default=400.0, description="From this distance on, far_speed_mm_s applies.")
    far_speed_mm_s: Speed = Field(default=1000.0, description="Largest speed from far_mm on.")

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.far_mm <= self.near_mm or self.far_speed_mm_s < self.near_speed_mm_s:
            raise ValueError(
                "far_mm must exceed near_mm, and far_speed_mm_s must not be below near_speed_mm_s"
            )
        return self


def _build_tool_body(name: str, start: Numbers3, end: Numbers3, radius: float) -> ToolBody:
    return ToolBody(name=name, start_mm=start, end_mm=end, radius_mm=radius)


def _build_room_body(name: str, start: Numbers3, end: Numbers3, radius: float) -> RoomBody:
    return RoomBody(name=name, start_mm=start, end_mm=end, radius_mm=radius)


# As drawn. The plate starts on the flange, at (-220, 0, -60); up to its start here the hand covers it.
_MOUNT = (
    _build_tool_body("plate of the mount", (-175.0, 0.0, -60.0), (-130.0, 0.0, -60.0), 13.0),
    _build_tool_body("mount", (-130.0, 0.0, -60.0), (-130.0, 0.0, -170.0), 13.0),
)
STEREO_HEAD = (
    *_MOUNT,
    _build_tool_body("bridge of the stereo head", (-130.0, 0.0, -170.0), (0.0, 0.0, -257.0), 15.0),
    _build_tool_body("beam of the stereo head", (0.0, -130.0, -257.0), (0.0, 130.0, -257.0), 20.0),
    _build_tool_body("left camera", (0.0, -101.6, -195.1), (0.0, -144.0, -276.8), 30.0),
    _build_tool_body("right camera", (0.0, 101.6, -195.1), (0.0, 144.0, -276.8), 30.0),
)
# The tube ends flat, at -85: a round end would either miss its rim or reach 4 mm beyond it.
_FLAT_END = tuple(
    _build_tool_body("end of the guide", (-half_mm, y_mm, -86.5), (half_mm, y_mm, -86.5), 2.5)
    for y_mm, half_mm in ((-6.0, 6.95), (-2.0, 8.0), (2.0, 8.0), (6.0, 6.95))
)
GUIDE = (
    *_MOUNT,
    _build_tool_body("bridge of the guide", (-130.0, 0.0, -170.0), (0.0, 0.0, -170.0), 15.0),
    _build_tool_body("tube of the guide", (0.0, 0.0, -160.0), (0.0, 0.0, -94.0), 10.0),
    *_FLAT_END,
)
AROUND_THE_PATIENT = (
    _build_room_body("left pin of the clamp", (95.0, 15.0, 10.0), (125.0, 30.0, 5.0), 8.0),
    _build_room_body("right pin of the clamp", (-95.0, 15.0, 10.0), (-125.0, 30.0, 5.0), 8.0),
    _build_room_body("left arm of the clamp", (125.0, 30.0, 5.0), (125.0, 130.0, -20.0), 14.0),
    _build_room_body("right arm of the clamp", (-125.0, 30.0, 5.0), (-125.0, 130.0, -20.0), 14.0),
    _build_room_body("cross bar of the clamp", (125.0, 130.0, -20.0), (-125.0, 130.0, -20.0), 16.0),
    _build_room_body("adaptor of the clamp", (0.0, 135.0, -20.0), (0.0, 200.0, -160.0), 25.0),
    _build_room_body("neck", (0.0, 20.0, -100.0), (0.0, 30.0, -200.0), 60.0),
    _build_room_body("shoulders", (-150.0, 40.0, -280.0), (150.0, 40.0, -280.0), 80.0),
    _build_room_body("torso", (0.0, 40.0, -330.0), (0.0, 40.0, -800.0), 150.0),
    _build_room_body("left side of the table", (170.0, 240.0, -220.0), (170.0, 240.0, -1500.0), 50.0),
    _build_room_body("middle of the table", (0.0, 240.0, -220.0), (0.0, 240.0, -1500.0), 50.0),
    _build_room_body("right side of the table", (-170.0, 240.0, -220.0), (-170.0, 240.0, -1500.0), 50.0),
)


class CollisionConfig(Strict):
    """Collision bodies and clearances for checking every path before the arm moves."""

    # Safety against contact of arm, tool or needle with head, clamp, table and room (U).
    margin_mm: Millimetres = Field(default=10.0, description="Smallest clearance along a planned path.")
    live_margin_mm: NotNegative = Field(
        default=5.0, description="Smallest clearance of a set-point; below it the arm stops."
    )
    corridor_mm: Annotated[float, Field(gt=0, le=LARGEST_CORRIDOR_MM), Length] = Field(
        default=2.5, description="Radius of the needle corridor about a trajectory."
    )

    arm: ArmThickness = Field(default=ArmThickness(), description="Radii of the links of the arm.")
    zone: HeadZone = Field(default=HeadZone(), description="Speed limit near the head.")
    stereo_head: tuple[ToolBody, ...] = Field(
        default=STEREO_HEAD, description="Bodies of the stereo head, in the tool frame."
    )
    guide: tuple[ToolBody, ...] = Field(default=GUIDE, description="Bodies of the guide, in the tool frame.")
    bodies: tuple[RoomBody, ...] = Field(default=AROUND_THE_PATIENT, description="Bodies around the arm.")

    @model_validator(mode="after")
    def _live_is_less(self) -> Self:
        if self.live_margin_mm >= self.margin_mm:
            raise ValueError("live_margin_mm must be less than margin_mm, the clearance of planned paths")
        return self

    def build_surroundings(
        self,
        tool: tuple[ToolBody, ...],
        flange_from_tool: Pose,
        robot_from_head: Pose,
        head_semi_axes_mm: Numbers3,
        fiducials_mm: tuple[Numbers3, ...] = (),
        corridor: Corridor | None = None,
    ) -> Surroundings:
        """Build the surroundings in the frames used by the arm.

        `fiducials_mm` are in $ROBROOT, as localized so far.
        """
        head = covering_ellipsoid(head_semi_axes_mm, robot_from_head)
        obstacles = [Obstacle(HEAD, capsule, True) for capsule in head]
        for body in self.bodies:
            capsule = body.capsule
            in_robot = capsule if body.frame is BodyFrame.ROBOT else capsule.moved(robot_from_head)
            obstacles.append(Obstacle(body.name, in_robot))
        for number, centre in enumerate(fiducials_mm, start=1):
            obstacles.append(
                Obstacle(f"{FIDUCIAL} {number}", _build_post(centre, robot_from_head.position_mm))
            )
        return self.surround(tool, flange_from_tool, obstacles, corridor)

    def surround(
        self,
        tool: Sequence[ToolBody],
        flange_from_tool: Pose,
        obstacles: Sequence[Obstacle],
        corridor: Corridor | None = None,
    ) -> Surroundings:
        """Surround an arm and its tool with obstacles, at the margins and in the speed zone of this cell."""
        zone = self.zone
        return Surroundings(
            tool=tuple(Part(one.name, one.capsule.moved(flange_from_tool), one.enters_head) for one in tool),
            obstacles=tuple(obstacles),
            radii=self.arm.measured,
            margin_mm=self.margin_mm,
            live_margin_mm=self.live_margin_mm,
            zone=SpeedZone(zone.near_mm, zone.near_speed_mm_s, zone.far_mm, zone.far_speed_mm_s),
            corridor=corridor,
        )


def _build_post(centre: Numbers3, middle: Numbers3) -> Capsule:
    """Build the capsule around a sphere and its post, directed towards the centre of the head."""
    away = [m - c for m, c in zip(middle, centre, strict=True)]
    length = sum(value * value for value in away) ** 0.5
    foot = [c + POST_MM * value / length for c, value in zip(centre, away, strict=True)]
    return Capsule(centre, (foot[0], foot[1], foot[2]), SPHERE_POST_RADIUS_MM)
