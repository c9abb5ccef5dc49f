"""Comparison of a resumed run's assistant with the journal and, in the guide, with its tracked frame.

An instrument in the guide is led out along the axis that the assistant's joints have. If a cart was displaced
meanwhile, that is not the axis of the bore any more: no arm draws the instrument against the guide.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from procedures.engine.engine import Engine
from procedures.engine.run_folder import parse_record
from procedures.guards.assistant_frame import SHIFTED_MM
from procedures.guards.errors import InsertionDisturbed
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.journal.results import StepResult
from procedures.runs.comparison import Comparison
from procedures.runs.interrupted_run import InterruptedRun
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.two_arms.assisted_insertion import SEEN_APART_RAD, compare_frames
from procedures.steps.clinical.two_arms.base_to_base import KnownBases
from procedures.workcell import InsertionAxis
from procedures.workcell.arm_history import fold_history
from procedures.workcell.assistant import Assistant
from procedures.workcell.errors import TipOffAxis
from procedures.workcell.patient_frame import seen_after
from procedures.workcell.tracker_look import mean_pose, read_frames_at_rest
from ronna_hw.config import ASSISTANT
from ronna_hw.errors import RonnaError
from ronna_hw.records import Record
from ronna_hw.text import format_against_limit

R = TypeVar("R", bound=StepResult)

BY_HAND = (
    "No arm leads the instrument out; move none while it is in the guide. By hand: hold the instrument, open "
    "the clamp of the assistant's holder, and draw the instrument straight out of the guide. Lock the carts, "
    "jog the assistant home with its pendant, then repeat the command"
)
LOOK_AT_CART = (
    "before you accept, look that its cart is locked and the instrument does not press on the guide"
)


def compare_assistant(engine: Engine, previous: InterruptedRun, comparison: Comparison) -> None:
    """Compare where the assistant is with the journal; refuse a way out that nobody can check.

    Its devices are configured.
    """
    workcell = engine.setting.workcell
    if (assistant := workcell.assistant) is None:
        return
    if (axis := assistant.place.axis) is not None:
        try:
            assistant.require_on_axis()
        except TipOffAxis as problem:
            comparison.add_difference("the assistant", f"on the axis of {axis.trajectory}", problem)
        else:
            _compare_with_frame(engine, assistant, axis, comparison)
    if assistant.history.base is None and workcell.is_any_arm_out:
        comparison.refuse(
            "an arm is away from its home, and the journal does not say where the assistant stands: jog both "
            "arms home with their pendants, one at a time"
        )
    was_home = fold_history(previous.chain, previous.lost, ASSISTANT).place.is_home
    if was_home and assistant.place.is_out:
        comparison.warn("the assistant was at its home and is not any more: somebody has moved it")


def _compare_with_frame(
    engine: Engine, assistant: Assistant, axis: InsertionAxis, comparison: Comparison
) -> None:
    """Refuse the way out along `axis` if the tracker sees the assistant beside it.

    Counted across the axis, and from the master's frame. Where the tracker sees too little, warn.
    """
    workcell = engine.setting.workcell
    bases, localized = _find_last(engine, KnownBases), _find_last(engine, GlobalLocalization)
    if bases is None or localized is None:
        comparison.warn(f"no record says where the assistant's frame was seen: {LOOK_AT_CART}")
        return
    move = workcell.tracker_move(localized[0].identifier).move.inverse()
    try:
        read, _ = read_frames_at_rest(workcell.tracker, engine.setting.clock, count=CAREFUL_FRAMES)
    except RonnaError as problem:
        comparison.warn(f"the assistant was not compared with its frame ({problem.summary}): {LOOK_AT_CART}")
        return
    frames = [seen_after(move, one) for one in read]
    names = workcell.calibrations.tracker_frame.tool, assistant.holder.frame
    on_master, on_assistant = (mean_pose(frames, name, CAREFUL_FRAMES // 2) for name in names)
    if on_master is None or on_assistant is None:
        hidden = names[0] if on_master is None else names[1]
        comparison.warn(f"the tracker does not see {hidden}: {LOOK_AT_CART}")
        return
    apart = compare_frames(workcell, assistant, bases[1], axis.arriving, on_master, on_assistant)
    along = assistant.base.rotation_matrix @ axis.held.rotation_matrix[:, 2]
    across_mm = float(np.linalg.norm(apart.way_mm - (apart.way_mm @ along) * along))
    got = f"{format_against_limit(across_mm, SHIFTED_MM, 2)} mm, {math.degrees(apart.turned_rad):.2f} deg"
    if across_mm <= SHIFTED_MM and apart.turned_rad <= SEEN_APART_RAD:
        comparison.note(f"assistant: its frame within {got} across the axis of {axis.trajectory}")
        return
    displaced = InsertionDisturbed(
        f"the tracker sees the assistant beside the axis of {axis.trajectory}, with the instrument in the "
        "guide: a cart was displaced, or a frame or the tracker",
        limit=f"{SHIFTED_MM:g} mm, {math.degrees(SEEN_APART_RAD):g} deg",
        got=got,
        action=BY_HAND,
    )
    comparison.refuse(str(displaced))


def _find_last(engine: Engine, model: type[R]) -> tuple[Record, R] | None:
    """Return the last result, also if void: it tells how the arms stood when the instrument was led in."""
    made = [record for record in engine.case.records if record.kind == model.kind]
    return (made[-1], parse_record(made[-1], model)) if made else None
