"""Calibration records of the theatre file: plain numbers, poses as mm and scalar-first quaternion."""

from __future__ import annotations

import math
from datetime import date, datetime, timedelta
from functools import lru_cache
from typing import TYPE_CHECKING, Annotated, ClassVar, Self

from pydantic import (
    AfterValidator,
    AwareDatetime,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationInfo,
    model_validator,
)

from ronna_hw.arm.catalogue import require_known_arm
from ronna_hw.errors import EXIT_REFUSED, DataError
from ronna_hw.plausible import (
    FARTHEST_ON_TOOL_MM,
    FINEST_MM,
    LARGEST_DEVIATION_MM,
    LARGEST_DEVIATION_RAD,
    SHORTEST_TRANSLATION_MM,
    WIDEST_VIEW_DEG,
    ArmError,
    DeviationMm,
    DeviationRad,
    FocalPixels,
    MountedError,
    Scatter,
    SensorPixels,
    StatedError,
    Words,
    check_on_holder,
    farther_than,
)

if TYPE_CHECKING:
    from ronna_hw.frames import Frame, Transform

UNIT_NORM_TOLERANCE = 1e-6
Numbers3 = tuple[float, float, float]
Numbers4 = tuple[float, float, float, float]
Numbers2 = tuple[float, float]
ArmName = Annotated[str, AfterValidator(require_known_arm)]

STEREO_HEAD_NUMBER = 1  # as the controller's inputs report it; 0 is an empty mount
CLOCKS_AGREE = timedelta(days=1)  # between two computers, whatever their time zones
# Of the instrument from where the holder's frame faces. With the tip at a head that the tracker sees from
# above, a frame that faces closer to the tip shows the tracker its edge or its back.
LEAST_TIP_FROM_FACE_DEG = 60.0
AS_MACHINED_RAD = 1.7e-3  # 0.1 degrees: for a guide assumed to point as drawn, never measured


def _require_whole_moment(value: object, info: ValidationInfo) -> object:
    if isinstance(value, date) and getattr(value, "tzinfo", None) is None:
        raise ValueError("expected day, time and time zone, as 2026-12-21T12:00:00Z")
    if info.mode == "json" and isinstance(value, str):  # the result is no longer JSON
        return datetime.fromisoformat(value)
    return value


Moment = Annotated[AwareDatetime, BeforeValidator(_require_whole_moment)]


def _as_pair(pair: tuple[float, float]) -> str:
    return "[{:g}, {:g}]".format(*pair)


def _as_text(moment: datetime) -> str:
    return f"{moment:%Y-%m-%d %H:%M} {moment.tzname() or ''}".rstrip()


class CalibrationExpired(DataError):
    """A calibration record or a tool record has expired, or is dated in the future."""

    code = "CAL-001"
    action = "Repeat the calibration, or have the record's owner extend it; no motion until then."
    exit_code = EXIT_REFUSED


class Strict(BaseModel):
    """Base of all theatre-file models: strict types, finite numbers, no unknown keys, immutable."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class PoseRecord(Strict):
    """A rigid pose `target <- source`; the containing field names the frames."""

    translation_mm: Annotated[Numbers3, farther_than(SHORTEST_TRANSLATION_MM)] = Field(
        description="Origin of the source frame in the target frame."
    )
    quaternion_wxyz: Numbers4 = Field(description="Rotation as a unit quaternion, scalar first.")

    @model_validator(mode="after")
    def _is_rotation(self) -> Self:
        norm = sum(value * value for value in self.quaternion_wxyz) ** 0.5
        if abs(norm - 1.0) > UNIT_NORM_TOLERANCE:
            raise ValueError(f"quaternion_wxyz has norm {norm:.6f}, not 1: give a rotation, not angles")
        return self

    @property
    def z_axis(self) -> Numbers3:
        """Direction of the source frame's z axis in the target frame."""
        w, x, y, z = self.quaternion_wxyz
        return (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))

    def transform(self, target: Frame, source: Frame) -> Transform:
        """Convert the pose to a checked transform."""
        return _build_transform(target, source, self.translation_mm, self.quaternion_wxyz)


@lru_cache(maxsize=32)  # poses on arm and tools are asked for in every look
def _build_transform(
    target: Frame, source: Frame, translation_mm: Numbers3, quaternion_wxyz: Numbers4
) -> Transform:
    from ronna_hw.frames import Transform

    return Transform.of(target, source, translation_mm=translation_mm, quaternion_wxyz=quaternion_wxyz)


