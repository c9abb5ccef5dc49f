"""Scene model: the true state of everything, read by every simulated device.

Frames as in `ronna_hw.frames`; a field `a_from_b` maps b coordinates to a. Lengths in mm, angles in rad.
`nominal` values are those on paper, `true` values the real ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import dist, sqrt
from operator import not_
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from ronna_hw.arm.name_field import arm_of
from ronna_hw.bounded_input import InputRefused, read_json_bytes, read_toml
from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from ronna_hw.mistakes import describe_mistakes, find_other_kind
from ronna_hw.patient_frame import PART_NUMBER as PATIENT_FRAME_PART_NUMBER
from ronna_hw.plausible import FocalPixels, Length
from ronna_hw.text import format_count
from ronna_hw.wire.polaris import PolarisModel
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from sim.errors import BAD_SCENE
from sim.world.descriptions import MAKES
from sim.world.head_surface.bare_bone import BareBone
from sim.world.head_surface.face import Face
from sim.world.head_surface.skin_shift import SkinShift
from sim.world.options import ArmRole
from sim.world.scene.line_projector import LineProjector
from sim.world.scene.parts import (
    ASSISTANT_FRAME_PART_NUMBER,
    Facing,
    Guide,
    ManualAccuracy,
    MarkerCentres,
    NotNegative,
    PartNumber,
    Positive,
    Serial,
    Target,
    ToolName,
)

Numbers6 = tuple[float, float, float, float, float, float]
Variant = Annotated[str, arm_of(*(make.name for make in MAKES.values()))]
Count = Annotated[int, Field(ge=1)]
SlicePixels = Annotated[int, Field(ge=16, le=2048)]  # no scanner reconstructs more
HeadAxis = Annotated[float, Field(gt=0, le=1000), Length]
ToolNumber = Annotated[int, Field(ge=1, le=16)]  # as reported by the controller's inputs
SPHERE_RADIUS_MM = 5.75  # NDI passive sphere, 11.5 mm diameter
BASE_MM = 16.0  # from a screw's head to the centre of its sphere
MOST_WORN_PERCENT = 60.0  # of a film; beyond, the sphere cannot be found
FRAME_TOLERANCE_MM = 0.01  # on the distances within a one-piece frame
SEATING_ERROR_MM = 0.05  # per axis, of a base that is screwed on again


class Fiducial(Strict):
    """A sphere on a bone screw or on the x-shaped frame."""

    number: Count = Field(description="Number that names the sphere in messages and in the ground truth.")
    centre_ct_mm: Numbers3 = Field(description="Centre, CT frame.")
    post_ct: Numbers3 = Field(description="Unit vector from the skull to the sphere.")
    radius_mm: Annotated[float, Field(ge=1, le=25), Length] = Field(
        default=SPHERE_RADIUS_MM, description="Radius of the sphere."
    )
    base_mm: Positive = Field(
        default=BASE_MM, description="Length of the sphere's base at the CT, from the screw to its centre."
    )
    base_in_theatre: Count | None = Field(
        default=None, description="Number of the sphere whose base is now on this screw; default: its own."
    )
    displaced_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0),
        description="Displacement since the CT, CT axes: a loosened screw or a bent base.",
    )
    worn_percent: Annotated[float, Field(ge=0, le=MOST_WORN_PERCENT)] = Field(
        default=0.0, description="Share of the retro-reflective film worn off since the CT, in spots."
    )
    missing: bool = Field(default=False, description="True: not refitted after the CT.")


class Adhesive(Strict):
    """A ring glued to the skin, seen by the CT only."""

    number: Count = Field(description="Number that names the ring in the ground truth.")
    centre_ct_mm: Numbers3 = Field(
        description="Centre of its hole, half its thickness above the skin, CT frame."
    )
    normal_ct: Facing = Field(description="Outward normal of the skin under it, CT frame.")


class ExchangedHead(Strict):
    """Head of another patient, in the place of the scene's."""

    semi_axes_mm: tuple[HeadAxis, HeadAxis, HeadAxis] = Field(
        description="Semi-axes of its ellipsoid: left, posterior, superior."
    )
    face: Face = Field(description="Measures of its face.")


