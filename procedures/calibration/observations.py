"""Stored calibration measurements, and whether they match the theatre's records."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

from pydantic import Field, ValidationError

from procedures.calibration.errors import BAD_OBSERVATIONS, OfAnotherTheatre
from procedures.relocalization.outline import SphereImage
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import Dated, PoseRecord, StereoHeadCalibration, Strict, ToolTipCalibration
from ronna_hw.config import Calibrations
from ronna_hw.frames import Frame, Transform
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector

SAME = 1e-6  # in any unit: more than writing a number changes, far below the error of any calibration
NOT_MEASURED = {"created", "expires", "made_by"}

OBSERVATIONS_FILE = "observations.json"
Positive = Annotated[float, Field(gt=0)]
Pixels = tuple[float, float]
FlangePose = Annotated[
    PoseRecord, Field(description="Pose robot <- flange, from the arm's record or nominal.")
]
S = TypeVar("S", bound=Strict)


class Measurements(Strict):
    """Base class of a calibration's stored measurements."""

    RECORDS: ClassVar[Mapping[str, str]]  # names in the theatre file -> fields with the records in use

    created: datetime = Field(description="When it was measured.")
    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")

    @property
    def records(self) -> Mapping[str, Dated | None]:
        """Calibration records in use, by their names in the theatre file; None for a missing record."""
        return {name: getattr(self, field) for name, field in self.RECORDS.items()}


def require_same_theatre(
    measured: Measurements, theatre: Calibrations, found: Mapping[str, Any] | None = None
) -> None:
    """Raise CAL-020 unless each theatre record is the one used in measuring or its replacement in `found`.

    A calibration says where something is relative to what its records say of the rest: with another head, or
    another mount, it is wrong by their difference. Before anything is computed (`found` is None), a record
    passes if by its name it may be such a result.
    """
    for name, then in measured.records.items():
        now = getattr(theatre, name)
        if now is None and then is None:
            continue
        if _is_alike(_record_content(now), _record_content(then)):
            continue
        if found is None:
            is_result = now is not None and (
                now.identifier.endswith(identifier_suffix(measured.created))
                or now.identifier == _record_name(then)
            )
        else:
            is_result = _is_alike(_record_content(now), _strip_metadata(found.get(name)))
        if not is_result:
            raise OfAnotherTheatre(
                f"the measurements were made with another [calibration.{name}] than the theatre file's",
                expected=_record_name(now),
                got=_record_name(then)
                if _record_name(then) != _record_name(now)
                else f"{_record_name(then)} with other numbers",
            )


def identifier_suffix(created: datetime) -> str:
    """Return the identifier suffix of records computed from measurements made at this time."""
    return f"-{created:%Y%m%dT%H%M%S}"


def _record_name(record: Dated | None) -> str:
    return "none" if record is None else record.identifier


def _record_content(record: Dated | None) -> Any:
    return None if record is None else _strip_metadata(record.model_dump())


def _strip_metadata(plain: Any) -> Any:
    return {key: value for key, value in plain.items() if key not in NOT_MEASURED} if plain else None


def _is_alike(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_is_alike(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_is_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=0.0, abs_tol=SAME)
    return bool(one == other)


class Outline(Strict):
    """Ball outline in one image, full-sensor pixels, major semi-axis first, with perspective bias."""

    centre_px: Pixels = Field(description="Centre of the ellipse, x and y.")
    axes_px: tuple[Positive, Positive] = Field(description="Semi-axes, major first.")
    covariance_px2: tuple[Pixels, Pixels] = Field(description="Covariance of the centre, x and y.")
    quality: float = Field(ge=0, le=1, description="Quality; reduced by lost rim, scatter and noise.")
    rim_fraction: float = Field(default=1.0, ge=0, le=1, description="Visible share of the rim.")
    scatter_px: float = Field(default=0.0, ge=0, description="Scatter of the rim points about the ellipse.")
    blur_px: float = Field(default=0.0, ge=0, description="Width of the rim's edge.")

    @classmethod
    def of(cls, sphere: SphereImage) -> Self:
        """Convert a measured outline; only reliable outlines are stored."""
        return cls(**{name: getattr(sphere, name) for name in cls.model_fields})


class Observation(Strict):
    """One view of the ball: nominal flange pose, and the ball's outline in both images.

    `orientation` is the number of a self-check orientation; None for views used only for calibration.
    """

    joints_rad: JointVector = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: PoseRecord = Field(description="Nominal pose robot <- flange at these joints.")
    left: Outline = Field(description="In the left image.")
    right: Outline = Field(description="In the right image.")
    orientation: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="Number of the orientation of the check, for views that belong to it."
    )

    @property
    def flange_pose(self) -> Transform:
        """Pose ROBOT <- FLANGE."""
        return self.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE)


class ObservationSet(Measurements):
    """All views for one head calibration, and the records it started from."""

    RECORDS: ClassVar = {"stereo_head": "start", "tool_tip": "tool_tip"}

    serials: tuple[str, str] = Field(description="Serial numbers of the left and the right camera.")
    arm_variant: str = Field(description="Name of the arm's kinematic model.")
    start: StereoHeadCalibration = Field(description="The record in use at the time.")
    tool_tip: ToolTipCalibration | None = Field(default=None, description="The tip record in use.")
    observations: tuple[Observation, ...] = Field(description="The views.")


def read_strict(kind: type[S], path: Path) -> S:
    """Read a strict record from JSON. Raises CAL-005 listing all its errors."""
    try:
        return kind.model_validate_json(read_json_bytes(path))
    except OSError as error:
        raise BAD_OBSERVATIONS(f"cannot read {path}: {error.strerror}") from error
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BAD_OBSERVATIONS(
            f"{path.name} has {format_count(len(mistakes), 'mistake')}: {'; '.join(mistakes[:5])}"
        ) from error
