"""Steps of the guide tip calibration: stereo measurement of the stand's ball, then dial readings of a divot.

Head and tip visit the same orientations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from procedures.calibration import pose_set, tip_calibration
from procedures.calibration.errors import NO_BALL, POSES_OUT_OF_REACH, TOO_FEW_POSES
from procedures.calibration.head_model import pose_record
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.engine.questions import IN_DIVOT
from procedures.journal.results import StepResult
from procedures.operator.question import Task, Topic
from procedures.steps.calibration.ball_place import (
    SPARE,
    BallPlace,
    bring_over_ball,
    measuring_step,
    reachable_joints,
)
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.clinical.tool_mounting import exchange_tool
from procedures.steps.conditions import needs_exchangeable_tool
from procedures.strategies.strategy import ONE_SIDE
from procedures.workcell import MountedTool, Workcell
from procedures.workcell.ball_watcher import build_free_surroundings, build_stand
from ronna_hw.arrays import Array
from ronna_hw.frames import Frame, Transform
from ronna_hw.text import format_count
from ronna_hw.wire.room_tasks import DIALS, OnStand

TILT_RAD = float(np.radians(25.0))
TURN_RAD = float(np.radians(40.0))
HOVER_MM = 40.0  # back along the guide, before and after the divot
READS = tuple(f"{axis} in mm, along the axes of the robot" for axis in "xyz")
NEAR_MM = 0.3  # a reading below it needs no other: dials a degree askew then show 0.005 mm too much
MOST_TRIES = 3  # at one orientation: the second is near, unless something gives way


class ObservedStand(StepResult, kind="stand_ball"):
    """Stereo head looks at the stand's ball."""

    looks: tuple[tip_calibration.BallLook, ...] = Field(description="One for each orientation.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


def _measure_stand(context: StepContext, count: int) -> Outcome[ObservedStand]:
    """Measure the stand's ball. Raises CAL-010 or CAL-002 for too few looks, PRO-002, STE-009 without it."""
    context.result(CheckedSetUp)
    place, workcell = context.result(BallPlace), context.workcell
    plan = _looks_at_stand(place, workcell, count)
    context.setting.room.prepare_stand(OnStand.BALL)
    context.confirm(
        Topic.CALIBRATION,
        "the stand is screwed down and its ball is seated",
        f"ball at {' '.join(f'{value:.0f}' for value in place.ball_mm)} mm in $ROBROOT, within 10 mm",
    )
    watcher = bring_over_ball(
        context,
        place,
        f"{count} measurements of the stand's ball",
        0,
        ball="the stand's ball",
        if_missing="Seat the ball on the stand, or correct its position: --ball X Y Z, or stand_mm in "
        "[procedure].",
    )
    looks: list[tip_calibration.BallLook] = []
    for planned in plan:
        if len(looks) == count:
            break
        seen = watcher.take(planned, ONE_SIDE)
        is_seen = seen is not None and seen.point is not None
        context.progress((len(looks) + is_seen) / count, f"{len(looks) + is_seen} of {count} measurements")
        if seen is None or seen.point is None:
            continue
        joints = workcell.master.joints_rad()
        x, y, z = seen.point.position_mm.tolist()
        looks.append(
            tip_calibration.BallLook(
                joints_rad=joints,
                robot_from_flange=pose_record(workcell.master.flange_pose(joints)),
                ball_mm=(x, y, z),
            )
        )
    workcell.master.go_home()
    if len(looks) < count:
        raise TOO_FEW_POSES(
            "too few poses show the stand's ball",
            expected=str(count),
            got=f"{len(looks)}; {watcher.why_rejected()}",
        )
    left_out = watcher.rejected.total()
    remarks = (f"{left_out} measurements of the ball failed: {watcher.why_rejected()}",) if left_out else ()
    return Outcome(
        ObservedStand(looks=tuple(looks), remarks=remarks), format_count(len(looks), "measurement")
    )


def _looks_at_stand(place: BallPlace, workcell: Workcell, count: int) -> list[pose_set.PlannedLook]:
    wanted = round(SPARE * count)
    looks = pose_set.plan_poses_about(
        place.reference, place.ball_mm, wanted, tilt_rad=TILT_RAD, turn_rad=TURN_RAD
    )
    reached = [look for look in looks if reachable_joints(workcell, look) is not None]
    if len(reached) < count:
        raise POSES_OUT_OF_REACH(
            "too few poses around the stand are reachable",
            expected=f"{count} poses",
            got=f"{len(reached)} of {wanted}",
            action="Put the stand nearer to the middle of the workspace, with free space around it.",
        )
    # The first ones are spread evenly; a chain of neighbours through all would leave out one side.
    return [*pose_set.order_by_orientation(reached[:count]), *reached[count:]]


def _read_stand_position(context: StepContext) -> Outcome[BallPlace]:
    """Take the stand's position from the theatre file. Raises CAL-009."""
    stand_mm = context.setting.settings.stand_mm
    if stand_mm is None:
        raise NO_BALL(
            "the position of the calibration stand is not given",
            action="Give the position of its ball with --ball X Y Z, or as stand_mm in [procedure].",
        )
    return Outcome(BallPlace(ball_mm=stand_mm, others_mm=()), "according to the theatre file")


def stand_place_step() -> StepSpec[BallPlace]:
    """Build the step that takes the stand's position from the theatre file."""
    return StepSpec(BallPlace, "Use the stand's position", Phase.PREPARATION, _read_stand_position)


def stand_step(count: int) -> StepSpec[ObservedStand]:
    """Build the step that measures the stand's ball in `count` orientations."""
    run = partial(_measure_stand, count=count)
    return measuring_step(ObservedStand, "Measure the stand's ball", run, BallPlace)


class TipReadings(StepResult, kind="tip_readings"):
    """Readings used to calibrate the guide tip."""

    observed: tip_calibration.TipLooks = Field(description="Contents of `tip-looks.json`.")


def _read_divot(context: StepContext, validation: int) -> Outcome[TipReadings]:
    """Collect dial readings at the divot. Raises PRO-002, PRO-009 (wrong tool), CAL-018 (implausible)."""
    context.result(CheckedSetUp)
    context.request_instrument_removal()  # of an earlier attempt
    place, stand, workcell = context.result(BallPlace), context.result(ObservedStand), context.workcell
    number = exchange_tool(context, MountedTool.GUIDE)
    context.setting.room.prepare_stand(OnStand.DIVOT)
    context.confirm(
        Topic.CALIBRATION,
        f"The arm will move the tip of tool {number} to where the ball was, in {len(stand.looks)} "
        "orientations. Confirm that the divot is on the stand and lowered, the stand was not "
        "moved, and nobody and nothing else is within the arm's reach",
        f"{len(stand.looks)} orientations",
    )
    surroundings, guide = context.setting.surroundings, workcell.master.flange_from(MountedTool.GUIDE)
    workcell.master.surround(
        build_free_surroundings(surroundings, guide, surroundings.guide, build_stand(place.ball_mm))
    )
    workcell.start()
    reading = _Reading(context, _prepare_looks(context, stand, validation))
    for look in range(len(stand.looks)):
        reading.take(look)
        context.progress((look + 1) / len(stand.looks), f"{look + 1} of {len(stand.looks)} dial readings")
    workcell.master.go_home()
    return Outcome(
        TipReadings(observed=reading.observed), format_count(len(reading.observed.readings), "reading")
    )


def _prepare_looks(context: StepContext, stand: ObservedStand, validation: int) -> tip_calibration.TipLooks:
    workcell = context.workcell
    calibrations = workcell.calibrations
    return tip_calibration.TipLooks(
        created=context.setting.began,
        arm=workcell.master.arm.kinematics.name,
        stereo_head=calibrations.stereo_head,
        start=calibrations.tool_tip,
        arm_record=calibrations.arm,
        looks=stand.looks,
        readings=(),
        validation=pose_set.choose_held_out(len(stand.looks), validation),
    )


@dataclass
class _Reading:
    """Divot readings so far; they improve the aim at the next orientation."""

    context: StepContext
    observed: tip_calibration.TipLooks

    def take(self, look: int) -> None:
        """Take the reading of one orientation; repeat it if the tip was far from the divot."""
        for _ in range(MOST_TRIES):
            reading = self._read(look)
            others = tuple(one for one in self.observed.readings if one.look != look)
            self.observed = self.observed.model_copy(update={"readings": (*others, reading)})
            if max(map(abs, reading.dials_mm)) <= NEAR_MM:
                return

    def _read(self, look: int) -> tip_calibration.DivotReading:
        workcell = self.context.workcell
        over = self.observed.looks[look]
        there, back = (self._pose(over, away_mm) for away_mm in (0.0, HOVER_MM))
        hover_rad = workcell.master.joints_at(back, over.joints_rad)
        workcell.master.settle(hover_rad, ONE_SIDE, allow_detour=True)
        workcell.master.settle(workcell.master.joints_at(there, over.joints_rad), ONE_SIDE)
        workcell.master.hold()  # hands raise the divot: only the next motion may move the arm
        workcell.master.instrument.record_insertion(IN_DIVOT)
        x_mm, y_mm, z_mm = self.context.perform_task(
            Task(
                DIALS,
                f"at orientation {look + 1} of {len(self.observed.looks)} raise the divot to the tip and "
                "read the three dials",
                reads=READS,
                plausible_mm=(-tip_calibration.DIALS_TRAVEL_MM, tip_calibration.DIALS_TRAVEL_MM),
            )
        )
        dials_mm = (x_mm, y_mm, z_mm)
        tip_calibration.require_plausible(dials_mm)
        joints = workcell.master.joints_rad()
        self.context.request_instrument_removal()
        workcell.master.settle(hover_rad, ONE_SIDE)
        return tip_calibration.DivotReading(
            look=look,
            joints_rad=joints,
            robot_from_flange=pose_record(workcell.master.flange_pose(joints)),
            dials_mm=dials_mm,
        )

    def _pose(self, over: tip_calibration.BallLook, away_mm: float) -> Transform:
        """Return the pose ROBOT <- TOOL of the guide with its tip `away_mm` short of the measured ball."""
        workcell = self.context.workcell
        tools = (MountedTool.STEREO_HEAD, MountedTool.GUIDE)
        head, guide = map(workcell.master.flange_from, tools)

        flange = over.robot_from_flange.transform(Frame.ROBOT, Frame.FLANGE)
        ball = (flange @ head).apply(over.ball_mm)
        tip = head.apply(self._tip_mm(guide, head))  # flange frame
        axis = flange.rigid.rotation.apply(guide.rotation_matrix[:, 2])
        origin = ball - flange.rigid.rotation.apply(tip) - away_mm * axis
        wanted = RigidTransform.from_components(origin, flange.rigid.rotation)
        return Transform(Frame.ROBOT, Frame.FLANGE, wanted) @ guide

    def _tip_mm(self, guide: Transform, head: Transform) -> Array:
        """Return the tip in the head's tool frame, from the readings so far or else from the record."""
        if not self.observed.readings:
            return (head.inverse() @ guide).translation_mm
        return np.asarray(
            tip_calibration.tips_of(tip_calibration.pairs_of(self.observed, self.observed.readings)).mean(
                axis=0
            )
        )


def readings_step(validation: int) -> StepSpec[TipReadings]:
    """Build the step that reads the divot, reserving `validation` readings for validation."""
    return StepSpec(
        TipReadings,
        "Read the divot at the tip of the guide",
        Phase.OPERATION,
        partial(_read_divot, validation=validation),
        reads=(CheckedSetUp, BallPlace, ObservedStand),
        moves=True,
        preconditions=needs_exchangeable_tool,
    )
