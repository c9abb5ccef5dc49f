"""Step sequence of each calibration, and the recipe from which a replay rebuilds it."""

from __future__ import annotations

from enum import StrEnum

from pydantic import Field, ValidationError

from procedures.calibration import Baseline
from procedures.engine.errors import NotRecorded
from procedures.engine.order import Steps
from procedures.steps.calibration.ball_place import place_step
from procedures.steps.calibration.frame_looks import rotation_step
from procedures.steps.calibration.head_looks import (
    LOOK_IN_PLACE,
    LOOK_OVER_BALL,
    observation_step,
    visit_step,
)
from procedures.steps.calibration.sphere_looks import looks_step
from procedures.steps.calibration.tip_readings import readings_step, stand_place_step, stand_step
from procedures.steps.clinical import global_localization, set_up
from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.config import Calibrations
from ronna_hw.mistakes import describe_mistakes

MOST_LOOKS = 1000  # no command takes half of it


def head_check(baseline: Baseline, visits: int) -> Steps:
    """Return the steps of a stereo head check: set-up, looks from the baseline's poses."""
    return (set_up.STEP, visit_step(baseline, visits))


def head_look(ball_mm: Numbers3 | None) -> Steps:
    """Return the steps of a single measurement: set-up, ball location, one look."""
    return (*_steps_to_ball(ball_mm), LOOK_OVER_BALL)


def look_in_place() -> Steps:
    """Return the single step that takes a look without motion."""
    return (LOOK_IN_PLACE,)


def _steps_to_ball(ball_mm: Numbers3 | None) -> Steps:
    by_tracker: Steps = () if ball_mm is not None else (global_localization.STEP,)
    return (set_up.STEP, *by_tracker, place_step(ball_mm))


class Calibrated(StrEnum):
    """Subject of a calibration."""

    HEAD = "stereo head"
    ARM = "arm"
    FRAME = "tracker frame"
    TIP = "tool tip"


class Recipe(Strict):
    """Parameters of one calibration's steps."""

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
        match self.of:
            case Calibrated.HEAD:
                return (*_steps_to_ball(self.ball_mm), observation_step(self.looks, self.more))
            case Calibrated.ARM:
                return (set_up.STEP, global_localization.STEP, looks_step(self.looks, self.more))
            case Calibrated.FRAME:
                return (set_up.STEP, rotation_step(self.looks, self.more))
            case Calibrated.TIP:
                place = stand_place_step() if self.ball_mm is None else place_step(self.ball_mm)
                return (set_up.STEP, place, stand_step(self.looks + self.more), readings_step(self.more))

    @property
    def starts(self) -> frozenset[str]:
        """Names of the records used only as starting values, which may therefore have expired."""
        match self.of:
            case Calibrated.HEAD:
                return frozenset(Calibrations.model_fields)
            case Calibrated.ARM:
                return frozenset()
            case Calibrated.FRAME | Calibrated.TIP:
                return frozenset({"tracker_frame", "tool_tip"})

    @classmethod
    def read(cls, plain: object) -> Recipe:
        """Read a recorded recipe. Raises PRO-024 if this version does not know it."""
        try:
            return cls.model_validate(plain, strict=False)
        except ValidationError as error:
            mistakes = "; ".join(describe_mistakes(error))
            raise NotRecorded(f"this version does not know such a calibration: {mistakes}") from error
