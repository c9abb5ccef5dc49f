"""The scene: where everything really is. Read by every simulated device, written once.

Frames as in `ronna_hw.frames`; a field `a_from_b` maps b coordinates to a. Lengths mm, angles rad.
`nominal` values are what the hardware's papers say; `true` values are what is really there.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from ronna_hw.calibration import Numbers3, PoseRecord, Strict
from ronna_hw.config import describe_mistakes
from sim.errors import BadScene

Numbers6 = tuple[float, float, float, float, float, float]
Count = Annotated[int, Field(ge=1)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Name = Annotated[str, Field(min_length=1)]
ToolNumber = Annotated[int, Field(ge=1, le=16)]  # as the controller's inputs report it
SPHERE_RADIUS_MM = 5.75  # NDI passive sphere, 11.5 mm diameter


class Fiducial(Strict):
    """A sphere on a bone screw. `post` is the unit vector from the skull to the sphere, CT frame."""

    number: Count
    centre_ct_mm: Numbers3
    post_ct: Numbers3
    radius_mm: Positive = SPHERE_RADIUS_MM


class Target(Strict):
    """A planned trajectory in the CT frame."""

    identifier: Name
    entry_ct_mm: Numbers3
    target_ct_mm: Numbers3
    free_angle_deg: float = 0.0
    margin_mm: NotNegative = 2.0


class Head(Strict):
    """The patient: where the CT frame really lies in the room, and the head's ellipsoid in it."""

    robot_from_ct: PoseRecord
    centre_ct_mm: Numbers3
    semi_axes_mm: tuple[Positive, Positive, Positive]
    fiducials: Annotated[tuple[Fiducial, ...], Field(min_length=1)]
    targets: Annotated[tuple[Target, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _told_apart(self) -> Self:
        numbers = [fiducial.number for fiducial in self.fiducials]
        identifiers = [target.identifier for target in self.targets]
        if len(set(numbers)) < len(numbers):
            raise ValueError(f"every fiducial needs a number of its own, not {numbers}")
        if len(set(identifiers)) < len(identifiers):
            raise ValueError(f"every target needs an identifier of its own, not {identifiers}")
        return self


class CtProtocol(Strict):
    """How the CT is scanned: voxel size, grid and noise."""

    pixel_mm: Positive = 0.5
    slice_mm: Positive = 1.0
    columns: Count = 512
    rows: Count = 512
    slices: Count = 200
    noise_HU: NotNegative = 20.0


class LinkError(Strict):
    """How one link of the true arm differs from the nominal one."""

    translation_mm: Numbers3
    rotation_rad: Numbers3


class ArmTruth(Strict):
    """The true arm: nominal geometry plus these errors, in the order A1..A6.

    The joint angle that really acts is the encoder's plus offset, first and second harmonic, sag, and
    backlash with the sign of the last motion; at rest a repeatability error is added.
    """

    variant: Literal["kr6_r900_sixx", "kr6_r900_2"] = "kr6_r900_sixx"
    home_deg: Numbers6
    links: tuple[LinkError, LinkError, LinkError, LinkError, LinkError, LinkError]
    joint_offset_rad: Numbers6
    harmonic_1_rad: Numbers6
    harmonic_1_phase_rad: Numbers6
    harmonic_2_rad: Numbers6
    harmonic_2_phase_rad: Numbers6
    sag_rad: tuple[float, float]  # A2 and A3 when stretched out horizontally
    backlash_rad: Numbers6
    repeatability_mm: NotNegative  # per axis at the tool, one standard deviation


class Mount(Strict):
    """The common mount on the flange and what can hang on it."""

    flange_from_tool_nominal: PoseRecord
    flange_from_tool_true: PoseRecord  # tool centre point of the stereo head
    tool_from_tip_true: PoseRecord  # guide tip relative to the head's tool centre point
    tool_from_marker_true: PoseRecord  # reference frame M, which stays on the mount
    tool_number_stereo: ToolNumber = 1
    tool_number_guide: ToolNumber = 2

    @model_validator(mode="after")
    def _two_tools(self) -> Self:
        if self.tool_number_stereo == self.tool_number_guide:
            raise ValueError(f"both tools have the number {self.tool_number_guide}")
        return self


class CameraTruth(Strict):
    """A camera as it really is: pinhole, distortion k1 k2 p1 p2 k3, and its place on the head."""

    serial: str
    focal_px: tuple[Positive, Positive]
    principal_point_px: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    sensor_px: tuple[Count, Count] = (2048, 1088)
    camera_from_tool: PoseRecord
    read_noise_electrons: NotNegative = 13.5
    full_well_electrons: Positive = 11900.0


class TrackerTool(Strict):
    """A passive tool: markers and their common normal in the tool's own frame."""

    name: str
    part_number: str
    markers_mm: tuple[Numbers3, ...]
    normal: Numbers3 = (0.0, 0.0, 1.0)


class TrackerTruth(Strict):
    """The tracker: where it stands, how well it sees a single marker, and what it takes for one.

    Noise is one standard deviation at mid volume. A bias is the rms length of the fixed, smooth field over a
    volume: what makers state as its accuracy.
    """

    robot_from_tracker: PoseRecord
    tools: Annotated[
        tuple[TrackerTool, ...], Field(min_length=1)
    ]  # the first is the reference frame M on the mount
    places: tuple[PoseRecord, ...] = ()  # tracker <- tool, for other loaded definitions, in order of loading
    fiducials_visible: bool = True  # false on the bench, where there is no head
    noise_xy_mm: NotNegative = 0.04
    noise_z_mm: NotNegative = 0.14
    bias_mm: NotNegative = 0.25  # over the pyramid, or the only volume of the unit
    bias_extended_mm: NotNegative = 0.30  # over the extended pyramid
    strays_mm: tuple[Numbers3, ...] = ()  # further stray markers, fixed in the tracker frame
    line_separation_mm: NotNegative = 0.5  # rays that pass this near are one marker: phantoms; 0 makes none
    reflections: Annotated[int, Field(ge=0)] = 0  # glints that come and go


class CalibrationError(Strict):
    """Stated errors of the calibration records that the theatre hands out, one standard deviation."""

    camera_rotation_rad: NotNegative = 4e-5
    camera_translation_mm: NotNegative = 0.01
    focal_relative: NotNegative = 1e-4
    tip_mm: NotNegative = 0.03  # per axis: 0.05 mm in space
    marker_translation_mm: NotNegative = 0.2
    marker_rotation_rad: NotNegative = 1e-3


class Scene(Strict):
    """Everything that is true in the theatre."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    name: str
    seed: Annotated[int, Field(ge=0)] = 0
    head: Head
    ct: CtProtocol = CtProtocol()
    arm: ArmTruth
    mount: Mount
    tracker: TrackerTruth
    left: CameraTruth
    right: CameraTruth
    servo_area_px: tuple[Count, Count] = (
        1024,
        1024,
    )  # area of interest that holds a sphere with room to move
    calibration_error: CalibrationError = CalibrationError()


def parse_scene(content: dict[str, Any], name: str) -> Scene:
    """Check the content of a scene; raises SIM-001 with every mistake in it."""
    try:
        return Scene.model_validate(content, strict=False)
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadScene(f"{name} has {len(mistakes)} mistake(s): " + "; ".join(mistakes)) from error


def read_scene(path: Path) -> Scene:
    """Read a scene file (TOML or JSON); raises SIM-001 with every mistake in it."""
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".json":
            return Scene.model_validate_json(text, strict=False)
        content = tomllib.loads(text)
    except OSError as error:
        raise BadScene(f"cannot read the scene {path.name}: {error.strerror}") from error
    except ValidationError as error:
        raise BadScene(f"{path.name}: " + "; ".join(describe_mistakes(error))) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadScene(f"{path.name} is not TOML: {error}") from error
    return parse_scene(content, path.name)
