"""What a step would move, by the motions that the path check has previewed; nothing is asked or moved."""

from __future__ import annotations

from procedures.engine.case import Case
from procedures.engine.step import StepKey
from procedures.planning.reach.motions import HOME
from procedures.steps.clinical.path_check import CheckedPaths
from procedures.steps.clinical.paths.previews import MotionPreview
from procedures.steps.clinical.positioning import PositionedGuide
from procedures.steps.clinical.relocalization import Relocalization
from procedures.steps.clinical.retreat import Retreated
from procedures.steps.clinical.tool_change import MountedGuide
from procedures.steps.clinical.tool_check import CheckedTool

MOVE, LINE = "move", "line"


def would_move(case: Case, key: StepKey) -> tuple[str, ...] | None:
    """One line for each motion of a step; None before the path check."""
    paths = case.find(CheckedPaths, None)
    if paths is None:
        return None
    if key.name == CheckedTool.kind:
        return ("move home to the gauge and back; checked for clearance right before",)
    lines = [_described(one) for one in paths.result.motions if _belongs(one, key)]
    if key.name == Retreated.kind:
        lines = [*(f"back: {line}" for line in lines if LINE in line), *(one for one in lines if MOVE in one)]
    return tuple(lines)


def _belongs(motion: MotionPreview, key: StepKey) -> bool:
    sphere, target = "/fiducial", "/target"
    own = f"{key.trajectory}/" if key.trajectory else ""
    if key.name == Relocalization.kind:
        return motion.end.startswith(own) and sphere in motion.end
    if key.name == MountedGuide.kind:
        return motion.end == HOME and sphere in motion.start
    if key.name == PositionedGuide.kind:
        return motion.end == f"{key.trajectory}{target}"
    if key.name == Retreated.kind:
        return motion.start == f"{key.trajectory}{target}"
    return False


def _described(motion: MotionPreview) -> str:
    near = motion.closest
    passing = "" if near is None else f"; {near.first} passes {near.second} at {near.distance_mm:.0f} mm"
    ends = f"{motion.start} to {motion.end}" if motion.start != motion.end else f"onto {motion.end}"
    speed = f"{motion.duration_s:.1f} s at up to {motion.largest_speed_mm_s:.0f} mm/s"
    return f"{motion.kind} {ends}, {speed}{passing}"
