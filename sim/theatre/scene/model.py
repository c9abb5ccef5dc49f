"""The scene: where everything really is. Read by every simulated device, written once.

Frames as in `ronna_hw.frames`; a field `a_from_b` maps b coordinates to a. Lengths mm, angles rad.
`nominal` values are what the hardware's papers say; `true` values are what is really there.
"""

from __future__ import annotations

from itertools import combinations
from math import dist
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from ronna_hw.bounded_input import read_json_bytes, read_toml
from ronna_hw.calibration import FocalPixels, Length, Numbers3, PoseRecord, Strict
from ronna_hw.config import describe_mistakes
from ronna_hw.text.counting import counted
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from sim.errors import BadScene
from sim.theatre.scene.guide import Guide, Hands
from sim.theatre.scene.quantities import NotNegative, Positive

Numbers6 = tuple[float, float, float, float, float, float]
Count = Annotated[int, Field(ge=1)]
SlicePixels = Annotated[int, Field(ge=16, le=2048)]  # no scanner reconstructs more
HeadAxis = Annotated[float, Field(gt=0, le=1000), Length]
Name = Annotated[str, Field(min_length=1)]
ToolNumber = Annotated[int, Field(ge=1, le=16)]  # as the controller's inputs report it
SPHERE_RADIUS_MM = 5.75  # NDI passive sphere, 11.5 mm diameter
BASE_MM = 16.0  # from the head of a screw to the centre of its sphere
MOST_WORN_PERCENT = 60.0  # of a film: beyond, nothing of a sphere is found
FRAME_TOLERANCE_MM = 0.01  # of the distances of a frame of one piece
SEATING_ERROR_MM = 0.05  # per axis, of a base that is screwed on again


class Fiducial(Strict):
    """A sphere on a bone screw, or on the x-shaped frame."""

    number: Count = Field(description="Name of the sphere in messages and truth.")
    centre_ct_mm: Numbers3 = Field(description="Its centre.")
    post_ct: Numbers3 = Field(description="Unit vector from the skull to the sphere.")
    radius_mm: Annotated[float, Field(ge=1, le=25), Length] = Field(
        default=SPHERE_RADIUS_MM, description="Of the sphere."
    )
    base_mm: Positive = Field(
        default=BASE_MM, description="Length of the base that it had in the CT, from the screw to its centre."
    )
    base_in_theatre: Count | None = Field(
        default=None,
        description="Number of the sphere whose base is on its screw since; its own when not given.",
    )
    displaced_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Way of its place since the CT, CT axes: a screw that loosened, a base that was bent.",
    )
    worn_percent: Annotated[float, Field(ge=0, le=MOST_WORN_PERCENT)] = Field(
        default=0.0, description="Share of its film that is rubbed off since the CT, in spots."
    )
    missing: bool = Field(default=False, description="Whether it was not put back after the CT.")


class Target(Strict):
    """A planned trajectory in the CT frame."""

    identifier: Name = Field(description="Name of the trajectory.")
    entry_ct_mm: Numbers3 = Field(description="Where it enters the head.")
    target_ct_mm: Numbers3 = Field(description="Where it ends.")
    free_angle_deg: float = Field(default=0.0, description="Of the guide about the trajectory.")
    margin_mm: NotNegative = Field(default=2.0, description="As the plan states it.")

    @property
    def outwards_ct(self) -> Numbers3:
        """Unit vector from the target towards the entry."""
        length_mm = dist(self.entry_ct_mm, self.target_ct_mm)
        x, y, z = ((e - t) / length_mm for e, t in zip(self.entry_ct_mm, self.target_ct_mm, strict=True))
        return (x, y, z)


