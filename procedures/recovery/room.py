"""Patient and robot base after a restart: the tracker measures both again, as a step does at rest.

The spheres on the head are compared as far as the tracker sees them; the robot's base by the reference frame
on the arm, in poses with the orientation in which both were recorded.
"""

from __future__ import annotations

from functools import partial

from procedures.engine.engine import Engine
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_reading import read_room
from procedures.guards.stability import CAREFUL_FRAMES
from procedures.recovery.comparison import Comparison
from procedures.registration.movement import shift_of
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import RegisteredRobot
from procedures.steps.clinical.room import build_watch, followed_registration, followed_spheres, frame_at_home
from procedures.workcell import MountedTool


def compare_room(engine: Engine, comparison: Comparison) -> bool:
    """Compare both; False when the tracker sees too little of the head from here. Raises its errors."""
    stored = engine.case.find(GlobalLocalization, None)
    if stored is None:
        what = "patient" if engine.setting.clinical is not None else "stand"
        comparison.note(f"{what} and robot base: not recorded yet, nothing to compare")
        return True
    workcell, matched = engine.setting.workcell, engine.case.find(Correspondence, None)
    pairs = None if matched is None else matched.result.pairs
    watch = build_watch(workcell, stored.record.identifier, stored.result, pairs)
    context = engine.context(engine.order.sequence[0])
    followed = context.result_among(RegisteredRobot, partial(followed_registration, trajectory=None))
    watch.follow(followed_spheres(followed))
    watch.refer(frame_at_home(context))
    reading = read_room(workcell, engine.setting.clock, watch.robot_from_tracker, CAREFUL_FRAMES)
    head, base = shift_of(watch.spheres_mm, reading.spheres_mm), watch.base_shift(reading)
    if head is None:
        return False
    try:
        findings = watch.compare(reading).require()
    except PatientMoved as moved:
        if context.stands(RegisteredRobot) or workcell.tool is not MountedTool.GUIDE:
            comparison.differs("room", f"all within {moved.limit}", moved.what)
        else:  # hence none is valid: the step registration asks whether to follow the move
            comparison.note(f"patient: {moved.what}; no registration is valid")
        return True
    except BaseShifted as moved:
        comparison.differs("room", f"all within {moved.limit}", moved.what)
        return True
    if reading.frame_mm is None and workcell.place.is_home:
        comparison.differs("robot base", "the frame on the arm in view", "the tracker does not see it")
        return True
    comparison.note(f"patient: spheres within {head.rms_mm:.2f} mm of their recorded positions")
    if base is None:
        comparison.note("robot base: not compared in this pose")
    else:
        comparison.note(
            f"robot base: the frame on the arm within {base.moved_mm:.2f} mm of its recorded position"
        )
    comparison.notes += findings
    return True
