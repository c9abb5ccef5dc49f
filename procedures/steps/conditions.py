"""Preconditions shared by several steps, and a limit on the age of readings."""

from __future__ import annotations

from collections.abc import Callable

from procedures.engine.context import StepContext
from procedures.steps.errors import ReadingTooOld
from procedures.workcell import MountedTool

REMOUNTED = "; with {arms} home, run global_localization: it is mounted there again"
# Safety against a reading of depth stop or gauge that is old (U).
LONGEST_S = 3600.0  # theatre time; a check on the gauge takes minutes, skin, skull and dura half an hour


def needs_tool(tool: MountedTool, remedy: str = "") -> Callable[[StepContext], tuple[str, ...]]:
    """Require a given tool on an arm that is on no axis, identifying an unknown tool first.

    `remedy` names the step that mounts it instead of the guide, if no earlier step is listed; `{arms}` in it
    stands for the arms of the case.
    """

    def unmet(context: StepContext) -> tuple[str, ...]:
        reasons = []
        workcell = context.workcell
        if workcell.master.tool is MountedTool.UNKNOWN:
            workcell.master.mount.identify()
        if workcell.master.tool is not tool:
            remounting = workcell.master.tool is MountedTool.GUIDE
            instead = remedy.format(arms=workcell.phrases.arms) if remounting else ""
            carrier = workcell.master.spoken_name
            reasons.append(f"the {carrier} carries the {workcell.master.tool}, not the {tool}{instead}")
        return (*reasons, *workcell.master.place.hold_reasons)

    return unmet


def needs_exchangeable_tool(context: StepContext) -> tuple[str, ...]:
    """Require the stereo head or, during an exchange, a parked arm that cannot move."""
    workcell = context.workcell
    unmet = needs_tool(MountedTool.STEREO_HEAD)(context)
    if not unmet or context.done_before:
        return unmet
    return () if not workcell.master.streaming and workcell.master.place.is_home else unmet


def needs_guide_unmounted(context: StepContext) -> tuple[str, ...]:
    """Require that the guide is not mounted: later localizations could not be redone with it."""
    workcell = context.workcell
    if workcell.master.tool is MountedTool.GUIDE:
        return (
            f"the {workcell.master.spoken_name} carries the guide: if this result changed, the spheres "
            "could not be localized again; if it must change, send "
            f"{workcell.phrases.arms} home and start a new run",
        )
    return ()


def needs_arm_home(context: StepContext) -> tuple[str, ...]:
    """Require every arm at home, so that none is over the head while staff work at cart or clamp."""
    away = [arm for arm in context.workcell.arms.values() if not arm.place.is_home]
    if not away:
        return ()
    return away[0].place.hold_reasons or (
        f"the {away[0].spoken_name} is not home: send it there first (home)",
    )


def needs_insertion(context: StepContext) -> tuple[str, ...]:
    """Require the guide in front of this step's entry."""
    if (current_trajectory := context.workcell.master.place.trajectory) == context.trajectory:
        return ()
    where = (
        "on no axis" if current_trajectory is None else f"held in front of the entry of {current_trajectory}"
    )
    return (f"the guide is {where}, not in front of that of {context.trajectory}",)


def needs_insertion_or_withdrawal(context: StepContext) -> tuple[str, ...]:
    """Require the guide in front of this step's entry, or just withdrawn from it."""
    if context.workcell.master.place.withdrawn_from == context.trajectory:
        return ()
    return needs_insertion(context)


def require_recent(context: StepContext, what: str, read_s: float) -> None:
    """Raise TOOL-007 if a manual reading, taken at theatre time `read_s`, is too old to rely on."""
    age_s = context.setting.clock.now_s() - read_s
    if age_s > LONGEST_S:
        raise ReadingTooOld(
            f"{what}: read too long ago", limit=f"{LONGEST_S / 60:.0f} min", got=f"{age_s / 60:.0f} min"
        )
