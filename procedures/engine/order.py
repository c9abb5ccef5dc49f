"""The order of the clinical steps: their phases, which may follow which, and the sequence of a whole case.

It stands here and nowhere else: the state chart and the engine are made from it.
"""

from __future__ import annotations

from collections.abc import Sequence

from procedures.engine.step import StepKey

IDLE = "idle"
PHASES: dict[str, tuple[str, ...]] = {
    "preoperative": ("ct_import", "fiducial_localization", "plan_check"),
    "preparation": ("set_up", "global_localization", "correspondence", "path_check"),
    "operation": ("relocalization", "registration", "tool_change", "positioning", "at_target", "retreat"),
}
# For every step: which steps may come right before it.
PREDECESSORS: dict[str, tuple[str, ...]] = {
    "ct_import": (IDLE,),
    "fiducial_localization": ("ct_import",),
    "plan_check": ("fiducial_localization",),
    "set_up": ("plan_check",),
    "global_localization": ("set_up",),
    "correspondence": ("global_localization",),
    "path_check": ("correspondence",),
    "relocalization": ("path_check", "registration"),
    "registration": ("relocalization",),
    "tool_change": ("registration",),
    "positioning": ("tool_change", "retreat"),
    "at_target": ("positioning",),
    "retreat": ("at_target",),
}
# Of these a trajectory's step follows that of the same trajectory only.
SAME_TRAJECTORY = {("relocalization", "registration"), ("positioning", "at_target"), ("at_target", "retreat")}
ENDS = ("finished", "fault", "aborted")
LOCALIZING = ("relocalization", "registration")  # for every trajectory, before the tool change
TARGETING = ("positioning", "at_target", "retreat")  # for every trajectory, after it


def may_follow(step: StepKey, before: StepKey | None) -> bool:
    """Whether `step` may come right after `before`; None is the beginning of the case."""
    if before is None:
        return IDLE in PREDECESSORS[step.name]
    if before.name not in PREDECESSORS[step.name]:
        return False
    return (before.name, step.name) not in SAME_TRAJECTORY or before.trajectory == step.trajectory


def sequence_of(trajectories: Sequence[str]) -> tuple[StepKey, ...]:
    """The steps of a whole case: every localization of every trajectory before the tool change."""
    return (
        *(StepKey(name) for name in (*PHASES["preoperative"], *PHASES["preparation"])),
        *(StepKey(name, trajectory) for trajectory in trajectories for name in LOCALIZING),
        StepKey("tool_change"),
        *(StepKey(name, trajectory) for trajectory in trajectories for name in TARGETING),
    )