def _require_on_mount(pose: PoseRecord) -> PoseRecord:
    if (length_mm := math.hypot(*pose.translation_mm)) > FARTHEST_ON_TOOL_MM:
        raise ValueError(f"has length {length_mm:.3g}: expected at most {FARTHEST_ON_TOOL_MM:g} mm")
    return pose


MountPose = Annotated[PoseRecord, AfterValidator(_require_on_mount)]
PointOnMount = Annotated[Numbers3, farther_than(SHORTEST_TRANSLATION_MM, FARTHEST_ON_TOOL_MM)]


def _require_on_holder(pose: PoseRecord) -> PoseRecord:
    check_on_holder(pose.translation_mm)
    return pose


class CameraCalibration(Strict):
    """Calibration of one camera of the stereo head: pinhole with radial and tangential distortion.

    Pixel (0, 0) is the centre of the sensor's top-left pixel. `camera_from_tool` maps tool coordinates to the
    camera frame (z along the optical axis, x along columns, y down the rows).
    """

    serial: Words = Field(description="Serial number, as read from the camera.")
    focal_px: tuple[FocalPixels, FocalPixels] = Field(
        description="Focal length along columns and along rows."
    )
    principal_point_px: tuple[float, float] = Field(description="Principal point on the sensor.")
    distortion: tuple[float, float, float, float, float] = Field(
        default=(0.0, 0.0, 0.0, 0.0, 0.0), description="Distortion coefficients k1 k2 p1 p2 k3."
    )
    sensor_px: tuple[SensorPixels, SensorPixels] = Field(
        default=(2048, 1088), description="Sensor size, columns and rows."
    )
    camera_from_tool: PoseRecord = Field(description="Pose camera <- tool centre.")

    @model_validator(mode="after")
    def _fits_sensor(self) -> Self:
        """Check the principal point and the focal length for plausibility against the sensor size."""
        for count, at_px in zip(self.sensor_px, self.principal_point_px, strict=True):
            if not 0.25 * count < at_px < 0.75 * count:
                raise ValueError(
                    f"principal_point_px {_as_pair(self.principal_point_px)} is not in the middle half of "
                    f"sensor_px {_as_pair(self.sensor_px)}: give columns first, then rows"
                )
        view_deg = 2.0 * math.degrees(math.atan2(0.5 * max(self.sensor_px), min(self.focal_px)))
        if view_deg > WIDEST_VIEW_DEG:
            raise ValueError(
                f"focal_px {_as_pair(self.focal_px)} with sensor_px {_as_pair(self.sensor_px)} is a view of "
                f"{view_deg:.0f} degrees, expected at most {WIDEST_VIEW_DEG:g}: give the focal length in "
                "pixels of this sensor"
            )
        return self


class Dated(Strict):
    """Fields of all dated records."""

    what: ClassVar[str] = "calibration"  # its kind, in messages

    identifier: Words = Field(description="Name of the record.")
    created: Moment = Field(description="Time of measurement, with time zone.")
    expires: Moment = Field(description="Time of expiry, with time zone.")
    made_by: Words = Field(description="Person or program that measured it.")

    @model_validator(mode="after")
    def _expires_after_creation(self) -> Self:
        if self.expires < self.created:
            raise ValueError(
                f"expires {_as_text(self.expires)}, before it was created, {_as_text(self.created)}"
            )
        return self

    def check_valid_at(self, moment: datetime) -> None:
        """Raise CAL-001 if the record has expired at `moment` or is dated after it.

        With a clock that was set back, an expired record would appear valid.
        """
        if moment < self.created - CLOCKS_AGREE:
            raise CalibrationExpired(
                f"{self.what} {self.identifier} is dated {_as_text(self.created)}, which is in the future",
                got=f"now {_as_text(moment)}",
                action="Set this computer's clock, or correct the record's date.",
            )
        if moment > self.expires:
            raise CalibrationExpired(
                f"{self.what} {self.identifier} expired on {_as_text(self.expires)}",
                got=f"now {_as_text(moment)}",
                action=self._renewing,
            )

    @property
    def _renewing(self) -> str | None:
        """Advice for renewing an expired record, or None to use the advice for calibrations."""
        return None


class DatedRecord(Dated):
    """Fields common to all calibration records."""

    stated_error_mm: StatedError = Field(description="Stated error, one standard deviation.")


