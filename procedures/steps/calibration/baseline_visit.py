"""Measure the ball again from the joint angles of a baseline: has a camera or the mount moved since?"""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from procedures.calibration import Baseline, Observation
from procedures.calibration.errors import NotTheBaseline
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.relocalization.errors import NoSphere
from procedures.relocalization.triangulation import check_serial
from procedures.steps.calibration.over_ball import BALL_PICTURE
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import carries
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher, around_ball
from procedures.workcell.stereo_picture import pair_picture
from ronna_hw.calibration import StereoHeadCalibration


class VisitedBaseline(StepResult, kind="baseline_visit"):
    """The looks of a check."""

    calibration: str = Field(description="Name of the calibration being checked.")
    looks: tuple[Observation, ...] = Field(description="From the orientations of the baseline, in turn.")


@dataclass(frozen=True)
class BaselineVisit:
    """The baseline, and how often each of its orientations is visited."""

    baseline: Baseline
    visits: int

    def run(self, context: StepContext) -> Outcome[VisitedBaseline]:
        """Raises STE-010, CAL-008, CAL-001, PRO-002 unless confirmed, STE-003 without a ball."""
        context.result(CheckedSetUp)
        workcell, head = context.workcell, self.baseline.stereo_head
        for camera, serial in zip((head.left, head.right), workcell.stereo.serials, strict=True):
            check_serial(camera, serial)
        in_use = workcell.calibrations.stereo_head
        _require_same_cameras(in_use, head)
        in_use.check_valid_at(context.setting.today())
        arm = workcell.arm.kinematics.name
        if self.baseline.arm_variant != arm:
            raise GateFailed("the baseline is from another arm", expected=self.baseline.arm_variant, got=arm)
        context.confirm(
            Topic.CALIBRATION,
            "The arm will move to the eight poses of the baseline; the ball must be where it was",
            f"calibration {head.identifier} of {self.baseline.created:%Y-%m-%d %H:%M} UTC",
        )
        first = [
            next(one for one in self.baseline.looks if one.orientation == orientation)
            for orientation in self.baseline.orientations
        ]
        watcher = BallWatcher(workcell, self.baseline.ball_mm)
        tool = workcell.flange_from(MountedTool.STEREO_HEAD)
        workcell.surround(around_ball(context.setting.surroundings, tool, watcher.ball_mm))
        workcell.start(cameras=True)
        workcell.sensors.read_whole()
        seen = []
        for visit in range(self.visits):
            for number, one in enumerate(first):
                found = watcher.observe_at(one.joints_rad, one.orientation)
                if found is not None:
                    seen.append(found)
                done = visit * len(first) + number + 1
                context.progress(done / (self.visits * len(first)), "measuring the ball")
        workcell.go_home()
        if watcher.last is not None:
            context.keep_picture(BALL_PICTURE, pair_picture(watcher.last))
        if not seen:
            raise NoSphere("the ball is not in view from any orientation", got=watcher.why_rejected())
        return Outcome(
            VisitedBaseline(calibration=head.identifier, looks=tuple(seen)), f"{len(seen)} measurements"
        )


def _require_same_cameras(in_use: StereoHeadCalibration, baseline: StereoHeadCalibration) -> None:
    """Where the head is on the flange may differ: a calibration of the arm determines that again."""
    if (in_use.left, in_use.right) != (baseline.left, baseline.right):
        raise NotTheBaseline(
            "the theatre's calibration of the cameras is not that of the baseline",
            expected=in_use.identifier,
            got=baseline.identifier,
            action="Give the baseline of the theatre's calibration, or put the records that were written "
            "with this baseline into the theatre file.",
        )


def visit_step(baseline: Baseline, visits: int) -> StepSpec[VisitedBaseline]:
    """The step for a baseline."""
    return StepSpec(
        VisitedBaseline,
        "Measure the ball again",
        Phase.OPERATION,
        BaselineVisit(baseline, visits).run,
        reads=(CheckedSetUp,),
        moves=True,
        preconditions=carries(MountedTool.STEREO_HEAD),
    )