class Head(Strict):
    """Patient's head: true pose of the CT frame in the room, and ellipsoid in the CT frame."""

    robot_from_ct: PoseRecord = Field(description="Pose robot <- CT: where the patient is.")
    centre_ct_mm: Numbers3 = Field(description="Centre of the head ellipsoid, CT frame.")
    semi_axes_mm: tuple[HeadAxis, HeadAxis, HeadAxis] = Field(
        description="Semi-axes of the ellipsoid: left, posterior, superior."
    )
    face: Face | None = Field(
        default=None, description="Measures of the face on that ellipsoid; without it, the ellipsoid alone."
    )
    own_ct: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Folder of a CT series that is the head, without spheres or face."
    )
    skin_shift: SkinShift = Field(
        default=SkinShift(), description="How the skin moved since the CT; with a face only."
    )
    bare_bone: BareBone | None = Field(
        default=None,
        description="Where the scalp is open in the theatre, on a head with a face; none without.",
    )
    exchanged: ExchangedHead | None = Field(
        default=None,
        exclude_if=not_,
        description="The head that lies on the table while the CT shows this one; none if they are the same.",
    )
    fiducials: tuple[Fiducial, ...] = Field(
        description="Spheres on bone screws or on the x-shaped frame; none only on a head with a face."
    )
    seating_error_mm: NotNegative = Field(
        default=SEATING_ERROR_MM,
        description="Displacement of a refitted sphere from its CT position, per axis, one standard "
        "deviation.",
    )
    adhesives: tuple[Adhesive, ...] = Field(
        default=(), description="Adhesive rings on the skin at the CT; neither tracker nor cameras see them."
    )
    x_frame: bool = Field(
        default=False, description="True if the spheres are the four of the x-shaped frame, in its order."
    )
    template_mm: tuple[Numbers3, ...] | None = Field(
        default=None, description="Sphere positions of the implantation template, CT frame."
    )
    robot_from_patient_frame: PoseRecord | None = Field(
        default=None,
        description="Pose robot <- patient's frame on the head clamp, which moves with the head (tracker "
        "tool `patient_frame`); without it, none.",
    )
    targets: Annotated[tuple[Target, ...], Field(min_length=1)] = Field(
        description="Trajectories of the plan."
    )
    target_balls: bool = Field(
        default=False,
        description="True: a ball at each target, as on a phantom, placed after the CT, too dim for the "
        "tracker.",
    )

    @model_validator(mode="after")
    def _identifiers_are_unique(self) -> Self:
        numbers = [fiducial.number for fiducial in self.fiducials]
        identifiers = [target.identifier for target in self.targets]
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"fiducial numbers must be unique, got {numbers}")
        rings = [ring.number for ring in self.adhesives]
        if len(set(rings)) < len(rings):
            raise ValueError(f"numbers of adhesive markers must be unique, got {rings}")
        if len(set(identifiers)) < len(identifiers):
            raise ValueError(f"target identifiers must be unique, got {identifiers}")
        return self

    @model_validator(mode="after")
    def _own_ct_is_as_it_is(self) -> Self:
        if self.own_ct is not None and (self.fiducials or self.adhesives or self.face is not None):
            raise ValueError("own_ct is a head as scanned: it has no spheres, rings or face of the scene")
        return self

    @model_validator(mode="after")
    def _shifted_skin_has_a_face(self) -> Self:
        if self.face is None and not self.skin_shift.is_none:
            raise ValueError("skin_shift needs a face: the ellipsoid's skin does not move")
        if self.face is None and self.bare_bone is not None:
            raise ValueError("bare_bone needs a face: the ellipsoid has no skull of its own")
        if self.face is None and self.exchanged is not None:
            raise ValueError("exchanged needs a face: it is the skin that tells one head from another")
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
                    raise ValueError("the spheres do not match the x-shaped frame, in its order")
        return self

    @model_validator(mode="after")
    def _bases_are_there_once(self) -> Self:
        there = [one for one in self.fiducials if not one.missing]
        bases = [one.base_in_theatre or one.number for one in there]
        unknown = sorted(set(bases) - {one.number for one in self.fiducials})
        has_skin = self.face is not None or self.own_ct is not None
        if not self.fiducials and not has_skin:
            raise ValueError("head.fiducials needs a sphere: the head has no face to register instead")
        if not there and not has_skin:
            raise ValueError(
                "at least one sphere must be present in the theatre, or the head must have a face"
            )
        if unknown:
            raise ValueError(f"base_in_theatre names unknown spheres: {unknown}")
        if len(set(bases)) < len(bases):
            raise ValueError(f"a base can be on one screw only, got bases {bases}")
        return self


