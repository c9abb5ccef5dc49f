"""Before and after the motions of a step: have head, cart and tracker stayed where they were localized?"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

from procedures.engine.context import StepContext
from procedures.guards.errors import PatientUnseen
from procedures.guards.room_reading import check_now
from procedures.guards.room_watch import Approach, RoomWatch
from procedures.planning.sight.tracker import TrackerSight
from procedures.registration.shift import LEAST_POINTS
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.validity.followed_move import spheres_followed, that_followed, watch_over
from ronna_hw.arm.clearance.surroundings import Surroundings
from ronna_hw.devices.readings import JointVector

ROOM_READS = (GlobalLocalization, Correspondence)  # what every step that checks the room must declare


def check_room(context: StepContext, where: str) -> None:
    """Read the tracker and compare with the global localization and the readings since.

    The arm rests meanwhile. What is not seen is a finding. Raises PRO-019 and PRO-020; then the localization
    is superseded, or the registrations that may follow the move, and all that descends from them.
    """
    from procedures.steps.clinical.validity.moved_head import void_moved  # as in `_watch`

    setting, void = context.setting, partial(void_moved, context)
    for finding in check_now(_watch(context), setting.workcell, setting.clock, setting.memory, void):
        context.find(f"{where}: {finding}")


def require_head_seen(context: StepContext, where: str) -> None:
    """Refuse to go to a head that the last reading, from the arm's present pose, did not show; PRO-022."""
    if head_hidden(context):
        raise PatientUnseen(
            f"{where}, the tracker does not see the head",
            expected="at least three known spheres in view",
        )


def head_hidden(context: StepContext) -> bool:
    """Whether the tracker's last reading saw too little of the head past the arm in its present pose."""
    watch, workcell = context.setting.memory.find(RoomWatch), context.workcell
    if watch is None or watch.hidden_from is None:
        return False
    return watch.hides_head(workcell.flange_pose(workcell.joints_rad()))


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
    watch = _watch(context)
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


def _watch(context: StepContext) -> RoomWatch:
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
        context.setting.memory.keep(watch)
    followed = partial(that_followed, trajectory=context.key.trajectory)
    watch.follow(spheres_followed(context.result_among(RegisteredRobot, followed)))
    return watch