class Head(Strict):
    """The patient: where the CT frame really lies in the room, and the head's ellipsoid in it."""

    robot_from_ct: PoseRecord = Field(description="Pose robot <- CT: where the patient lies.")
    centre_ct_mm: Numbers3 = Field(description="Middle of the ellipsoid.")
    semi_axes_mm: tuple[HeadAxis, HeadAxis, HeadAxis] = Field(description="Left, posterior, superior.")
    fiducials: Annotated[tuple[Fiducial, ...], Field(min_length=1)] = Field(
        description="Spheres on bone screws or on the frame."
    )
    seating_error_mm: NotNegative = Field(
        default=SEATING_ERROR_MM,
        description="By how much a sphere that was put back after the CT stands beside its place there, per "
        "axis, one standard deviation.",
    )
    x_frame: bool = Field(
        default=False, description="Whether its spheres are the four of the x-shaped frame, in its order."
    )
    template_mm: tuple[Numbers3, ...] | None = Field(
        default=None, description="Where the template by which they were implanted would have them."
    )
    targets: Annotated[tuple[Target, ...], Field(min_length=1)] = Field(
        description="Trajectories of the plan."
    )
    target_balls: bool = Field(
        default=False,
        description="Whether a ball stands at each target, as on a phantom; put there after the CT, and not "
        "bright enough for the tracker.",
    )

    @model_validator(mode="after")
    def _identifiers_are_unique(self) -> Self:
        numbers = [fiducial.number for fiducial in self.fiducials]
        identifiers = [target.identifier for target in self.targets]
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"fiducial numbers must be unique, got {numbers}")
        if len(set(identifiers)) < len(identifiers):
            raise ValueError(f"target identifiers must be unique, got {identifiers}")
        return self

    @model_validator(mode="after")
    def _frame_is_the_frame(self) -> Self:
        if self.x_frame:
            centres = [one.centre_ct_mm for one in self.fiducials]
            if len(centres) != len(SPHERE_CENTRES_MM):
                raise ValueError(
                    f"the x-shaped frame has {len(SPHERE_CENTRES_MM)} spheres, not {len(centres)}"
                )
            for (one, other), (here, there) in zip(
                combinations(SPHERE_CENTRES_MM, 2), combinations(centres, 2), strict=True
            ):
                if abs(dist(one, other) - dist(here, there)) > FRAME_TOLERANCE_MM:
                    raise ValueError("the spheres do not lie as the x-shaped frame has them, in its order")
        return self

    @model_validator(mode="after")
    def _bases_are_there_once(self) -> Self:
        there = [one for one in self.fiducials if not one.missing]
        bases = [one.base_in_theatre or one.number for one in there]
        unknown = sorted(set(bases) - {one.number for one in self.fiducials})
        if not there:
            raise ValueError("at least one sphere must be there in the theatre")
        if unknown:
            raise ValueError(f"base_in_theatre names no sphere: {unknown}")
        if len(set(bases)) < len(bases):
            raise ValueError(f"a base is on one screw only, got those of {bases}")
        return self


class CtProtocol(Strict):
    """How the CT is scanned: voxel size, grid and noise."""

    pixel_mm: Annotated[float, Field(ge=0.05, le=10)] = Field(default=0.5, description="Within a slice.")
    slice_mm: Annotated[float, Field(ge=0.05, le=20)] = Field(default=1.0, description="From slice to slice.")
    columns: SlicePixels = Field(default=512, description="Of a slice.")
    rows: SlicePixels = Field(default=512, description="Of a slice.")
    slices: Annotated[int, Field(ge=1, le=2000)] = Field(default=200, description="Of the series.")
    noise_HU: NotNegative = Field(default=20.0, description="One standard deviation.")


class LinkError(Strict):
    """How one link of the true arm differs from the nominal one."""

    translation_mm: Numbers3 = Field(description="Displacement of the next joint.")
    rotation_rad: Numbers3 = Field(description="Rotation vector of the next joint.")


class ArmTruth(Strict):
    """The true arm: nominal geometry plus these errors, in the order A1..A6.

    The joint angle that really acts is the encoder's plus offset, first and second harmonic, sag, and
    backlash with the sign of the last motion; at rest a repeatability error is added.
    """

    variant: Literal["kr6_r900_sixx", "kr6_r900_2"] = Field(
        default="kr6_r900_sixx", description="Which arm stands there."
    )
    home_deg: Numbers6 = Field(description="Axes at the start.")
    links: tuple[LinkError, LinkError, LinkError, LinkError, LinkError, LinkError] = Field(
        description="Errors of the links."
    )
    joint_offset_rad: Numbers6 = Field(description="Constant error of each encoder.")
    harmonic_1_rad: Numbers6 = Field(description="Once per turn: amplitude.")
    harmonic_1_phase_rad: Numbers6 = Field(description="Once per turn: phase.")
    harmonic_2_rad: Numbers6 = Field(description="Twice per turn: amplitude.")
    harmonic_2_phase_rad: Numbers6 = Field(description="Twice per turn: phase.")
    sag_rad: tuple[float, float] = Field(description="Of A2 and A3 when stretched out horizontally.")
    backlash_rad: Numbers6 = Field(description="Dead way of each joint; it lies half of it to either side.")
    repeatability_mm: NotNegative = Field(description="Per axis at the tool, one standard deviation.")
    stiffness_N_mm: Positive = Field(
        default=80.0, description="At the tool: a hand's load displaces what hangs there."
    )
    sag_mm_kg: NotNegative = Field(
        default=0.15, description="By which a load beyond the one that was told lowers the flange."
    )
    thermal_drift_mm: NotNegative = Field(
        default=0.0,
        description="By which the flange has wandered when the arm is warm; by motion, not by time.",
    )
    thermal_time_s: Positive = Field(
        default=1200.0, description="Of motion until the arm is warm to two thirds."
    )