class CtProtocol(Strict):
    """CT acquisition protocol: voxel size, grid and noise."""

    pixel_mm: Annotated[float, Field(ge=0.05, le=10)] = Field(default=0.5, description="Pixel spacing.")
    slice_mm: Annotated[float, Field(ge=0.05, le=20)] = Field(default=1.0, description="Slice spacing.")
    columns: SlicePixels = Field(default=512, description="Columns of a slice.")
    rows: SlicePixels = Field(default=512, description="Rows of a slice.")
    slices: Annotated[int, Field(ge=1, le=2000)] = Field(default=200, description="Slices of the series.")
    noise_HU: NotNegative = Field(default=20.0, description="Noise, one standard deviation.")
    mirrored: bool = Field(
        default=False,
        exclude_if=not_,
        description="True: left and right are exchanged on the way, under unchanged headers, and the plan is "
        "made on what the series shows.",
    )
    missing_slices: Annotated[int, Field(ge=0, le=2000)] = Field(
        default=0, exclude_if=not_, description="Slices, from the feet on, that the series has lost."
    )

    @model_validator(mode="after")
    def _some_slices_are_left(self) -> Self:
        if self.missing_slices >= self.slices:
            raise ValueError(f"missing_slices must be fewer than the {self.slices} slices of the series")
        return self


class LinkError(Strict):
    """Deviation of a true arm link from its nominal geometry."""

    translation_mm: Numbers3 = Field(description="Displacement of the next joint.")
    rotation_rad: Numbers3 = Field(description="Rotation vector of the next joint.")


class ArmTruth(Strict):
    """True arm: nominal geometry plus errors from the base outwards.

    The effective joint angle is the encoder's plus offset, first and second harmonic, sag, and backlash with
    the sign of the last motion; at rest a repeatability error is added.
    """

    variant: Variant = Field(default="kr6_r900_sixx", description="Arm model.")
    home_deg: Numbers6 = Field(description="Joint angles at the start.")
    links: tuple[LinkError, LinkError, LinkError, LinkError, LinkError, LinkError] = Field(
        description="Geometric errors of the links, from the base outwards."
    )
    joint_offset_rad: Numbers6 = Field(description="Constant error of each encoder.")
    harmonic_1_rad: Numbers6 = Field(description="First harmonic of the encoder error: amplitude.")
    harmonic_1_phase_rad: Numbers6 = Field(description="First harmonic of the encoder error: phase.")
    harmonic_2_rad: Numbers6 = Field(description="Second harmonic of the encoder error: amplitude.")
    harmonic_2_phase_rad: Numbers6 = Field(description="Second harmonic of the encoder error: phase.")
    sag_rad: tuple[float, float] = Field(
        description="Sag of the second and third joint, arm stretched out horizontally."
    )
    backlash_rad: Numbers6 = Field(description="Backlash, half of it to either side.")
    repeatability_mm: NotNegative = Field(
        description="Repeatability per axis at the tool, one standard deviation."
    )
    stiffness_N_mm: Positive = Field(
        default=80.0, description="Stiffness at the tool: a hand's force displaces the mounted tool."
    )
    sag_mm_kg: NotNegative = Field(
        default=0.15,
        description="Sag of the flange per kilogram of load above the load data in the controller.",
    )
    thermal_drift_mm: NotNegative = Field(
        default=0.0, description="Drift of the flange when the arm is warm; driven by motion, not by time."
    )
    thermal_growth: Annotated[float, Field(ge=0, le=0.001)] = Field(
        default=0.0,
        description="Share by which all links lengthen when the arm is warm: 1.2e-4 for steel, 10 K warmer.",
    )
    thermal_time_s: Positive = Field(
        default=1200.0, description="Time in motion until two thirds of drift and growth are reached."
    )
    encoder_step_rad: Annotated[float, Field(ge=0, le=0.001)] = Field(
        default=0.0,
        description="Resolution of each joint's encoder: the joint is held at the nearest step; 0: exact.",
    )


