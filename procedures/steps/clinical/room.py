"""Comparison of the room with its localization, before and after a step's motions.

Have head, cart and tracker stayed in place? If not, the results that depend on what moved are voided, and the
targets that nobody has confirmed since are in doubt.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from procedures.calibration.errors import PlatformMoved
from procedures.engine.context import StepContext
from procedures.guards.errors import BaseShifted, PatientMoved, PatientUnseen
from procedures.guards.room_reading import AS_KNOWN, CAREFUL_FRAMES, FRAMES, ON_ARM, ArrivedSides
from procedures.guards.room_watch import RoomLook, RoomWatch, check_now
from procedures.registration.movement import LEAST_POINTS
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.localized_room import bring_up_to_date, build_watch
from procedures.steps.clinical.plan_check import CheckedPlan
from procedures.steps.clinical.results import ConfirmedTarget, KnownBases, RegisteredRobot
from procedures.workcell import MountedTool
from procedures.workcell.tracker_look import read_frames_at_rest
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arrays import Array
from ronna_hw.collision_config import BodyFrame
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector

# Safety against a registration that follows too large a move (U).
MOST_FOLLOWED_MM = 5.0  # rms over the spheres, of a move that a registration may follow

ROOM_READS = (
    GlobalLocalization,
    Correspondence,
    CheckedPlan,
)  # what every step that checks the room must declare


def check_room(
    context: StepContext, occasion: str, frames: int = FRAMES, sides: ArrivedSides = AS_KNOWN
) -> RoomLook:
    """Hold a tracker reading, taken at rest, against all looks since the localization.

    `sides` are those of its backlash on which each joint rests, by default as the workcell knows. Raises
    PRO-019, PRO-020, PRO-022, PRO-051, PRO-052, PRO-054 and CAL-023; a move voids the localization, or the
    registrations that may follow it, and everything computed from them.
    """
    setting, void = context.setting, partial(void_moved, context)
    look = check_now(room_watch(context), setting.workcell, setting.memory, void, frames, sides)
    for finding in look.findings:
        context.find(f"{occasion}: {finding}")
    return look


def require_unmoved(context: StepContext, occasion: str) -> RoomLook:
    """Require head and base unmoved, by a careful look with the arm home, before a guide goes to the head.

    Raises PRO-022 if head or base cannot be compared, the error of an arm that does not tell its joints, and
    as `check_room`.
    """
    look = check_room(context, occasion, CAREFUL_FRAMES)
    if look.head_mm is None:
        seen = len(look.judged.look.spheres.numbers)
        raise PatientUnseen(
            f"{occasion}, the tracker sees {seen} of the {len(room_watch(context).spheres_mm)} spheres on "
            "the head, and no frame on its clamp",
            expected="at least three known spheres in view",
        )
    if look.base_mm is None:
        raise PatientUnseen(
            f"{occasion}, the tracker does not see the frame on the arm: the cart may have moved",
            expected=f"the frame on the arm in view, with {context.workcell.phrases.arms} home",
        )
    for arm in context.workcell.assistants:
        if ON_ARM[arm.role] not in look.reading.rests:
            arm.joints_rad()  # raises the reason, which is no hidden frame
        if ON_ARM[arm.role] not in look.reading.frames:
            raise PatientUnseen(
                f"{occasion}, the tracker does not see the frame on the {arm.name}: its cart may have moved",
                expected=f"the frame on the {arm.name} in view, with both arms home",
            )
    return look


@dataclass(frozen=True)
class ExpectedSight:
    """Expected view of the tracker past the guide, based on the collision bodies."""

    context: StepContext
    watch: RoomWatch
    surroundings: Surroundings

    def hidden_at(
        self, joints_rad: JointVector, others_rad: Mapping[str, JointVector] = MappingProxyType({})
    ) -> bool:
        """Whether too few spheres, and markers on the clamp, are visible with the arm at these joints.

        The other arms are where they are, or at `others_rad` by role.
        """
        workcell = self.context.workcell
        known = [one for one in workcell.assistants if one.history.base]
        for sight in self.watch.sights:
            seen = sight.seen(workcell.master.arm.kinematics, self.surroundings, joints_rad)
            for other in known:
                from_base = replace(sight, robot_from_tracker=other.base.inverse() @ sight.robot_from_tracker)
                there_rad = others_rad.get(other.role) or other.joints_rad()
                seen &= from_base.seen(other.arm.kinematics, Surroundings(tool=other.tool()), there_rad)
            if int(seen.sum()) >= LEAST_POINTS:
                return False
        return True

    def hidden_now(self) -> bool:
        """Whether too few spheres are visible with every arm in its current pose."""
        return self.hidden_at(self.context.workcell.master.joints_rad())


def build_expected_sight(context: StepContext, surroundings: Surroundings) -> ExpectedSight:
    """Build the expected view of the localized spheres, and pass it to the room watch."""
    watch = room_watch(context)
    expected = ExpectedSight(context, watch, surroundings)
    watch.head_sight.expect_approach(expected.hidden_now, context.key.trajectory)
    return expected


@contextmanager
def require_head_in_view(context: StepContext) -> Iterator[None]:
    """During the block, limit how long the head may be out of view before the case is suspended."""
    watch = context.setting.memory.find(RoomWatch)
    if watch is None or watch.head_sight.hides_head is None:
        yield
        return
    watch.head_sight.under_way = True
    try:
        yield
    finally:
        watch.head_sight.under_way = False


def room_watch(context: StepContext) -> RoomWatch:
    """Return the watch over the current localization, creating it for a new one.

    After a followed move of the head, the spheres are expected at their new places.
    """
    localized, matched = context.result(GlobalLocalization), context.result(Correspondence)
    checked, name = context.result(CheckedPlan), context.identifier(GlobalLocalization)
    watch = context.setting.memory.find(RoomWatch)
    bases, followed = context.latest(KnownBases), find_followed(context, context.key.trajectory)
    workcell, settings = context.workcell, context.setting.settings
    if watch is None or watch.localization != name:
        points_mm = targets_mm(checked, matched)
        watch = build_watch(workcell, settings, name, localized, matched.pairs, points_mm, bases, followed)
        context.setting.memory.keep(watch)
    else:
        bring_up_to_date(watch, workcell, settings, bases, followed)
    return watch


def read_localized(context: StepContext, count: int = CAREFUL_FRAMES) -> list[TrackerFrame]:
    """Read tracker frames at rest, as the tracker would have seen them from where it was localized."""
    room = room_watch(context)
    read, _ = read_frames_at_rest(context.workcell, count=count)
    return [room.as_localized(one) for one in read]


def find_followed(context: StepContext, trajectory: str | None) -> RegisteredRobot | None:
    """Return the trajectory's valid registration, or else the last one, if it followed a head move."""

    def own(registrations: Sequence[RegisteredRobot]) -> RegisteredRobot | None:
        found = [one for one in registrations if trajectory in one.trajectories] or list(registrations)
        return found[-1] if found and found[-1].followed is not None else None

    return context.result_among(RegisteredRobot, own)


