"""Before and after the motions of a step: have head, cart and tracker stayed where they were localized?"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from procedures.engine.context import StepContext
from procedures.guards.errors import PatientUnseen
from procedures.guards.room_reading import FRAMES, check_now
from procedures.guards.room_watch import Approach, RoomLook, RoomWatch
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.planning.line_of_sight import TrackerSight
from procedures.registration.shift import LEAST_POINTS
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.validity.followed_move import (
    frame_at_home,
    spheres_followed,
    that_followed,
    watch_over,
)
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.devices.readings import JointVector

ROOM_READS = (GlobalLocalization, Correspondence)  # what every step that checks the room must declare


def check_room(context: StepContext, where: str, frames: int = FRAMES) -> RoomLook:
    """Read the tracker and compare with the global localization and the readings since.

    The arm rests meanwhile. Raises PRO-019 and PRO-020; then the localization is superseded, or the
    registrations that may follow the move, and all that descends from them.
    """
    from procedures.steps.clinical.confirmation import void_moved  # as in `room_watch`

    setting, void = context.setting, partial(void_moved, context)
    look = check_now(room_watch(context), setting.workcell, setting.clock, setting.memory, void, frames)
    for finding in look.findings:
        context.find(f"{where}: {finding}")
    return look


def require_unmoved(context: StepContext, where: str) -> None:
    """Look carefully, with the arm home, before a guide goes to the head.

    Raises PRO-022 where head or base cannot be compared, and as `check_room`.
    """
    look = check_room(context, where, CAREFUL_FRAMES)
    if look.head_mm is None:
        raise PatientUnseen(
            f"{where}, the tracker does not see the head",
            expected="at least three known spheres in view",
        )
    if look.base is None:
        raise PatientUnseen(
            f"{where}, the tracker does not see the frame on the arm: the cart may have moved",
            expected="the frame on the arm in view, with the arm home",
        )


@dataclass(frozen=True)
class ExpectedSight:
    """What the tracker is expected to see past the guide, from the bodies that the arm is given."""

    context: StepContext
    sight: TrackerSight
    surroundings: Surroundings

    def hidden_at(self, joints_rad: JointVector) -> bool:
        """Whether fewer spheres than are needed would be seen with the arm there."""
        arm = self.context.workcell.arm.kinematics
        return int(self.sight.seen(arm, self.surroundings, joints_rad).sum()) < LEAST_POINTS

    def hidden_now(self) -> bool:
        """The same for the arm's present pose."""
        return self.hidden_at(self.context.workcell.joints_rad())


def expected_sight(context: StepContext, surroundings: Surroundings) -> ExpectedSight:
    """Of the standing localization's spheres, past the guide; the watch knows it from here on."""
    watch = room_watch(context)
    expected = ExpectedSight(context, TrackerSight(watch.robot_from_tracker, watch.spheres_mm), surroundings)
    watch.approach = Approach(expected.hidden_now)
    return expected


@contextmanager
def head_must_show(context: StepContext) -> Iterator[None]:
    """Within, the head may go unseen for a bounded time only; then the case suspends."""
    watch = context.setting.memory.find(RoomWatch)
    approach = None if watch is None else watch.approach
    if approach is None:
        yield
        return
    approach.under_way = True
    try:
        yield
    finally:
        approach.under_way = False


def room_watch(context: StepContext) -> RoomWatch:
    """The watch over the standing localization; a new one begins with that.

    Where the registration has followed a move of the head, its spheres are watched where they are since.
    """
    # registration reads what relocalization leaves, which checks the room
    from procedures.steps.clinical.registration import RegisteredRobot

    localized = context.result(GlobalLocalization)
    name = context.identifier(GlobalLocalization)
    watch = context.setting.memory.find(RoomWatch)
    if watch is None or watch.localization != name:
        watch = watch_over(context.workcell, name, localized, context.result(Correspondence).pairs)
        watch.refer(frame_at_home(context))
        context.setting.memory.keep(watch)
    followed = partial(that_followed, trajectory=context.key.trajectory)
    watch.follow(spheres_followed(context.result_among(RegisteredRobot, followed)))
    return watch
