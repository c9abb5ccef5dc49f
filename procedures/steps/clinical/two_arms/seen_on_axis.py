"""Look at both arms with the instrument in the guide, before the assistant leads it out.

That way leads along the axis that the assistant's joints have. If a cart was displaced since a halt, it is
not the axis of the bore any more: no arm draws the instrument against the guide.
"""

from __future__ import annotations

from procedures.guards.assistant_on_axis import BETTER_FRAMES, LARGEST_OFF_MM, BesideBore, beside_bore
from procedures.guards.errors import InsertionDisturbed
from procedures.guards.room_reading import CAREFUL_FRAMES
from procedures.guards.room_watch import RoomWatch
from procedures.room.motion import Moved
from procedures.room.sighting import Tracked
from procedures.workcell import Workcell
from procedures.workcell.tracker_look import read_frames_at_rest
from ronna_hw.errors import RonnaError
from ronna_hw.text import format_against_limit

LOOK_AT_CART = (
    "before you accept, look that its cart is locked and the instrument does not press on the guide"
)
OF_THE_HEAD = (Moved.HEAD, Moved.HEAD_IN_CLAMP, Moved.CLAMP_FRAME, Moved.TRACKER, Moved.HEAD_OR_TRACKER)


class NotCompared(Exception):
    """The tracker, or the records, tell too little."""


def look_before_retreat(workcell: Workcell, watch: RoomWatch | None) -> str:
    """Return what staff must look at where the tracker shows too little, or ''. Raises PRO-054."""
    try:
        require_seen_on_axis(workcell, watch)
    except NotCompared as unknown:
        return f"{unknown}: {LOOK_AT_CART}"
    return ""


def require_seen_on_axis(workcell: Workcell, watch: RoomWatch | None) -> BesideBore:
    """Return how far the instrument may be beside the bore, by a look at both arms.

    Raises PRO-054 if the bore may be further off than the instrument gives way, or an arm is not where its
    joints have it; `NotCompared` if the tracker shows too little. What the head does is for later looks.
    """
    if watch is None or watch.bases is None:
        raise NotCompared("no record says where the assistant's frame was seen")
    for count in (CAREFUL_FRAMES, BETTER_FRAMES):
        try:
            frames, _ = read_frames_at_rest(workcell, count=count)
            judged = watch.judge(watch.read(workcell, frames))
        except RonnaError as problem:
            raise NotCompared(
                f"the assistant was not compared with its frame ({problem.summary})"
            ) from problem
        found, motion = beside_bore(workcell, watch, judged), judged.motion
        if found is None:
            raise NotCompared("the tracker does not see the frame on the assistant")
        if found.is_within and (motion is None or motion.moved in OF_THE_HEAD):
            if Tracked.ARM not in judged.look.frames:  # the cart of the guide counts as well
                raise NotCompared("the tracker does not see the frame on the arm with the guide")
            return found
        limit_mm, got_mm = LARGEST_OFF_MM, found.largest_mm
        if found.is_within and motion is not None:  # an arm is not where its joints have it
            limit_mm, got_mm = motion.limit_mm, motion.moved_mm
    axis = workcell.assistant.place.axis
    raise InsertionDisturbed(
        f"the tracker sees the assistant beside the axis of {'' if axis is None else axis.trajectory}, with "
        "the instrument in the guide: a cart was displaced, or a frame",
        limit=f"{limit_mm:.2f} mm",
        got=f"{format_against_limit(got_mm, limit_mm, 2)} mm ({found})",
        action=InsertionDisturbed.by_hand,
    )
