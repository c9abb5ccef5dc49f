"""What the steps of a calibration are made from, so that a replay makes the same ones again."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field, ValidationError

from procedures.engine.errors import NotRecorded
from procedures.engine.order import Steps
from procedures.steps.calibration.procedures import arm_looks, frame_looks, head_calibration, tip_readings
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.config import Calibrations
from ronna_hw.mistakes import describe_mistakes

MOST_LOOKS = 1000  # no command takes half of it


class Calibrated(StrEnum):
    """What a calibration is of."""

    HEAD = "stereo head"
    ARM = "arm"
    FRAME = "tracker frame"
    TIP = "tool tip"


class Recipe(Strict):
    """The steps of one calibration."""

    of: Calibrated = Field(description="What is calibrated.")
    looks: int = Field(ge=0, le=MOST_LOOKS, description="Measurements, poses or readings to compute from.")
    more: int = Field(
        ge=0,
        le=MOST_LOOKS,
        description="Further ones for validation; for the head, visits of each orientation.",
    )
    ball_mm: Numbers3 | None = Field(default=None, description="Position of the ball in $ROBROOT, if given.")

    @property
    def steps(self) -> Steps:
        """In their order."""
        match self.of:
            case Calibrated.HEAD:
                return head_calibration(self.looks, self.more, self.ball_mm)
            case Calibrated.ARM:
                return arm_looks(self.looks, self.more)
            case Calibrated.FRAME:
                return frame_looks(self.looks, self.more)
            case Calibrated.TIP:
                return tip_readings(self.looks, self.more, self.ball_mm)

    @property
    def starts(self) -> frozenset[str]:
        """The records that this calibration only starts from, by their names: they may have expired."""
        match self.of:
            case Calibrated.HEAD:
                return frozenset(Calibrations.model_fields)
            case Calibrated.ARM:
                return frozenset()
            case Calibrated.FRAME | Calibrated.TIP:
                return frozenset({"tracker_frame", "tool_tip"})

    @classmethod
    def read(cls, plain: object) -> Recipe:
        """As it was recorded. Raises PRO-024 for one that this version does not know."""
        try:
            return cls.model_validate(plain, strict=False)
        except ValidationError as error:
            mistakes = "; ".join(describe_mistakes(error))
            raise NotRecorded(f"this version does not know such a calibration: {mistakes}") from error