class Mount(Strict):
    """Mount on the flange, with the tools it carries."""

    flange_from_tool_nominal: PoseRecord = Field(description="Pose flange <- tool centre, as designed.")
    flange_from_tool_true: PoseRecord = Field(description="The same for the stereo head as it really is.")
    tool_from_tip_true: PoseRecord = Field(description="Pose of the guide's tip in the head's tool centre.")
    tool_from_marker_true: PoseRecord = Field(
        description="Pose of the reference frame M, which stays on the mount."
    )
    guide: Guide = Field(default=Guide(), description="The guide and the instrument in it.")
    tool_number_stereo: Literal[1] = Field(
        default=1, description="Tool number of the stereo head in the controller: 1 in every theatre."
    )
    tool_number_guide: ToolNumber = Field(
        default=2, description="Tool number of the guide in the controller."
    )

    @model_validator(mode="after")
    def _two_tools(self) -> Self:
        if self.tool_number_stereo == self.tool_number_guide:
            raise ValueError(f"both tools have number {self.tool_number_guide}")
        return self


SQUARE = sqrt(0.5)  # of a quaternion: a quarter turn
# Hard steel on hard steel under oil: 0.23 at rest, 0.1 sliding (Kirk-Othmer, Lubrication and Lubricants).
DRILL_FRICTION = 0.2


class ForceSensorTruth(Strict):
    """Six-axis force sensor between flange and holder, wired to the arm's controller."""

    noise_N: NotNegative = Field(
        default=0.2, description="Noise of a force in each cycle, one standard deviation."
    )
    noise_Nm: NotNegative = Field(default=0.01, description="The same of a torque.")
    bias_N: NotNegative = Field(
        default=3.0, description="Force that it shows without any, per axis, one standard deviation."
    )
    gain_share: NotNegative = Field(
        default=0.005, description="Error of its gain, one standard deviation of each axis."
    )
    scale: NotNegative = Field(
        default=1.0,
        description="Factor on all that it shows, as of electronics set to another range; 1 is right.",
    )
    crosstalk_share: NotNegative = Field(
        default=0.01, description="Share of a force that shows on another axis, one standard deviation."
    )
    drift_N_min: NotNegative = Field(
        default=0.05, description="Drift of a force, per axis, one standard deviation."
    )


