"""Look after a target: have head, base or guide moved since the guide went to it?

This look finds a move since the one before. Nobody knows when it happened, so every target worked at since is
in doubt. Results that no longer hold are not used for another target.
"""

from __future__ import annotations

from procedures.engine.context import StepContext
from procedures.engine.errors import TOOL_UNCHECKED
from procedures.engine.order import Outcome, Phase, Scope, StepSpec
from procedures.guards.errors import RoomMoved
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomLook, RoomWatch, read_watched
from procedures.guards.stability import SeenUnchanged, Subject, guide_noticeable_mm
from procedures.operator.question import Topic
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.positioning import REFUSALS
from procedures.steps.clinical.results import ConfirmedTarget, running_link_health
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.room import ROOM_READS, doubt, list_unconfirmed_targets, room_watch, void_moved
from procedures.steps.clinical.surroundings import READS
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool, read_on_gauge
from procedures.steps.conditions import needs_arm_home, needs_tool
from procedures.workcell import MountedTool


def run(context: StepContext) -> Outcome[ConfirmedTarget]:
    """Check the guide on its gauge, then head and base from home.

    Raises PRO-019, PRO-020 or PRO-051 if something has moved and remaining targets cannot follow it.
    """
    for model in context.reads:
        context.result(model)
    context.workcell.master.mount.check(MountedTool.GUIDE)
    targets_remain = bool(set(context.remaining) - set(context.trajectories_done(ReachedTarget)))
    guide = _check_guide(context, targets_remain)
    link, other = running_link_health(context)
    context.workcell.rest()  # it may have been the last target
    watch = room_watch(context)
    look = _check_room(context, watch, targets_remain)
    seen = (*_compare_at_target(watch, context.trajectory, look), guide)
    unchanged = look.in_place and not look.spheres_hidden and guide.unchanged
    in_doubt = () if unchanged else list_unconfirmed_targets(context)
    return Outcome(
        ConfirmedTarget(seen=seen, in_doubt=in_doubt, link=link, assistant_link=other),
        summary=", ".join(map(str, seen)) + (f"; in doubt: {', '.join(in_doubt)}" if in_doubt else ""),
    )


def _check_guide(context: StepContext, targets_remain: bool) -> SeenUnchanged:
    """Check the guide on its gauge. A changed guide must be checked again before remaining targets."""
    try:
        found = read_on_gauge(context)
    except REFUSALS as problem:
        if not context.workcell.master.place.is_home:  # it was reached, and the way back is not clear
            raise
        doubt(context, f"the gauge cannot be reached, so the guide was not checked: {problem.summary}")
        return SeenUnchanged.guide(None, guide_noticeable_mm(context.workcell.master.arm.kinematics.name))
    if found.differs:
        off = f"{found.off_mm:.2f} mm and {found.tilt_deg:.2f} deg"
        reason = f"the guide is {off} from its record after {context.trajectory}"
        doubt(context, reason)
        if targets_remain:
            context.void(CheckedTool, TOOL_UNCHECKED(reason))
    return SeenUnchanged.guide(found.off_mm, found.noticeable_mm, differs=found.differs)


def _check_room(context: StepContext, watch: RoomWatch, targets_remain: bool) -> RoomLook:
    """Check head and base by the tracker. If targets remain, a move voids the results that depend on it."""
    setting, occasion = context.setting, f"after {context.trajectory}"
    judged = read_watched(watch, setting.workcell, CAREFUL_FRAMES)
    look = watch.compare(judged, setting.clock.now_s())
    if isinstance(look.moved, RoomMoved) and targets_remain:
        void_moved(context, look.moved)
        setting.memory.drop(RoomWatch)
        if not context.stands(GlobalLocalization):
            raise look.moved
    elif look.moved is not None:
        doubt(context, f"{occasion}: {look.moved.summary}")
    else:
        for finding in look.findings:
            context.find(f"{occasion}: {finding}")
        unseen = {"head": look.head_mm is None, "frame on the arm": look.base_mm is None}
        for subject in (name for name, hidden in unseen.items() if hidden):
            doubt(context, f"{occasion} the tracker does not see the {subject}: it may have moved meanwhile")
        if look.spheres_hidden:
            doubt(
                context,
                f"{occasion} the spheres are hidden: the frame on the clamp is in its place, but the head "
                "may have slipped in the clamp",
            )
    return look


def _compare_at_target(
    watch: RoomWatch, trajectory: str, look: RoomLook
) -> tuple[SeenUnchanged, SeenUnchanged]:
    """Return how far head and base may have displaced the guide at the target since the look before.

    What the frame shows of the clamp is no sight of the head in it. If something has moved: how far.
    """
    changes = watch.changes_at(trajectory)
    seen_mm = {"head": None if look.spheres_hidden else look.head_mm, "base": look.base_mm}
    found = []
    for body, subject in (("head", Subject.HEAD), ("base", Subject.BASE)):
        (way_mm, noticed_mm), moved_mm = changes[body], seen_mm[body]
        if look.moved is None and moved_mm is not None:
            moved_mm = way_mm
        differs = look.moved is not None
        found.append(
            SeenUnchanged(subject=subject, moved_mm=moved_mm, noticeable_mm=noticed_mm, differs=differs)
        )
    return found[0], found[1]


STEP = StepSpec(
    ConfirmedTarget,
    "Look again at head, cart and guide",
    Phase.OPERATION,
    run,
    asks=(Topic.TOOL_CHECK, Topic.INSTRUMENT_OUT, Topic.PARK),
    scope=Scope.TRAJECTORY,
    reads=(ReachedTarget, Retreated, MountedGuide, *ROOM_READS, *READS),
    moves=True,
    preconditions=lambda context: (*needs_tool(MountedTool.GUIDE)(context), *needs_arm_home(context)),
)
