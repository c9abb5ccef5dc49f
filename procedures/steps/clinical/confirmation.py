"""Look again after a target: are head, base and guide as they were before the guide went there?

What has moved since the look before is found here. Nobody knows when it did: every target worked at since is
in doubt, and said to be. What no longer holds leads nothing to another target.
"""

from __future__ import annotations

from pydantic import Field

from procedures.engine.context import StepContext
from procedures.engine.errors import ToolUnchecked
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_reading import read_room
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.guards.stability import CAREFUL_FRAMES, SeenUnchanged, Subject
from procedures.journal.results import StepResult
from procedures.operator.question import Topic
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.paths.surroundings import READS
from procedures.steps.clinical.positioning import REFUSED
from procedures.steps.clinical.registration import RegisteredRobot
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool, read_on_gauge
from procedures.steps.clinical.validity.followed_move import MOST_FOLLOWED_MM
from procedures.steps.clinical.validity.room import ROOM_READS, room_watch
from procedures.steps.conditions import away_from_head, carries
from procedures.steps.link_health import LinkHealth, link_health
from procedures.workcell import MountedTool
from ronna_hw.errors import RonnaError


class ConfirmedTarget(StepResult, kind="confirmation"):
    """Result of the look after a target."""

    seen: tuple[SeenUnchanged, ...] = Field(description="Head, cart and tracker, guide.")
    in_doubt: tuple[str, ...] = Field(description="Targets that may be off by more than was predicted.")
    link: LinkHealth | None = Field(description="Health of the robot link over the gauge; none if unused.")

    def confirms(self, subject: Subject) -> bool:
        """Whether a subject was seen unchanged."""
        return any(one.unchanged for one in self.seen if one.subject == subject)


def run(context: StepContext) -> Outcome[ConfirmedTarget]:
    """Read the guide on its gauge, then look at head and base from home.

    Raises PRO-019 and PRO-020 where targets remain that cannot follow what has moved.
    """
    for model in context.spec.reads:
        context.result(model)
    context.workcell.check_mounted(MountedTool.GUIDE)
    remain = bool(set(context.remaining) - set(context.done_for(ReachedTarget)))
    guide = _guide(context, remain)
    link = link_health(context) if context.workcell.streaming else None
    context.workcell.rest()  # it may have been the last target
    look = _room(context, remain)
    seen = (SeenUnchanged.head(look.head_mm), SeenUnchanged.base(look.base), guide)
    in_doubt = () if look.in_place and guide.unchanged else unconfirmed(context)
    return Outcome(
        ConfirmedTarget(seen=seen, in_doubt=in_doubt, link=link),
        summary=", ".join(map(str, seen)) + (f"; in doubt: {', '.join(in_doubt)}" if in_doubt else ""),
    )


def _guide(context: StepContext, remain: bool) -> SeenUnchanged:
    """The guide on its gauge. One that has changed is not led to what remains before it was checked again."""
    try:
        found = read_on_gauge(context)
    except REFUSED as problem:
        if not context.workcell.place.is_home:  # it was reached, and the way back is not clear
            raise
        doubt(context, f"the gauge cannot be reached, so the guide was not checked: {problem.summary}")
        return SeenUnchanged.guide(None)
    if found.differs:
        off = f"{found.off_mm:.2f} mm and {found.tilt_deg:.2f} deg"
        reason = f"the guide is {off} from its record after {context.trajectory}"
        doubt(context, reason)
        if remain:
            context.void(CheckedTool, ToolUnchecked(reason))
    return SeenUnchanged.guide(found.off_mm, differs=found.differs)


def _room(context: StepContext, remain: bool) -> RoomLook:
    """Head and base by the tracker. What hangs on one that has moved is void, where targets remain."""
    setting, where = context.setting, f"after {context.trajectory}"
    watch = room_watch(context)
    reading = read_room(setting.workcell, setting.clock, watch.robot_from_tracker, CAREFUL_FRAMES)
    look = watch.compare(reading, setting.clock.now_s())
    if isinstance(look.moved, BaseShifted | PatientMoved) and remain:
        void_moved(context, look.moved)
        setting.memory.drop(RoomWatch)
        if not context.stands(GlobalLocalization):
            raise look.moved
    elif look.moved is not None:
        doubt(context, f"{where}: {look.moved.summary}")
    else:
        for finding in look.findings:
            context.find(f"{where}: {finding}")
        unseen = {"head": look.head_mm is None, "frame on the arm": look.base is None}
        for subject in (name for name, hidden in unseen.items() if hidden):
            doubt(context, f"{where} the tracker does not see the {subject}: it may have moved meanwhile")
    return look


def unconfirmed(context: StepContext) -> tuple[str, ...]:
    """The targets worked at, or begun to be, since the last look that showed nothing."""
    confirmed = context.done_for(ConfirmedTarget, lambda look: not look.in_doubt)
    stages = context.workcell.instrument.stages
    return tuple(name for name in context.trajectories if stages.at(name) and name not in confirmed)


def doubt(context: StepContext, reason: str, *, again: bool = True) -> None:
    """Record a finding on the unconfirmed targets; unless `again`, on those without a look only."""
    looked = () if again else context.done_for(ConfirmedTarget)
    if targets := tuple(name for name in unconfirmed(context) if name not in looked):
        context.find(f"{' and '.join(targets)} in doubt: {reason}", targets)


def void_moved(context: StepContext, moved: RonnaError) -> None:
    """Void the registrations that may follow a small move, with the guide mounted; else the localization.

    A cart that has moved was not locked. Nobody knows when something moved: unconfirmed targets are in doubt.
    """
    doubt(context, moved.summary)
    may_follow = (
        isinstance(moved, PatientMoved)
        and moved.moved_mm <= MOST_FOLLOWED_MM
        and context.workcell.tool is MountedTool.GUIDE
        and context.stands(RegisteredRobot)
    )
    if may_follow:
        context.void_each(RegisteredRobot, moved)
    elif isinstance(moved, BaseShifted) and moved.cart and context.stands(LockedCart):
        context.void(LockedCart, moved)
    else:
        context.void(GlobalLocalization, moved)


def _at_home(context: StepContext) -> tuple[str, ...]:
    return (*carries(MountedTool.GUIDE)(context), *away_from_head(context))


STEP = StepSpec(
    ConfirmedTarget,
    "Look again at head, cart and guide",
    Phase.OPERATION,
    run,
    asks=(Topic.TOOL_CHECK, Topic.INSTRUMENT_OUT, Topic.PARK),
    scope=Scope.TRAJECTORY,
    reads=(ReachedTarget, Retreated, MountedGuide, *ROOM_READS, *READS),
    moves=True,
    preconditions=_at_home,
)