class AssistantTruth(Strict):
    """The assistant: a second arm on a cart of its own, with a tracked frame and a ball on its holder."""

    robot_from_base: PoseRecord = Field(
        description="Pose robot <- base of the assistant: where its cart stands."
    )
    arm: ArmTruth = Field(description="The true arm.")
    flange_from_frame: PoseRecord = Field(
        description="Pose flange <- its tracked frame (tracker tool `assistant_frame`)."
    )
    flange_from_ball_mm: Numbers3 = Field(
        description="Centre of the ball that the stereo head looks at, flange of the assistant."
    )
    ball_radius_mm: Annotated[float, Field(ge=1, le=25), Length] = Field(
        default=SPHERE_RADIUS_MM, description="Radius of that ball."
    )
    flange_from_clamp: PoseRecord = Field(
        default=PoseRecord(translation_mm=(0.0, 0.0, 110.0), quaternion_wxyz=(SQUARE, 0.0, SQUARE, 0.0)),
        description="Pose flange <- clamp of its holder, z along the instrument; the depth stop is at its "
        "origin.",
    )
    force_sensor: ForceSensorTruth | None = Field(
        default=None,
        description="Force sensor on the flange of an arm that senses no force by itself; none without.",
    )
    force_error_N: Annotated[float, Field(ge=0, le=10)] | None = Field(
        default=None,
        description="Two standard errors of a change of its force, as the theatre file states them "
        "(`force_error_N`); none: as the driver has it.",
    )
    drills: bool = Field(
        default=False, description="Whether the theatre file has the assistant drill, not a hand."
    )
    drill_friction: Annotated[float, Field(ge=0, le=1)] = Field(
        default=DRILL_FRICTION,
        description="Share of a force across its drill that resists the feed as friction in the guide. A "
        "drill that turns there by itself, not in a sleeve, has hardly any along its axis.",
    )


class CameraTruth(Strict):
    """True camera: pinhole, distortion k1 k2 p1 p2 k3 and pose on the stereo head."""

    serial: Serial = Field(description="Serial number reported by the camera.")
    focal_px: tuple[FocalPixels, FocalPixels] = Field(
        description="Focal length along columns and along rows."
    )
    principal_point_px: tuple[float, float] = Field(description="Principal point on the sensor.")
    distortion: tuple[float, float, float, float, float] = Field(
        description="Distortion coefficients k1 k2 p1 p2 k3."
    )
    sensor_px: tuple[Count, Count] = Field(default=(2048, 1088), description="Sensor size, columns and rows.")
    camera_from_tool: PoseRecord = Field(description="Pose camera <- tool centre.")
    read_noise_electrons: NotNegative = Field(
        default=13.5, description="Read noise per pixel, one standard deviation."
    )
    full_well_electrons: Positive = Field(default=11900.0, description="Charge at which a pixel saturates.")


class TrackerTool(Strict):
    """Passive tool: markers and their common normal, in the tool frame."""

    name: ToolName = Field(description="Name of the tool.")
    part_number: PartNumber = Field(description="Part number in the tool definition.")
    markers_mm: MarkerCentres = Field(description="Centres of the spheres, 3 to 20.")
    normal: Facing = Field(default=(0.0, 0.0, 1.0), description="Direction that the markers face.")


class TrackerTruth(Strict):
    """True tracker: model, pose, single-marker accuracy, and objects that it mistakes for markers.

    Noise is one standard deviation at mid volume. A bias is the rms length of the fixed, smooth field over a
    volume: what manufacturers state as accuracy.
    """

    model: PolarisModel = Field(default=PolarisModel.SPECTRA, description="Model of the unit.")
    robot_from_tracker: PoseRecord = Field(description="Pose robot <- tracker: where the unit is.")
    tools: Annotated[tuple[TrackerTool, ...], Field(min_length=1)] = Field(
        description="Passive tools; the first is the reference frame M on the mount."
    )
    places: tuple[PoseRecord, ...] = Field(
        default=(), description="Poses tracker <- tool for other loaded definitions, in the order of loading."
    )
    fiducials_visible: bool = Field(
        default=True, description="True if the tracker sees the spheres; the bench has no head."
    )
    noise_xy_mm: NotNegative = Field(
        default=0.04, description="Noise of one marker across the line of sight."
    )
    noise_z_mm: NotNegative = Field(default=0.14, description="The same along the line of sight.")
    bias_mm: NotNegative | None = Field(
        default=None,
        description="Bias over the pyramid, or the only volume; default: as stated for the model.",
    )
    bias_extended_mm: NotNegative | None = Field(
        default=None, description="Bias over the extended pyramid; default likewise."
    )
    strays_mm: tuple[Numbers3, ...] = Field(
        default=(), description="More stray markers, fixed in the tracker frame."
    )
    line_separation_mm: NotNegative = Field(
        default=0.5, description="Rays closer than this are taken for one marker (phantom markers); 0: none."
    )
    reflections: Annotated[int, Field(ge=0)] = Field(
        default=0, description="Number of intermittent reflections."
    )
    sphere_interval_ms: NotNegative = Field(
        default=0.0,
        description="Time between the exposures of two spheres on the head; 0: all at once, as a Polaris "
        "images passive spheres.",
    )

    @model_validator(mode="after")
    def _tool_names_are_unique(self) -> Self:
        names = [tool.name for tool in self.tools]
        if len(set(names)) < len(names):
            raise ValueError(f"tool names must be unique, got {names}")
        return self