class Mount(Strict):
    """The common mount on the flange and what can hang on it."""

    flange_from_tool_nominal: PoseRecord = Field(description="Pose flange <- tool centre, as designed.")
    flange_from_tool_true: PoseRecord = Field(description="The same, as it really is, of the stereo head.")
    tool_from_tip_true: PoseRecord = Field(description="Pose of the guide's tip in the head's tool centre.")
    tool_from_marker_true: PoseRecord = Field(
        description="Pose of the reference frame M, which stays on the mount."
    )
    guide: Guide = Field(default=Guide(), description="The guide, and the instrument in it.")
    tool_number_stereo: ToolNumber = Field(default=1, description="As the controller reports the head.")
    tool_number_guide: ToolNumber = Field(default=2, description="As they report the guide.")

    @model_validator(mode="after")
    def _two_tools(self) -> Self:
        if self.tool_number_stereo == self.tool_number_guide:
            raise ValueError(f"both tools have the number {self.tool_number_guide}")
        return self


class CameraTruth(Strict):
    """A camera as it really is: pinhole, distortion k1 k2 p1 p2 k3, and its place on the head."""

    serial: str = Field(description="Serial number that the camera tells.")
    focal_px: tuple[FocalPixels, FocalPixels] = Field(description="Along columns and along rows.")
    principal_point_px: tuple[float, float] = Field(description="Where the optical axis meets the sensor.")
    distortion: tuple[float, float, float, float, float] = Field(description="k1 k2 p1 p2 k3.")
    sensor_px: tuple[Count, Count] = Field(default=(2048, 1088), description="Columns and rows.")
    camera_from_tool: PoseRecord = Field(description="Pose camera <- tool centre.")
    read_noise_electrons: NotNegative = Field(default=13.5, description="One standard deviation per pixel.")
    full_well_electrons: Positive = Field(default=11900.0, description="At which a pixel saturates.")


class TrackerTool(Strict):
    """A passive tool: markers and their common normal in the tool's own frame."""

    name: str = Field(description="Of the tool.")
    part_number: str = Field(description="As its definition says it.")
    markers_mm: tuple[Numbers3, ...] = Field(description="Centres of the spheres.")
    normal: Numbers3 = Field(default=(0.0, 0.0, 1.0), description="Into which the markers face.")


class TrackerTruth(Strict):
    """The tracker: where it stands, how well it sees a single marker, and what it takes for one.

    Noise is one standard deviation at mid volume. A bias is the rms length of the fixed, smooth field over a
    volume: what makers state as its accuracy.
    """

    robot_from_tracker: PoseRecord = Field(description="Pose robot <- tracker: where the unit stands.")
    tools: Annotated[tuple[TrackerTool, ...], Field(min_length=1)] = Field(
        description="Passive tools; the first is the reference frame M on the mount."
    )
    places: tuple[PoseRecord, ...] = Field(
        default=(), description="Poses tracker <- tool for other loaded definitions, in the order of loading."
    )
    fiducials_visible: bool = Field(
        default=True, description="Whether the tracker sees the spheres; the bench has no head."
    )
    noise_xy_mm: NotNegative = Field(default=0.04, description="Of one marker across, at mid volume.")
    noise_z_mm: NotNegative = Field(default=0.14, description="The same in depth.")
    bias_mm: NotNegative = Field(default=0.25, description="Over the pyramid, or the unit's only volume.")
    bias_extended_mm: NotNegative = Field(default=0.30, description="Over the extended pyramid.")
    strays_mm: tuple[Numbers3, ...] = Field(
        default=(), description="Further stray markers, fixed in the tracker frame."
    )
    line_separation_mm: NotNegative = Field(
        default=0.5, description="Rays that pass this near are one marker: phantoms; 0 makes none."
    )
    reflections: Annotated[int, Field(ge=0)] = Field(default=0, description="How many glints come and go.")


