"""Measure the ball on the calibration stand, in the orientations in which the tip will take its place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from procedures.calibration.errors import NoBall, PosesOutOfReach, TooFewPoses
from procedures.calibration.head_model import pose_record
from procedures.calibration.pose_set import PlannedLook, in_short_order, turned_about
from procedures.calibration.tool_tip.looks import BallLook
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.over_ball import SPARE, bring_over_ball
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import carries
from procedures.strategies.approach import ONE_SIDE
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher

BALL = "ball"
TILT_RAD = float(np.radians(25.0))
TURN_RAD = float(np.radians(40.0))


class ObservedStand(StepResult, kind="stand_ball"):
    """The ball of the stand, as the stereo head sees it."""

    looks: tuple[BallLook, ...] = Field(description="One for each orientation.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


@dataclass(frozen=True)
class StandBall:
    """In how many orientations."""

    count: int

    def run(self, context: StepContext) -> Outcome[ObservedStand]:
        """Raises CAL-010 or CAL-002 with too few looks, PRO-002 unless confirmed, STE-009 without a ball."""
        context.result(CheckedSetUp)
        place, workcell = context.result(BallPlace), context.workcell
        plan = self._plan(place, BallWatcher(workcell, np.array(place.ball_mm)))
        context.setting.room.prepare_stand(BALL)
        context.confirm(
            Topic.CALIBRATION,
            "the stand is screwed down and its ball is seated",
            f"ball at {' '.join(f'{value:.0f}' for value in place.ball_mm)} mm in $ROBROOT, within 10 mm",
        )
        watcher = bring_over_ball(
            context,
            place,
            f"{self.count} measurements of the stand's ball",
            0,
            ball="the stand's ball",
            if_missing="Seat the ball on the stand, or correct its position: --ball X Y Z, or stand_mm in "
            "[procedure].",
        )
        looks: list[BallLook] = []
        for planned in plan:
            if len(looks) == self.count:
                break
            seen = watcher.take(planned, ONE_SIDE)
            context.progress(len(looks) / self.count, "measuring the stand's ball")
            if seen is None or seen.point is None:
                continue
            joints = workcell.joints_rad()
            x, y, z = seen.point.position_mm.tolist()
            looks.append(
                BallLook(
                    joints_rad=joints,
                    robot_from_flange=pose_record(workcell.flange_pose(joints)),
                    ball_mm=(x, y, z),
                )
            )
        workcell.go_home()
        if len(looks) < self.count:
            raise TooFewPoses(
                "too few poses show the stand's ball",
                expected=str(self.count),
                got=f"{len(looks)}; {watcher.why_rejected()}",
            )
        left_out = watcher.rejected.total()
        remarks = (
            (f"{left_out} measurements of the ball failed: {watcher.why_rejected()}",) if left_out else ()
        )
        return Outcome(ObservedStand(looks=tuple(looks), remarks=remarks), f"{len(looks)} measurements")

    def _plan(self, place: BallPlace, watcher: BallWatcher) -> list[PlannedLook]:
        wanted = round(SPARE * self.count)
        looks = turned_about(place.reference, place.ball_mm, wanted, tilt_rad=TILT_RAD, turn_rad=TURN_RAD)
        reached = [look for look in looks if watcher.reaches(look.pose)]
        if len(reached) < self.count:
            raise PosesOutOfReach(
                "too few poses around the stand are reachable",
                expected=f"{self.count} poses",
                got=f"{len(reached)} of {wanted}",
                action="Put the stand nearer to the middle of the workspace, with free space around it.",
            )
        # The first are spread evenly; a chain of neighbours through all of them would leave out one side.
        return [*in_short_order(reached[: self.count]), *reached[self.count :]]


def _stated(context: StepContext) -> Outcome[BallPlace]:
    """Position of the stand according to the theatre file. Raises CAL-009."""
    stand_mm = context.setting.settings.stand_mm
    if stand_mm is None:
        raise NoBall(
            "the position of the calibration stand is not given",
            action="Give the position of its ball with --ball X Y Z, or as stand_mm in [procedure].",
        )
    return Outcome(BallPlace(ball_mm=stand_mm, others_mm=()), "according to the theatre file")


def stand_place_step() -> StepSpec[BallPlace]:
    """The step that takes the stand's position from the theatre file."""
    return StepSpec(BallPlace, "Use the stand's position", Phase.PREPARATION, _stated)


def stand_step(count: int) -> StepSpec[ObservedStand]:
    """The step for so many orientations."""
    return StepSpec(
        ObservedStand,
        "Measure the stand's ball",
        Phase.OPERATION,
        StandBall(count).run,
        reads=(CheckedSetUp, BallPlace),
        moves=True,
        preconditions=carries(MountedTool.STEREO_HEAD),
    )