class Stand(Strict):
    """Calibration stand on the table, empty until a ball or divot is placed on it.

    Divot and ball share one position to within the stand's own tolerance.
    """

    ball_mm: Numbers3 = Field(default=(563.0, -325.0, 230.0), description="Centre of the ball, robot frame.")
    divot_from_ball_mm: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="Offset of the divot at zero from the ball centre, robot frame."
    )
    dials_turned_rad: Numbers3 = Field(
        default=(0.0, 0.0, 0.0), description="Rotation vector of the dials' axes in the robot frame."
    )
    travel_mm: Positive = Field(default=6.0, description="Travel of the divot along each axis, either way.")
    reading_mm: NotNegative = Field(default=0.003, description="Noise of a reading, one standard deviation.")
    scale_mm: Positive = Field(default=0.01, description="Resolution of the dials.")


class ArmResidual(Strict):
    """Residual errors of an arm calibration, as standard deviations."""

    link_mm: NotNegative = Field(default=0.06, description="Error of each link's length, per axis.")
    angle_rad: NotNegative = Field(
        default=1.4e-4, description="Error of each link's rotation per axis, and of each joint's offset."
    )
    tool_mm: NotNegative = Field(default=0.1, description="Error of the stereo head on the flange, per axis.")


class CalibrationError(Strict):
    """Stated errors of the theatre's calibration records, as standard deviations."""

    camera_rotation_rad: NotNegative = Field(default=4e-5, description="Rotation of each camera, per axis.")
    camera_translation_mm: NotNegative = Field(default=0.01, description="Position of each camera, per axis.")
    focal_relative: NotNegative = Field(default=1e-4, description="Error of the focal lengths.")
    tip_mm: NotNegative = Field(default=0.03, description="Guide tip, per axis: 0.05 mm in space.")
    tip_direction_rad: NotNegative = Field(
        default=2e-4, description="Direction of the guide's bore, about either axis: 0.01 mm in 60 mm."
    )
    marker_translation_mm: NotNegative = Field(
        default=0.2, description="Position of the reference frame, per axis."
    )
    marker_rotation_rad: NotNegative = Field(
        default=1e-3, description="Rotation of the reference frame, per axis."
    )
    first_day: bool = Field(
        default=False,
        description="True: frame and tip never measured; their records hold design values and have expired.",
    )
    arm: ArmResidual | None = Field(
        default=None, description="Errors of the arm's calibration record; without it the head is nominal."
    )