class StereoHeadCalibration(DatedRecord):
    """Calibration of both cameras, and the stereo head's nominal tool centre point on the flange."""

    stated_error_mm: StatedError = Field(
        description="Stated error of a point measured in the tool frame, one standard deviation; not that of "
        "the tool centre on the flange."
    )
    flange_from_tool: MountPose = Field(description="Pose flange <- tool centre of the head.")
    left: CameraCalibration = Field(description="The left camera.")
    right: CameraCalibration = Field(description="The right camera.")


def _require_guide_number(number: int) -> int:
    if number == STEREO_HEAD_NUMBER:
        raise ValueError("is the number of the stereo head: expected another for the guide")
    return number


class ToolTipCalibration(DatedRecord):
    """Calibration of a surgical guide: nominal pose of its tip on the flange, z along the guide."""

    stated_error_mm: MountedError = Field(description="Stated error, one standard deviation.")
    tool_number: Annotated[int, Field(ge=1, le=16), AfterValidator(_require_guide_number)] = Field(
        description="Tool number reported by the controller's inputs; "
        f"{STEREO_HEAD_NUMBER} is that of the stereo head."
    )
    flange_from_tool: MountPose = Field(description="Pose flange <- tip, z along the guide.")
    stated_direction_error_rad: Annotated[float, Field(ge=0, lt=0.1)] = Field(
        default=AS_MACHINED_RAD,
        description="Angle between z and the bore, one standard deviation; default: as machined.",
    )


class TrackerFrameCalibration(DatedRecord):
    """Calibration of the reference frame M on the tool mount: its pose and tracked-tool name."""

    stated_error_mm: MountedError = Field(description="Stated error, one standard deviation.")
    tool: Words = Field(description="Name of the tool definition in the tracker's options.")
    tool_from_marker: MountPose = Field(description="Pose tool centre <- reference frame.")


class HolderCalibration(DatedRecord):
    """Calibration of the assistant's holder: the clamp of the instrument, the ball, and the frame as drawn.

    The instrument is clamped at its depth stop, which is at the origin of the clamp; z leads to its tip.
    """

    stated_error_mm: StatedError = Field(description="Of clamp and ball, one standard deviation in 3-D.")
    stated_direction_error_rad: Annotated[float, Field(ge=0.0, le=AS_MACHINED_RAD)] = Field(
        description="Of the instrument's direction, one standard deviation."
    )
    flange_from_clamp: Annotated[MountPose, AfterValidator(_require_on_holder)] = Field(
        description="Pose flange <- clamp."
    )
    flange_from_ball_mm: Annotated[PointOnMount, AfterValidator(check_on_holder)] = Field(
        description="Centre of the ball on the flange."
    )
    flange_from_frame: Annotated[MountPose, AfterValidator(_require_on_holder)] = Field(
        description="Pose flange <- frame, as drawn; z, to which the frame faces, leads away from the tip."
    )
    frame: Words = Field(description="Name of the assistant's frame in the tracker's options.")

    @model_validator(mode="after")
    def _faces_tracker(self) -> Self:
        """Refuse a clamp whose z leads the wrong way: with the tip at the head, its frame would face that."""
        tip, faces = (pose.z_axis for pose in (self.flange_from_clamp, self.flange_from_frame))
        cosine = sum(one * other for one, other in zip(tip, faces, strict=True))
        if (apart_deg := math.degrees(math.acos(min(1.0, max(-1.0, cosine))))) < LEAST_TIP_FROM_FACE_DEG:
            raise ValueError(
                f"z of flange_from_clamp is {apart_deg:.0f} degrees from that of flange_from_frame, expected "
                f"at least {LEAST_TIP_FROM_FACE_DEG:g}: the first leads to the instrument's tip, the other "
                "from the frame to the tracker; reverse the one that is wrong"
            )
        return self


def _parse_rows(rows: object) -> object:
    """Parse text lines into rows of numbers; return anything else unchanged."""
    if isinstance(rows, list | tuple):
        return tuple(tuple(map(float, row.split())) if isinstance(row, str) else row for row in rows)
    return rows


def _format_rows(rows: tuple[tuple[float, ...], ...]) -> tuple[str, ...]:
    return tuple(" ".join(map(str, row)) for row in rows)


# A line of text for each row: TOML would have one for each of three thousand numbers.
Rows = Annotated[
    tuple[tuple[float, ...], ...],
    BeforeValidator(_parse_rows),
    PlainSerializer(_format_rows, tuple[str, ...]),
]


