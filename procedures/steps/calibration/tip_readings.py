"""Exchange the head for the guide, bring its tip to where the ball was, and have the dials read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.calibration.head_model import pose_record
from procedures.calibration.tool_tip.looks import BallLook, DivotReading, TipLooks, kept_apart, pairs_of
from procedures.calibration.tool_tip.record import DIALS_TRAVEL_MM, require_plausible
from procedures.calibration.tool_tip.tip import tips_of
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.engine.questions import IN_DIVOT
from procedures.journal.results import StepResult
from procedures.operator.question import Task, Topic
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.stand_ball import ObservedStand
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tools.exchange import exchange_for
from procedures.steps.conditions import exchangeable
from procedures.strategies.approach import ONE_SIDE
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import in_free_room, stand_under
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.room_tasks import DIALS

Array = NDArray[np.float64]

DIVOT = "divot"
HOVER_MM = 40.0  # back along the guide, on the way to the divot and from it
READS = tuple(f"{axis} in mm, along the axes of the robot" for axis in "xyz")
NEAR_MM = 0.3  # a reading below it needs no other: dials a degree askew then show 0.005 mm too much
MOST_TRIES = 3  # at one orientation: the second is near, unless something gives way


class ReadTip(StepResult, kind="tip_readings"):
    """What the calibration of the tip is computed from."""

    observed: TipLooks = Field(description="Contents of `tip-looks.json`.")


@dataclass(frozen=True)
class TipReadings:
    """How many of the orientations are kept to judge by."""

    validation: int

    def run(self, context: StepContext) -> Outcome[ReadTip]:
        """Raises PRO-002 unless confirmed, PRO-009 for another tool, CAL-018 for impossible readings."""
        context.result(CheckedSetUp)
        context.have_instrument_out()  # of an earlier try
        place, stand, workcell = context.result(BallPlace), context.result(ObservedStand), context.workcell
        number = exchange_for(context, MountedTool.GUIDE)
        context.setting.room.prepare_stand(DIVOT)
        context.confirm(
            Topic.CALIBRATION,
            f"The arm will move the tip of tool {number} to where the ball was, in {len(stand.looks)} "
            "orientations. Confirm that the divot is on the stand and lowered, the stand was not "
            "moved, and nobody and nothing else is within the arm's reach",
            f"{len(stand.looks)} orientations",
        )
        surroundings, guide = context.setting.surroundings, workcell.flange_from(MountedTool.GUIDE)
        workcell.surround(in_free_room(surroundings, guide, surroundings.guide, stand_under(place.ball_mm)))
        workcell.start()
        reading = _Reading(context, self._observed(context, stand))
        for look in range(len(stand.looks)):
            reading.take(look)
            context.progress((look + 1) / len(stand.looks), "reading the dials")
        workcell.go_home()
        return Outcome(ReadTip(observed=reading.observed), f"{len(reading.observed.readings)} readings")

    def _observed(self, context: StepContext, stand: ObservedStand) -> TipLooks:
        """Before the first reading."""
        workcell = context.workcell
        calibrations = workcell.calibrations
        return TipLooks(
            created=context.setting.began,
            arm=workcell.arm.kinematics.name,
            stereo_head=calibrations.stereo_head,
            start=calibrations.tool_tip,
            arm_record=calibrations.arm,
            looks=stand.looks,
            readings=(),
            validation=kept_apart(len(stand.looks), self.validation),
        )


@dataclass
class _Reading:
    """Brings the tip to the divot, by what is known of it so far, and has the dials read."""

    context: StepContext
    observed: TipLooks

    def take(self, look: int) -> None:
        """One orientation; again where the first reading shows the tip far from the divot."""
        for _ in range(MOST_TRIES):
            reading = self._read(look)
            others = tuple(one for one in self.observed.readings if one.look != look)
            self.observed = self.observed.model_copy(update={"readings": (*others, reading)})
            if max(map(abs, reading.dials_mm)) <= NEAR_MM:
                return

    def _read(self, look: int) -> DivotReading:
        workcell = self.context.workcell
        over = self.observed.looks[look]
        there, back = (self._pose(over, away_mm) for away_mm in (0.0, HOVER_MM))
        hover_rad = workcell.joints_at(back, over.joints_rad)
        workcell.settle(hover_rad, ONE_SIDE, from_afar=True)
        workcell.settle(workcell.joints_at(there, over.joints_rad), ONE_SIDE)
        workcell.hold()  # hands raise the divot: only a motion that is asked for leads on
        workcell.instrument.goes_in(IN_DIVOT)
        x_mm, y_mm, z_mm = self.context.have_done(
            Task(
                DIALS,
                f"at orientation {look + 1} raise the divot to the tip and read the three dials",
                reads=READS,
                plausible_mm=(-DIALS_TRAVEL_MM, DIALS_TRAVEL_MM),
            )
        )
        dials_mm = (x_mm, y_mm, z_mm)
        require_plausible(dials_mm)
        joints = workcell.joints_rad()
        self.context.have_instrument_out()
        workcell.settle(hover_rad, ONE_SIDE)
        return DivotReading(
            look=look,
            joints_rad=joints,
            robot_from_flange=pose_record(workcell.flange_pose(joints)),
            dials_mm=dials_mm,
        )

    def _pose(self, over: BallLook, away_mm: float) -> Transform:
        """ROBOT <- TOOL, as the workcell has the guide, with its tip where the head saw the ball."""
        workcell = self.context.workcell
        head, guide = workcell.flange_from(MountedTool.STEREO_HEAD), workcell.flange_from(MountedTool.GUIDE)
        flange = over.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE)
        ball = (flange @ head).apply(over.ball_mm)
        tip = head.apply(self._tip_mm(guide, head))  # flange frame
        axis = flange.rigid.rotation.apply(guide.rotation_matrix[:, 2])
        origin = ball - flange.rigid.rotation.apply(tip) - away_mm * axis
        wanted = RigidTransform.from_components(origin, flange.rigid.rotation)
        return Transform(Frame.ROBOT, Frame.FLANGE, wanted) @ guide

    def _tip_mm(self, guide: Transform, head: Transform) -> Array:
        """The tip in the tool frame of the head: by the readings so far, before the first by the record."""
        if not self.observed.readings:
            return (head.inverse() @ guide).translation_mm
        return np.asarray(tips_of(pairs_of(self.observed, self.observed.readings)).mean(axis=0))


def readings_step(validation: int) -> StepSpec[ReadTip]:
    """The step; so many readings are kept to judge by."""
    return StepSpec(
        ReadTip,
        "Read the divot at the tip of the guide",
        Phase.OPERATION,
        TipReadings(validation).run,
        reads=(CheckedSetUp, BallPlace, ObservedStand),
        moves=True,
        preconditions=exchangeable,
    )