def targets_mm(checked: CheckedPlan, matched: Correspondence) -> dict[str, Array]:
    """Return the plan's targets (3,) mm by name, robot frame, within the tracker's error."""
    robot_from_ct = matched.robot_from_ct.transform
    return {one.id: np.asarray(robot_from_ct.apply(one.target_mm)) for one in checked.plan.trajectories}


def list_unconfirmed_targets(context: StepContext) -> tuple[str, ...]:
    """Return the targets where work may have begun and no check has confirmed that nothing moved."""
    confirmed = context.trajectories_done(ConfirmedTarget, lambda look: not look.in_doubt)
    stages = context.workcell.master.instrument.stages
    return tuple(
        name for name in context.trajectories if stages.may_have_begun(name) and name not in confirmed
    )


def doubt(context: StepContext, reason: str, *, again: bool = True) -> None:
    """Record a finding about unconfirmed targets; unless `again`, skip those already checked."""
    looked = () if again else context.trajectories_done(ConfirmedTarget)
    if targets := tuple(name for name in list_unconfirmed_targets(context) if name not in looked):
        context.find(f"{' and '.join(targets)} in doubt: {reason}", targets)


def void_moved(context: StepContext, moved: RonnaError) -> None:
    """After a move, void the registrations if they can follow it, or else the localization.

    A moved cart voids its lock as well. Unconfirmed targets are in doubt, as nobody knows when it moved.
    """
    doubt(context, moved.summary)
    may_follow = (
        isinstance(moved, PatientMoved)
        and moved.moved_mm <= MOST_FOLLOWED_MM
        and context.workcell.master.tool is MountedTool.GUIDE
        and (registered := context.latest(RegisteredRobot)) is not None
        and registered.can_follow
    )
    if may_follow:
        context.void_each(RegisteredRobot, moved)
    elif isinstance(moved, BaseShifted) and moved.cart and context.stands(LockedCart):
        context.void(LockedCart, moved)
    else:
        context.void(GlobalLocalization, moved)
    if isinstance(moved, BaseShifted):
        _shift_room(context, moved)
    elif isinstance(moved, PlatformMoved) and moved.way_mm is not None:
        for arm in context.workcell.assistants:
            arm.follow(moved.way_mm)


def _shift_room(context: StepContext, moved: BaseShifted) -> None:
    """Move the room and the assistant by what one look tells, for the clearance of the way home."""
    if moved.room_moved is not None:
        bodies = context.setting.surroundings.bodies
        on_cart = {body.name for body in bodies if body.frame is BodyFrame.ROBOT}
        context.workcell.shift_room(moved.room_moved, on_cart)
    elif moved.frame_off_mm:
        for arm in context.workcell.assistants:
            arm.doubt(moved.frame_off_mm)
