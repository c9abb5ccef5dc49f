"""Input of a calibration: outlines of one ball at many arm poses, as stored in a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal, Self, TypeVar

from pydantic import Field, ValidationError

from procedures.calibration.errors import BadObservations
from procedures.calibration.same_theatre import Measurements
from procedures.relocalization.sphere_image import SphereImage
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.calibration import Dated, PoseRecord, StereoHeadCalibration, Strict, ToolTipCalibration
from ronna_hw.frames import Frame, Transform
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import counted

OBSERVATIONS_FILE = "observations.json"
Positive = Annotated[float, Field(gt=0)]
Pixels = tuple[float, float]
Joints = tuple[float, float, float, float, float, float]  # from the base outwards
S = TypeVar("S", bound=Strict)


class Outline(Strict):
    """The ball's outline in one image, full-sensor pixels, major semi-axis first; perspective bias kept."""

    centre_px: Pixels = Field(description="Centre of the ellipse, x and y.")
    axes_px: tuple[Positive, Positive] = Field(description="Semi-axes, major first.")
    covariance_px2: tuple[Pixels, Pixels] = Field(description="Covariance of the centre, x and y.")
    quality: float = Field(ge=0, le=1, description="Quality; reduced by lost rim, scatter and noise.")
    rim_fraction: float = Field(default=1.0, ge=0, le=1, description="Visible share of the rim.")
    scatter_px: float = Field(default=0.0, ge=0, description="Scatter of the rim points about the ellipse.")
    blur_px: float = Field(default=0.0, ge=0, description="Width of the rim's edge.")

    @classmethod
    def of(cls, sphere: SphereImage) -> Self:
        """From a measurement; only reliable ones are stored."""
        return cls(**{name: getattr(sphere, name) for name in cls.model_fields})


class Observation(Strict):
    """One view: the flange pose by the nominal arm model, and the ball in both images.

    `orientation` is the number of a self-check orientation; None for views used only for calibration.
    """

    joints_rad: Joints = Field(description="Measured joints, from the base outwards.")
    robot_from_flange: PoseRecord = Field(description="Nominal pose robot <- flange at these joints.")
    left: Outline = Field(description="In the left image.")
    right: Outline = Field(description="In the right image.")
    orientation: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="Number of the orientation of the check, for views that belong to it."
    )

    @property
    def flange_pose(self) -> Transform:
        """ROBOT <- FLANGE."""
        return self.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE)


class ObservationSet(Measurements):
    """All views of one calibration, and the records it started from."""

    schema_version: Literal[1] = Field(default=1, alias="schema", description="Version of the file format.")
    serials: tuple[str, str] = Field(description="Serial numbers of the left and the right camera.")
    arm_variant: str = Field(description="Name of the arm's kinematic model.")
    start: StereoHeadCalibration = Field(description="The record in use at the time.")
    tool_tip: ToolTipCalibration | None = Field(default=None, description="The tip record in use.")
    observations: tuple[Observation, ...] = Field(description="The views.")

    @property
    def records(self) -> Mapping[str, Dated | None]:
        """As `Measurements.records`."""
        return {"stereo_head": self.start, "tool_tip": self.tool_tip}


def read_strict(kind: type[S], path: Path) -> S:
    """Read one strict record from JSON; raises CAL-005 listing every error in it."""
    try:
        return kind.model_validate_json(read_json_bytes(path))
    except OSError as error:
        raise BadObservations(f"cannot read {path}: {error.strerror}") from error
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise BadObservations(
            f"{path.name} has {counted(len(mistakes), 'mistake')}: {'; '.join(mistakes[:5])}"
        ) from error
