"""Tracked frames of both arms with the instrument in the guide, before the assistant leads it out.

That way leads along the axis that the assistant's joints have. If a cart was displaced since a halt, it is
not the axis of the bore any more: no arm draws the instrument against the guide.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from procedures.guards.assistant_frame import SHIFTED_MM, AssistantFrame
from procedures.guards.errors import InsertionDisturbed
from procedures.steps.clinical.two_arms.base_to_base import KnownBases
from procedures.strategies.strategy import Sides
from procedures.workcell import Workcell
from procedures.workcell.assistant import Assistant
from procedures.workcell.tracker_look import FrameHidden, see_both_arms
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.errors import RonnaError
from ronna_hw.frames import Transform
from ronna_hw.text import format_against_limit

SEEN_APART_RAD = math.radians(0.5)  # three standard errors of the frames' angles
BY_HAND = (
    "No arm leads the instrument out; move none while it is in the guide. By hand: hold the instrument, open "
    "the clamp of the assistant's holder, and draw the instrument straight out of the guide. Lock the carts, "
    "jog the assistant home with its pendant, then repeat the command"
)
LOOK_AT_CART = (
    "before you accept, look that its cart is locked and the instrument does not press on the guide"
)


class FramesApart(NamedTuple):
    """Way (3,) mm, robot frame, and angle from the assistant's frame by the joints to that by the tracker."""

    way_mm: NDArray[np.float64]
    turned_rad: float


class NotCompared(Exception):
    """The tracker, or the records, tell too little."""


def look_before_retreat(
    workcell: Workcell, known: KnownBases | None, read: Callable[[], list[TrackerFrame]]
) -> str:
    """Return what staff must look at where the tracker shows too little, or ''. Raises PRO-054."""
    try:
        require_seen_on_axis(workcell, known, read)
    except NotCompared as unknown:
        return f"{unknown}: {LOOK_AT_CART}"
    return ""


def has_stayed(
    watched: AssistantFrame,
    read: Callable[[], list[TrackerFrame]],
    robot_from_tracker: Transform,
    trajectory: str | None,
) -> bool:
    """Return whether the tracker sees the assistant where it was over the guide, False if too little.

    `read` returns frames in the tracker frame of the localization. Raises PRO-054 if it sees it beside.
    """
    watched.begin_watch()
    with suppress(RonnaError):  # else the comparison with the joints says what is lacking
        for frame in read():
            watched.add_frame(frame, robot_from_tracker)
    if watched.shifted_mm > SHIFTED_MM:
        raise InsertionDisturbed(
            f"the tracker sees the assistant beside where it was over the guide at {trajectory}: "
            "a cart was displaced, or a frame or the tracker",
            limit=f"{SHIFTED_MM:g} mm",
            got=f"{format_against_limit(watched.shifted_mm, SHIFTED_MM, 2)} mm",
            action=BY_HAND,
        )
    return watched.has_seen


def require_seen_on_axis(
    workcell: Workcell, known: KnownBases | None, read: Callable[[], list[TrackerFrame]]
) -> str:
    """Return how far the tracker sees the assistant across its axis, and turned.

    Counted from the master's frame; `read` returns frames in the tracker frame of the localization. Raises
    PRO-054 beyond the limits, `NotCompared` if the tracker shows too little.
    """
    assistant = workcell.assistant
    assert assistant is not None
    axis = assistant.place.axis
    assert axis is not None
    if known is None:
        raise NotCompared("no record says where the assistant's frame was seen")
    try:
        on_master, on_assistant = see_both_arms(workcell, read())
    except RonnaError as problem:
        raise NotCompared(f"the assistant was not compared with its frame ({problem.summary})") from problem
    except FrameHidden as hidden:
        raise NotCompared(f"the tracker does not see {hidden}") from hidden
    apart = compare_frames(workcell, assistant, known, axis.arriving, on_master, on_assistant)
    along = known.robot_from_base.transform.rotation_matrix @ axis.held.rotation_matrix[:, 2]
    across_mm = float(np.linalg.norm(apart.way_mm - (apart.way_mm @ along) * along))
    got = f"{format_against_limit(across_mm, SHIFTED_MM, 2)} mm, {math.degrees(apart.turned_rad):.2f} deg"
    if across_mm <= SHIFTED_MM and apart.turned_rad <= SEEN_APART_RAD:
        return got
    raise InsertionDisturbed(
        f"the tracker sees the assistant beside the axis of {axis.trajectory}, with the instrument in the "
        "guide: a cart was displaced, or a frame or the tracker",
        limit=f"{SHIFTED_MM:g} mm, {math.degrees(SEEN_APART_RAD):g} deg",
        got=got,
        action=BY_HAND,
    )


def compare_frames(
    workcell: Workcell,
    assistant: Assistant,
    known: KnownBases,
    arriving: Sides,
    on_master: Transform,
    on_assistant: Transform,
) -> FramesApart:
    """Compare the frames of both arms by the tracker, TRACKER <- MARKER at its localization, with the joints.

    The base is the one measured: where a look has since seen the assistant does not show whether it stood.
    The joints of the assistant have arrived from the sides `arriving`.
    """
    held_on = workcell.place.axis
    arrived = None if held_on is None else held_on.arriving
    flange = known.robot_from_base.transform @ assistant.flange_pose(assistant.joints_rad(), arriving)
    by_joints = (flange @ known.flange_from_frame.transform).rigid
    turn = known.robot_from_tracker.transform.rigid.rotation
    # From the master's frame: the tracker's smooth error is much the same for both.
    seen_mm = turn.apply(on_assistant.translation_mm - on_master.translation_mm)
    by_master = (
        workcell.flange_pose(workcell.joints_rad(), arrived) @ known.flange_from_master_frame.transform
    )
    held_mm = by_joints.translation - by_master.translation_mm
    turned_rad = float((by_joints.rotation.inv() * turn * on_assistant.rigid.rotation).magnitude())
    return FramesApart(seen_mm - held_mm, turned_rad)
