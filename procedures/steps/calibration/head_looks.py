"""Steps of the stereo head calibration: a single look, looks from all sides, and check looks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from pydantic import Field

from procedures.calibration import Baseline, Observation, ObservationSet, Outline
from procedures.calibration.bundle import LEAST_POSES
from procedures.calibration.errors import POSES_OUT_OF_REACH, TOO_FEW_POSES, NotTheBaseline
from procedures.calibration.pose_set import (
    CHECK_ORIENTATIONS,
    PlannedLook,
    plan_calibration_looks,
    self_check_variants,
)
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Phase, StepSpec
from procedures.journal.errors import GateFailed
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.relocalization.errors import NoSphere
from procedures.relocalization.triangulation import check_serial
from procedures.steps.calibration import ball_place
from procedures.steps.clinical.set_up import CheckedSetUp
from procedures.workcell.ball_watcher import BallWatcher
from procedures.workcell.stereo_look import Look, pair_picture
from ronna_hw.calibration import Numbers3, StereoHeadCalibration
from ronna_hw.text import format_count


class BallMeasurement(StepResult, kind="ball_look"):
    """Result of one stereo pair."""

    position_mm: Numbers3 | None = Field(description="The ball in the tool frame, if measured.")
    left: Outline | None = Field(description="Its outline in the left image.")
    right: Outline | None = Field(description="Its outline in the right image.")
    reason: str = Field(description="Why the measurement yielded no point.")


def run_in_place(context: StepContext) -> Outcome[BallMeasurement]:
    """Take a look without motion, connecting only the cameras. Raises CAL-001, STE-010."""
    workcell = context.workcell
    head, stereo = workcell.calibrations.stereo_head, workcell.stereo
    head.check_valid_at(context.setting.today())
    stereo.connect()
    for camera, serial in zip((head.left, head.right), stereo.serials, strict=True):
        check_serial(camera, serial)
    stereo.configure()
    workcell.sensors.read_whole()
    stereo.activate()
    return _keep_look(context, workcell.look())


def run_over_ball(context: StepContext) -> Outcome[BallMeasurement]:
    """Take a look from above the ball, and return home."""
    context.result(CheckedSetUp)
    ball_place.bring_over_ball(context, context.result(ball_place.BallPlace), "one measurement", 0)
    seen = context.workcell.look()
    context.workcell.master.go_home()
    return _keep_look(context, seen)


def _keep_look(context: StepContext, seen: Look) -> Outcome[BallMeasurement]:
    context.setting.memory.keep(seen)  # for a display of the pictures
    context.keep_picture(ball_place.BALL_PICTURE, pair_picture(seen))
    point = seen.point
    return Outcome(
        BallMeasurement(
            position_mm=None if point is None else point.position_mm.tolist(),
            left=None if seen.left is None else Outline.of(seen.left),
            right=None if seen.right is None else Outline.of(seen.right),
            reason=seen.reason,
        ),
        seen.reason or "measured",
    )


LOOK_IN_PLACE = StepSpec(BallMeasurement, "Look", Phase.OPERATION, run_in_place)
LOOK_OVER_BALL = ball_place.measuring_step(
    BallMeasurement, "Measure the ball", run_over_ball, ball_place.BallPlace
)


class ObservedBall(StepResult, kind="ball_observation"):
    """Looks at the ball used to calibrate the stereo head."""

    observed: ObservationSet = Field(description="Contents of `observations.json`.")
    remarks: tuple[str, ...] = Field(description="Warnings for the operator.")


def _observe_ball(context: StepContext, poses: int, visits: int) -> Outcome[ObservedBall]:
    """Measure the ball. Raises PRO-002, STE-009 if it is not found, CAL-010 or CAL-002 for too few looks."""
    context.result(CheckedSetUp)
    place, workcell = context.result(ball_place.BallPlace), context.workcell
    total = poses + visits * CHECK_ORIENTATIONS
    purpose = f"{total} measurements from {poses + CHECK_ORIENTATIONS} poses"
    watcher = ball_place.bring_over_ball(context, place, purpose, poses)
    plan = plan_calibration_looks(place.reference, watcher.ball_mm, round(ball_place.SPARE * poses))
    seen = watcher.observe_all(
        plan, poses, lambda count: context.progress(count / total, "measuring the ball")
    )
    for visit in range(visits):
        for number in range(CHECK_ORIENTATIONS):
            one = check_look(watcher, self_check_variants(place.reference, watcher.ball_mm, number), seen)
            if one is not None:
                seen.append(one)
            done = poses + CHECK_ORIENTATIONS * visit + number
            context.progress(done / total, "measuring the ball")
    remarks = ball_place.return_home_if_clear(context)
    if watcher.rejected:
        remarks.append(f"{watcher.rejected.total()} measurements without a ball: {watcher.why_rejected()}")
    checked = len({one.orientation for one in seen} - {None})
    if checked < CHECK_ORIENTATIONS:
        remarks.append(
            f"warning: only {checked} of the check's {CHECK_ORIENTATIONS} orientations were measured"
        )
    if len(seen) < LEAST_POSES:
        raise_too_few(watcher, len(seen))
    calibrations = workcell.calibrations
    observed = ObservationSet(
        created=context.setting.began,
        serials=workcell.stereo.serials,
        arm_variant=workcell.master.arm.kinematics.name,
        start=calibrations.stereo_head,
        tool_tip=calibrations.tool_tip,
        observations=tuple(seen),
    )
    return Outcome(
        ObservedBall(observed=observed, remarks=tuple(remarks)), format_count(len(seen), "measurement")
    )


def observation_step(poses: int, visits: int) -> StepSpec[ObservedBall]:
    """Build the step with `poses` calibration poses and `visits` to each check orientation."""
    run = partial(_observe_ball, poses=poses, visits=visits)
    return ball_place.measuring_step(ObservedBall, "Measure the ball", run, ball_place.BallPlace)


def check_look(
    watcher: BallWatcher, variants: Sequence[PlannedLook], seen: Sequence[Observation]
) -> Observation | None:
    """Repeat an earlier check look at the same joints, or else take the first variant that works."""
    for one in seen:
        if one.orientation is not None and one.orientation == variants[0].orientation:
            return watcher.observe_at(one.joints_rad, one.orientation)
    for planned in variants:
        found = watcher.observe(planned)
        if found is not None:
            return found
    return None


def raise_too_few(watcher: BallWatcher, count: int) -> None:
    """Raise CAL-010 if most looks were out of reach, and CAL-002 otherwise."""
    expected, got = f"at least {LEAST_POSES}", f"{count}; {watcher.why_rejected()}"
    if any(reason.startswith("ARM-") for reason, _ in watcher.rejected.most_common(1)):
        raise POSES_OUT_OF_REACH("too few poses around the ball are reachable", expected=expected, got=got)
    raise TOO_FEW_POSES("too few poses show the ball", expected=expected, got=got)


class VisitedBaseline(StepResult, kind="baseline_visit"):
    """Looks at the ball used to check the stereo head."""

    calibration: str = Field(description="Name of the calibration being checked.")
    looks: tuple[Observation, ...] = Field(description="From the orientations of the baseline, in turn.")


def _visit_baseline(context: StepContext, baseline: Baseline, visits: int) -> Outcome[VisitedBaseline]:
    """Measure the ball from the baseline's poses. Raises STE-010, CAL-008, CAL-001, PRO-002, STE-003."""
    context.result(CheckedSetUp)
    workcell, head = context.workcell, baseline.stereo_head
    for camera, serial in zip((head.left, head.right), workcell.stereo.serials, strict=True):
        check_serial(camera, serial)
    in_use = workcell.calibrations.stereo_head
    _require_same_cameras(in_use, head)
    in_use.check_valid_at(context.setting.today())
    arm = workcell.master.arm.kinematics.name
    if baseline.arm_variant != arm:
        raise GateFailed("the baseline is from another arm", expected=baseline.arm_variant, got=arm)
    context.confirm(
        Topic.CALIBRATION,
        "The arm will move to the eight poses of the baseline; the ball must be where it was",
        f"calibration {head.identifier} of {baseline.created:%Y-%m-%d %H:%M} UTC",
    )
    first = [
        next(one for one in baseline.looks if one.orientation == orientation)
        for orientation in baseline.orientations
    ]
    watcher = BallWatcher(workcell, baseline.ball_mm)
    ball_place.start_around_ball(context, watcher.ball_mm)
    seen = []
    for visit in range(visits):
        for number, one in enumerate(first):
            found = watcher.observe_at(one.joints_rad, one.orientation)
            if found is not None:
                seen.append(found)
            done = visit * len(first) + number + 1
            context.progress(done / (visits * len(first)), "measuring the ball")
    workcell.master.go_home()
    if watcher.last is not None:
        context.keep_picture(ball_place.BALL_PICTURE, pair_picture(watcher.last))
    if not seen:
        raise NoSphere("the ball is not in view from any orientation", got=watcher.why_rejected())
    return Outcome(
        VisitedBaseline(calibration=head.identifier, looks=tuple(seen)),
        format_count(len(seen), "measurement"),
    )


def _require_same_cameras(in_use: StereoHeadCalibration, baseline: StereoHeadCalibration) -> None:
    """Raise CAL-008 if the cameras differ from the baseline's. The head's pose on the flange may be newer."""
    if (in_use.left, in_use.right) != (baseline.left, baseline.right):
        raise NotTheBaseline(
            "the theatre's calibration of the cameras is not that of the baseline",
            expected=in_use.identifier,
            got=baseline.identifier,
            action="Give the baseline of the theatre's calibration, or put the records that were written "
            "with this baseline into the theatre file.",
        )


def visit_step(baseline: Baseline, visits: int) -> StepSpec[VisitedBaseline]:
    """Build the step that visits the poses of a baseline."""
    run = partial(_visit_baseline, baseline=baseline, visits=visits)
    return ball_place.measuring_step(VisitedBaseline, "Measure the ball again", run)