class Stand(Strict):
    """The calibration stand on the table, empty until ball or divot are put on it.

    Divot and ball take the same place to within the stand's own tolerance.
    """

    ball_mm: Numbers3 = Field(default=(563.0, -325.0, 230.0), description="Centre of its ball, robot frame.")
    divot_from_ball_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="By which the divot at zero lies beside that, robot frame."
    )
    dials_turned_rad: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="Rotation vector of the dials' axes in the robot frame."
    )
    travel_mm: Positive = Field(default=6.0, description="Of the divot along each axis, either way.")
    reading_mm: NotNegative = Field(default=0.003, description="Of one reading, one standard deviation.")
    scale_mm: Positive = Field(default=0.01, description="Step of the dials.")


class ArmResidual(Strict):
    """What a calibration of the arm leaves over in its record, one standard deviation each."""

    link_mm: NotNegative = Field(default=0.06, description="Of each link's length, per axis.")
    angle_rad: NotNegative = Field(
        default=1.4e-4, description="Of each link's rotation per axis, and of each joint's offset."
    )
    tool_mm: NotNegative = Field(default=0.1, description="Of the head on the flange, per axis.")


class CalibrationError(Strict):
    """Stated errors of the calibration records that the theatre hands out, one standard deviation."""

    camera_rotation_rad: NotNegative = Field(default=4e-5, description="Of each camera, per axis.")
    camera_translation_mm: NotNegative = Field(default=0.01, description="Of each camera, per axis.")
    focal_relative: NotNegative = Field(default=1e-4, description="Of the focal lengths.")
    tip_mm: NotNegative = Field(default=0.03, description="Of the guide's tip per axis: 0.05 mm in space.")
    tip_direction_rad: NotNegative = Field(
        default=2e-4, description="Of the guide's bore, about either axis: 0.01 mm in 60 mm."
    )
    marker_translation_mm: NotNegative = Field(default=0.2, description="Of the reference frame, per axis.")
    marker_rotation_rad: NotNegative = Field(default=1e-3, description="Of the reference frame, per axis.")
    first_day: bool = Field(
        default=False,
        description="Whether frame and tip were never measured: their records hold the drawing, and are no "
        "longer valid.",
    )
    arm: ArmResidual | None = Field(
        default=None, description="Of the arm's own record; without, there is none and the head is nominal."
    )


class Scene(Strict):
    """Everything that is true in the theatre."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = Field(
        default=1, description="Version of this form."
    )
    name: str = Field(description="Of the scene.")
    seed: Annotated[int, Field(ge=0)] = Field(
        default=0, description="Of everything that is drawn at random later on."
    )
    head: Head = Field(description="The patient.")
    ct: CtProtocol = Field(default=CtProtocol(), description="How the CT is scanned.")
    arm: ArmTruth = Field(description="The true arm.")
    mount: Mount = Field(description="What hangs on the flange.")
    tracker: TrackerTruth = Field(description="The true tracker and what it sees.")
    left: CameraTruth = Field(description="The left camera.")
    right: CameraTruth = Field(description="The right camera.")
    stand: Stand = Field(default=Stand(), description="The calibration stand.")
    hands: Hands = Field(default=Hands(), description="What the room's hands do.")
    servo_area_px: tuple[Count, Count] = Field(
        default=(1024, 1024), description="Area of interest that holds a sphere with room to move."
    )
    calibration_error: CalibrationError = Field(
        default=CalibrationError(), description="How well the theatre's calibration records are known."
    )


def parse_scene(content: dict[str, Any], name: str) -> Scene:
    """Check the content of a scene; raises SIM-001 with every mistake in it."""
    try:
        return Scene.model_validate(content, strict=False)
    except ValidationError as error:
        mistakes = describe_mistakes(error, Scene)
        raise BadScene(f"{name} has {counted(len(mistakes), 'mistake')}: " + "; ".join(mistakes)) from error


def read_scene(path: Path) -> Scene:
    """Read a scene file (TOML or JSON); raises SIM-001 with every mistake in it."""
    try:
        if path.suffix == ".json":
            return Scene.model_validate_json(read_json_bytes(path), strict=False)
        content = read_toml(path, BadScene)
    except OSError as error:
        raise BadScene(f"cannot read the scene {path.name}: {error.strerror}") from error
    except ValidationError as error:
        raise BadScene(f"{path.name}: " + "; ".join(describe_mistakes(error, Scene))) from error
    return parse_scene(content, path.name)
