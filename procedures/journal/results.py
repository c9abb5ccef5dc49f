"""Step results: one frozen, versioned model per step, stored as JSON and parsed from its record.

A step declares its model in its own module. Other steps import the model and ask the context for it; that
makes it a parent of their own result.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, ClassVar, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ronna_hw.calibration import Numbers3, Numbers4
from ronna_hw.frames import Frame, Transform
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import OTHER_VERSION, BadRecord, Record

Matrix3 = tuple[Numbers3, Numbers3, Numbers3]


R = TypeVar("R", bound="StepResult")


class Values(BaseModel):
    """Base of results and their parts: frozen, finite numbers, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StepResult(Values):
    """Base of step results. `kind` identifies the step; `version` rises when a field's meaning changes."""

    kind: ClassVar[str]
    version: ClassVar[int]

    def __init_subclass__(cls, *, kind: str, version: int = 1) -> None:
        super().__init_subclass__()
        cls.kind, cls.version = kind, version

    @classmethod
    def renew(cls, plain: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return a stored result, perhaps of an older program, under today's names of the same fields."""
        return plain

    def leaves_out(self) -> Mapping[str, str]:
        """Return the trajectories that this result excludes from the case, with reasons."""
        return {}

    def names_series(self) -> str | None:
        """Return the DICOM UID of the CT series selected by this result, or None."""
        return None


class FramedPose(Values):
    """A rigid pose with its frames: `target <- source`."""

    target: Frame = Field(description="Frame that the pose maps into.")
    source: Frame = Field(description="Frame whose points it maps.")
    translation_mm: Numbers3 = Field(description="Origin of the source in the target.")
    quaternion_wxyz: Numbers4 = Field(description="Rotation, scalar first, of norm 1.")

    @classmethod
    def of(cls, pose: Transform) -> Self:
        """Build a serializable pose from a transform."""
        return cls(
            target=pose.target,
            source=pose.source,
            translation_mm=pose.translation_mm.tolist(),
            quaternion_wxyz=pose.quaternion_wxyz.tolist(),
        )

    @property
    def transform(self) -> Transform:
        """The pose as a checked transform."""
        return Transform.of(
            self.target, self.source, translation_mm=self.translation_mm, quaternion_wxyz=self.quaternion_wxyz
        )


def parse_record(record: Record, model: type[R]) -> R:
    """Parse a record's payload. Raises REC-003 for a different version, REC-001 for invalid content."""
    if record.version != model.version:
        raise OTHER_VERSION(
            f"{record.identifier} has another version",
            expected=f"{model.kind} version {model.version}",
            got=f"version {record.version}",
        )
    try:
        return model.model_validate_json(json.dumps(model.renew(record.payload)))
    except ValidationError as error:
        mistakes = "; ".join(describe_mistakes(error))
        raise BadRecord(f"{record.identifier} is not a {model.kind}: {mistakes}") from error
