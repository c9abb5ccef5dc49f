"""One look of the stereo head: from its present pose, or after moving over the ball."""

from __future__ import annotations

from pydantic import Field

from procedures.calibration import Outline
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult
from procedures.relocalization.triangulation import check_serial
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.over_ball import BALL_PICTURE, bring_over_ball
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import carries
from procedures.workcell import MountedTool
from procedures.workcell.stereo_look import Look
from procedures.workcell.stereo_picture import pair_picture
from ronna_hw.calibration import Numbers3


class LookedAtBall(StepResult, kind="ball_look"):
    """What one pair showed."""

    position_mm: Numbers3 | None = Field(description="The ball in the tool frame, if measured.")
    left: Outline | None = Field(description="Its outline in the left image.")
    right: Outline | None = Field(description="Its outline in the right image.")
    reason: str = Field(description="Why the measurement yielded no point.")


def run_where_it_stands(context: StepContext) -> Outcome[LookedAtBall]:
    """A look without motion: only the cameras are connected. Raises CAL-001, STE-010."""
    workcell = context.workcell
    head, stereo = workcell.calibrations.stereo_head, workcell.stereo
    head.check_valid_at(context.setting.today())
    stereo.connect()
    for camera, serial in zip((head.left, head.right), stereo.serials, strict=True):
        check_serial(camera, serial)
    stereo.configure()
    workcell.sensors.read_whole()
    stereo.activate()
    return _kept(context, workcell.look())


def run_over_ball(context: StepContext) -> Outcome[LookedAtBall]:
    """A look over the ball, and back home."""
    context.result(CheckedSetUp)
    bring_over_ball(context, context.result(BallPlace), "one measurement", 0)
    seen = context.workcell.look()
    context.workcell.go_home()
    return _kept(context, seen)


def _kept(context: StepContext, seen: Look) -> Outcome[LookedAtBall]:
    context.setting.memory.keep(seen)  # for whoever wants to see the pictures
    context.keep_picture(BALL_PICTURE, pair_picture(seen))
    point = seen.point
    return Outcome(
        LookedAtBall(
            position_mm=None if point is None else point.position_mm.tolist(),
            left=None if seen.left is None else Outline.of(seen.left),
            right=None if seen.right is None else Outline.of(seen.right),
            reason=seen.reason,
        ),
        seen.reason or "measured",
    )


def look_step(*, over_ball: bool) -> StepSpec[LookedAtBall]:
    """The step, with motion or without."""
    if not over_ball:
        return StepSpec(LookedAtBall, "Look", Phase.OPERATION, run_where_it_stands)
    return StepSpec(
        LookedAtBall,
        "Measure the ball",
        Phase.OPERATION,
        run_over_ball,
        reads=(CheckedSetUp, BallPlace),
        moves=True,
        preconditions=carries(MountedTool.STEREO_HEAD),
    )
