"""Measure the ball from planned poses, and again and again from the eight orientations of the check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pydantic import Field

from procedures.calibration import Observation, ObservationSet
from procedures.calibration.bundle import LEAST_POSES
from procedures.calibration.errors import PosesOutOfReach, TooFewPoses
from procedures.calibration.pose_set import CHECK_ORIENTATIONS, PlannedLook, calibration_looks, check_variants
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.results import StepResult
from procedures.steps.calibration.ball_place import BallPlace
from procedures.steps.calibration.over_ball import SPARE, bring_over_ball
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.steps.conditions import carries
from procedures.workcell import MountedTool
from procedures.workcell.ball_watcher import BallWatcher
from ronna_hw.arm.errors import NotClear


class ObservedBall(StepResult, kind="ball_observation"):
    """The looks that a calibration is computed from."""

    observed: ObservationSet = Field(description="Contents of `observations.json`.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


@dataclass(frozen=True)
class BallObservation:
    """How many poses, and how many visits of each orientation of the check."""

    poses: int
    visits: int

    def run(self, context: StepContext) -> Outcome[ObservedBall]:
        """Raises PRO-002 unless confirmed, STE-009 without a ball, CAL-010 or CAL-002 with too few looks."""
        context.result(CheckedSetUp)
        place, workcell = context.result(BallPlace), context.workcell
        total = self.poses + self.visits * CHECK_ORIENTATIONS
        purpose = f"{total} measurements from {self.poses + CHECK_ORIENTATIONS} poses"
        watcher = bring_over_ball(context, place, purpose, self.poses)
        plan = calibration_looks(place.reference, watcher.ball_mm, round(SPARE * self.poses))
        seen = watcher.observe_all(
            plan, self.poses, lambda count: context.progress(count / total, "measuring the ball")
        )
        for visit in range(self.visits):
            for number in range(CHECK_ORIENTATIONS):
                one = check_look(watcher, check_variants(place.reference, watcher.ball_mm, number), seen)
                if one is not None:
                    seen.append(one)
                done = self.poses + CHECK_ORIENTATIONS * visit + number
                context.progress(done / total, "measuring the ball")
        remarks = _homeward(context)
        if watcher.rejected:
            remarks.append(
                f"{watcher.rejected.total()} measurements without a ball: {watcher.why_rejected()}"
            )
        checked = len({one.orientation for one in seen} - {None})
        if checked < CHECK_ORIENTATIONS:
            remarks.append(
                f"warning: only {checked} of the check's {CHECK_ORIENTATIONS} orientations were measured"
            )
        if len(seen) < LEAST_POSES:
            refuse_too_few(watcher, len(seen))
        calibrations = workcell.calibrations
        observed = ObservationSet(
            created=context.setting.began,
            serials=workcell.stereo.serials,
            arm_variant=workcell.arm.kinematics.name,
            start=calibrations.stereo_head,
            tool_tip=calibrations.tool_tip,
            observations=tuple(seen),
        )
        return Outcome(ObservedBall(observed=observed, remarks=tuple(remarks)), f"{len(seen)} measurements")


def observation_step(poses: int, visits: int) -> StepSpec[ObservedBall]:
    """The step for so many poses, and so many visits of each orientation of the check."""
    return StepSpec(
        ObservedBall,
        "Measure the ball",
        Phase.OPERATION,
        BallObservation(poses, visits).run,
        reads=(CheckedSetUp, BallPlace),
        moves=True,
        preconditions=carries(MountedTool.STEREO_HEAD),
    )


def check_look(
    watcher: BallWatcher, variants: Sequence[PlannedLook], seen: Sequence[Observation]
) -> Observation | None:
    """A look of the check: the first that can be taken, and from then on always at its joint angles."""
    for one in seen:
        if one.orientation is not None and one.orientation == variants[0].orientation:
            return watcher.observe_at(one.joints_rad, one.orientation)
    for planned in variants:
        found = watcher.observe(planned)
        if found is not None:
            return found
    return None


def refuse_too_few(watcher: BallWatcher, count: int) -> None:
    """Raise CAL-010 when most looks could not be taken, CAL-002 when they showed no ball."""
    expected, got = f"at least {LEAST_POSES}", f"{count}; {watcher.why_rejected()}"
    if any(reason.startswith("ARM-") for reason, _ in watcher.rejected.most_common(1)):
        raise PosesOutOfReach("too few poses around the ball are reachable", expected=expected, got=got)
    raise TooFewPoses("too few poses show the ball", expected=expected, got=got)


def _homeward(context: StepContext) -> list[str]:
    try:
        context.workcell.go_home()
    except NotClear as error:  # raised before anything moved; what was seen is worth keeping
        return [f"the arm stays where it is: {error.what}"]
    return []