class Scene(Strict):
    """Complete ground truth of a theatre."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = Field(
        default=1, description="Version of this file format."
    )
    name: str = Field(pattern=r"^[^\x00-\x1f\x7f-\x9f]+$", description="Name of the scene.")
    seed: Annotated[int, Field(ge=0)] = Field(
        default=0, description="Seed of everything drawn at random later."
    )
    head: Head = Field(description="The patient.")
    ct: CtProtocol = Field(default=CtProtocol(), description="How the CT is scanned.")
    arm: ArmTruth = Field(description="The true arm.")
    mount: Mount = Field(description="The mount on the flange and its tools.")
    assistant: AssistantTruth | None = Field(
        default=None, description="The second arm; without it, there is one."
    )
    tracker: TrackerTruth = Field(description="The true tracker and what it sees.")
    projector: LineProjector | None = Field(
        default=None,
        description="Line projector on the stereo head, switched by the left camera's output line.",
    )
    left: CameraTruth = Field(description="The left camera.")
    right: CameraTruth = Field(description="The right camera.")
    stand: Stand = Field(default=Stand(), description="The calibration stand.")
    hands: ManualAccuracy = Field(default=ManualAccuracy(), description="Accuracy of manual tasks.")
    servo_area_px: tuple[Count, Count] = Field(
        default=(1024, 1024), description="Area of interest that contains a sphere with room to move."
    )
    calibration_error: CalibrationError = Field(
        default=CalibrationError(), description="Errors of the theatre's calibration records."
    )

    @model_validator(mode="after")
    def _cameras_differ(self) -> Self:
        if self.left.serial == self.right.serial:
            raise ValueError(f"left.serial and right.serial are both {self.left.serial!r}")
        return self

    @model_validator(mode="after")
    def _assistant_frame_is_a_tool(self) -> Self:
        known = any(tool.part_number == ASSISTANT_FRAME_PART_NUMBER for tool in self.tracker.tools[1:])
        if self.holders and not known:
            raise ValueError(
                f"assistant needs a tool with part number {ASSISTANT_FRAME_PART_NUMBER} in tracker.tools, "
                "after the frame on the mount"
            )
        return self

    @property
    def holders(self) -> Mapping[ArmRole, AssistantTruth]:
        """Arms beside the master by role; each holds an instrument."""
        found = {ArmRole.ASSISTANT: self.assistant}
        return {role: one for role, one in found.items() if one is not None}

    @property
    def arms(self) -> Mapping[ArmRole, ArmTruth]:
        """True arms by role, the master first."""
        return {ArmRole.MASTER: self.arm, **{role: one.arm for role, one in self.holders.items()}}

    def arm_of(self, role: ArmRole) -> ArmTruth:
        """Return the true arm in a role; raises SIM-001 for one that is not there."""
        arm = self.arms.get(role)
        if arm is None:
            raise BAD_SCENE(
                f"{self.name} has no {role}", action="Start ronna-sim theatre --dual, or give it one."
            )
        return arm

    @model_validator(mode="after")
    def _patient_frame_is_a_tool(self) -> Self:
        on_clamp = self.head.robot_from_patient_frame is not None
        known = any(tool.part_number == PATIENT_FRAME_PART_NUMBER for tool in self.tracker.tools[1:])
        if on_clamp and not known:
            raise ValueError(
                f"head.robot_from_patient_frame needs a tool with part number {PATIENT_FRAME_PART_NUMBER} in "
                "tracker.tools, after the frame on the mount"
            )
        return self


def parse_scene(content: dict[str, Any], name: str) -> Scene:
    """Validate a scene's content; raises SIM-001 listing every error."""
    if kind := find_other_kind(content, "head"):
        raise BAD_SCENE(f"{name} is {kind}, not a scene", expected="tables such as [head] and [tracker]")
    try:
        return Scene.model_validate(content, strict=False)
    except ValidationError as error:
        mistakes = describe_mistakes(error, Scene)
        raise BAD_SCENE(
            f"{name} has {format_count(len(mistakes), 'mistake')}: " + "; ".join(mistakes)
        ) from error


def parse_scene_json(content: bytes, name: str) -> Scene:
    """Parse the content of a JSON scene file; raises SIM-001 listing every error."""
    try:
        return Scene.model_validate_json(content, strict=False)
    except ValidationError as error:
        raise BAD_SCENE(f"{name}: " + "; ".join(describe_mistakes(error, Scene))) from error


def read_scene(path: Path) -> Scene:
    """Read a scene file (TOML or JSON); raises SIM-001 listing every error."""
    try:
        if path.suffix == ".json":
            return parse_scene_json(read_json_bytes(path), path.name)
        content = read_toml(path, BAD_SCENE)
    except InputRefused as error:
        raise BAD_SCENE(f"{path.name} is refused: {error.summary}") from error
    except OSError as error:
        raise BAD_SCENE(f"cannot read the scene {path.name}: {error.strerror}") from error
    return parse_scene(content, path.name)