class ArmCalibration(DatedRecord):
    """Calibrated deviations of an arm from the kinematics of its driver. Joints count from the base outwards.

    A driver computes with the model's, or with those that the arm's controller states (Universal Robots).
    """

    arm: ArmName = Field(description="Name of the kinematic model to correct.")
    serial: Words | None = Field(
        default=None, description="Serial number of the arm; absent where its controller reports none."
    )
    stereo_head_mm: PointOnMount | None = Field(
        default=None, description="Tool centre of the stereo head on the flange, as found with the arm."
    )
    tool_tip_mm: PointOnMount | None = Field(
        default=None, description="The guide's tip on the flange, which was moved with the head."
    )
    scatter_mm: Scatter = Field(
        description="Random error per axis from pose to pose, one standard deviation."
    )
    arm_error_mm: ArmError | None = Field(
        default=None,
        description="Remaining local error of the arm per axis, one standard deviation; without it, from "
        "stated_error_mm.",
    )
    tool_error_mm: MountedError | None = Field(
        default=None,
        description="Remaining error of the stereo head on the flange per axis, one standard deviation; "
        "without it, from stated_error_mm.",
    )
    link_translation_mm: tuple[tuple[DeviationMm, DeviationMm, DeviationMm], ...] = Field(
        description="Displacement of each link's far end, in the frame that rotates with its joint."
    )
    link_rotation_rad: tuple[tuple[DeviationRad, DeviationRad, DeviationRad], ...] = Field(
        description="Rotation vector of each link's far end, same frame."
    )
    joint_offset_rad: tuple[DeviationRad, ...] = Field(description="Constant error of each joint.")
    sine_rad: tuple[tuple[DeviationRad, DeviationRad], ...] = Field(
        description="Error coefficients of the sine of the joint angle and of twice the angle."
    )
    cosine_rad: tuple[tuple[DeviationRad, DeviationRad], ...] = Field(description="The same for the cosines.")
    sag_rad: tuple[DeviationRad, ...] = Field(
        description="Sag under gravity, arm stretched out horizontally."
    )
    backlash_rad: tuple[DeviationRad, ...] = Field(
        description="Backlash; a joint rests half of it to either side."
    )
    remaining: Rows | None = Field(
        default=None,
        description="Errors that the calibration leaves, with their correlations: the lower triangle L of "
        "their covariance L L^T, a line of text for each row. Order: the deviations as listed here, each "
        "joint by joint; then the stereo head on the flange, x, y, z. Without it, from stated_error_mm.",
    )
    freedom: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None,
        description="Degrees of freedom of scatter_mm: the coordinates measured, less what the calibration "
        "has learnt from them. They widen the limit on the residual of a case; without it, scatter_mm counts "
        "as exact.",
    )

    @model_validator(mode="after")
    def _has_equal_counts(self) -> Self:
        counts = {name: len(getattr(self, name)) for name in ARM_DEVIATIONS}
        if len(set(counts.values())) != 1:
            listed = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise ValueError(f"every deviation needs one entry per joint: {listed}")
        return self

    @model_validator(mode="after")
    def _leaves_plausible_errors(self) -> Self:
        """Check the shape and row magnitudes of `remaining`.

        A triangle cannot be asymmetric or indefinite.
        """
        if self.remaining is None:
            return self
        joints = len(self.joint_offset_rad)
        count = PER_JOINT * joints + 3
        if [len(row) for row in self.remaining] != list(range(1, count + 1)):
            raise ValueError(f"remaining: expected {count} rows, of 1 to {count} numbers")
        for number, row in enumerate(self.remaining):
            size = math.hypot(*row)
            in_mm = not 3 * joints <= number < count - 3
            if in_mm and size < FINEST_MM:
                raise ValueError(
                    f"remaining: row {number + 1} is {size:.2g} mm, expected at least {FINEST_MM:g} mm"
                )
            if size > (limit := LARGEST_DEVIATION_MM if in_mm else LARGEST_DEVIATION_RAD):
                raise ValueError(f"remaining: row {number + 1} is {size:.2g}, expected at most {limit:g}")
        return self


ARM_DEVIATIONS = (
    "link_translation_mm",
    "link_rotation_rad",
    "joint_offset_rad",
    "sine_rad",
    "cosine_rad",
    "sag_rad",
    "backlash_rad",
)
PER_JOINT = 13  # numbers in all of them
