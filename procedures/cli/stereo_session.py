"""The three pieces of work behind `ronna-stereo`: observe for a calibration, repeat the check, one look."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import UTC, datetime

from scipy.spatial.transform import Rotation

from procedures.calibration import Baseline, Observation, ObservationSet
from procedures.calibration.bundle import LEAST_POSES
from procedures.calibration.errors import PosesOutOfReach, TooFewPoses
from procedures.calibration.pose_set import CHECK_ORIENTATIONS, PlannedLook, calibration_looks, check_variants
from procedures.cli.stereo_ball import Triple, place_of_ball
from procedures.cli.stereo_looks import BallWatcher, surround_ball
from procedures.cli.stereo_room import activate, set_up
from procedures.engine.step import StepContext
from procedures.relocalization.errors import NoSphere
from procedures.relocalization.triangulation import check_serial
from procedures.steps.stereo_look import Look, look, whole_sensor
from ronna_hw.arm.errors import NotClear

SPARE = 1.5  # planned looks for each wanted one: some are out of reach, some show a ball half hidden
Progress = Callable[[float], None]


def observe_for_calibration(
    context: StepContext,
    numbers: tuple[int, int],
    ball_mm: Triple | None,
    progress: Progress,
    tell: Callable[[str], None],
) -> ObservationSet:
    """Look at the ball from so many planned poses, and so many times from each orientation of the check.

    Raises PRO-002 unless confirmed, CAL-009, STE-009 when the ball is not there, CAL-010 or CAL-002 when too
    few looks show it, and what the devices raise.
    """
    poses, visits = numbers
    total = poses + visits * CHECK_ORIENTATIONS
    set_up(context)
    watcher, rotation = _bring_over_ball(context, ball_mm, f"{total} looks from {poses + 8} poses", poses)
    plan = calibration_looks(rotation, watcher.ball_mm, round(SPARE * poses))
    seen = watcher.observe_all(plan, poses, lambda count: progress(count / total))
    for round_number in range(visits):
        for number in range(CHECK_ORIENTATIONS):
            one = check_look(watcher, check_variants(rotation, watcher.ball_mm, number), seen)
            if one is not None:
                seen.append(one)
            progress((poses + CHECK_ORIENTATIONS * round_number + number) / total)
    try:
        watcher.go_home()
    except NotClear as error:  # raised before anything moved; what was seen is worth keeping
        tell(f"the arm stays where it is: {error.what}")
    if watcher.rejected:
        tell(f"{watcher.rejected.total()} looks without a ball: {watcher.why_rejected()}")
    checked = len({one.orientation for one in seen} - {None})
    if checked < CHECK_ORIENTATIONS:
        tell(f"warning: {checked} of {CHECK_ORIENTATIONS} orientations of the check were taken: no baseline")
    if len(seen) < LEAST_POSES:
        refuse_too_few(watcher, len(seen))
    calibrations = context.calibrations
    return ObservationSet(
        created=datetime.now(UTC).replace(microsecond=0),
        serials=context.devices.stereo.serials,
        arm_variant=context.devices.arm.kinematics.name,
        start=calibrations.stereo_head,
        tool_tip=calibrations.tool_tip,
        observations=tuple(seen),
    )


def observe_for_check(
    context: StepContext, baseline: Baseline, visits: int, progress: Progress
) -> list[Observation]:
    """Look at the ball again from the joint angles of the baseline. Raises STE-010 for other cameras."""
    set_up(context)
    for camera, serial in zip(
        (baseline.stereo_head.left, baseline.stereo_head.right), context.devices.stereo.serials, strict=True
    ):
        check_serial(camera, serial)
    baseline.stereo_head.check_valid_at(datetime.now(UTC))
    home = context.devices.arm.read_state().joints_rad
    context.confirm(
        "The arm will move to the eight poses of the baseline; the ball must stand where it stood",
        f"calibration {baseline.stereo_head.identifier} of {baseline.created:%Y-%m-%d %H:%M} UTC",
    )
    first = [next(one for one in baseline.looks if one.orientation == k) for k in baseline.orientations]
    watcher = BallWatcher(context, baseline.ball_mm, home)
    surround_ball(context, watcher.ball_mm)
    activate(context)
    watcher.begin()
    seen = []
    for round_number in range(visits):
        for number, one in enumerate(first):
            found = watcher.observe_at(one.joints_rad, one.orientation)
            if found is not None:
                seen.append(found)
            progress((round_number * len(first) + number + 1) / (visits * len(first)))
    watcher.go_home()
    if not seen:
        raise NoSphere("the ball is not in view from any orientation", got=watcher.why_rejected())
    return seen


def look_once(context: StepContext, *, find: bool, ball_mm: Triple | None) -> Look:
    """One pair and what is measured in it; with `find` the head is first brought over the ball."""
    if find or ball_mm is not None:
        set_up(context)
        watcher, _ = _bring_over_ball(context, ball_mm, "one look", 0)
        seen = look(context)
        watcher.go_home()
        return seen
    head, stereo = context.calibrations.stereo_head, context.devices.stereo
    head.check_valid_at(datetime.now(UTC))
    stereo.connect()
    for camera, serial in zip((head.left, head.right), stereo.serials, strict=True):
        check_serial(camera, serial)
    stereo.configure()
    stereo.set_areas(whole_sensor(head.left), whole_sensor(head.right))
    stereo.activate()
    return look(context)


def _bring_over_ball(
    context: StepContext, ball_mm: Triple | None, what_for: str, poses: int
) -> tuple[BallWatcher, Rotation]:
    """Confirmed by the operator, the head over the ball, and the ball in view. The reference orientation.

    Before anything moves so many poses about the ball must be within reach; raises CAL-010.
    """
    place = place_of_ball(context, ball_mm)
    home = context.devices.arm.read_state().joints_rad
    watcher = BallWatcher(context, place.ball_mm, home)
    plan = calibration_looks(place.reference, place.ball_mm, round(SPARE * poses)) if poses else ()
    reached = sum(watcher.reaches(look.pose) for look in plan)
    if not watcher.reaches(place.first_look.pose) or reached < poses:
        raise PosesOutOfReach(
            "the poses about the ball are out of the arm's reach",
            expected=f"{poses} poses",
            got=f"{reached} of {len(plan)}",
        )
    x, y, z = place.ball_mm.tolist()
    context.confirm(
        f"The arm will move about the ball: {what_for}. Nobody and nothing else may be within its reach",
        f"ball at {x:.0f} {y:.0f} {z:.0f} mm in $ROBROOT",
    )
    surround_ball(context, place.ball_mm, place.others_mm)
    activate(context)
    watcher.begin()
    watcher.find(place.first_look)
    return watcher, place.reference


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
    if any(reason.startswith("ARM-") for reason, _ in watcher.rejected.most_common(1)):
        raise PosesOutOfReach(
            "too few poses about the ball can be taken",
            expected=f"at least {LEAST_POSES}",
            got=f"{count}; {watcher.why_rejected()}",
        )
    raise TooFewPoses(
        "too few poses show the ball",
        expected=f"at least {LEAST_POSES}",
        got=f"{count}; {watcher.why_rejected()}",
    )
